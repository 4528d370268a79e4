"""Facts about a swarm other than its motion: the scenario, and the constraint sets of the robots that take part.

The sets are computed once per membership, in the background.
"""

from __future__ import annotations

import time
from itertools import chain
from math import fsum, isfinite, nan
from threading import Thread
from typing import TYPE_CHECKING, Literal

from swarmabs_bag.shown.swarm_state import Members, finite
from swarmabs_config.scenario import PlaneScenario
from swarmabs_core.systems import PLANE_TABLES
from swarmabs_core.theory.constraint_sets import ConstraintSets
from swarmabs_view.presenter import Presenter
from swarmabs_view.protocol import Hello, Manifold, Plane, Regions, Sets

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from swarmabs_config.model.scenario import Scenario

    Work = Callable[[], None]

_FEW, _SAMPLES = 10, 40
"""Torques on each side of 0 at which the boundaries of the sets are computed; four times as many for few robots, where
J_max has corners and is cheap."""
_MARGIN = 1.1
"""Range of the torques, over that of the manifold."""

MOST = 64
"""Most memberships whose sets are kept."""
REST = 4.0
"""Pause after a computation, as a multiple of its duration: one for 21 different masses takes a second."""


def hello_of(
    source: Literal["bag", "run", "swarm"],
    title: str,
    place: str,
    scenario: Scenario | None = None,
    last_step: int | None = None,
) -> Hello:
    """Return the hello of a swarm without its robots; without a scenario, the plane until a system describes itself."""
    hello = Hello(
        source=source,
        title=title,
        place=place,
        period=None,
        last_step=None,
        system=Presenter(PLANE_TABLES if scenario is None else scenario.tables).system,
        robots=[],
        plane=None,
        manifold=None,
        regions=None,
        playback=source == "bag",
    )
    if scenario is None:
        return hello
    steps = scenario.steps if last_step is None else last_step
    hello = hello.model_copy(update={"period": scenario.period, "last_step": steps})
    if not isinstance(scenario, PlaneScenario):
        return hello
    plane, manifold = scenario.plane, scenario.manifold
    masses = [agent.mass for agent in scenario.initial_agents]
    heights = {agent.id: agent.center_height for agent in scenario.agents if agent.center_height}
    of_plane = {
        "plane": Plane(length=plane.length, inertia=plane.inertia, gravity=plane.gravity, heights=heights),
        "manifold": Manifold(curvature=manifold.curvature, offset=manifold.offset, torque_max=manifold.torque_max),
        "regions": regions(masses, plane.length, plane.gravity, manifold.torque_max),
    }
    return hello.model_copy(update=of_plane)


def regions(
    masses: Sequence[float],
    length: float,
    gravity: float,
    torque_max: float,
    standing: Sequence[tuple[float, float]] = (),
) -> Regions | None:
    """Sample the boundaries of A_A and A_P for moving robots and weights at rest.

    The robots are given by mass (kg, at least two), the plane by length (m), gravity in m/s^2. Weights at rest, given
    by mass (kg) and position (m), add a constant torque and a constant inertia. The range extends somewhat beyond the
    largest torque of the manifold (N m), but not beyond the largest torque of robots on the plane.
    """
    if len(masses) < 2 or not all(map(isfinite, (*masses, *chain.from_iterable(standing)))):
        return None
    shift = gravity * fsum(mass * place for mass, place in standing)
    lift = fsum(mass * place**2 for mass, place in standing)
    sets = ConstraintSets(masses, length, gravity)
    reach = min(_MARGIN * torque_max + abs(shift), sets.largest_torque)
    samples = 4 * _SAMPLES if len(masses) <= _FEW else _SAMPLES
    # Without the weights at rest, the sets are symmetric in the torque.
    half = [reach * index / samples for index in range(samples + 1)]
    curves = [
        [finite(lift + sets.smallest_inertia(torque)) for torque in half],
        [finite(lift + sets.largest_admissible_inertia(torque)) for torque in half],
        [finite(lift + sets.largest_inertia(torque).lower) for torque in half],
    ]
    smallest, admissible, reachable = ([*reversed(curve[1:]), *curve] for curve in curves)
    return Regions(
        torque=[shift + torque for torque in (*(-torque for torque in reversed(half[1:])), *half)],
        smallest=smallest,
        admissible=admissible,
        reachable=reachable,
    )


def in_background(work: Work) -> Thread:
    """Run a function in a daemon thread, which pauses afterwards."""

    def run() -> None:
        begun = time.monotonic()
        work()
        time.sleep(REST * (time.monotonic() - begun))

    thread = Thread(target=run, daemon=True)
    thread.start()
    return thread


class Shading:
    """The sets to shade, by membership: `first` are those of the hello; `run` computes others in the background."""

    def __init__(self, hello: Hello, run: Callable[[Work], Thread | None] = in_background) -> None:
        self._hello = hello
        self._run = run
        self._worker: Thread | None = None
        moving = [robot.id for robot in hello.robots if not robot.joins]
        self.first = Sets(moving=moving, standing=[], regions=hello.regions)
        self._sets = {Members(tuple(moving), ()): self.first}

    def of(self, members: Members) -> Sets | None:
        """Return the sets of a membership, None until they are computed."""
        if self._hello.plane is None or self._hello.manifold is None:
            return self.first  # nothing is known of this swarm
        if members not in self._sets and (self._worker is None or not self._worker.is_alive()):
            self._worker = self._run(lambda: self._compute(members))
        return self._sets.get(members)

    def _compute(self, members: Members) -> None:
        hello = self._hello
        if hello.plane is None or hello.manifold is None:
            return
        column = [row.name for row in hello.system.rows if row.role == "constant"].index("mass")
        masses = {robot.id: nan if (mass := robot.constants[column]) is None else mass for robot in hello.robots}
        reached = regions(
            [masses[robot] for robot in members.moving],
            hello.plane.length,
            hello.plane.gravity,
            hello.manifold.torque_max,
            [(masses[robot], place) for robot, place in members.standing],
        )
        standing = [robot for robot, _ in members.standing]
        self._sets[members] = Sets(moving=list(members.moving), standing=standing, regions=reached)
        while len(self._sets) > MOST:
            del self._sets[next(iter(self._sets))]

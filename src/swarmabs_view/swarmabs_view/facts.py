"""Facts about a swarm other than its motion: the scenario, and the constraint sets of the robots that take part.

The sets are computed once per membership, in the background.
"""

from __future__ import annotations

import time
from itertools import chain
from math import fsum, isfinite, nan
from threading import Thread
from typing import TYPE_CHECKING, Any

from swarmabs_bag.shown.swarm_state import Members, finite
from swarmabs_config.scenario import Scenario
from swarmabs_core.systems import PLANE_TABLES
from swarmabs_core.theory.constraint_sets import ConstraintSets
from swarmabs_view.presenter import Presenter
from swarmabs_view.protocol import Manifold, Plane, Regions, Sets

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from swarmabs_config.model.scenario import AnyScenario
    from swarmabs_view.protocol import Hello

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

UNKNOWN: dict[str, Any] = {
    **dict.fromkeys(("period", "last_step", "plane", "manifold", "regions")),
    "robots": [],
    "system": Presenter(PLANE_TABLES).system,
}
"""The result of `scenario_facts` while the scenario is not known: until a system describes itself, it is the plane."""


def scenario_facts(scenario: AnyScenario) -> dict[str, Any]:
    """Return the fields of a `Hello` that the scenario determines, except for system and robots."""
    known = {**UNKNOWN, "period": scenario.period, "last_step": scenario.steps}
    if not isinstance(scenario, Scenario):
        return known
    return {
        **known,
        "plane": Plane(length=scenario.plane.length, inertia=scenario.plane.inertia, gravity=scenario.plane.gravity),
        "manifold": Manifold(
            curvature=scenario.manifold.curvature,
            offset=scenario.manifold.offset,
            torque_max=scenario.manifold.torque_max,
        ),
        "regions": regions(
            [agent.mass for agent in scenario.initial_agents],
            scenario.plane.length,
            scenario.plane.gravity,
            scenario.manifold.torque_max,
        ),
    }


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
        self._known = {Members(tuple(moving), ()): self.first}

    def of(self, members: Members) -> Sets | None:
        """Return the sets of a membership, None until they are computed."""
        if self._hello.plane is None or self._hello.manifold is None:
            return self.first  # nothing is known of this swarm
        found = self._known.get(members)
        if found is None and (self._worker is None or not self._worker.is_alive()):
            self._worker = self._run(lambda: self._compute(members))
        return found or self._known.get(members)

    def _compute(self, members: Members) -> None:
        plane, manifold = self._hello.plane, self._hello.manifold
        if plane is None or manifold is None:
            return
        hello = self._hello
        column = [row.name for row in hello.system.rows if row.role == "constant"].index("mass")
        masses = {robot.id: robot.constants[column] for robot in hello.robots}
        mass = {robot: nan if known is None else known for robot, known in masses.items()}
        found = regions(
            [mass[robot] for robot in members.moving],
            plane.length,
            plane.gravity,
            manifold.torque_max,
            [(mass[robot], place) for robot, place in members.standing],
        )
        standing = [robot for robot, _ in members.standing]
        self._known[members] = Sets(moving=list(members.moving), standing=standing, regions=found)
        while len(self._known) > MOST:
            del self._known[next(iter(self._known))]

"""What the page knows of a swarm besides its motion: its scenario, and the sets of those who take part.

These are computed once for each membership, in the background.
"""

from __future__ import annotations

import time
from itertools import chain
from math import fsum, isfinite, nan
from threading import Thread
from typing import TYPE_CHECKING, Any

from swarmabs_bag.swarm_state import Members, SwarmState, finite
from swarmabs_core.theory.constraint_sets import ConstraintSets
from swarmabs_view.protocol import Manifold, Plane, Regions, Robot, Sets

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from swarmabs_config.scenario import Scenario
    from swarmabs_view.protocol import Hello

    Work = Callable[[], None]

_FEW, _SAMPLES = 10, 40
"""Torques on each side of 0 at which the boundaries of the sets are computed; of few robots four times as many, for
then J_max has corners and costs little."""
_MARGIN = 1.1
"""How far beyond the manifold the sets are shown."""

MOST = 64
"""Memberships of which the sets are kept."""
REST = 4.0
"""How many times as long as a computation no other one begins: of 21 different masses one takes a second."""

UNKNOWN: dict[str, Any] = {**dict.fromkeys(("period", "last_step", "plane", "manifold", "regions")), "robots": []}
"""What `scenario_facts` returns, as long as there is no scenario."""


def scenario_facts(scenario: Scenario) -> dict[str, Any]:
    """Return the fields of a `Hello` that a scenario determines; generated robots are listed."""
    return {
        "period": scenario.period,
        "last_step": scenario.steps,
        "robots": [Robot.of(robot) for robot in SwarmState.of(scenario).robots],
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
    """Sample the boundaries of A_A and A_P: of the states that robots give, and weights that stand still among them.

    These, by mass (kg) and place (m), add a constant torque and a constant inertia to what the robots of some masses
    (kg, at least two) give on a plane of some length (m). Gravity is in m/s^2. The sets are shown somewhat beyond the
    torque of the manifold (N m), but never further than robots on the plane reach.
    """
    if len(masses) < 2 or not all(map(isfinite, (*masses, *chain.from_iterable(standing)))):
        return None
    shift = gravity * fsum(mass * place for mass, place in standing)
    lift = fsum(mass * place**2 for mass, place in standing)
    sets = ConstraintSets(masses, length, gravity)
    reach = min(_MARGIN * torque_max + abs(shift), sets.largest_torque)
    samples = 4 * _SAMPLES if len(masses) <= _FEW else _SAMPLES
    # Without the weights that stand still, the sets are symmetric in the torque.
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
    """Do something in a daemon thread, which rests afterwards."""

    def run() -> None:
        begun = time.monotonic()
        work()
        time.sleep(REST * (time.monotonic() - begun))

    thread = Thread(target=run, daemon=True)
    thread.start()
    return thread


class Shading:
    """What the page shades, by who takes part: `first` is what stands in the hello, and `run` has others computed."""

    def __init__(self, hello: Hello, run: Callable[[Work], Thread | None] = in_background) -> None:
        self._hello = hello
        self._run = run
        self._worker: Thread | None = None
        moving = [robot.id for robot in hello.robots if not robot.joins]
        self.first = Sets(moving=moving, standing=[], regions=hello.regions)
        self._known = {Members(tuple(moving), ()): self.first}

    def of(self, members: Members) -> Sets | None:
        """Return the sets of a membership, None as long as they are not computed."""
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
        mass = {robot.id: nan if robot.mass is None else robot.mass for robot in self._hello.robots}
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

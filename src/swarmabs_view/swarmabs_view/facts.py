"""What does not change while something is shown: the scenario as the page needs it."""

from __future__ import annotations

from itertools import chain
from math import fsum, isfinite
from typing import TYPE_CHECKING, Any

from swarmabs_bag.swarm_state import SwarmState, finite
from swarmabs_core.theory.constraint_sets import ConstraintSets
from swarmabs_view.frame import robots_of
from swarmabs_view.protocol import Manifold, Plane, Regions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_config.scenario import Scenario

_FEW, _SAMPLES = 10, 40
"""Torques on each side of 0 at which the boundaries of the sets are computed; of few robots four times as many, for
then J_max has corners and costs little."""
_MARGIN = 1.1
"""How far beyond the manifold the sets are shown."""

UNKNOWN: dict[str, Any] = {
    "period": None,
    "last_step": None,
    "robots": [],
    "plane": None,
    "manifold": None,
    "regions": None,
}
"""What `scenario_facts` returns, as long as there is no scenario."""


def scenario_facts(scenario: Scenario) -> dict[str, Any]:
    """Return the fields of a `Hello` that a scenario determines; generated robots are listed."""
    return {
        "period": scenario.period,
        "last_step": scenario.steps,
        "robots": robots_of(SwarmState.of(scenario).robots),
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

    These add a constant torque and a constant inertia to what the robots give.

    Parameters
    ----------
    masses : sequence of float
        Of all robots that are commanded, kg; there are no sets of fewer than two.
    length : float
        Of the plane, m.
    gravity : float
        m/s^2.
    torque_max : float
        Of the manifold, N m: the sets are shown somewhat beyond, but never further than robots on the plane reach.
    standing : sequence of tuple of float
        Mass (kg) and place (m) of each weight that stands still.
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

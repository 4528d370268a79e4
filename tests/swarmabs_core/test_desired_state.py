"""The desired state when robots begin to stand, against a swarm of which none does and sums over the robots."""

from fractions import Fraction

import pytest
from tests.swarmabs_core.helpers import PERIOD_NS, agent_state

from swarmabs_core.abstraction import divided_load
from swarmabs_core.desired_state import DesiredStateGenerator, SwarmOnPlane
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import DesiredAbstractState, PlaneState, StandingState, Status
from swarmabs_core.swarm_law import SwarmGains

GRAVITY = 9.81
MANIFOLD = Manifold(0.0125, 0.025, 5.0)
BODIES = {1: (0.4, 0.15), 2: (0.5, -0.12), 3: (0.6, 0.11), 4: (0.4, -0.14)}
"""Mass, kg, and position, m, of the robots."""


class Swinging:
    """A law whose torque changes in each step."""

    def torque(self, time: float, plane: PlaneState) -> float:
        return 0.4 - 0.3 * time

    def reference(self, time: float) -> float:
        return 0.0


Part = tuple[StandingState | None, int]
"""How the abstract state divides, and for how many steps."""


def asked(*parts: Part) -> DesiredAbstractState:
    """Return what is asked for in the last of these steps."""
    generator = DesiredStateGenerator(PERIOD_NS, MANIFOLD, Swinging(), SwarmOnPlane(GRAVITY, SwarmGains()))
    divisions = [division for division, steps in parts for _ in range(steps)]
    for step, division in enumerate(divisions):
        if division is not None:
            generator.divide(division)
        _, desired = generator.advance(step * PERIOD_NS, PlaneState(step * PERIOD_NS, step, 0.1, 0.0))
    return desired


def standing(*ids: int, scale: float = 1.0) -> StandingState:
    """Return how the abstract state divides if these robots stand, with all positions scaled."""
    states = [
        agent_state(n, mass=mass, position=scale * p, status=Status.SAFE_STOP if n in ids else Status.ACTIVE)
        for n, (mass, p) in BODIES.items()
    ]
    return divided_load(0, 0, states, GRAVITY)


def test_a_change_of_the_swarm_moves_the_desired_inertia_to_the_new_curve_without_a_jump() -> None:
    """Also if another robot takes the place of the one that stands, and if the swarm changes again on the way."""
    past: list[Part] = [(None, 20)]
    for change in (standing(1), standing(2), standing(2, 3)):
        unchanged, changed = asked(*past, (past[-1][0], 1)), asked(*past, (change, 1))
        assert changed.inertia == pytest.approx(unchanged.inertia, rel=1e-12)
        assert changed.inertia_rate == pytest.approx(unchanged.inertia_rate, rel=1e-9)
        past.append((change, 20))
        settled, curve = asked(*past, (change, 1200)), MANIFOLD.around(change, GRAVITY)
        assert settled.inertia == pytest.approx(curve.inertia(settled.torque), rel=1e-9)


@pytest.mark.parametrize(("scale", "share"), [(0.2, Fraction(4)), (3.0, Fraction(1, 4))])
def test_robots_that_are_close_together_or_far_apart_are_not_flung_by_a_change(scale: float, share: Fraction) -> None:
    """Their second moment that is desired is at most four times that which they have, and at least a quarter."""
    change = standing(1, scale=scale)
    desired = asked((None, 5), (change, 1))
    bodies = {n: (Fraction(mass), Fraction(scale * p)) for n, (mass, p) in BODIES.items()}
    still, moving = [bodies.pop(1)], [*bodies.values()]
    mass = sum(m for m, _ in moving)
    centre = sum(m * p for m, p in moving) / mass
    spread = sum(m * (p - centre) ** 2 for m, p in moving)
    moment = Fraction(desired.torque) / Fraction(GRAVITY) - sum(m * p for m, p in still)
    least = sum(m * p * p for m, p in still) + moment * moment / mass
    assert desired.inertia - float(least) == pytest.approx(float(share * spread), rel=1e-9)
    curve = MANIFOLD.around(change, GRAVITY)
    assert desired.inertia_rate == pytest.approx(curve.rate(desired.torque, desired.torque_rate), rel=1e-9)

"""The curve around robots that stand, against the least inertia that the others can have."""

from fractions import Fraction

import pytest
from hypothesis import given, settings, strategies as st

from swarmabs_core.abstraction import divided_load
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import AgentState, Kind, Status

MANIFOLD, GRAVITY = Manifold(), 9.81


def robot(agent_id: int, mass: float, position: float, status: Status = Status.ACTIVE) -> AgentState:
    return AgentState(0, 0, 0, agent_id, Kind.SINGLE_INTEGRATOR, status, mass, 0.0, position, 0.0, 0.0)


bodies = st.lists(st.tuples(st.floats(0.2, 2.0), st.floats(-0.4, 0.4)), min_size=1, max_size=5)


@settings(max_examples=60)
@given(bodies, bodies, st.floats(-5.0, 5.0))
def test_what_is_left_for_the_robots_that_move_is_always_a_positive_spread(
    still: list[tuple[float, float]], moving: list[tuple[float, float]], torque: float
) -> None:
    """In rational arithmetic: sum m p^2 >= (sum m p)^2 / sum m, with equality if all are at one place."""
    states = [robot(n + 1, *body, Status.SAFE_STOP) for n, body in enumerate(still)]
    states += [robot(n + 101, *body) for n, body in enumerate(moving)]
    curve = MANIFOLD.around(divided_load(0, 0, states, GRAVITY), GRAVITY)
    masses = sum(Fraction(m) for m, _ in moving)
    moment = Fraction(torque) / Fraction(GRAVITY) - sum(Fraction(m) * Fraction(p) for m, p in still)
    least = sum(Fraction(m) * Fraction(p) ** 2 for m, p in still) + moment * moment / masses
    whole = masses + sum(Fraction(m) for m, _ in still)
    spread = float(Fraction(curve.inertia(torque)) - least)
    share = float(masses / whole) ** 2 * MANIFOLD.offset
    growth = max(0.0, MANIFOLD.curvature - 1.0 / (GRAVITY**2 * float(whole))) * torque * torque
    assert spread == pytest.approx(share + growth, rel=1e-9, abs=1e-12 * float(least))


def test_where_nobody_stands_it_is_the_curve_of_the_paper_to_the_bit() -> None:
    states = [robot(1, 0.4, 0.1), robot(2, 0.5, -0.1)]
    curve = MANIFOLD.around(divided_load(0, 0, states, GRAVITY), GRAVITY)
    assert curve == (0.0125, 0.0, 0.025)
    assert str(curve.rate(-0.3, 0.0)) == "-0.0", "which no added zero may change"


@given(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.floats(-5.0, 5.0))
def test_its_rates_are_the_derivatives_along_a_path(t: float, a: float, b: float) -> None:
    states = [robot(1, 0.7, 0.16, Status.SAFE_STOP), robot(2, 0.5, -0.1), robot(3, 0.4, 0.05)]
    curve = MANIFOLD.around(divided_load(0, 0, states, GRAVITY), GRAVITY)
    h = 1e-4

    def inertia(x: float) -> float:
        return curve.inertia(t + a * x + 0.5 * b * x * x)

    assert curve.rate(t, a) == pytest.approx((inertia(h) - inertia(-h)) / (2 * h), rel=1e-5, abs=1e-6)
    bend = (inertia(h) - 2.0 * inertia(0.0) + inertia(-h)) / h**2
    assert curve.acceleration(t, a, b) == pytest.approx(bend, rel=1e-4, abs=1e-4)
    end = t + a * h
    assert curve.mean_rate(t, end, h) == pytest.approx((curve.inertia(end) - curve.inertia(t)) / h, rel=1e-6, abs=1e-8)

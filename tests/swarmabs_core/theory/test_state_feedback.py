"""The regions of attraction of state feedback, the paper's and the proven one, by hand; V falls within the latter."""

from math import cos, inf, pi, sin, sqrt, tan

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from scipy.linalg import expm
from tests.swarmabs_core.helpers import builtin

from swarmabs_config.theory import setting
from swarmabs_core.manifold import Manifold
from swarmabs_core.plant import Friction
from swarmabs_core.theory.arise import printed_bound
from swarmabs_core.theory.error_dynamics import (
    deepest_swing,
    epsilon_bound,
    first_order,
    printed_epsilon_bound,
    second_order,
    second_order_energy,
)
from swarmabs_core.theory.state_feedback import (
    Estimate,
    Loop,
    check_feedback,
    estimate,
    level_set,
    potential,
    printed_inertia_rate,
)

FRICTION = Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0)
MANIFOLD = Manifold(0.0125, 0.025, 5.0)
K1, K2 = 3.1623, 3.2859
LOOP = Loop(K1, K2, 0.5, FRICTION, MANIFOLD, first_order((10.0, 10.0)))


def state_derivative(state: np.ndarray[tuple[int], np.dtype[np.float64]], loop: Loop) -> tuple[float, ...]:
    """Return w, w', e_tau', e_J', J_s' and tau_d of the loop without limit and filter."""
    angle, w, e_torque, e_inertia = state.tolist()
    wanted = K1 * angle + K2 * w + loop.compensated * tan(angle)
    k1 = K1 + loop.compensated / cos(angle) ** 2
    inertia = 0.0125 * wanted**2 + 0.025 - e_inertia
    # J_s' = 2 A tau_d (k1 w + k2 w') + K e_J, and (J + J_s) w' = rest - J_s' w: two linear equations.
    slope = 0.025 * wanted
    rest = -cos(angle) * (wanted - e_torque) - FRICTION.torque(w) + (loop.weight + loop.compensated) * sin(angle)
    matrix = [[1.0, -slope * K2], [w, 0.5 + inertia]]
    inertia_rate, acceleration = np.linalg.solve(matrix, [slope * k1 * w + 10.0 * e_inertia, rest]).tolist()
    return w, acceleration, -10.0 * e_torque, -10.0 * e_inertia, inertia_rate, wanted


@pytest.mark.parametrize("weights", [(0.0, 0.0), (1.2, 0.0), (-1.0, 0.0), (0.0, 2.0), (0.5, -1.0)])
def test_lyapunov_function_falls_everywhere_in_the_set(weights: tuple[float, float]) -> None:
    """Also with a plane above its axis, partly compensated: (g H that is not, g H that is)."""
    loop = LOOP._replace(weight=weights[0], compensated=weights[1])
    found = level_set(loop, 0.2)
    draw = np.random.default_rng(1)
    inside = 0
    for _ in range(1500):
        state = draw.uniform(-1.0, 1.0, 4) * (0.2, found.rate, *[sqrt(2.0 * found.level / found.weight)] * 2)
        angle, w, e_torque, e_inertia = state.tolist()
        _, acceleration, de_torque, de_inertia, inertia_rate, wanted = state_derivative(state, loop)
        inertia = 0.5 + 0.0125 * wanted**2 + 0.025 - e_inertia
        energy = (
            K1 * potential(angle)
            - loop.weight * (1.0 - cos(angle))
            + inertia * w * w / 2.0
            + found.weight * (e_torque**2 + e_inertia**2) / 2.0
        )
        if inertia < 0.5 or energy > found.level:
            continue
        inside += 1
        falls = (
            (K1 * angle * cos(angle) - loop.weight * sin(angle)) * w
            + inertia * w * acceleration
            + inertia_rate * w * w / 2.0
        )
        falls += found.weight * (e_torque * de_torque + e_inertia * de_inertia)
        assert falls < 0.0
        assert abs(inertia_rate) <= found.inertia_rate
        assert abs(wanted) <= found.torque * (1.0 + 1e-6)
    assert inside > 100
    found = level_set(Loop(K1, -2.0, 0.5, FRICTION, MANIFOLD, first_order((10.0, 10.0))), 0.2)
    assert found.damping < 0.0
    assert found.coupling < 1.0


@pytest.mark.parametrize(
    ("k1", "k2", "gain", "radius", "expected"),
    [
        # 2 A tau_max = 0.5, J + J_max = 2.5, J + B = 1.5: (k1 z^2/4 + (k1 5/4 + k2 3/2 - K) z + k2 9/4)/(k2 z/2 + 3/2)
        (4.0, 0.0, 1.0, 2.0, 12.0 / 1.5),
        (4.0, 2.0, 1.0, 2.0, (4.0 + 14.0 + 4.5) / 3.5),
        (4.0, 2.0, 20.0, 2.0, 4.5 / 1.5),
        (0.0, -2.0, 0.0, 0.5, 0.0),
        (0.0, -2.0, 0.0, 1.5, inf),
    ],
)
def test_printed_rate_of_the_inertia(k1: float, k2: float, gain: float, radius: float, expected: float) -> None:
    friction = Friction(0.5, 1000.0, 700.0, 0.02, 1000.0, 3.0)
    loop = Loop(k1, k2, 1.0, friction, Manifold(0.0625, 0.5, 4.0), first_order((10.0, 10.0)))
    assert printed_inertia_rate(loop, gain, radius) == pytest.approx(expected, rel=1e-12)


def region(name: str, *overrides: str, angle_max: float = 0.2) -> Estimate:
    found = estimate(setting(builtin(name, *overrides), angle_max=angle_max))
    assert found is not None
    return found


def test_estimate_of_a_scenario() -> None:
    """What the paper's numbers give is held by `tests/errata/test_proof_pd.py`."""
    found = region("pd_het_4")
    e_torque, e_inertia = 5.0 - found.setting.initial.torque, 0.3375 - found.setting.initial.inertia
    assert found.error_squared(0.0, 50.0) == pytest.approx(2500.0 + e_torque**2 + e_inertia**2, rel=1e-12), "limited"
    assert region("pd_het_4", angle_max=0.4).corrected == pytest.approx(0.16)
    lqr = region("pd_het_4", "controller.type=lqr").setting.law
    assert [lqr.k1, lqr.k2] == pytest.approx([3.1623, 1.3066], abs=5e-5)
    joining = region("pd_het_4", "faults.0={at: 1.0, kind: join, agent: 3}")
    assert joining.setting.initial.inertia == pytest.approx(0.015625 * (1.8442 - 0.6762)), "is not there yet"
    assert estimate(setting(builtin("arise_het_4"))) is None


@pytest.mark.parametrize(("k1", "growth"), [(0.3, 0.3 * potential(0.2) / 0.2**2), (3.0, 0.25)])
def test_functions_grow_with_the_squares_of_the_errors(k1: float, growth: float) -> None:
    found = check_feedback(setting(builtin("pd_si_4", f"controller.gains=[{k1}, 3.3]")))
    assert found is not None
    weight = found.attraction["weight"]
    assert isinstance(weight, float)
    assert found.growths == pytest.approx((growth, 0.5 * weight), rel=1e-12)


GAINS = st.floats(0.2, 50.0)


def test_printed_conditions_leave_the_papers_gains_too_much_and_others_nothing() -> None:
    assert printed_epsilon_bound(10.0, 5.0) == pytest.approx(sqrt(10.0))
    assert printed_epsilon_bound(1.0, 5.0) == pytest.approx(5.0 - 25.0 / 4.0)


@settings(max_examples=20)
@given(GAINS, GAINS, st.floats(0.05, 0.95))
def test_numbers_bound_what_they_say(kp: float, kd: float, share: float) -> None:
    epsilon = share * epsilon_bound(kp, kd)
    found = second_order((kp, kp), (kd, kd), epsilon)
    m2 = np.array([[epsilon * kp, epsilon * kd / 2.0], [epsilon * kd / 2.0, kd - epsilon]])
    for angle in np.linspace(0.0, pi, 60):
        e, rate = np.cos(angle), np.sin(angle)
        energy = second_order_energy((kp, kp), epsilon, (e, 0.0), (rate, 0.0))
        assert np.array([e, rate]) @ m2 @ np.array([e, rate]) >= found.decay * e * e - 1e-9
        assert abs(e) <= found.torque * sqrt(2.0 * energy) * (1.0 + 1e-9)
        assert abs(rate) <= found.inertia_rate * sqrt(2.0 * energy) * (1.0 + 1e-9)


@settings(max_examples=20)
@given(GAINS, GAINS, st.floats(-1.0, 1.0), st.floats(-5.0, 5.0))
@example(4.0, 5.0, 0.2, -5.0)
def test_swing_is_the_least_value_of_the_solution(kp: float, kd: float, excess: float, rate: float) -> None:
    times = np.linspace(0.0, 8.0 * max(1.0 / sqrt(kp), kd / kp, 1.0 / kd), 4001)
    step = expm(np.array([[0.0, 1.0], [-kp, -kd]]) * times[1])
    state, least = np.array([excess, rate]), min(0.0, excess)
    for _ in times[1:]:
        state = step @ state
        least = min(least, float(state[0]))
    scale = abs(excess) + abs(rate) / sqrt(kp)
    assert deepest_swing(kp, kd, excess, rate) == pytest.approx(least, abs=2e-3 * scale + 1e-12)
    assert deepest_swing(kp, 2.0 * sqrt(kp), 1.0, 0.0) == 0.0


@pytest.mark.parametrize(
    ("slope", "alphas", "expected"),
    [
        (3.0, (0.1, 0.2), 2.5 * 0.1 + 3.0),
        (3.0, (1.0, 3.0), abs(1.0 + 2.5 * 2.0 * 3.0) + abs(0.5 + 2.0 - 4.0 * 3.0)),
        (0.5, (1.5, 3.0), abs(1.0 + 2.5 * 1.5 * 3.0) + abs(0.75 + 4.5 - 4.5 * 0.5)),
        (3.0, (3.0, 1.0), 2.0 * 27.0 + 9.0 * 3.0),
    ],
)
def test_each_part_of_the_printed_bound(slope: float, alphas: tuple[float, float], expected: float) -> None:
    assert printed_bound(2.0, 0.5, slope, *alphas) == pytest.approx(expected, rel=1e-12)

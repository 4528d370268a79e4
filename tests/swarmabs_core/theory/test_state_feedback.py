"""The regions of attraction of state feedback, the paper's and the proven one, by hand; V falls within the latter."""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np
import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_config.theory import setting
from swarmabs_core.manifold import Manifold
from swarmabs_core.plant import Friction
from swarmabs_core.theory.error_dynamics import first_order
from swarmabs_core.theory.state_feedback import (
    Loop,
    corrected_eta,
    estimate,
    level_set,
    matrix_eigenvalues,
    potential,
    printed_eta,
    radius_squared,
)

FRICTION = Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0)
MANIFOLD = Manifold(0.0125, 0.025, 5.0)
K1, K2 = 3.1623, 3.2859
LOOP = Loop(K1, K2, 0.5, FRICTION, MANIFOLD, first_order((10.0, 10.0)))
INERTIA = 0.5
# 0.0125 * 7.5^2 + 0.025 and 0.0125 * 5^2 + 0.025
AT_7_5, AT_5 = 0.728125, 0.3375


@pytest.mark.parametrize(("rate", "expected"), [(0.0, (-0.31, 3.53)), (1.9059, (-0.41, 2.68))])
def test_symmetric_part_of_the_papers_matrix_is_indefinite(rate: float, expected: tuple[float, float]) -> None:
    found = matrix_eigenvalues(K1, K2, 0.2, rate)
    assert found == pytest.approx(expected, abs=5e-3)
    m = np.array([[0.0, -1.0], [cos(0.2) * K1, cos(0.2) * K2 - rate / 2.0]])
    assert found == pytest.approx(np.linalg.eigvalsh((m + m.T) / 2.0))


def test_level_is_the_potential_at_the_largest_angle() -> None:
    found = level_set(LOOP, 0.2)
    assert found.level == pytest.approx(3.1623 * (0.2 * 0.19866933 + 0.98006658 - 1.0))
    assert found.rate == pytest.approx(sqrt(2.0 * found.level / 0.5))
    assert found.damping == pytest.approx(cos(0.2) * K2 + 1.0 - found.inertia_rate / 2.0)
    assert found.coupling == pytest.approx(4.0 * found.weight * 10.0 * found.damping)


def state_derivative(state: np.ndarray[tuple[int], np.dtype[np.float64]]) -> tuple[float, ...]:
    """Return w, w', e_tau', e_J' and J_s' of the loop without limit and filter."""
    angle, w, e_torque, e_inertia = state.tolist()
    wanted = K1 * angle + K2 * w
    inertia = 0.0125 * wanted**2 + 0.025 - e_inertia
    # J_s' = 2 A tau_d (k1 w + k2 w') + K e_J, and (J + J_s) w' = rest - J_s' w: two linear equations.
    slope = 0.025 * wanted
    rest = -cos(angle) * (wanted - e_torque) - FRICTION.torque(w)
    matrix = [[1.0, -slope * K2], [w, 0.5 + inertia]]
    inertia_rate, acceleration = np.linalg.solve(matrix, [slope * K1 * w + 10.0 * e_inertia, rest]).tolist()
    return w, acceleration, -10.0 * e_torque, -10.0 * e_inertia, inertia_rate


def test_lyapunov_function_falls_everywhere_in_the_set() -> None:
    found = level_set(LOOP, 0.2)
    draw = np.random.default_rng(1)
    inside = 0
    for _ in range(4000):
        state = draw.uniform(-1.0, 1.0, 4) * (0.2, found.rate, *[sqrt(2.0 * found.level / found.weight)] * 2)
        angle, w, e_torque, e_inertia = state.tolist()
        inertia = 0.5 + 0.0125 * (K1 * angle + K2 * w) ** 2 + 0.025 - e_inertia
        energy = K1 * potential(angle) + inertia * w * w / 2.0 + found.weight * (e_torque**2 + e_inertia**2) / 2.0
        if inertia < 0.5 or energy > found.level:
            continue
        inside += 1
        _, acceleration, de_torque, de_inertia, inertia_rate = state_derivative(state)
        falls = K1 * angle * cos(angle) * w + inertia * w * acceleration + inertia_rate * w * w / 2.0
        falls += found.weight * (e_torque * de_torque + e_inertia * de_inertia)
        assert falls < 0.0
        assert abs(inertia_rate) <= found.inertia_rate
        assert abs(K1 * angle + K2 * w) <= found.torque * (1.0 + 1e-6)
    assert inside > 500


def test_printed_lyapunov_function_grows_where_the_paper_says_it_falls() -> None:
    angle, w = 0.1, -0.01
    _, acceleration, _, _, inertia_rate = state_derivative(np.array([angle, w, 0.0, 0.0]))
    inertia = 0.5 + 0.0125 * (K1 * angle + K2 * w) ** 2 + 0.025
    assert angle * w + inertia * w * acceleration + inertia_rate * w * w / 2.0 > 0.0


def test_no_weight_helps_feedback_that_drives() -> None:
    found = level_set(Loop(K1, -2.0, 0.5, FRICTION, MANIFOLD, first_order((10.0, 10.0))), 0.2)
    assert found.damping < 0.0
    assert found.coupling < 1.0


def test_potential_grows_up_to_a_right_angle() -> None:
    angles = np.linspace(0.0, 1.57, 200)
    values = np.array([potential(angle) for angle in angles.tolist()])
    assert (np.diff(values) > 0.0).all()
    assert values[-1] == pytest.approx(1.57 * sin(1.57) + cos(1.57) - 1.0)


def test_the_radii_of_the_paper() -> None:
    assert radius_squared(0.2, corrected_eta(INERTIA, AT_7_5)) == pytest.approx(0.0326, abs=5e-5)
    assert radius_squared(0.2, corrected_eta(INERTIA, AT_5)) == pytest.approx(0.04, rel=1e-12)
    assert radius_squared(0.2, printed_eta(INERTIA, AT_5)) == pytest.approx(0.02, rel=1e-12)


def test_heavy_planes_have_one_eta() -> None:
    assert printed_eta(3.0, 1.0) == corrected_eta(3.0, 1.0) == 2.0


def test_the_papers_initial_state_has_the_true_error() -> None:
    # a(0) with g: 9.81 * 0.125 * (0.3552 - 0.3532 + 0.6762 - 0.4596), 0.125^2 * 1.8442; a_d(0) from tau = 3.1623 * 0.1
    torque, inertia = 9.81 * 0.125 * 0.2186, 0.015625 * 1.8442
    e_torque, e_inertia = 0.31623 - torque, 0.0125 * 0.31623**2 + 0.025 - inertia
    assert [e_torque, e_inertia] == pytest.approx([0.0482, -0.0026], abs=5e-5)
    found = estimate(setting(builtin("pd_het_4")))
    assert found is not None
    assert [found.setting.initial.torque, found.setting.initial.inertia] == pytest.approx([torque, inertia])
    assert found.error_squared(0.1, 0.0) == pytest.approx(0.01 + e_torque**2 + e_inertia**2, rel=1e-12)
    assert found.printed == pytest.approx(0.02)
    assert found.corrected == pytest.approx(0.04)


def test_the_torque_asked_for_is_limited() -> None:
    found = estimate(setting(builtin("pd_het_4")))
    assert found is not None
    e_torque, e_inertia = 5.0 - found.setting.initial.torque, AT_5 - found.setting.initial.inertia
    assert found.error_squared(0.0, 50.0) == pytest.approx(2500.0 + e_torque**2 + e_inertia**2, rel=1e-12)


def test_the_angles_bound_is_a_setting() -> None:
    found = estimate(setting(builtin("pd_het_4"), angle_max=0.4))
    assert found is not None
    assert found.corrected == pytest.approx(0.16)


def test_lqr_is_a_pd_law_with_other_gains() -> None:
    found = estimate(setting(builtin("pd_het_4", "controller.type=lqr")))
    assert found is not None
    assert [found.setting.law.k1, found.setting.law.k2] == pytest.approx([3.1623, 1.3066], abs=5e-5)


def test_there_is_none_for_arise() -> None:
    assert estimate(setting(builtin("arise_het_4"))) is None


def test_robots_that_join_later_are_not_there_yet() -> None:
    found = estimate(setting(builtin("pd_het_4", "faults.0={at: 1.0, kind: join, agent: 3}")))
    assert found is not None
    assert found.setting.initial.inertia == pytest.approx(0.015625 * (1.8442 - 0.6762))

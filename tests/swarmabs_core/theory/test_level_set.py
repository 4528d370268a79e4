"""The proven region of attraction: its numbers by hand, and that V falls within it."""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np
import pytest

from swarmabs_core.manifold import Manifold
from swarmabs_core.plant import Friction
from swarmabs_core.theory.error_dynamics import first_order
from swarmabs_core.theory.state_feedback import Loop, level_set, matrix_eigenvalues, potential

FRICTION = Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0)
MANIFOLD = Manifold(0.0125, 0.025, 5.0)
K1, K2 = 3.1623, 3.2859
LOOP = Loop(K1, K2, 0.5, FRICTION, MANIFOLD, first_order((10.0, 10.0)))


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

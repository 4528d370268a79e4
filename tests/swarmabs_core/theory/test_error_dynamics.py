"""How the swarm's errors decay: against eigenvalues of the paper's matrices and solutions of the equation."""

from __future__ import annotations

from math import exp, pi, sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.linalg import expm

from swarmabs_core.theory.error_dynamics import (
    deepest_swing,
    epsilon_bound,
    printed_epsilon_bound,
    second_order,
    second_order_energy,
)

GAINS = st.floats(0.2, 50.0)


def proves(kp: float, kd: float, epsilon: float) -> bool:
    """Whether M1 is positive and M2 negative definite (app. ProofLQR_DI)."""
    m1 = [[kp, epsilon], [epsilon, 1.0]]
    m2 = [[-epsilon * kp, -epsilon * kd / 2.0], [-epsilon * kd / 2.0, epsilon - kd]]
    return bool(np.linalg.eigvalsh(m1).min() > 0.0 > np.linalg.eigvalsh(m2).max())


def test_the_papers_gains_leave_3_077() -> None:
    assert epsilon_bound(10.0, 5.0) == pytest.approx(200.0 / 65.0)
    assert epsilon_bound(10.0, 5.0) == pytest.approx(3.077, abs=5e-4)
    assert printed_epsilon_bound(10.0, 5.0) == pytest.approx(sqrt(10.0))


@given(GAINS, GAINS)
def test_bound_is_where_the_matrices_cease_to_prove_stability(kp: float, kd: float) -> None:
    bound = epsilon_bound(kp, kd)
    assert proves(kp, kd, 0.99 * bound)
    assert not proves(kp, kd, 1.01 * bound)


def test_printed_conditions_are_neither_necessary_nor_sufficient() -> None:
    assert printed_epsilon_bound(1.0, 5.0) < 0.0  # 5 - 25/4: none is left
    assert proves(1.0, 5.0, 0.5)
    assert not proves(10.0, 5.0, 3.1)  # below sqrt 10


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


def test_the_papers_gains_swing_by_1_7_percent() -> None:
    ratio = 5.0 / (2.0 * sqrt(10.0))
    assert deepest_swing(10.0, 5.0, 1.0, 0.0) == pytest.approx(-exp(-pi * ratio / sqrt(1.0 - ratio**2)))
    assert deepest_swing(10.0, 5.0, 1.0, 0.0) == pytest.approx(-0.017, abs=5e-4)
    assert deepest_swing(10.0, 2.0 * sqrt(10.0), 1.0, 0.0) == 0.0


@given(GAINS, GAINS, st.floats(-1.0, 1.0), st.floats(-5.0, 5.0))
def test_swing_is_the_least_value_of_the_solution(kp: float, kd: float, excess: float, rate: float) -> None:
    times = np.linspace(0.0, 8.0 * max(1.0 / sqrt(kp), kd / kp, 1.0 / kd), 4001)
    step = expm(np.array([[0.0, 1.0], [-kp, -kd]]) * times[1])
    state, least = np.array([excess, rate]), min(0.0, excess)
    for _ in times[1:]:
        state = step @ state
        least = min(least, float(state[0]))
    scale = abs(excess) + abs(rate) / sqrt(kp)
    assert deepest_swing(kp, kd, excess, rate) == pytest.approx(least, abs=2e-3 * scale + 1e-12)

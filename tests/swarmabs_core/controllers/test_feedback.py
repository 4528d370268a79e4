from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from swarmabs_core.controllers import StateFeedback, lqr_gains
from swarmabs_core.messages import PlaneState

weights = st.floats(0.01, 100.0)


def riccati_gains(q: tuple[float, float], r: float, inertia: float, viscous: float) -> np.ndarray:
    """K of tau = K (th, w) by python-control; tau enters as -tau/inertia, its u is -K x."""
    a = np.array([[0.0, 1.0], [0.0, -viscous / inertia]])
    b = np.array([[0.0], [1.0 / inertia]])
    return control.lqr(a, b, np.diag(q), np.array([[r]]))[0][0]


@settings(max_examples=50)
@given(weights, weights, weights, st.floats(0.05, 5.0), st.floats(0.0, 10.0))
def test_lqr_gains_solve_the_riccati_equation(q1: float, q2: float, r: float, inertia: float, viscous: float) -> None:
    expected = riccati_gains((q1, q2), r, inertia, viscous)
    assert lqr_gains((q1, q2), r, inertia, viscous) == pytest.approx(expected, rel=1e-6)


def test_lqr_gains_of_the_paper_corrected() -> None:
    assert lqr_gains((10.0, 1.0), 1.0, 0.525, 1.0) == pytest.approx((3.1623, 1.3066), abs=5e-5)


def test_printed_gains_belong_to_the_wrong_sign_of_the_friction() -> None:
    """Erratum: K = [3.1623, 3.2859] is that of A22 = +c/(J + J_sd0) with J + J_sd0 = 0.51."""
    printed = (3.1623, 3.2859)
    assert riccati_gains((10.0, 1.0), 1.0, 0.51, -1.0) == pytest.approx(printed, abs=5e-5)
    assert lqr_gains((10.0, 1.0), 1.0, 0.51, -1.0) == pytest.approx(printed, abs=5e-5)
    assert lqr_gains((10.0, 1.0), 1.0, 0.51, 1.0)[1] < 1.4


def test_closed_loop_with_the_lqr_gains_is_stable() -> None:
    k1, k2 = lqr_gains((10.0, 1.0), 1.0, 0.525, 1.0)
    poles = np.roots([0.525, 1.0 + k2, k1])
    assert (poles.real < 0.0).all()


def test_feedback_is_linear_and_regulates() -> None:
    law = StateFeedback(3.0, 0.5)
    assert law.torque(17.0, PlaneState(0, 0, 0.1, -0.2)) == pytest.approx(0.2, rel=1e-15)
    assert law.reference(17.0) == 0.0

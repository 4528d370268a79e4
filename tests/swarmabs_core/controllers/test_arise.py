from __future__ import annotations

import cmath
from math import cos, tanh

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.swarmabs_core.helpers import taylor

from swarmabs_core.controllers import Arise, AriseGains, regressor
from swarmabs_core.messages import PlaneState
from swarmabs_core.plant import Friction
from swarmabs_core.trajectory import Constant, Sine

PAPER = Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0)
TRAJECTORY = Sine(0.7, 0.015 * np.pi)


def plane(angle: float, angular_velocity: float) -> PlaneState:
    return PlaneState(0, 0, angle, angular_velocity)


@given(st.floats(0.0, 50.0), st.floats(0.1, 6.0), st.floats(0.1, 6.0), st.floats(0.1, 6.0))
def test_regressor_and_its_derivatives(t: float, g2: float, g3: float, g5: float) -> None:
    """Each entry, as a function of time along a sine, differentiated by Cauchy's integral."""
    amplitude, w = 0.4, 0.8

    def rate(z: complex, order: int) -> complex:
        return amplitude * w**order * cmath.sin(w * z + order * cmath.pi / 2.0)

    entries = (
        lambda z: rate(z, 2),
        lambda z: cmath.tanh(g2 * rate(z, 1)) - cmath.tanh(g3 * rate(z, 1)),
        lambda z: cmath.tanh(g5 * rate(z, 1)),
        lambda z: rate(z, 1),
    )
    expected = np.array([taylor(entry, t, 2) for entry in entries]).T
    _, *rates = Sine(amplitude, w).derivatives(t)
    found = regressor(Friction(9.0, g2, g3, 9.0, g5, 9.0), tuple(rates))
    np.testing.assert_allclose(found, expected, atol=1e-9)


@given(st.floats(-0.5, 0.5), st.floats(-2.0, 2.0), st.floats(0.1, 2.0))
def test_regressor_times_the_true_parameters_is_the_torque_needed(w: float, dw: float, j: float) -> None:
    y, _, _ = regressor(PAPER, (w, dw, 0.0, 0.0))
    parameters = (j, PAPER.g1, PAPER.g4, PAPER.g6)
    needed = j * dw + PAPER.torque(w)
    assert np.dot(y, parameters) == pytest.approx(needed, rel=1e-13, abs=1e-15)


def test_first_torque_is_the_feed_forward_alone() -> None:
    """At step 0 e2 - e2(0) and both integrals vanish: lambda is its initial value."""
    gains = AriseGains()
    law = Arise(gains, TRAJECTORY, PAPER, 0.01)
    rate = 0.7 * 0.015 * np.pi  # th_d'(0); th_d''(0) = 0
    lam = gains.adaptive_initial
    feed_forward = (
        (np.tanh(1000.0 * rate) - np.tanh(700.0 * rate)) * lam[1] + np.tanh(1000.0 * rate) * lam[2] + rate * lam[3]
    )
    assert law.torque(0.0, plane(0.075, 0.3)) == pytest.approx(-feed_forward / cos(0.075), rel=1e-13)


def test_first_steps_by_hand_about_a_constant() -> None:
    """Without a regressor only the error terms remain."""
    gains = AriseGains(ks=2.0, alpha1=1.5, alpha2=0.5, beta=0.4, smoothing=0.1)
    law = Arise(gains, Constant(0.2), PAPER, 0.05)
    # e2 = -w + 1.5 (0.2 - th): 0.15, then 0.05, then -0.1
    assert law.torque(0.0, plane(0.1, 0.0)) == pytest.approx(0.0, abs=1e-16)
    mu1 = 0.05 * (3.0 * 0.5 * 0.15 + 0.4 * tanh(1.5))
    second = law.torque(0.05, plane(0.1, 0.1))
    assert second == pytest.approx(-(3.0 * (0.05 - 0.15) + mu1) / cos(0.1), rel=1e-12)
    mu1 += 0.05 * (3.0 * 0.5 * 0.05 + 0.4 * tanh(0.5))
    third = law.torque(0.1, plane(0.2, 0.1))
    assert third == pytest.approx(-(3.0 * (-0.1 - 0.15) + mu1) / cos(0.2), rel=1e-12)


def test_many_steps_against_sums_over_the_history() -> None:
    """The integrals are left Riemann sums of what was seen before; NumPy adds them up afterwards."""
    gains = AriseGains(gamma=(8.0, 2.0, 3.0, 9.0))
    friction = Friction(0.01, 30.0, 20.0, 0.02, 40.0, 1.0)
    trajectory, dt, n = Sine(0.7, 1.1), 0.01, 400
    time = dt * np.arange(n)
    th, w = 0.1 * np.cos(3.0 * time), 0.2 * np.sin(2.0 * time)

    law = Arise(gains, trajectory, friction, dt)
    found = [law.torque(t, plane(a, b)) for t, a, b in zip(time, th, w, strict=True)]

    th_d = np.array([trajectory.derivatives(t) for t in time]).T
    e2 = th_d[1] - w + gains.alpha1 * (th_d[0] - th)
    y, dy, ddy = np.array([regressor(friction, tuple(rates)) for rates in th_d[1:].T]).transpose(1, 0, 2)
    ks1 = gains.ks + 1.0

    def integral(rate: np.ndarray) -> np.ndarray:
        return dt * (np.cumsum(rate, axis=0) - rate)

    mu1 = integral(ks1 * gains.alpha2 * e2 + gains.beta * np.tanh(e2 / gains.smoothing))
    mu2 = integral((ddy - gains.alpha2 * dy) * e2[:, None])
    lam = gains.adaptive_initial + np.array(gains.gamma) * (dy * e2[:, None] - dy[0] * e2[0] - mu2)
    expected = -((y * lam).sum(axis=1) + ks1 * (e2 - e2[0]) + mu1) / np.cos(th)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)


def test_adaptation_is_the_integral_of_its_rate() -> None:
    """Erratum: eq. controlLaw3 is lambda, not its derivative. lambda' = Gamma Yd'^T r with r = e2' + alpha2 e2."""
    gains, trajectory, t_end = AriseGains(), Sine(0.7, 1.1), 1.0
    friction = Friction(0.01, 3.0, 2.0, 0.02, 4.0, 1.0)

    def e2(t: float) -> float:
        return 0.3 * np.sin(2.0 * t) + 0.1

    t = np.linspace(0.0, t_end, 20_001)
    derivatives = np.array([trajectory.derivatives(s)[1:] for s in t])
    _, dy, ddy = np.array([regressor(friction, tuple(rates)) for rates in derivatives]).transpose(1, 0, 2)
    r = 0.6 * np.cos(2.0 * t) + gains.alpha2 * e2(t)
    direct = np.trapezoid(dy * r[:, None], t, axis=0)
    by_parts = dy[-1] * e2(t_end) - dy[0] * e2(0.0)
    by_parts -= np.trapezoid((ddy - gains.alpha2 * dy) * e2(t)[:, None], t, axis=0)
    np.testing.assert_allclose(by_parts, direct, rtol=1e-6)


def test_reference_is_the_trajectory() -> None:
    law = Arise(AriseGains(), TRAJECTORY, PAPER, 0.01)
    assert law.reference(10.0) == pytest.approx(0.7 * np.sin(0.15 * np.pi), rel=1e-15)

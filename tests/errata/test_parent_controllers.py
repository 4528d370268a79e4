"""Section Parent Controller: linearisation, gains, and the adaptation of ARISE."""

from __future__ import annotations

from math import cos, pi, sin

import control
import numpy as np
import pytest
from scipy.integrate import quad
from tests.errata.paper import FRICTION, INERTIA, OFFSET, PD_PRINTED, slope

from swarmabs_core.controllers import CONTROLLERS, Arise, AriseGains, ParentContext, lqr_gains, regressor
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import PlaneState
from swarmabs_core.plant import Friction, Plane, PlaneDynamics, swarm_load
from swarmabs_core.trajectory import Sine

VISCOUS = FRICTION[5]
TOTAL = INERTIA + OFFSET


def riccati(inertia: float, a22: float) -> np.ndarray:
    """K of tau = K x for Q = diag(10, 1), R = 1; the torque enters as -tau/inertia."""
    a, b = np.array([[0.0, 1.0], [0.0, a22]]), np.array([[0.0], [-1.0 / inertia]])
    return -control.lqr(a, b, np.diag([10.0, 1.0]), np.eye(1))[0][0]


def test_linearised_friction_has_the_wrong_sign() -> None:
    """Before eq. ControlLawPD and in app. ProofLQR_SI: A22 = +c/(J + J_sd0); a plane without torque slows down."""
    dt, w = 1e-5, 0.5
    rest = PlaneDynamics(Plane(inertia=TOTAL, friction=Friction(0.0, 1.0, 1.0, 0.0, 1.0, VISCOUS), substep=dt), dt)
    _, after = rest.advance(0.0, w, 0.0, swarm_load([], 9.81))
    found = (after - w) / dt / w
    assert found < 0.0
    assert found == pytest.approx(-VISCOUS / TOTAL, rel=1e-4)
    printed = VISCOUS / TOTAL
    assert abs(found - printed) > 3.0
    # Energy of a free plane must fall: (J w^2/2)' = J w w'.
    assert TOTAL * w * (printed * w) > 0.0 > TOTAL * w * (found * w)


def test_printed_gains_are_not_the_optimal_ones() -> None:
    """Section PD Controller: K = [3.1623, 3.2859] is that of the wrong sign and J + J_sd0 = 0.51."""
    right = riccati(TOTAL, -VISCOUS / TOTAL)
    assert right == pytest.approx((3.1623, 1.3066), abs=5e-5)
    assert abs(PD_PRINTED[1] - right[1]) > 1.9
    assert riccati(0.51, +VISCOUS / 0.51) == pytest.approx(PD_PRINTED, abs=5e-5)  # where they come from

    assert lqr_gains((10.0, 1.0), 1.0, TOTAL, VISCOUS) == pytest.approx(right, rel=1e-6)
    context = ParentContext(0.01, INERTIA, Friction(*FRICTION), Manifold(0.0125, OFFSET, 5.0))
    law = CONTROLLERS.make("lqr", {"q": (10.0, 1.0), "r": 1.0}, context)
    found = [law.torque(0.0, PlaneState(0, 0, *x)) for x in ((1.0, 0.0), (0.0, 1.0))]
    assert found == pytest.approx(right, rel=1e-6)


def test_controllability_matrix() -> None:
    """app. ProofLQR_SI: [B, AB] is printed as [[0, -1/I], [-g6/I^2, 0]]; without friction it would be singular."""
    for viscous in (VISCOUS, 0.0):
        a = np.array([[0.0, 1.0], [0.0, -viscous / TOTAL]])
        b = np.array([[0.0], [-1.0 / TOTAL]])
        truth = control.ctrb(a, b)
        printed = np.array([[0.0, -1.0 / TOTAL], [-viscous / TOTAL**2, 0.0]])
        right = np.array([[0.0, -1.0 / TOTAL], [-1.0 / TOTAL, viscous / TOTAL**2]])
        assert np.abs(printed - truth).max() > 1.0
        np.testing.assert_allclose(right, truth)
    assert np.linalg.matrix_rank(printed) == 1 < np.linalg.matrix_rank(truth)


def test_adaptation_is_no_rate() -> None:
    """eq. controlLaw3 prints the derivative of the estimate on the left; the proof has lambda' = Gamma Yd'^T r."""
    # A law that shows its estimate of the inertia: k_s + 1 = 0, beta = 0, and no other column of the regressor.
    start, gain, alpha2 = 0.4, 6.0, 2.0
    gains = AriseGains(-1.0, 1.0, alpha2, 0.0, (gain, 0.0, 0.0, 0.0), 0.03, (start, 0.0, 0.0, 0.0))
    reference = Sine(0.7, 1.1)
    dt, steps = 1e-3, 1500

    def angle(t: float) -> float:
        return 0.2 * cos(1.7 * t)

    def rate(t: float) -> float:
        return -0.34 * sin(1.7 * t)

    def e2(t: float) -> float:
        th_d, w_d, *_ = reference.derivatives(t)
        return w_d - rate(t) + gains.alpha1 * (th_d - angle(t))

    def dy(t: float) -> float:
        return reference.derivatives(t)[3]

    end = dt * steps
    truth = start + gain * quad(lambda t: dy(t) * (slope(e2, t) + alpha2 * e2(t)), 0.0, end)[0]

    def right_hand_side(t: float) -> float:
        def mu2_rate(s: float) -> float:
            return (reference.derivatives(s)[4] - alpha2 * dy(s)) * e2(s)

        return start + gain * (dy(t) * e2(t) - dy(0.0) * e2(0.0) - quad(mu2_rate, 0.0, t)[0])

    printed = start + quad(right_hand_side, 0.0, end)[0]
    assert abs(printed - truth) > 0.3
    assert right_hand_side(end) == pytest.approx(truth, rel=1e-6)

    law = Arise(gains, reference, Friction(0.0, 1.0, 1.0, 0.0, 1.0, 0.0), dt)
    torque = [law.torque(dt * k, PlaneState(0, 0, angle(dt * k), rate(dt * k))) for k in range(steps + 1)]
    found = -torque[-1] * cos(angle(end)) / reference.derivatives(end)[2]
    assert found == pytest.approx(truth, abs=1e-2)


def test_law_needs_the_fourth_derivative() -> None:
    """thm. ARISE_SI_sys asks for th_d and three derivatives; eq. controlLaw4 uses Y_d'', which has the fourth."""
    friction = Friction(*FRICTION)
    # Two references that agree up to the third derivative at an instant.
    one, other = (regressor(friction, (0.1, 0.2, 0.3, fourth)) for fourth in (0.0, 50.0))
    assert one[:2] == other[:2]
    assert one[2] != other[2]
    assert other[2][0] - one[2][0] == 50.0
    # t^(7/2) has a third derivative that is bounded near 0 and a fourth that is not.
    time = 1e-8
    third, fourth = 13.125 * time**0.5, 6.5625 * time**-0.5
    assert third < 2e-3
    assert regressor(friction, (0.0, 0.0, third, fourth))[2][0] > 6e4
    w = 0.015 * pi
    assert regressor(friction, Sine(0.7, w).derivatives(10.0)[1:])[2][0] == pytest.approx(0.7 * w**4 * sin(10.0 * w))

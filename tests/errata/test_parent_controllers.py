"""Section Parent Controller: linearisation, gains, and the adaptation of ARISE."""

from math import cos, sin

import control
import numpy as np
import pytest
from scipy.integrate import quad
from tests.errata.paper import FRICTION, INERTIA, OFFSET, PD_PRINTED, slope

from swarmabs_core.controllers import CONTROLLERS, Arise, AriseGains, ParentContext, regressor
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
    """Before eq. ControlLawPD and in app. ProofLQR_SI: A22 = +c/(J + J_sd0); a plane without torque slows down.

    app. ProofLQR_SI prints [B, AB] as [[0, -1/I], [-g6/I^2, 0]]; without friction it would be singular.
    """
    dt, w = 1e-5, 0.5
    rest = PlaneDynamics(Plane(inertia=TOTAL, friction=Friction(0.0, 1.0, 1.0, 0.0, 1.0, VISCOUS), substep=dt), dt)
    _, after = rest.advance(0.0, w, 0.0, swarm_load([], 9.81))
    assert (after - w) / dt / w == pytest.approx(-VISCOUS / TOTAL, rel=1e-4)

    for viscous in (VISCOUS, 0.0):
        a = np.array([[0.0, 1.0], [0.0, -viscous / TOTAL]])
        truth = control.ctrb(a, np.array([[0.0], [-1.0 / TOTAL]]))
        printed = np.array([[0.0, -1.0 / TOTAL], [-viscous / TOTAL**2, 0.0]])
        assert np.abs(printed - truth).max() > 1.0
        np.testing.assert_allclose([[0.0, -1.0 / TOTAL], [-1.0 / TOTAL, viscous / TOTAL**2]], truth)
    assert np.linalg.matrix_rank(printed) == 1 < np.linalg.matrix_rank(truth)


def test_printed_gains_are_not_the_optimal_ones() -> None:
    """Section PD Controller: K = [3.1623, 3.2859] is that of the wrong sign and J + J_sd0 = 0.51."""
    right = riccati(TOTAL, -VISCOUS / TOTAL)
    assert right == pytest.approx((3.1623, 1.3066), abs=5e-5)
    assert riccati(0.51, +VISCOUS / 0.51) == pytest.approx(PD_PRINTED, abs=5e-5)  # where they come from
    assert abs(PD_PRINTED[1] - right[1]) > 1.9

    context = ParentContext(0.01, INERTIA, Friction(*FRICTION), Manifold(0.0125, OFFSET, 5.0))
    law = CONTROLLERS.make("lqr", {"q": (10.0, 1.0), "r": 1.0}, context)
    gains = [law.torque(0.0, PlaneState(0, 0, *x)) for x in ((1.0, 0.0), (0.0, 1.0))]
    assert gains == pytest.approx(right, rel=1e-6)


def test_adaptation_is_no_rate() -> None:
    """eq. controlLaw3 prints the derivative of the estimate on the left; the proof has lambda' = Gamma Yd'^T r."""
    # A law that shows its estimate of the inertia: k_s + 1 = 0, beta = 0, and no other column of the regressor.
    start, gain, alpha2 = 0.4, 6.0, 2.0
    gains = AriseGains(-1.0, 1.0, alpha2, 0.0, (gain, 0.0, 0.0, 0.0), 0.03, (start, 0.0, 0.0, 0.0))
    reference = Sine(0.7, 1.1)
    dt, steps = 1e-3, 1500
    end = dt * steps

    def state(t: float) -> PlaneState:
        return PlaneState(0, 0, 0.2 * cos(1.7 * t), -0.34 * sin(1.7 * t))

    def e2(t: float) -> float:
        th_d, w_d, *_ = reference.derivatives(t)
        return w_d - state(t).angular_velocity + gains.alpha1 * (th_d - state(t).angle)

    def dy(t: float) -> float:
        return reference.derivatives(t)[3]

    def right_hand_side(t: float) -> float:
        mu2 = quad(lambda s: (reference.derivatives(s)[4] - alpha2 * dy(s)) * e2(s), 0.0, t)[0]
        return start + gain * (dy(t) * e2(t) - dy(0.0) * e2(0.0) - mu2)

    truth = start + gain * quad(lambda t: dy(t) * (slope(e2, t) + alpha2 * e2(t)), 0.0, end)[0]
    assert abs(start + quad(right_hand_side, 0.0, end)[0] - truth) > 0.3  # as printed
    assert right_hand_side(end) == pytest.approx(truth, rel=1e-6)

    law = Arise(gains, reference, Friction(0.0, 1.0, 1.0, 0.0, 1.0, 0.0), dt)
    torque = [law.torque(dt * k, state(dt * k)) for k in range(steps + 1)]
    estimate = -torque[-1] * cos(state(end).angle) / reference.derivatives(end)[2]
    assert estimate == pytest.approx(truth, abs=1e-2)


def test_law_needs_the_fourth_derivative() -> None:
    """thm. ARISE_SI_sys asks for th_d and three derivatives; eq. controlLaw4 uses Y_d'', which has the fourth."""
    friction = Friction(*FRICTION)
    # Two references that agree up to the third derivative at an instant.
    one, other = (regressor(friction, (0.1, 0.2, 0.3, fourth)) for fourth in (0.0, 50.0))
    assert one[:2] == other[:2]
    assert other[2][0] - one[2][0] == 50.0

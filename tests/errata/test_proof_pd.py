"""thm. LQR_SI_sys, app. ProofLQR_SI, lem. J_dot_is_bounded, and the numbers of section PD Controller."""

from math import cos, pi

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.errata.paper import (
    CURVATURE,
    FRICTION,
    GAINS,
    GRAVITY,
    INERTIA,
    MASS,
    OFFSET,
    PD_PRINTED,
    POSITION,
    THETA_MAX,
    TORQUE_MAX,
    checked,
    friction,
    manifold,
    slope,
)

from swarmabs_config.scenarios import find_scenario
from swarmabs_config.theory import setting
from swarmabs_core.behaviours import Controller
from swarmabs_core.controllers import StateFeedback
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import DesiredAbstractState, PlaneState
from swarmabs_core.models import ControllerConfig
from swarmabs_core.plant import Friction, Plane, PlaneDynamics, SwarmLoad
from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass
from swarmabs_core.theory.state_feedback import (
    Estimate,
    corrected_eta,
    estimate,
    matrix_eigenvalues,
    potential,
    printed_eta,
    radius_squared,
)

K1, K2 = PD_PRINTED
K_S2 = GAINS.k[1]
CURVE = Manifold(CURVATURE, OFFSET, TORQUE_MAX)
J_DOT_PRINTED = 1.9059
SLOPE_MAX = 2.0 * CURVATURE * TORQUE_MAX
MOST, LEAST = INERTIA + manifold(TORQUE_MAX), INERTIA + OFFSET


def acceleration(th: float, w: float, torque: float, inertia: float, inertia_rate: float) -> float:
    """w' by eq. newDynamics, from the package's plane over a vanishing period."""
    dt = 1e-6
    moving = PlaneDynamics(Plane(inertia=INERTIA, friction=Friction(*FRICTION), substep=dt), dt)
    load = SwarmLoad((torque, 0.0, 0.0, 0.0), (inertia, inertia_rate * dt, 0.0, 0.0, 0.0, 0.0, 0.0))
    return (moving.advance(th, w, 0.0, load)[1] - w) / dt


def kinetic_rate(th: float, w: float, k2: float = K2, e_tau: float = 0.0, inertia_rate: float = 0.0) -> float:
    """Rate of (J + J_s) w^2/2 along the motion, J_s on the manifold."""
    wanted = K1 * th + k2 * w
    inertia = manifold(wanted)
    dw = acceleration(th, w, wanted - e_tau, inertia, inertia_rate)
    return (INERTIA + inertia) * w * dw + 0.5 * inertia_rate * w**2


def energy_rate(th: float, w: float, k2: float = K2, inertia_rate: float = 0.0) -> float:
    """V' of V = k1 (th sin th + cos th - 1) + (J + J_s) w^2/2."""
    return slope(lambda x: K1 * potential(x), th) * w + kinetic_rate(th, w, k2, inertia_rate=inertia_rate)


def own_region() -> Estimate:
    region = estimate(setting(find_scenario("pd_si_4")))
    assert region is not None
    return region


def test_matrix_m_is_not_positive_definite() -> None:
    """app. ProofLQR_SI: positive eigenvalues of M are said to make z'Mz positive definite; M is not symmetric."""
    for j_dot, expected in ((0.0, (-0.31, 3.53)), (J_DOT_PRINTED, (-0.41, 2.68))):
        c = cos(THETA_MAX)
        m = np.array([[0.0, -1.0], [c * K1, c * K2 - j_dot / 2.0]])
        assert (np.linalg.eigvals(m).real > 0.0).all()  # what the paper checks
        symmetric = np.linalg.eigvalsh((m + m.T) / 2.0)  # what z'Mz is
        assert symmetric == pytest.approx(expected, abs=5e-3)
        assert matrix_eigenvalues(K1, K2, THETA_MAX, j_dot) == pytest.approx(symmetric)


def test_printed_lyapunov_function_grows() -> None:
    """app. ProofLQR_SI: V_p = th^2/2 + (J + J_s) w^2/2 is said to fall, with the bound -z'Mz - w f_f, tau_s = tau_sd.

    Its rate is positive at (0.1, -0.01), and beyond that bound, as th w has both signs; and it holds cos(th) w e_tau.
    """
    th, w, c = 0.1, -0.01, cos(THETA_MAX)
    rate = th * w + kinetic_rate(th, w)
    z, m = np.array([th, w]), np.array([[0.0, -1.0], [c * K1, c * K2]])
    assert rate > max(1e-3, -z @ m @ z - w * friction(w) + 1e-5)
    assert kinetic_rate(th, 0.0) == pytest.approx(0.0, abs=1e-12)  # nor is it definite
    assert kinetic_rate(th, 0.2, e_tau=0.5) - kinetic_rate(th, 0.2) == pytest.approx(cos(th) * 0.2 * 0.5, abs=1e-6)

    # V with the potential of the controller has no term of th w: the bound by th_max is one.
    for th in np.linspace(-THETA_MAX, THETA_MAX, 9).tolist():
        for w in (-0.3, -0.05, -0.01, 0.01, 0.05, 0.3):
            assert energy_rate(th, w) <= -c * K2 * w**2 - w * friction(w) + 2e-5 < 0.0


def test_condition_on_k2() -> None:
    """thm. LQR_SI_sys: k2 > J'max/(2 cos); app. ProofLQR_DI and ProofLQR_noHomo: J'max/cos; neither counts g6."""
    j_dot, c = 4.0, cos(THETA_MAX)
    right = (j_dot / 2.0 - FRICTION[5]) / c
    assert right + 0.01 < j_dot / (2.0 * c)

    def worst(k2: float) -> float:
        """Largest V'/w^2 for any inertia's rate that is allowed, also where dry friction no longer counts."""
        states = [(th, w) for th in (-THETA_MAX, 0.1, THETA_MAX) for w in (-50.0, 0.3, 50.0)]
        return max(energy_rate(th, w, k2, r) / w**2 for th, w in states for r in (-j_dot, 0.0, j_dot))

    assert worst(right - 0.01) > 0.0 > worst(right + 0.01)  # below both printed bounds, and it decreases
    own = checked("pd_si_4", "k2")
    assert own.corrected.value == pytest.approx(c * K2 + FRICTION[5])
    assert own.corrected.bound == pytest.approx(own.inputs["inertia_rate_corrected"] / 2.0)


def largest_v(square: float) -> float:
    """Largest V_p + V_a on the ball norm(z)^2 = square, by sampling directions and taking the axes."""
    directions = np.vstack([np.random.default_rng(0).normal(size=(5000, 4)), np.eye(4)])
    th, w, e_tau, e_j = (np.sqrt(square) * directions.T) / np.linalg.norm(directions, axis=1)
    inertia = manifold(np.clip(K1 * th + K2 * w, -TORQUE_MAX, TORQUE_MAX)) - e_j
    return float((0.5 * (th**2 + e_tau**2 + e_j**2) + 0.5 * (INERTIA + inertia) * w**2).max())


def test_region_of_the_theorem() -> None:
    """thm. LQR_SI_sys: eta = max(1, ...) for max(1/2, ...), as in the appendix, which has norm(z) for norm(z)^2.

    Section PD Controller: norm(z)^2 < 0.0326, which neither eta gives with torque_max = 5.
    """
    level = THETA_MAX**2 / 2.0
    printed, right = (level / max(least, MOST / 2.0) for least in (1.0, 0.5))
    assert (own_region().printed, own_region().corrected) == pytest.approx((printed, right)) == (0.02, 0.04)
    assert printed_eta(3.0, 1.0) == corrected_eta(3.0, 1.0) == 2.0  # of heavy planes they are the same
    assert largest_v(printed) < 0.51 * level  # not the largest ball
    assert largest_v(right) == pytest.approx(level, rel=1e-9)
    assert level / ((INERTIA + CURVE.inertia(7.5)) / 2.0) == pytest.approx(0.0326, abs=5e-5)  # where it comes from

    # Where a radius is larger than 1, the angle alone leads out of the level set, if the radius is not squared.
    radius = radius_squared(1.2, 0.5)
    assert 0.5 * (0.95 * radius) ** 2 > 0.5 * 1.2**2 == pytest.approx(0.5 * radius)


def test_constrained_region_violates_its_constraint() -> None:
    """Section PD Controller: with abs(e_J) <= 0.03, abs(e_tau) < 2 the region is said to stay norm(z)^2 <= 0.0326."""
    assert 0.03**2 < 0.18**2 <= 0.0326  # e_J = 0.18 is inside,
    assert CURVE.inertia(0.0) - 0.18 < 0.0  # where there is not even an inertia
    initial = np.array([0.1, 0.0, 0.0273, 0.0288])
    assert initial @ initial > 0.03**2  # the largest ball with abs(e_J) <= 0.03 does not cover the paper's own start

    # Nor are these errors "acceptable" about the manifold: at tau = 0 there is room for 0.025 only.
    sets = ConstraintSets(MASS.tolist(), 1.0, GRAVITY)
    assert sets.classify(0.0, OFFSET - 0.03) is StateClass.EMPTY
    for direction in np.linspace(0.0, 2.0 * pi, 33):
        torque, e_j = 0.0249 * np.array([np.sin(direction), np.cos(direction)])
        assert sets.classify(torque, OFFSET + e_j) is StateClass.ADMISSIBLE
    assert np.hypot(0.0482, -0.0026) > 0.025  # e_a(0)


def test_initial_abstract_error() -> None:
    """Section PD Controller: z_a0 = (0.0273, 0.0288) is (sum m p, sum m p^2), not an error."""
    printed = (0.0273, 0.0288)
    assert pytest.approx(printed, abs=5e-5) == (MASS @ POSITION, MASS @ POSITION**2)

    config = ControllerConfig(10_000_000, manifold=CURVE)
    parent = Controller(config, config.desired_states(StateFeedback(K1, K2)))
    (desired,) = parent.handle(PlaneState(0, 0, 0.1, 0.0))
    assert isinstance(desired, DesiredAbstractState)
    assert (desired.torque, desired.inertia) == pytest.approx((K1 * 0.1, manifold(K1 * 0.1)))
    truth = (desired.torque - GRAVITY * MASS @ POSITION, desired.inertia - MASS @ POSITION**2)
    assert truth == pytest.approx((0.0482, -0.0026), abs=5e-5)
    assert own_region().error_squared(0.1, 0.0) == pytest.approx(0.01 + truth[0] ** 2 + truth[1] ** 2)


def inertia_rate(th: float, w: float, e_tau: float, e_j: float) -> float:
    """J_s' in the closed loop, where w' and J_sd' depend on it in turn: solved numerically."""
    wanted = K1 * th + K2 * w
    inertia = manifold(wanted) - e_j

    def mismatch(rate: float) -> float:
        dw = (-cos(th) * (wanted - e_tau) - rate * w - friction(w)) / (INERTIA + inertia)
        return rate - CURVE.curve.rate(wanted, K1 * w + K2 * dw) - K_S2 * e_j  # eq. swarmControlLaw

    return float(brentq(mismatch, -1e3, 1e3, xtol=1e-12))


def states(square: float) -> np.ndarray:
    """States inside the ball norm(z)^2 <= square."""
    random = np.random.default_rng(1)
    directions = random.normal(size=(300, 4))
    scale = np.sqrt(square) * random.uniform(0.0, 1.0, 300) / np.linalg.norm(directions, axis=1)
    return np.asarray(directions * scale[:, None])


def test_rate_of_the_inertia_in_closed_form() -> None:
    """lem. J_dot_is_bounded: -K_s2 e_J instead of +K_s2 e_J (J + J_sd - e_J), and tau_sd instead of tau_s."""
    errors = []
    for th, w, e_tau, e_j in states(0.04).tolist():
        wanted = K1 * th + K2 * w
        total, d = INERTIA + manifold(wanted) - e_j, 2.0 * CURVATURE * wanted
        below = total + d * K2 * w
        truth = inertia_rate(th, w, e_tau, e_j)
        printed = d * K1 * total * w - d * K2 * (cos(th) * wanted + friction(w)) - K_S2 * e_j
        right = printed + d * K2 * cos(th) * e_tau + K_S2 * e_j * (1.0 + total)
        assert right / below == pytest.approx(truth, abs=1e-9)
        errors.append(abs(printed / below - truth))
    assert max(errors) > 1.0


def printed_bound(n: float, *, sign: float = -1.0) -> float:
    """Bound of lem. J_dot_is_bounded, with the sign that it gives K_s2 in alpha_2."""
    g1, *_, g6 = FRICTION
    a2 = SLOPE_MAX * (K1 * MOST + K2 * g6) + sign * K_S2
    above = SLOPE_MAX / 2.0 * K1 * n**2 + a2 * n + SLOPE_MAX * K2 * (TORQUE_MAX + g1)
    return above / (SLOPE_MAX * K2 * n + LEAST)


def test_bound_on_the_rate_of_the_inertia() -> None:
    """lem. J_dot_is_bounded: alpha_2 subtracts K_s2, alpha_3 lacks g4, and the denominator grows with norm(z)."""
    g1, _, _, g4, _, g6 = FRICTION

    def right(n: float) -> float:
        above = SLOPE_MAX * (K1 * (MOST + n) * n + K2 * (TORQUE_MAX + n + g1 + g4 + g6 * n)) + K_S2 * n * (MOST + n)
        return above / (LEAST - n - SLOPE_MAX * K2 * n)

    assert abs(inertia_rate(0.0, 0.0, 0.0, 0.2)) > 5.0 * printed_bound(0.2)
    assert all(abs(inertia_rate(*z)) <= right(float(np.linalg.norm(z))) for z in states(0.04))


def test_largest_rate_of_the_inertia() -> None:
    """Section PD Controller: J'max = 1.9059, which neither the lemma nor the loop gives on any of the regions."""
    for square in (0.02, 0.0326, 0.04):
        n = square**0.5
        assert min(abs(printed_bound(n, sign=sign) - J_DOT_PRINTED) for sign in (-1.0, 1.0)) > 0.5
        # In the loop it is K norm(z), reached where e_J is all there is.
        assert abs(inertia_rate(0.0, 0.0, 0.0, n)) == pytest.approx(K_S2 * n)
        assert max(abs(inertia_rate(*z)) for z in states(square)) <= K_S2 * n
        assert abs(K_S2 * n - J_DOT_PRINTED) > 0.09


def test_initial_errors_of_arise() -> None:
    """Section ARISE Controller: e2(0) = -0.0618 and r(0) = -0.1104 belong to 0.7 sin(0.006 pi t) and th'' = 0."""
    a1, a2, th0 = 1.0, 2.0, 0.075

    def errors(frequency: float, th_acceleration: float) -> tuple[float, float, float]:
        e1, de1, dde1 = -th0, 0.7 * frequency, -th_acceleration
        e2 = de1 + a1 * e1
        return e1, e2, dde1 + a1 * de1 + a2 * e2

    assert errors(0.006 * pi, 0.0) == pytest.approx((-0.075, -0.0618, -0.1104), abs=5e-5)
    start = acceleration(th0, 0.0, GRAVITY * MASS @ POSITION, MASS @ POSITION**2, 0.0)
    assert start == pytest.approx(-0.505, abs=1e-3)
    right = errors(0.015 * pi, start)
    assert right == pytest.approx((-0.075, -0.0420, 0.4541), abs=1e-3)
    state = checked("arise_si_4", "initial state").inputs["state"]
    assert isinstance(state, tuple)
    assert state[:3] == pytest.approx(right, abs=1e-3)

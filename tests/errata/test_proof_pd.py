"""thm. LQR_SI_sys, app. ProofLQR_SI, lem. J_dot_is_bounded, and the numbers of section PD Controller."""

from __future__ import annotations

from math import cos, pi, sin

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
    friction,
    manifold,
    slope,
)

from swarmabs_config.scenarios import find_scenario
from swarmabs_config.theory import check_scenario, setting
from swarmabs_core.abstraction import Weight, abstraction
from swarmabs_core.behaviours import Controller, ControllerConfig
from swarmabs_core.controllers import StateFeedback
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import DesiredAbstractState, PlaneState
from swarmabs_core.plant import Friction, Plane, PlaneDynamics, SwarmLoad
from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass
from swarmabs_core.theory.state_feedback import estimate, matrix_eigenvalues, potential, radius_squared

K1, K2 = PD_PRINTED
K_S2 = GAINS.k[1]
CURVE = Manifold(CURVATURE, OFFSET, TORQUE_MAX)
J_DOT_PRINTED = 1.9059


def acceleration(th: float, w: float, torque: float, inertia: float, inertia_rate: float) -> float:
    """w' by eq. newDynamics, from the package's plane over a vanishing period."""
    dt = 1e-6
    moving = PlaneDynamics(Plane(inertia=INERTIA, friction=Friction(*FRICTION), substep=dt), dt)
    load = SwarmLoad((torque, 0.0, 0.0, 0.0), (inertia, inertia_rate * dt, 0.0, 0.0, 0.0, 0.0, 0.0))
    return (moving.advance(th, w, 0.0, load)[1] - w) / dt


def printed_rate(th: float, w: float, e_tau: float = 0.0, inertia_rate: float = 0.0) -> float:
    """V_p' of the paper's V_p = th^2/2 + (J + J_s) w^2/2 along the motion, J_s on the manifold."""
    wanted = K1 * th + K2 * w
    inertia = manifold(wanted)
    dw = acceleration(th, w, wanted - e_tau, inertia, inertia_rate)
    return th * w + (INERTIA + inertia) * w * dw + 0.5 * inertia_rate * w**2


def energy_rate(th: float, w: float, k2: float = K2, inertia_rate: float = 0.0) -> float:
    """V' of V = k1 (th sin th + cos th - 1) + (J + J_s) w^2/2."""
    wanted = K1 * th + k2 * w
    inertia = manifold(wanted)
    dw = acceleration(th, w, wanted, inertia, inertia_rate)
    return slope(lambda x: K1 * potential(x), th) * w + (INERTIA + inertia) * w * dw + 0.5 * inertia_rate * w**2


GRID = [(th, w) for th in np.linspace(-THETA_MAX, THETA_MAX, 9) for w in (-0.3, -0.05, -0.01, 0.01, 0.05, 0.3)]


def test_matrix_m_is_not_positive_definite() -> None:
    """app. ProofLQR_SI: positive eigenvalues of M are said to make z'Mz positive definite; M is not symmetric."""
    for j_dot, expected in ((0.0, (-0.31, 3.53)), (J_DOT_PRINTED, (-0.41, 2.68))):
        c = cos(THETA_MAX)
        m = np.array([[0.0, -1.0], [c * K1, c * K2 - j_dot / 2.0]])
        assert (np.linalg.eigvals(m).real > 0.0).all()  # what the paper checks
        symmetric = np.linalg.eigvalsh((m + m.T) / 2.0)  # what z'Mz is
        assert symmetric == pytest.approx(expected, abs=5e-3)
        assert symmetric[0] < 0.0 < symmetric[1]
        assert matrix_eigenvalues(K1, K2, THETA_MAX, j_dot) == pytest.approx(symmetric)


def test_printed_lyapunov_function_grows() -> None:
    """app. ProofLQR_SI: V_p' is said to be negative definite; it is positive at (0.1, -0.01)."""
    assert printed_rate(0.1, -0.01) > 1e-3
    assert printed_rate(0.1, 0.0) == pytest.approx(0.0, abs=1e-12)  # nor is it definite
    assert all(energy_rate(th, w) < 0.0 for th, w in GRID)


def test_cross_term_is_not_smallest_at_theta_max() -> None:
    """app. ProofLQR_SI: cos(th) k1 is replaced by cos(th_max) k1 although th w has both signs."""
    c = cos(THETA_MAX)
    m = np.array([[0.0, -1.0], [c * K1, c * K2]])
    z = np.array([0.1, -0.01])
    printed = -z @ m @ z - z[1] * friction(z[1])
    assert printed_rate(*z) > printed + 1e-5

    # V with the potential of the controller has no such term: the bound by th_max is one.
    assert all(energy_rate(th, w) <= -c * K2 * w**2 - w * friction(w) + 2e-5 for th, w in GRID)


def test_coupling_by_the_torque_error_is_missing() -> None:
    """app. ProofLQR_SI puts tau_s = tau_sd: V_p' lacks cos(th) w e_tau, the coupling term of thm. GeneralStability."""
    th, w, e_tau = 0.1, 0.2, 0.5
    printed = -(cos(th) * K1 - 1.0) * th * w - cos(th) * K2 * w**2 - w * friction(w)
    truth = printed_rate(th, w, e_tau)
    assert truth - printed > 0.09
    assert truth == pytest.approx(printed + cos(th) * w * e_tau, abs=1e-6)


def test_condition_on_k2() -> None:
    """thm. LQR_SI_sys: k2 > J'max/(2 cos); app. ProofLQR_DI and ProofLQR_noHomo: J'max/cos; neither counts g6."""
    j_dot, c = 4.0, cos(THETA_MAX)
    main, appendix, right = j_dot / (2.0 * c), j_dot / c, (j_dot / 2.0 - FRICTION[5]) / c
    assert right < main < appendix

    def worst(k2: float) -> float:
        """Largest V'/w^2 for any inertia's rate that is allowed, also where dry friction no longer counts."""
        states = [(th, w) for th in (-THETA_MAX, 0.1, THETA_MAX) for w in (-50.0, 0.3, 50.0)]
        return max(energy_rate(th, w, k2, r) / w**2 for th, w in states for r in (-j_dot, 0.0, j_dot))

    assert worst(right - 0.01) > 0.0
    assert worst(right + 0.01) < 0.0  # below both printed bounds, and it decreases

    checked = {c.name: c for t in check_scenario(find_scenario("pd_si_4")).theorems for c in t.conditions}["k2"]
    assert checked.corrected.value == pytest.approx(c * K2 + FRICTION[5])
    assert checked.corrected.bound == pytest.approx(checked.inputs["inertia_rate_corrected"] / 2.0)


def region(eta: float) -> float:
    """Squared radius of the ball S of thm. LQR_SI_sys."""
    return THETA_MAX**2 / (2.0 * eta)


def largest_v(square: float) -> float:
    """Largest V_p + V_a on the ball norm(z)^2 = square, by sampling directions and taking the axes."""
    directions = np.vstack([np.random.default_rng(0).normal(size=(5000, 4)), np.eye(4)])
    th, w, e_tau, e_j = (np.sqrt(square) * directions.T) / np.linalg.norm(directions, axis=1)
    inertia = manifold(np.clip(K1 * th + K2 * w, -TORQUE_MAX, TORQUE_MAX)) - e_j
    return float((0.5 * (th**2 + e_tau**2 + e_j**2) + 0.5 * (INERTIA + inertia) * w**2).max())


def test_eta_of_the_theorem() -> None:
    """thm. LQR_SI_sys: eta = max(1, ...); the largest ball in V <= th_max^2/2 has max(1/2, ...), as the appendix."""
    level = THETA_MAX**2 / 2.0
    half_inertia = (INERTIA + CURVE.inertia(TORQUE_MAX)) / 2.0
    printed, right = region(max(1.0, half_inertia)), region(max(0.5, half_inertia))
    assert (printed, right) == pytest.approx((0.02, 0.04))
    own = estimate(setting(find_scenario("pd_si_4")))
    assert own is not None
    assert (own.printed, own.corrected) == pytest.approx((printed, right))
    assert largest_v(printed) < 0.51 * level  # not the largest ball
    assert largest_v(right) == pytest.approx(level, rel=1e-9)
    assert largest_v(1.01 * right) > level


def test_printed_region_needs_another_torque_limit() -> None:
    """Section PD Controller: norm(z)^2 < 0.0326; with torque_max = 5 it is 0.0400."""
    printed = 0.0326
    half_inertia = (INERTIA + CURVE.inertia(TORQUE_MAX)) / 2.0
    for eta in (max(1.0, half_inertia), max(0.5, half_inertia)):
        assert abs(region(eta) - printed) > 0.007
    assert region(max(0.5, half_inertia)) == pytest.approx(0.04)
    own = estimate(setting(find_scenario("pd_si_4")))
    assert own is not None
    assert own.corrected == pytest.approx(0.04)
    with_more = (INERTIA + CURVE.inertia(7.5)) / 2.0
    assert region(max(0.5, with_more)) == pytest.approx(printed, abs=5e-5)  # where it comes from


def test_region_lacks_the_square() -> None:
    """app. ProofLQR_SI: norm(z) <= th_max^2/(2 eta), without the square of the theorem."""
    theta_max, eta = 1.2, 0.5
    radius = theta_max**2 / (2.0 * eta)
    inside_printed = 0.95 * radius  # as the angle alone
    assert 0.5 * inside_printed**2 > 0.5 * theta_max**2  # outside of the level set it should lie in
    assert 0.5 * radius == pytest.approx(0.5 * theta_max**2)  # as norm(z)^2 it touches the level set
    assert radius_squared(theta_max, eta) == pytest.approx(radius)


def test_constrained_region_violates_its_constraint() -> None:
    """Section PD Controller: with abs(e_J) <= 0.03 the region is still said to be norm(z)^2 <= 0.0326."""
    z = np.array([0.0, 0.0, 0.0, 0.18])
    assert z @ z <= 0.0326
    assert abs(z[3]) > 0.03
    assert CURVE.inertia(0.0) - z[3] < 0.0  # not even an inertia

    right = 0.03**2  # the largest ball with abs(e_J) <= 0.03 and abs(e_tau) < 2: its radius is the smaller of them
    for e_tau, e_j in np.sqrt(right) * np.stack([np.cos(np.linspace(0, 6.3, 64)), np.sin(np.linspace(0, 6.3, 64))]).T:
        assert abs(e_tau) < 2.0
        assert abs(e_j) <= 0.03
    initial = np.array([0.1, 0.0, 0.0273, 0.0288])
    assert initial @ initial > right  # so the paper's own start is not covered


def test_errors_have_less_room_than_said() -> None:
    """Section PD Controller: abs(e_J) <= 0.03 and abs(e_tau) < 2 are "acceptable" about the manifold."""
    masses = MASS.tolist()
    assert OFFSET - 0.03 < 0.0  # the error 0.03 at tau = 0: an inertia that no positions have
    assert ConstraintSets(masses, 1.0, GRAVITY).classify(0.0, OFFSET - 0.03) is StateClass.EMPTY
    for direction in np.linspace(0.0, 2.0 * pi, 33):
        torque, inertia = 0.0249 * sin(direction), OFFSET + 0.0249 * cos(direction)
        assert inertia > (torque / GRAVITY) ** 2 / MASS.sum()
        assert ConstraintSets(masses, 1.0, GRAVITY).classify(torque, inertia) is StateClass.ADMISSIBLE
    assert np.hypot(0.0482, -0.0026) > 0.025  # e_a(0)


def test_initial_abstract_error() -> None:
    """Section PD Controller: z_a0 = (0.0273, 0.0288) is (sum m p, sum m p^2), not an error."""
    printed = (0.0273, 0.0288)
    assert pytest.approx(printed, abs=5e-5) == (MASS @ POSITION, MASS @ POSITION**2)

    torque = K1 * 0.1
    truth = (torque - GRAVITY * MASS @ POSITION, manifold(torque) - MASS @ POSITION**2)
    assert truth == pytest.approx((0.0482, -0.0026), abs=5e-5)
    assert np.abs(np.array(truth) - printed).max() > 0.02

    parent = Controller(ControllerConfig(10_000_000, CURVE), StateFeedback(K1, K2))
    (desired,) = parent.handle(PlaneState(0, 0, 0.1, 0.0))
    assert isinstance(desired, DesiredAbstractState)
    total = abstraction([Weight(float(m), float(p), 0.0) for m, p in zip(MASS, POSITION, strict=True)], GRAVITY)
    assert (desired.torque - total.torque, desired.inertia - total.inertia) == pytest.approx(truth, abs=1e-12)
    own = estimate(setting(find_scenario("pd_si_4")))
    assert own is not None
    assert own.error_squared(0.1, 0.0) == pytest.approx(0.01 + truth[0] ** 2 + truth[1] ** 2)


def inertia_rate(th: float, w: float, e_tau: float, e_j: float) -> float:
    """J_s' in the closed loop, where w' and J_sd' depend on it in turn: solved numerically."""
    wanted = K1 * th + K2 * w
    inertia = manifold(wanted) - e_j

    def mismatch(rate: float) -> float:
        dw = (-cos(th) * (wanted - e_tau) - rate * w - friction(w)) / (INERTIA + inertia)
        return rate - CURVE.inertia_rate(wanted, K1 * w + K2 * dw) - K_S2 * e_j  # eq. swarmControlLaw

    return float(brentq(mismatch, -1e3, 1e3, xtol=1e-12))


def states(square: float, count: int = 300) -> list[tuple[float, float, float, float]]:
    """States on and inside the ball norm(z)^2 <= square where the total inertia is positive."""
    random = np.random.default_rng(1)
    directions = random.normal(size=(count, 4))
    directions *= (np.sqrt(square) * random.uniform(0.0, 1.0, count) / np.linalg.norm(directions, axis=1))[:, None]
    return [tuple(z) for z in directions]


def test_rate_of_the_inertia_in_closed_form() -> None:
    """lem. J_dot_is_bounded: -K_s2 e_J instead of +K_s2 e_J (J + J_sd - e_J), and tau_sd instead of tau_s."""
    worst = 0.0
    for th, w, e_tau, e_j in states(0.04):
        wanted = K1 * th + K2 * w
        total, d = INERTIA + manifold(wanted) - e_j, 2.0 * CURVATURE * wanted
        below = total + d * K2 * w
        truth = inertia_rate(th, w, e_tau, e_j)
        printed = (d * K1 * total * w - d * K2 * (cos(th) * wanted + friction(w)) - K_S2 * e_j) / below
        own = d * K1 * total * w - d * K2 * (cos(th) * (wanted - e_tau) + friction(w)) + K_S2 * e_j * total
        assert own / below == pytest.approx(truth, abs=1e-9)
        worst = max(worst, abs(printed - truth))
    assert worst > 1.0


def test_bound_on_the_rate_of_the_inertia() -> None:
    """lem. J_dot_is_bounded: alpha_2 subtracts K_s2, alpha_3 lacks g4, and the denominator grows with norm(z)."""
    slope_max = 2.0 * CURVATURE * TORQUE_MAX
    most, least = INERTIA + manifold(TORQUE_MAX), INERTIA + OFFSET
    g1, _, _, g4, _, g6 = FRICTION

    def printed(n: float) -> float:
        a1, a2 = slope_max / 2.0 * K1, slope_max * (K1 * most + K2 * g6) - K_S2
        a3, b1 = slope_max * K2 * (TORQUE_MAX + g1), slope_max * K2
        return (a1 * n**2 + a2 * n + a3) / (b1 * n + least)

    def right(n: float) -> float:
        above = slope_max * (K1 * (most + n) * n + K2 * (TORQUE_MAX + n + g1 + g4 + g6 * n)) + K_S2 * n * (most + n)
        return above / (least - n - slope_max * K2 * n)

    assert abs(inertia_rate(0.0, 0.0, 0.0, 0.2)) > 5.0 * printed(0.2)
    for z in states(0.04):
        assert abs(inertia_rate(*z)) <= right(float(np.linalg.norm(z)))


def test_largest_rate_of_the_inertia() -> None:
    """Section PD Controller: J'max = 1.9059, which neither the lemma nor the loop gives on any of the regions."""
    slope_max = 2.0 * CURVATURE * TORQUE_MAX
    most, least = INERTIA + manifold(TORQUE_MAX), INERTIA + OFFSET
    for square in (0.02, 0.0326, 0.04):
        n = square**0.5
        for sign in (-1.0, 1.0):
            a2 = slope_max * (K1 * most + K2 * FRICTION[5]) + sign * K_S2
            above = slope_max / 2.0 * K1 * square + a2 * n + slope_max * K2 * (TORQUE_MAX + FRICTION[0])
            assert abs(above / (slope_max * K2 * n + least) - J_DOT_PRINTED) > 0.5
        # In the loop it is K norm(z), reached where e_J is all there is.
        truth = K_S2 * n
        assert abs(inertia_rate(0.0, 0.0, 0.0, n)) == pytest.approx(truth)
        assert max(abs(inertia_rate(*z)) for z in states(square)) <= truth
        assert abs(truth - J_DOT_PRINTED) > 0.09
    assert pytest.approx(2.0) == K_S2 * 0.04**0.5


def test_initial_errors_of_arise() -> None:
    """Section ARISE Controller: e2(0) = -0.0618 and r(0) = -0.1104 belong to 0.7 sin(0.006 pi t) and th'' = 0."""
    a1, a2, th0 = 1.0, 2.0, 0.075

    def errors(frequency: float, th_acceleration: float) -> tuple[float, float, float]:
        e1, de1, dde1 = -th0, 0.7 * frequency, -th_acceleration
        e2 = de1 + a1 * e1
        return e1, e2, dde1 + a1 * de1 + a2 * e2

    printed = (-0.075, -0.0618, -0.1104)
    assert errors(0.006 * pi, 0.0) == pytest.approx(printed, abs=5e-5)  # where they come from

    start = acceleration(th0, 0.0, GRAVITY * MASS @ POSITION, MASS @ POSITION**2, 0.0)
    assert start == pytest.approx(-0.505, abs=1e-3)
    right = errors(0.015 * pi, start)
    assert right == pytest.approx((-0.075, -0.0420, 0.4541), abs=1e-3)
    assert abs(right[1] - printed[1]) > 0.01
    assert abs(right[2] - printed[2]) > 0.5
    checked = {c.name: c for t in check_scenario(find_scenario("arise_si_4")).theorems for c in t.conditions}
    state = checked["initial state"].inputs["state"]
    assert isinstance(state, tuple)
    assert state[:3] == pytest.approx(right, abs=1e-3)

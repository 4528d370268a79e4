"""thm. LQR_DI_sys with app. ProofLQR_DI, ProofARISE_DI and ProofLQR_noHomo."""

import numpy as np
import pytest
from tests.errata.paper import GAINS, THETA_MAX, random_swarm

from swarmabs_core.theory.error_dynamics import epsilon_bound, second_order_energy

KP, KD = GAINS.kp[0], GAINS.kd[0]


def m1(kp: float, eps: float) -> np.ndarray:
    """V_a = z' M1 z/2 of one abstract error and its rate."""
    return np.array([[kp, eps], [eps, 1.0]])


def m2(kp: float, kd: float, eps: float) -> np.ndarray:
    """V_a' = z' M2 z, by the Lyapunov equation of e'' = -kp e - kd e'."""
    a = np.array([[0.0, 1.0], [-kp, -kd]])
    return (m1(kp, eps) @ a + a.T @ m1(kp, eps)) / 2.0


def proves(kp: float, kd: float, eps: float) -> bool:
    """Tell whether V_a is positive and V_a' negative definite."""
    return bool(np.linalg.eigvalsh(m1(kp, eps))[0] > 0.0 > np.linalg.eigvalsh(m2(kp, kd, eps))[1])


def test_second_condition_on_epsilon() -> None:
    """eq. DI_cond2: eps kp kd - eps^2 kp - eps kd^2/4 > 0; the last term is eps^2 kd^2/4.

    app. ProofLQR_DI, where the determinant of M2 is that, has eps^2 kp^2 for eps^2 kp.
    """

    def printed(kp: float, kd: float, eps: float) -> bool:
        second = eps * kp * kd - eps**2 * kp - eps / 4.0 * kd**2
        return min(eps * kp + kd - eps, second, kp + 1.0, kp - eps**2) > 0.0

    assert printed(KP, KD, 3.1) and not proves(KP, KD, 3.1)  # too weak
    assert not any(printed(1.0, 5.0, eps) for eps in np.linspace(1e-3, 10.0, 2000))  # and too strong
    eps = 2.0
    truth = np.linalg.det(m2(KP, KD, eps))
    assert eps * KP * KD - eps**2 * KP**2 - eps**2 / 4.0 * KD**2 < 0.0 < truth  # the appendix refuses what works
    assert eps * KP * KD - eps**2 * KP - eps**2 / 4.0 * KD**2 == pytest.approx(truth)

    assert epsilon_bound(KP, KD) == pytest.approx(3.077, abs=5e-4)
    for kp, kd in [(KP, KD), (1.0, 5.0), (30.0, 1.0), (0.1, 0.2)]:
        bound = min(np.sqrt(kp), kd, 4.0 * kp * kd / (4.0 * kp + kd**2))
        assert epsilon_bound(kp, kd) == pytest.approx(bound)
        for eps in np.linspace(0.01, 2.0, 100) * bound * 0.999:
            assert proves(kp, kd, eps) == (eps < bound)


def test_error_dynamics_of_the_proof() -> None:
    """app. ProofLQR_DI: - Phi M (M^-1 Phi+ (...) (k_sd I + C) Phi+ a_d' - ...); M and M^-1 are interchanged."""
    swarm = random_swarm(4, double=True).in_row_space()
    gains, phi, pinv = swarm.gains, swarm.phi, np.linalg.pinv(swarm.phi)
    a_d, da_d, dda_d = np.array([0.4, 0.06]), np.array([0.3, -0.1]), np.array([-0.5, 0.2])
    mass, damping = np.diag(swarm.m), np.diag(swarm.c + gains.ksd)
    curvature = np.array([0.0, 2.0 * swarm.q])  # Phi' p'
    e, de = a_d - swarm.a, da_d - phi @ swarm.v
    c_a = phi @ np.linalg.inv(mass) @ damping @ pinv
    wish = np.array(gains.kp) * e + (np.diag(gains.kd) - c_a) @ de - curvature + dda_d

    def second(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
        force = inner @ pinv @ wish + damping @ pinv @ da_d - damping @ swarm.v
        return np.asarray(dda_d - curvature - phi @ outer @ force)

    truth = dda_d - swarm.acceleration(swarm.commands(a_d, da_d, dda_d))
    np.testing.assert_allclose(truth, -np.array(gains.kp) * e - np.array(gains.kd) * de, atol=1e-8)
    np.testing.assert_allclose(second(np.linalg.inv(mass), mass), truth, atol=1e-9)
    assert np.abs(second(mass, np.linalg.inv(mass)) - truth).max() > 0.1


def test_region_is_not_that_of_single_integrators() -> None:
    """thm. LQR_DI_sys: the same region, norm(z)^2 <= 0.04; V_a weighs e with K_p = 10 there, and z has e' too."""
    eps, level = 1.0, THETA_MAX**2 / 2.0
    assert proves(KP, KD, eps)
    weights, vectors = np.linalg.eigh(m1(KP, eps))
    right = 2.0 * level / max(1.0, weights[1])  # eta = lambda_max(M1)/2
    assert right == pytest.approx(0.04 / 10.11, rel=1e-3)
    z = right**0.5 * vectors[:, 1]
    assert 0.5 * z @ m1(KP, eps) @ z == pytest.approx(level)
    assert weights[1] > 10.0  # so in the printed region V_a exceeds the level by ten


def test_quadratic_forms_lack_the_half_and_the_square() -> None:
    """app. ProofARISE_DI: V_a = z' M1 z for z' M1 z/2; app. ProofLQR_DI: V_a' <= lambda_max(M2) norm(z_a)."""
    e, rate = z = np.array([0.3, -0.2])
    truth = 0.5 * (KP * e**2 + 2.0 * e * rate + rate**2)
    assert 0.5 * z @ m1(KP, 1.0) @ z == pytest.approx(truth)
    assert second_order_energy(GAINS.kp, 1.0, (e, 0.0), (rate, 0.0)) == pytest.approx(truth)

    (_, largest), vectors = np.linalg.eigh(m2(KP, KD, 1.0))
    z = 0.01 * vectors[:, 1]
    assert 0.0 > z @ m2(KP, KD, 1.0) @ z > largest * np.linalg.norm(z)

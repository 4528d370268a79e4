"""Section Swarm Controller: the laws of the robots against the Jacobian and the equations of motion."""

from __future__ import annotations

import numpy as np
import pytest
from tests.errata.paper import (
    DAMPING,
    GAINS,
    GRAVITY,
    HETEROGENEOUS,
    MASS,
    POSITION,
    Swarm,
    four_robots,
    random_swarm,
    slope,
)

from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_core.abstraction import Weight, abstraction, damping_sums, is_degenerate, second_moments
from swarmabs_core.messages import AuxiliaryState
from swarmabs_core.swarm_law import damping_matrix, pinv_row
from swarmabs_run.simulation import simulate

WANTED = (np.array([0.4, 0.06]), np.array([0.3, -0.1]), np.array([-0.5, 0.2]))
"""Some desired abstract state with its rate and acceleration."""


def intended(swarm: Swarm) -> np.ndarray:
    """eq. swarmControlLaw_double."""
    a_d, da_d, dda_d = WANTED
    return np.array(GAINS.kp) * (a_d - swarm.a) + np.array(GAINS.kd) * (da_d - swarm.phi @ swarm.v) + dda_d


@pytest.mark.parametrize("seed", range(5))
def test_pseudo_inverse_lacks_the_gravity(seed: int) -> None:
    swarm = random_swarm(seed, double=False)
    s0, s1, s2, s3 = swarm.s()
    truth = np.linalg.pinv(swarm.phi)

    printed = np.stack([swarm.m * (s2 - swarm.p * s1), 0.5 * swarm.m * (swarm.p * s0 - s1)]).T / s3
    np.testing.assert_allclose(swarm.phi @ printed, np.diag([GRAVITY, 1.0]), atol=1e-8)
    assert np.abs(printed - truth).max() > 0.1

    right = [pinv_row(m, p, swarm.sums(), GRAVITY) for m, p in zip(swarm.m, swarm.p, strict=True)]
    np.testing.assert_allclose(right, truth, rtol=1e-8, atol=1e-10)


def test_law_of_single_integrators_lacks_the_gravity() -> None:
    """eq. nodeControlLaw: as printed the torque runs after its reference 9.81 times too fast."""
    swarm = random_swarm(1, double=False)
    s0, s1, s2, s3 = swarm.s()
    a_d, da_d, _ = WANTED
    truth = np.array(GAINS.k) * (a_d - swarm.a) + da_d  # eq. swarmControlLaw

    rows = np.stack([swarm.m * (s2 - swarm.p * s1), 0.5 * swarm.m * (swarm.p * s0 - s1)]).T / s3
    np.testing.assert_allclose(swarm.phi @ (rows @ truth), truth * [GRAVITY, 1.0], atol=1e-9)
    assert abs(truth[0]) > 0.1  # so the two differ

    np.testing.assert_allclose(swarm.phi @ swarm.commands(*WANTED), truth, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_damping_matrix_lacks_s3_and_gravity(seed: int) -> None:
    """C_a must take Phi M^-1 (C + k_sd I) Phi+ out of the error dynamics."""
    swarm = random_swarm(seed, double=True)
    s0, s1, s2, s3 = swarm.s()
    md = swarm.m * (GAINS.ksd + swarm.c)
    truth = swarm.phi @ np.diag((swarm.c + GAINS.ksd) / swarm.m) @ np.linalg.pinv(swarm.phi)

    p = swarm.p
    printed = np.array(
        [
            [md @ (s2 - p * s1), 0.5 * md @ (p * s0 - s1)],
            [2.0 * (md * p) @ (s2 - p * s1), (md * p) @ (p * s0 - s1)],
        ]
    )
    assert np.abs(printed - truth).max() > 1.0
    np.testing.assert_allclose(printed / s3 * [[1.0, GRAVITY], [1.0 / GRAVITY, 1.0]], truth, rtol=1e-7, atol=1e-8)

    spread = second_moments(zip(swarm.m, swarm.p, strict=True))
    damping = damping_sums(zip(swarm.m, swarm.p, swarm.c, strict=True), GAINS.ksd)
    found = np.reshape(damping_matrix(AuxiliaryState(0, 0, *spread, *damping, 0.0), GRAVITY), (2, 2))
    np.testing.assert_allclose(found, truth, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_derivative_of_the_jacobian_needs_the_whole_swarm(seed: int) -> None:
    """eq. nodeControlLaw_double: -Phi' p_i' of one robot cannot cancel Phi' p' = [0, 2Q] of all."""
    swarm = random_swarm(seed, double=True).in_row_space()
    pinv = np.linalg.pinv(swarm.phi)
    right = swarm.commands(*WANTED)

    alone = 2.0 * swarm.m * swarm.v**2  # second entry of Phi' p_i', robot by robot
    printed = right + swarm.m * pinv[:, 1] * (2.0 * swarm.q - alone)
    assert np.abs(swarm.acceleration(printed) - intended(swarm)).max() > 0.02

    np.testing.assert_allclose(swarm.acceleration(right), intended(swarm), atol=1e-8)


def test_abstract_and_second_moments_do_not_suffice() -> None:
    """After eq. nodeControlLaw_double: the law is said to need a, a', a_d, S0 to S3 and C_a only."""
    mass, damping = np.full(3, 0.5), np.full(3, 1.0)
    position = np.array([-0.2, 0.0, 0.2])
    null = np.array([1.0, -2.0, 1.0])  # moves neither torque nor inertia: in the null space of Phi
    still, moving = (Swarm(mass, damping, position, s * null, np.full(3, True)) for s in (0.0, 0.5))

    known = [swarm.abstract()[3:] + swarm.sums()[2:9] for swarm in (still, moving)]
    assert known[0] == pytest.approx(known[1], abs=1e-15)  # all that the printed law knows is the same
    with_feedback = moving.commands(*WANTED) + GAINS.ksd * moving.v  # but for the robot's own damping
    printed = still.commands(*WANTED)  # what a law of these quantities alone has to command in both
    force = printed - GAINS.ksd * moving.v
    assert abs(moving.acceleration(force)[1] - intended(moving)[1]) > 1.0

    assert np.abs(with_feedback - printed).max() > 0.1
    np.testing.assert_allclose(moving.acceleration(moving.commands(*WANTED)), intended(moving), atol=1e-9)
    q = abstraction([Weight(*robot) for robot in zip(mass, position, moving.v, strict=True)], GRAVITY).q
    assert q == pytest.approx(moving.q, rel=1e-14)
    for count in (4, 8):  # what is broadcast, by the state machines and by the simulation on arrays
        run = simulate(
            parse_scenario(f"schema: 1\nduration: 0.05\nswarm: {{generate: {{double_integrator: {count}}}}}\n")
        )
        velocity = run.agents.velocity
        assert np.abs(velocity[-1]).max() > 1e-3
        np.testing.assert_allclose(run.auxiliary.q, (run.agents.mass * velocity**2).sum(axis=1), rtol=1e-12)


def test_one_gain_for_all_robots() -> None:
    """eq. nodeControlLaw_double: with a gain k_sdi of its own in the feed-forward the reference is not followed."""
    swarm = random_swarm(3, double=True).in_row_space()
    own = np.linspace(0.5, 2.0, len(swarm.m))
    right = swarm.commands(*WANTED)

    printed = right + (own - GAINS.ksd) * (np.linalg.pinv(swarm.phi) @ WANTED[1])
    assert np.abs(swarm.acceleration(printed) - intended(swarm)).max() > 0.05

    np.testing.assert_allclose(swarm.acceleration(right), intended(swarm), atol=1e-8)


def test_damping_leaves_a_residual_of_the_null_space() -> None:
    """eq. swarmControlLaw_double is said to be enforced; it is only up to the velocities that Phi does not see."""
    swarm = random_swarm(2, double=True)
    found = swarm.acceleration(swarm.commands(*WANTED)) - intended(swarm)
    assert np.abs(found).max() > 0.1  # the printed claim is 0

    unseen = swarm.v - swarm.in_row_space().v
    right = -swarm.phi @ ((swarm.c + GAINS.ksd) / swarm.m * unseen)
    np.testing.assert_allclose(found, right, atol=1e-8)


def test_mixed_swarm_does_not_split_into_two_abstract_errors() -> None:
    """app. ProofLQR_noHomo: V_as' = -e' K e of the single integrators alone, whatever the others do."""
    swarm = Swarm(MASS, DAMPING, POSITION, np.zeros(4), HETEROGENEOUS)
    error = np.array([0.2, 0.02])
    zero = np.zeros(2)
    velocity = np.where(swarm.double, swarm.v, swarm.commands(swarm.a + error, zero, zero))
    found = swarm.phi @ velocity  # the double integrators still stand

    printed = np.array(GAINS.k) * error
    assert np.abs(found / printed - 1.0).min() > 0.3

    share = swarm.phi[:, ~swarm.double] @ np.linalg.pinv(swarm.phi)[~swarm.double]
    np.testing.assert_allclose(found, share @ printed, rtol=1e-9)
    # The share's symmetric part is indefinite: -e' share K e is no negative definite rate of V_as.
    assert np.linalg.eigvalsh(share + share.T)[0] < -0.05


def test_swarm_is_singular_on_a_curve_not_at_a_point() -> None:
    """After eq. nodeControlLaw: S3 = 0 is said to be one point of the abstract space that a manifold can avoid."""
    states = []
    for position in (-0.3, 0.0, 0.2):
        sums = second_moments((float(m), position) for m in MASS)
        assert is_degenerate(sums.s0, sums.s3, 1.0)
        total = abstraction([Weight(float(m), position, 0.0) for m in MASS], GRAVITY)
        states.append((total.torque, total.inertia))
        # It is the whole lower bound of the abstract space.
        assert total.inertia == pytest.approx((total.torque / GRAVITY) ** 2 / MASS.sum(), abs=1e-15)
    assert np.abs(np.diff(states, axis=0)).min() > 0.01  # three different points

    sums = second_moments(zip(MASS.tolist(), POSITION.tolist(), strict=True))
    assert not is_degenerate(sums.s0, sums.s3, 1.0)


def test_origin_of_the_abstract_space_is_singular() -> None:
    """thm. GeneralConstrainedStability: A_C contains the origin; that of the errors is meant."""
    at_origin = second_moments((float(m), 0.0) for m in MASS)  # sum m p^2 = 0 has no other solution
    assert abstraction([Weight(float(m), 0.0, 0.0) for m in MASS], GRAVITY)[:2] == (0.0, 0.0)
    assert is_degenerate(at_origin.s0, at_origin.s3, 1.0)

    swarm = four_robots(double=False)
    at_zero_error = swarm.commands(swarm.a, np.zeros(2), np.zeros(2))
    np.testing.assert_allclose(at_zero_error, 0.0, atol=1e-15)  # well defined, and nothing moves
    sums = swarm.sums()
    assert not is_degenerate(sums.s0, sums.s3, 1.0)


def test_differentiable_is_not_uniformly_continuous() -> None:
    """Before thm. LQR_SI_sys: e_J -> 0 with a differentiable derivative is said to give e_J' -> 0 (Barbalat)."""

    def counterexample(t: float) -> float:
        return float(np.sin(t**2) / t)

    late = 1e3
    assert abs(counterexample(late)) <= 1.0 / late
    assert max(abs(slope(counterexample, late + k * 5e-4, 1e-6)) for k in range(7)) > 1.5  # does not vanish

    # What holds needs no lemma: under the law of single integrators e' = -K e.
    swarm = four_robots(double=False)
    for size in (1.0, 1e-3, 1e-6):
        error = size * np.array([0.3, 0.02])
        rate = -swarm.phi @ swarm.commands(swarm.a + error, np.zeros(2), np.zeros(2))
        np.testing.assert_allclose(rate, -np.array(GAINS.k) * error, rtol=1e-6)


def test_underdamped_inertia_is_flung_apart() -> None:
    """Section PD Controller: with K_p = 10, K_d = 5 the inertia swings through what no swarm can have."""
    goal = 0.025

    def lowest_after(start: float, kd: float) -> float:
        """Smallest inertia of e'' = -10 e - kd e' from rest, by the exact solution."""
        t = np.linspace(0.0, 10.0, 5001)
        decay, w = kd / 2.0, np.sqrt(complex(10.0 - kd**2 / 4.0))
        if abs(w) < 1e-6:
            e = (1.0 + decay * t) * np.exp(-decay * t)
        else:
            e = (np.exp(-decay * t) * (np.cos(w * t) + decay / w * np.sin(w * t))).real
        return float((goal + (start - goal) * e).min())

    assert lowest_after(2.0, 5.0) < 0.0  # an inertia below 0: no positions have it, S3 vanishes before
    assert lowest_after(2.0, 2.0 * np.sqrt(10.0)) > 0.0
    # The paper's own run starts close enough.
    assert lowest_after(float(MASS @ POSITION**2), 5.0) > 0.02

    def scenario(kd: float) -> Scenario:
        """Ten heavy robots that start far out."""
        return parse_scenario(
            "schema: 1\nduration: 2.0\nmanifold: {torque_max: 1}\nplane: {angle: 0.0}\nswarm:\n"
            f"  gains: {{kd: [{kd}, {kd}]}}\n"
            "  generate: {double_integrator: 10, mass: [0.7, 1.1], position: 0.45}\n"
        )

    assert any("swarm.gains: Kd < 2 sqrt(Kp)" in text for text in scenario(5.0).warnings())
    found = simulate(scenario(5.0))
    assert found.abstract.inertia.min() < 0.01
    assert np.abs(found.agents.position).max() > 1.0  # flung apart, off the plane
    assert not any("swarm.gains" in text for text in scenario(6.33).warnings())
    found = simulate(scenario(6.33))
    assert found.abstract.inertia[0] > 1.5
    assert found.abstract.inertia.min() > 0.0
    assert np.abs(found.agents.position).max() < 0.5

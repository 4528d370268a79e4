"""Section Swarm Controller: the laws of the robots against the Jacobian and the equations of motion."""

import numpy as np
import pytest
from tests.errata import paper

from swarmabs_config.scenario import Scenario, parse_scenario, warnings_of
from swarmabs_core.abstraction import is_degenerate
from swarmabs_core.swarm_law import damping_matrix, pinv_row
from swarmabs_run.simulation import simulate

WANTED = (np.array([0.4, 0.06]), np.array([0.3, -0.1]), np.array([-0.5, 0.2]))
"""Some desired abstract state with its rate and acceleration."""
SEEDS = pytest.mark.parametrize("seed", range(3))


def intended(swarm: paper.Swarm) -> np.ndarray:
    """eq. swarmControlLaw_double."""
    a_d, da_d, dda_d = WANTED
    gains = swarm.gains
    return np.array(gains.kp) * (a_d - swarm.a) + np.array(gains.kd) * (da_d - swarm.phi @ swarm.v) + dda_d


@SEEDS
def test_pseudo_inverse_lacks_the_gravity(seed: int) -> None:
    """Thus by eq. nodeControlLaw as printed the torque runs after its reference 9.81 times too fast."""
    swarm = paper.random_swarm(seed, double=False)
    s0, s1, s2, s3 = swarm.s()
    printed = np.stack([swarm.m * (s2 - swarm.p * s1), 0.5 * swarm.m * (swarm.p * s0 - s1)]).T / s3
    np.testing.assert_allclose(swarm.phi @ printed, np.diag([paper.GRAVITY, 1.0]), atol=1e-8)

    right = [pinv_row(m, p, swarm.sums(), paper.GRAVITY) for m, p in zip(swarm.m, swarm.p, strict=True)]
    np.testing.assert_allclose(right, np.linalg.pinv(swarm.phi), rtol=1e-8, atol=1e-10)
    a_d, da_d, mean_da_d = WANTED
    truth = np.array(paper.UNEVEN.k) * (a_d - swarm.a) + mean_da_d  # eq. swarmControlLaw, with the mean of a period
    np.testing.assert_allclose(swarm.phi @ swarm.commands(a_d, da_d, da_d, mean_da_d), truth, atol=1e-9)


@SEEDS
def test_damping_matrix_lacks_s3_and_gravity(seed: int) -> None:
    """C_a must take Phi M^-1 (C + k_sd I) Phi+ out of the error dynamics, of the double integrators alone."""
    swarm = paper.random_swarm(seed, double=True)
    swarm.double = np.arange(len(swarm.m)) % 3 > 0
    s0, s1, s2, s3 = swarm.s()
    md, p = np.where(swarm.double, swarm.m * (paper.UNEVEN.ksd + swarm.c), 0.0), swarm.p
    truth = swarm.phi @ np.diag(md / swarm.m**2) @ np.linalg.pinv(swarm.phi)

    printed = np.array(
        [
            [md @ (s2 - p * s1), 0.5 * md @ (p * s0 - s1)],
            [2.0 * (md * p) @ (s2 - p * s1), (md * p) @ (p * s0 - s1)],
        ]
    )
    assert np.abs(printed - truth).max() > 1.0
    np.testing.assert_allclose(
        printed / s3 * [[1.0, paper.GRAVITY], [1.0 / paper.GRAVITY, 1.0]], truth, rtol=1e-7, atol=1e-8
    )
    matrix = np.reshape(damping_matrix(swarm.sums(), paper.GRAVITY), (2, 2))
    np.testing.assert_allclose(matrix, truth, rtol=1e-8, atol=1e-8)


@SEEDS
def test_law_of_double_integrators(seed: int) -> None:
    """eq. nodeControlLaw_double: -Phi' p_i' of one robot cannot cancel Phi' p' = [0, 2Q] of all; k_sdi for k_sd.

    And eq. swarmControlLaw_double is enforced only up to the velocities that Phi does not see.
    """
    swarm = paper.random_swarm(seed, double=True)
    unseen = swarm.v - swarm.in_row_space().v
    residual = swarm.acceleration(swarm.commands(*WANTED)) - intended(swarm)
    np.testing.assert_allclose(residual, -swarm.phi @ ((swarm.c + paper.UNEVEN.ksd) / swarm.m * unseen), atol=1e-8)
    assert np.abs(residual).max() > 0.02

    swarm = swarm.in_row_space()
    right, pinv = swarm.commands(*WANTED), np.linalg.pinv(swarm.phi)
    np.testing.assert_allclose(swarm.acceleration(right), intended(swarm), atol=1e-8)
    alone = 2.0 * swarm.m * swarm.v**2  # second entry of Phi' p_i', robot by robot
    of_one = right + swarm.m * pinv[:, 1] * (2.0 * swarm.q - alone)
    own = np.linspace(0.5, 2.0, len(swarm.m))
    of_own_gains = right + (own - paper.UNEVEN.ksd) * (pinv @ WANTED[1])
    for printed in (of_one, of_own_gains):
        assert np.abs(swarm.acceleration(printed) - intended(swarm)).max() > 0.02


def test_abstract_and_second_moments_do_not_suffice() -> None:
    """After eq. nodeControlLaw_double: the law is said to need a, a', a_d, S0 to S3 and C_a only."""
    mass, damping = np.full(3, 0.5), np.full(3, 1.0)
    position = np.array([-0.2, 0.0, 0.2])
    null = np.array([1.0, -2.0, 1.0])  # moves neither torque nor inertia: in the null space of Phi
    still, moving = (paper.Swarm(mass, damping, position, s * null, np.full(3, True)) for s in (0.0, 0.5))

    broadcast = [swarm.abstract()[3:] + swarm.sums()[2:9] for swarm in (still, moving)]
    assert broadcast[0] == pytest.approx(broadcast[1], abs=1e-15)  # all that the printed law knows is the same
    # What a law of these quantities alone has to command in both, but for the robot's own damping:
    force = still.commands(*WANTED) - paper.GAINS.ksd * moving.v
    assert abs(moving.acceleration(force)[1] - intended(moving)[1]) > 1.0
    np.testing.assert_allclose(moving.acceleration(moving.commands(*WANTED)), intended(moving), atol=1e-9)


def test_mixed_swarm_does_not_split_into_two_abstract_errors() -> None:
    """app. ProofLQR_noHomo: V_as' = -e' K e of the single integrators alone, whatever the others do."""
    swarm = paper.Swarm(paper.MASS, paper.DAMPING, paper.POSITION, np.zeros(4), paper.HETEROGENEOUS)
    error = np.array([0.2, 0.02])
    commands = swarm.commands(swarm.a + error, np.zeros(2), np.zeros(2))
    rates = swarm.phi @ np.where(swarm.double, 0.0, commands)  # the double integrators still stand
    printed = np.array(paper.GAINS.k) * error
    assert np.abs(rates / printed - 1.0).min() > 0.3

    share = swarm.phi[:, ~swarm.double] @ np.linalg.pinv(swarm.phi)[~swarm.double]
    np.testing.assert_allclose(rates, share @ printed, rtol=1e-9)
    # The share's symmetric part is indefinite: -e' share K e is no negative definite rate of V_as.
    assert np.linalg.eigvalsh(share + share.T)[0] < -0.05


def test_swarm_is_singular_on_a_curve_not_at_a_point() -> None:
    """After eq. nodeControlLaw: S3 = 0 is said to be one point of the abstract space that a manifold can avoid.

    thm. GeneralConstrainedStability: A_C contains the origin, which is singular; that of the errors is meant.
    """
    states = []
    for position in (-0.3, 0.0, 0.2):
        swarm = paper.Swarm(paper.MASS, paper.DAMPING, np.full(4, position), np.zeros(4), np.full(4, False))
        s0, *_, s3 = swarm.s()
        assert is_degenerate(s0, s3, 1.0)
        # It is the whole lower bound of the abstract space.
        assert swarm.a[1] == pytest.approx((swarm.a[0] / paper.GRAVITY) ** 2 / paper.MASS.sum(), abs=1e-15)
        states.append(swarm.a)
    assert np.abs(np.diff(states, axis=0)).min() > 0.01  # three different points, and one of them
    assert not states[1].any()  # the origin

    swarm = paper.Swarm(paper.MASS, paper.DAMPING, paper.POSITION, np.zeros(4), np.full(4, False))
    s0, *_, s3 = swarm.s()
    assert not is_degenerate(s0, s3, 1.0)
    at_zero_error = swarm.commands(swarm.a, np.zeros(2), np.zeros(2))
    np.testing.assert_allclose(at_zero_error, 0.0, atol=1e-15)  # well defined, and nothing moves


def test_differentiable_is_not_uniformly_continuous() -> None:
    """Before thm. LQR_SI_sys: e_J -> 0 with a differentiable derivative is said to give e_J' -> 0 (Barbalat).

    sin(t^2)/t goes to 0 and its rate does not. What holds needs no lemma: single integrators have e' = -K e.
    """
    late = 1e3
    rates = [paper.slope(lambda t: float(np.sin(t**2) / t), late + k * 5e-4, 1e-6) for k in range(7)]
    assert max(map(abs, rates)) > 1.5


def test_underdamped_inertia_is_flung_apart() -> None:
    """Section PD Controller: with K_p = 10, K_d = 5 the inertia swings through what no swarm can have."""

    def scenario(kd: float) -> Scenario:
        """Ten heavy robots that start far out."""
        return parse_scenario(
            "schema: 1\nduration: 2.0\nmanifold: {torque_max: 1}\nplane: {angle: 0.0}\nswarm:\n"
            f"  gains: {{kd: [{kd}, {kd}]}}\n"
            "  generate: {double_integrator: 10, mass: [0.7, 1.1], position: 0.45}\n"
        )

    flung, kept = (simulate(scenario(kd)) for kd in (5.0, 6.33))  # 2 sqrt(10) is 6.325
    assert flung.abstract.inertia.min() < 0.01
    assert np.abs(flung.agents.position).max() > 1.0  # flung apart, off the plane
    assert any("Kd < 2 sqrt(Kp)" in text for text in warnings_of(scenario(5.0)))
    assert kept.abstract.inertia[0] > 1.5
    assert kept.abstract.inertia.min() > 0.0
    assert np.abs(kept.agents.position).max() < 0.5
    assert not any("swarm.gains" in text for text in warnings_of(scenario(6.33)))

"""The laws against the Jacobian of the abstraction, Phi = [[g m_i], [2 m_i p_i]], by linear algebra."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pytest

from swarmabs_core.messages import AbstractState, AuxiliaryState, DesiredAbstractState
from swarmabs_core.swarm_law import (
    SwarmGains,
    damping_matrix,
    double_integrator_command,
    pinv_row,
    single_integrator_command,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

G = 9.81
GAINS = SwarmGains((10.0, 7.0), (9.0, 11.0), (5.0, 6.0), 1.3)


@dataclass
class Swarm:
    """Robots in a random state, and a random wish; `di` tells who is a double integrator."""

    m: Array
    c: Array
    p: Array
    v: Array
    di: Array
    a_d: Array
    da_d: Array
    mean_da_d: Array
    dda_d: Array

    @property
    def phi(self) -> Array:
        return np.stack([G * self.m, 2.0 * self.m * self.p])

    @property
    def a(self) -> Array:
        return np.array([G * self.m @ self.p, self.m @ self.p**2])

    @property
    def q(self) -> float:
        return float(self.m @ self.v**2)

    def abstract(self) -> AbstractState:
        return AbstractState(0, 0, len(self.m), *map(float, self.a), *map(float, self.phi @ self.v))

    def sums(self) -> AuxiliaryState:
        mm, d = self.m**2, np.where(self.di, self.m * (self.c + GAINS.ksd), 0.0)
        s = [float(mm @ self.p**k) for k in range(3)]
        return AuxiliaryState(0, 0, *s, s[0] * s[2] - s[1] ** 2, *(float(d @ self.p**k) for k in range(3)), self.q)

    def desired(self) -> DesiredAbstractState:
        fields = (*self.a_d, *self.da_d, *self.mean_da_d, *self.dda_d)
        return DesiredAbstractState(0, 0, 1, *map(float, fields))

    def si_commands(self) -> Array:
        shared = (GAINS, G, self.abstract(), self.sums(), self.desired())
        return np.array([single_integrator_command(m, p, *shared) for m, p in zip(self.m, self.p, strict=True)])

    def di_commands(self) -> Array:
        shared = (GAINS, G, self.abstract(), self.sums(), self.desired())
        robots = zip(self.m, self.c, self.p, self.v, strict=True)
        return np.array([double_integrator_command(*robot, *shared) for robot in robots])


@pytest.fixture(params=range(8))
def random(request: pytest.FixtureRequest) -> np.random.Generator:
    return np.random.default_rng(request.param)


@pytest.fixture
def swarm(random: np.random.Generator) -> Swarm:
    n = int(random.integers(2, 12))
    return Swarm(
        m=random.uniform(0.25, 0.75, n),
        c=random.uniform(0.5, 1.5, n),
        p=random.uniform(-0.5, 0.5, n),
        v=random.uniform(-1.0, 1.0, n),
        di=np.ones(n, dtype=bool),
        **{name: random.uniform(-1.0, 1.0, 2) for name in ("a_d", "da_d", "mean_da_d", "dda_d")},
    )


def rows(swarm: Swarm) -> Array:
    return np.array([pinv_row(m, p, swarm.sums(), G) for m, p in zip(swarm.m, swarm.p, strict=True)])


def test_rows_are_the_pseudo_inverse(swarm: Swarm) -> None:
    np.testing.assert_allclose(rows(swarm), np.linalg.pinv(swarm.phi), rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(swarm.phi @ rows(swarm), np.eye(2), atol=1e-10)


def test_printed_pseudo_inverse_is_none(swarm: Swarm) -> None:
    """Erratum: as printed, without 1/g in the first column, Phi Phi+ is diag(9.81, 1)."""
    printed = rows(swarm) * [G, 1.0]
    np.testing.assert_allclose(swarm.phi @ printed, np.diag([9.81, 1.0]), atol=1e-9)


def test_damping_matrix_is_phi_gamma_pinv(swarm: Swarm, random: np.random.Generator) -> None:
    """C_a = Phi diag((c_i + k_sd)/m_i) Phi+, the sum of the diagonal over double integrators only."""
    swarm.di = random.random(len(swarm.m)) < 0.6
    gamma = np.where(swarm.di, (swarm.c + GAINS.ksd) / swarm.m, 0.0)
    expected = swarm.phi @ np.diag(gamma) @ np.linalg.pinv(swarm.phi)
    found = np.reshape(damping_matrix(swarm.sums(), G), (2, 2))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_single_integrators_give_the_abstract_state_its_error_dynamics(swarm: Swarm) -> None:
    """The abstract state moves with K e and the mean rate exactly."""
    expected = np.array(GAINS.k) * (swarm.a_d - swarm.a) + swarm.mean_da_d
    np.testing.assert_allclose(swarm.phi @ swarm.si_commands(), expected, atol=1e-9)


def test_single_integrators_share_one_two_vector(swarm: Swarm) -> None:
    """Every command is m_i (g y0 + 2 p_i y1): least squares with two unknowns leave nothing."""
    commands = swarm.si_commands()
    y, *_ = np.linalg.lstsq(swarm.phi.T, commands, rcond=None)
    np.testing.assert_allclose(swarm.phi.T @ y, commands, atol=1e-10)


def test_double_integrators_share_two_two_vectors(swarm: Swarm) -> None:
    """u_i + k_sd v_i = m_i row_i X + (c_i + k_sd) row_i Y, both of the rows' form."""
    wanted = swarm.di_commands() + GAINS.ksd * swarm.v
    basis = np.hstack([swarm.phi.T * swarm.m[:, None], swarm.phi.T * (swarm.c + GAINS.ksd)[:, None]])
    y, *_ = np.linalg.lstsq(basis, wanted, rcond=None)
    np.testing.assert_allclose(basis @ y, wanted, atol=1e-8)


def closed_loop(swarm: Swarm) -> tuple[Array, Array]:
    """Second derivative of the abstract state under the law, and Kp e + Kd e' + a_d''."""
    acceleration = (swarm.di_commands() - swarm.c * swarm.v) / swarm.m
    second = swarm.phi @ acceleration + [0.0, 2.0 * swarm.q]
    e, de = swarm.a_d - swarm.a, swarm.da_d - swarm.phi @ swarm.v
    return second, np.array(GAINS.kp) * e + np.array(GAINS.kd) * de + swarm.dda_d


def test_double_integrators_cancel_their_damping(swarm: Swarm) -> None:
    """With velocities in the row space of Phi the error dynamics are those that the law intends."""
    swarm.v = np.linalg.pinv(swarm.phi) @ swarm.phi @ swarm.v
    found, intended = closed_loop(swarm)
    np.testing.assert_allclose(found, intended, atol=1e-9)


def test_equal_damping_per_mass_cancels_for_any_velocities(swarm: Swarm) -> None:
    swarm.c = 4.0 * swarm.m - GAINS.ksd
    found, intended = closed_loop(swarm)
    np.testing.assert_allclose(found, intended, atol=1e-9)


def test_motion_in_the_null_space_leaves_a_residual(swarm: Swarm) -> None:
    """- Phi diag((c_i + k_sd)/m_i) v_0, with v_0 in the null space of Phi; the paper's proofs drop it."""
    null = swarm.v - np.linalg.pinv(swarm.phi) @ swarm.phi @ swarm.v
    found, intended = closed_loop(swarm)
    residual = -swarm.phi @ ((swarm.c + GAINS.ksd) / swarm.m * null)
    np.testing.assert_allclose(found - intended, residual, atol=1e-9)

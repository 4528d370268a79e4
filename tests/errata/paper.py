"""The paper's numbers, and what several tests of its errata need. Nothing here comes from the package under test.

Labels (eq., thm., app.) are those of the paper's LaTeX source.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_core.messages import AbstractState, AuxiliaryState, DesiredAbstractState
from swarmabs_core.swarm_law import SwarmGains, double_integrator_command, single_integrator_command

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

GRAVITY = 9.81
LENGTH = 1.0
INERTIA = 0.5
FRICTION = (0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0)
MASS = np.array([0.3552, 0.3532, 0.6762, 0.4596])
DAMPING = np.array([0.7290, 1.4133, 0.6524, 1.3258])
POSITION = np.array([0.125, -0.125, 0.125, -0.125])
HETEROGENEOUS = np.array([False, False, True, True])
"""Which of the four robots are double integrators in the third swarm."""

PD_PRINTED = (3.1623, 3.2859)
THETA_MAX = 0.2
CURVATURE, OFFSET, TORQUE_MAX = 0.0125, 0.025, 5.0
GAINS = SwarmGains(k=(10.0, 10.0), kp=(10.0, 10.0), kd=(5.0, 5.0), ksd=1.0)


def friction(w: float) -> float:
    """eq. frictionModel with tab. PhysicalParameters, N m."""
    g1, g2, g3, g4, g5, g6 = FRICTION
    return float(g1 * (np.tanh(g2 * w) - np.tanh(g3 * w)) + g4 * np.tanh(g5 * w) + g6 * w)


def manifold(torque: float) -> float:
    """eq. JLimit, kg m^2."""
    return CURVATURE * torque**2 + OFFSET


def phi(mass: Array, position: Array) -> Array:
    """Jacobian of the abstraction (eq. mapping_d): rates of torque and inertia per velocity."""
    return np.stack([GRAVITY * mass, 2.0 * mass * position])


def slope(function: Callable[[float], float], at: float, step: float = 1e-5) -> float:
    """Derivative by central differences of fourth order."""
    near, far = (function(at + k * step) - function(at - k * step) for k in (1, 2))
    return (8.0 * near - far) / (12.0 * step)


@dataclass
class Swarm:
    """A swarm in some state, with its broadcasts by plain sums, and the commands of the package's laws."""

    m: Array
    c: Array
    p: Array
    v: Array
    double: Array

    @property
    def phi(self) -> Array:
        return phi(self.m, self.p)

    @property
    def a(self) -> Array:
        return np.array([GRAVITY * self.m @ self.p, self.m @ self.p**2])

    @property
    def q(self) -> float:
        return float(self.m @ self.v**2)

    def s(self) -> list[float]:
        """S0 to S3 as after eq. pinv."""
        mm = self.m**2
        pairs = [(i, j) for i in range(len(mm)) for j in range(i + 1, len(mm))]
        spread = sum(mm[i] * mm[j] * (self.p[i] - self.p[j]) ** 2 for i, j in pairs)
        return [float(mm @ self.p**k) for k in range(3)] + [float(spread)]

    def abstract(self) -> AbstractState:
        return AbstractState(0, 0, len(self.m), *map(float, self.a), *map(float, self.phi @ self.v))

    def sums(self) -> AuxiliaryState:
        d = np.where(self.double, self.m * (self.c + GAINS.ksd), 0.0)
        return AuxiliaryState(0, 0, *self.s(), *(float(d @ self.p**k) for k in range(3)), self.q)

    def commands(self, a_d: Array, da_d: Array, dda_d: Array) -> Array:
        """What the package's laws command the robots: velocities and forces."""
        desired = DesiredAbstractState(0, 0, 1, *map(float, [*a_d, *da_d, *da_d, *dda_d]))
        shared = (GAINS, GRAVITY, self.abstract(), self.sums(), desired)
        return np.array(
            [
                double_integrator_command(m, c, p, v, *shared) if double else single_integrator_command(m, p, *shared)
                for m, c, p, v, double in zip(self.m, self.c, self.p, self.v, self.double, strict=True)
            ]
        )

    def acceleration(self, force: Array) -> Array:
        """Second derivative of the abstract state under forces on double integrators, by eq. EOM_DI."""
        return self.phi @ ((force - self.c * self.v) / self.m) + [0.0, 2.0 * self.q]

    def in_row_space(self) -> Swarm:
        """The same swarm without the part of its velocities that the abstract state does not see."""
        return Swarm(self.m, self.c, self.p, np.linalg.pinv(self.phi) @ self.phi @ self.v, self.double)


def four_robots(*, double: bool, v: Array | None = None) -> Swarm:
    """The paper's four robots where they start."""
    return Swarm(MASS, DAMPING, POSITION, np.zeros(4) if v is None else v, np.full(4, double))


def random_swarm(seed: int, *, double: bool) -> Swarm:
    """Robots with masses and dampings of tab. PhysicalParameters in a random state."""
    random = np.random.default_rng(seed)
    n = int(random.integers(3, 9))
    return Swarm(
        random.uniform(0.25, 0.75, n),
        random.uniform(0.5, 1.5, n),
        random.uniform(-0.5, 0.5, n),
        random.uniform(-1.0, 1.0, n),
        np.full(n, double),
    )

"""The paper's numbers, and what several tests of its errata need. Nothing here comes from the package under test.

Labels (eq., thm., app.) are those of the paper's LaTeX source.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from swarmabs_config.scenarios import find_scenario
from swarmabs_config.theory import check_scenario
from swarmabs_core.messages import AbstractState, AuxiliaryState, DesiredAbstractState
from swarmabs_core.swarm_law import SwarmGains, double_integrator_command, single_integrator_command
from swarmabs_core.theory.report import Condition

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
UNEVEN = SwarmGains(k=(10.0, 7.0), kp=(9.0, 11.0), kd=(5.0, 6.0), ksd=1.3)
"""Gains of which no two can be taken for each other."""


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
    gains: SwarmGains = GAINS

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
        d = np.where(self.double, self.m * (self.c + self.gains.ksd), 0.0)
        return AuxiliaryState(0, 0, *self.s(), *(float(d @ self.p**k) for k in range(3)), self.q)

    def commands(self, a_d: Array, da_d: Array, dda_d: Array, mean_da_d: Array | None = None) -> Array:
        """What the package's laws command the robots: velocities and forces."""
        mean_da_d = da_d if mean_da_d is None else mean_da_d
        desired = DesiredAbstractState(0, 0, 1, *map(float, [*a_d, *da_d, *mean_da_d, *dda_d]))
        shared = (self.gains, GRAVITY, self.abstract(), self.sums(), desired)
        return np.array(
            [
                double_integrator_command(m, c, p, v, *shared) if double else single_integrator_command(m, p, *shared)
                for m, c, p, v, double in zip(self.m, self.c, self.p, self.v, self.double, strict=True)
            ]
        )

    def acceleration(self, force: Array) -> Array:
        """Second derivative of the abstract state under forces on double integrators, by eq. EOM_DI."""
        return self.phi @ ((force - self.c * self.v) / self.m) + [0.0, 2.0 * self.q]

    def in_row_space(self) -> "Swarm":
        """The same swarm without the part of its velocities that the abstract state does not see."""
        return replace(self, v=np.linalg.pinv(self.phi) @ self.phi @ self.v)


def random_swarm(seed: int, *, double: bool) -> Swarm:
    """Robots with masses and dampings of tab. PhysicalParameters in a random state, and uneven gains."""
    random = np.random.default_rng(seed)
    n = int(random.integers(3, 9))
    return Swarm(
        random.uniform(0.25, 0.75, n),
        random.uniform(0.5, 1.5, n),
        random.uniform(-0.5, 0.5, n),
        random.uniform(-1.0, 1.0, n),
        np.full(n, double),
        UNEVEN,
    )


def checked(scenario: str, name: str) -> Condition:
    """Return a condition of a theorem as the package checks it for one of the paper's runs."""
    report = check_scenario(find_scenario(scenario))
    return {c.name: c for theorem in report.theorems for c in theorem.conditions}[name]

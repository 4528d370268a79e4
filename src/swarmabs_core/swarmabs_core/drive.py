"""How a robot moves under a command that is held over one control period (eq. swarmModel, EOM_DI)."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import expm1
from typing import Protocol


class Drive(Protocol):
    """What moves a robot over one control period."""

    def advance(self, position: float, velocity: float, command: float) -> tuple[float, float]:
        """Return position (m) and velocity (m/s) one period later under the command."""
        ...


def _phi(z: float) -> tuple[float, float]:
    """Return (exp(z) - 1)/z and (exp(z) - 1 - z)/z^2, by series where the quotients lose digits."""
    if abs(z) > 0.1:
        phi1 = expm1(z) / z
        return phi1, (phi1 - 1.0) / z
    phi1 = phi2 = 0.0
    for n in range(11, 0, -1):  # Horner, smallest terms first
        phi1 = 1.0 + phi1 * z / (n + 1)
        phi2 = 1.0 + phi2 * z / (n + 2)
    return phi1, phi2 / 2.0


@dataclass(frozen=True, slots=True)
class SingleIntegratorDrive:
    """p' = u, integrated exactly.

    Parameters
    ----------
    period : float
        Control period, s.
    """

    period: float

    def advance(self, position: float, velocity: float, command: float) -> tuple[float, float]:  # noqa: ARG002
        """Return position (m) and velocity (m/s) one period later under the velocity command (m/s)."""
        return position + command * self.period, command


@dataclass(frozen=True, slots=True)
class DoubleIntegratorDrive:
    """m v' = f - c v, p' = v, with f held: exact zero-order-hold discretisation.

    Parameters
    ----------
    period : float
        Control period, s.
    mass : float
        kg.
    damping : float
        N s/m, zero is allowed.
    """

    period: float
    mass: float
    damping: float
    decay: float = field(init=False)
    force_to_velocity: float = field(init=False)
    velocity_to_position: float = field(init=False)
    force_to_position: float = field(init=False)

    def __post_init__(self) -> None:
        z = -self.damping * self.period / self.mass
        phi1, phi2 = _phi(z)
        put = object.__setattr__
        put(self, "decay", 1.0 + z * phi1)
        put(self, "force_to_velocity", phi1 * self.period / self.mass)
        put(self, "velocity_to_position", phi1 * self.period)
        put(self, "force_to_position", phi2 * self.period * self.period / self.mass)

    def advance(self, position: float, velocity: float, command: float) -> tuple[float, float]:
        """Return position (m) and velocity (m/s) one period later under the force (N)."""
        return (
            position + self.velocity_to_position * velocity + self.force_to_position * command,
            self.decay * velocity + self.force_to_velocity * command,
        )

"""Motion of a robot under a command that is held over one control period (eq. swarmModel, EOM_DI)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias

from swarmabs_core.elementary import exp, expm1
from swarmabs_core.messages import Kind


class Drive(Protocol):
    """Model of a robot's motion over one control period."""

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


def _difference(a: float, b: float) -> float:
    """Return the divided difference (exp(a) - exp(b))/(a - b); exp(a) where both are equal."""
    low, high = min(a, b), max(a, b)
    return exp(high) * _phi(low - high)[0]


def _second_difference(a: float, b: float) -> float:
    """Return the divided difference of exp at 0, a and b, which are not positive and may be arbitrarily close."""
    low, high = min(a, b), max(a, b)
    if low < -1.0:
        return (_phi(high)[0] - _difference(low, high)) / -low
    # sum of h_n / (n + 2)!, h_n being the complete homogeneous polynomial of a and b
    total, power, homogeneous, factorial = 0.0, 1.0, 1.0, 2.0
    for n in range(1, 24):
        total += homogeneous / factorial
        power *= a
        homogeneous = homogeneous * b + power
        factorial *= n + 2
    return total


@dataclass(frozen=True, slots=True)
class SingleIntegratorDrive:
    """p' = u, integrated exactly over a control period (s)."""

    period: float

    def advance(self, position: float, velocity: float, command: float) -> tuple[float, float]:  # noqa: ARG002
        """Return position (m) and velocity (m/s) one period later under the velocity command (m/s)."""
        return position + command * self.period, command


class DoubleIntegratorDrive(NamedTuple):
    """m v' = f - c v, p' = v, with f held: exact zero-order-hold discretisation.

    `decay` is the fraction of the velocity that remains after a period. The factors are in s/kg (force to velocity), s
    (velocity to position) and s^2/kg (force to position).
    """

    decay: float
    force_to_velocity: float
    velocity_to_position: float
    force_to_position: float

    @classmethod
    def of(cls, period: float, mass: float, damping: float) -> DoubleIntegratorDrive:
        """Return the drive of a robot; period in s, mass in kg, damping in N s/m, which may be 0."""
        z = -damping * period / mass
        phi1, phi2 = _phi(z)
        return cls(1.0 + z * phi1, phi1 * period / mass, phi1 * period, phi2 * period * period / mass)

    def advance(self, position: float, velocity: float, command: float) -> tuple[float, float]:
        """Return position (m) and velocity (m/s) one period later under the force (N)."""
        return (
            position + self.velocity_to_position * velocity + self.force_to_position * command,
            self.decay * velocity + self.force_to_velocity * command,
        )


IdealDrive: TypeAlias = SingleIntegratorDrive | DoubleIntegratorDrive
"""The drive that the law of a robot on the plane expects."""


@dataclass(frozen=True, slots=True)
class Lag:
    r"""First-order lag of an actuator, :math:`T \dot x = u - x`, for a held command u.

    x is the velocity of a single integrator or the force of a double integrator. The system is linear, so its motion is
    that of the drive without lag plus the response to the decaying gap ``x - u``.

    Parameters
    ----------
    decay : float
        Fraction of the gap that remains after a period.
    gap_to_velocity, gap_to_position : float
        Change of velocity and position at the end of a period per unit of the gap at its beginning.
    """

    decay: float
    gap_to_velocity: float
    gap_to_position: float

    @classmethod
    def of(cls, kind: Kind, time_constant: float, period: float, mass: float, damping: float) -> Lag | None:
        """Return the lag of a robot's drive, None if there is none.

        Time constant and period are in s, mass in kg, damping in N s/m.
        """
        if not time_constant:
            return None
        lag, drag = -period / time_constant, -damping * period / mass
        if not kind.by_force:
            return cls(exp(lag), exp(lag), period * _phi(lag)[0])
        return cls(
            exp(lag),
            period / mass * _difference(lag, drag),
            period * period / mass * _second_difference(lag, drag),
        )

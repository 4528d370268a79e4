"""The curve in abstract space to which the desired abstract state is constrained (eq. JLimit)."""

from __future__ import annotations

from dataclasses import dataclass

from swarmabs_core.declaration import setting


@dataclass(frozen=True, slots=True)
class Manifold:
    """The curve in abstract space on which the swarm is held, Js = curvature tau^2 + offset.

    The torque is limited to +-torque_max (eq. tauLimit).
    """

    curvature: float = setting(0.0125, "A of Js = A tau^2 + B, kg m^2/(N m)^2", minimum=0.0)
    offset: float = setting(0.025, "B of Js = A tau^2 + B, kg m^2", above=0.0)
    torque_max: float = setting(5.0, "largest torque requested from the swarm, N m", above=0.0)

    def clip(self, torque: float) -> float:
        """Return the torque (N m) limited to +-torque_max."""
        return min(max(torque, -self.torque_max), self.torque_max)

    def inertia(self, torque: float) -> float:
        """Return the inertia (kg m^2) on the curve at a torque (N m)."""
        return self.curvature * torque * torque + self.offset

    def inertia_rate(self, torque: float, rate: float) -> float:
        """Return the inertia's rate of change (kg m^2/s) along the curve; `rate` in N m/s."""
        return 2.0 * self.curvature * torque * rate

    def inertia_acceleration(self, torque: float, rate: float, acceleration: float) -> float:
        """Return the inertia's second derivative (kg m^2/s^2) along the curve; `acceleration` in N m/s^2."""
        return 2.0 * self.curvature * (rate * rate + torque * acceleration)

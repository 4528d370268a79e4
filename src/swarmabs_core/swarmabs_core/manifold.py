r"""The curve in abstract space to which the desired abstract state is constrained (eq. JLimit).

Robots that stand (dead, stopped or silent) keep their torque :math:`\tau_s` and their inertia :math:`J_s`. The others
must supply the rest: at a torque :math:`\tau`, with mass :math:`M_A`, they have at least the inertia that belongs to
their centre, and the second moment G about it is what remains,

.. math:: J = J_s + \frac{(\tau - \tau_s)^2}{g^2 M_A} + G

On a curve that ignores this, G becomes negative and the robots are flung apart. `Manifold.around` therefore keeps G as
it is where no robot stands, :math:`G = (A - 1/(g^2 M)) \tau^2 + B` with the whole mass M, but for its constant part,
which shrinks with the square of the share of the mass that still moves, so that the robots do not spread beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.declaration import setting

if TYPE_CHECKING:
    from swarmabs_core.messages import StandingState


class Curve(NamedTuple):
    """Inertia over torque, J = curvature tau^2 + slope tau + offset, in kg m^2 and N m."""

    curvature: float
    slope: float
    offset: float

    def inertia(self, torque: float) -> float:
        """Return the inertia (kg m^2) at a torque (N m)."""
        return self._with(torque, self.curvature * torque * torque + self.offset)

    def rate(self, torque: float, rate: float) -> float:
        """Return the inertia's rate of change (kg m^2/s); `rate` is that of the torque, N m/s."""
        return self._with(rate, 2.0 * self.curvature * torque * rate)

    def mean_rate(self, torque: float, end: float, period: float) -> float:
        """Return the mean rate (kg m^2/s) over a period (s) from one torque to another, N m."""
        return self._with(end - torque, self.curvature * (end * end - torque * torque)) / period

    def acceleration(self, torque: float, rate: float, acceleration: float) -> float:
        """Return the inertia's second derivative (kg m^2/s^2), for derivatives of the torque in N m/s and N m/s^2."""
        return self._with(acceleration, 2.0 * self.curvature * (rate * rate + torque * acceleration))

    def _with(self, value: float, others: float) -> float:
        """Return the linear term and the others, which keep their bits without a slope."""
        return others + self.slope * value if self.slope else others


class Load(NamedTuple):
    """A part of the swarm on the plane: torque (N m), inertia (kg m^2) and mass (kg)."""

    torque: float
    inertia: float
    mass: float

    @classmethod
    def of(cls, rows: tuple[float, ...], constants: tuple[float, ...]) -> Load:
        """Return a part as `StandingState` has it."""
        (torque, inertia), (mass,) = rows, constants
        return cls(torque, inertia, mass)

    def around_centre(self, gravity: float) -> float:
        """Return the second moment about the centre of mass, kg m^2, 0 without robots; gravity in m/s^2."""
        if not self.mass:
            return 0.0
        return max(0.0, self.inertia - self.torque * self.torque / (gravity * gravity * self.mass))


@dataclass(frozen=True, slots=True)
class Manifold:
    """The curve in abstract space on which the swarm is held, Js = curvature tau^2 + offset.

    The torque is limited to +-torque_max (eq. tauLimit).
    """

    curvature: float = setting(0.0125, "A of Js = A tau^2 + B", unit="kg m^2/(N m)^2", minimum=0.0)
    offset: float = setting(0.025, "B of Js = A tau^2 + B", unit="kg m^2", above=0.0)
    torque_max: float = setting(5.0, "largest torque requested from the swarm", unit="N m", above=0.0)

    @property
    def curve(self) -> Curve:
        """The curve while no robot stands."""
        return Curve(self.curvature, 0.0, self.offset)

    def clip(self, torque: float) -> float:
        """Return the torque (N m) limited to +-torque_max."""
        return min(max(torque, -self.torque_max), self.torque_max)

    def inertia(self, torque: float) -> float:
        """Return the inertia (kg m^2) on the curve at a torque (N m)."""
        return self.curve.inertia(torque)

    def around(self, divided: StandingState, gravity: float) -> Curve:
        """Return the curve around robots that stand, while others follow the law; gravity in m/s^2."""
        if not divided.standing_count:
            return self.curve
        still = Load.of(divided.standing, divided.standing_constants)
        (mass,) = divided.moving_constants
        whole, squared = mass + still.mass, gravity * gravity
        own, share = 1.0 / (squared * mass), mass / whole
        growth = max(0.0, self.curvature - 1.0 / (squared * whole))
        return Curve(
            own + growth,
            -2.0 * own * still.torque,
            still.inertia + own * still.torque * still.torque + share * share * self.offset,
        )

r"""Estimate of the swarm's torque from the plane alone: a disturbance observer (docs/explanation/parent_response.md).

Over a period all torques on the plane change its angular momentum (eq. newDynamics, integrated),

.. math:: \left[ (J + J_s) w \right]_{k-1}^{k} = -\int (\cos\theta\,\tau_s + f_f(w) + \tau_d)\,dt

so angle and angular velocity at both ends give the mean over the period of :math:`\tau_s + \tau_d/\cos\theta`: swarm
and disturbance cannot be distinguished. A first-order filter attenuates the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from swarmabs_core.declaration import setting
from swarmabs_core.elementary import cos, expm1

if TYPE_CHECKING:
    from swarmabs_core.plant import Friction


@dataclass(frozen=True, slots=True)
class SumObserver:
    """The sum over the robots' states."""

    type: ClassVar[str] = "sum"
    description: ClassVar[str] = "torque and inertia are summed over the robots"


@dataclass(frozen=True, slots=True)
class ParentResponse:
    """The disturbance-observer estimate of the torque, see docs/explanation/parent_response.md."""

    type: ClassVar[str] = "parent_response"
    description: ClassVar[str] = "the torque is estimated from the plane's motion"

    bandwidth: float = setting(
        50.0, "bandwidth of the filter of the torque estimated from the plane's motion", unit="rad/s", above=0.0
    )


class TorqueEstimator:
    """A disturbance observer: estimates the torque of the swarm from one measurement of the plane per control period.

    Parameters
    ----------
    inertia : float
        Moment of inertia J of the plane alone, kg m^2.
    friction : Friction
        Friction of its bearing.
    bandwidth : float
        Bandwidth of the filter, rad/s; its delay is the inverse.
    period : float
        Control period, s.
    """

    def __init__(self, inertia: float, friction: Friction, bandwidth: float, period: float) -> None:
        self._inertia = inertia
        self._friction = friction
        self._period = period
        self._share = -expm1(-bandwidth * period)
        self._before: tuple[float, float, float] | None = None
        self._torque = 0.0

    def update(self, angle: float, angular_velocity: float, swarm_inertia: float) -> tuple[float, float]:
        """Take angle (rad) and angular velocity (rad/s); return the estimated torque (N m) and its rate (N m/s).

        After the first measurement the estimate is 0, as if the plane were in equilibrium. The moment of inertia J_s
        (kg m^2) of the swarm cannot be estimated from the response, so it is given.
        """
        friction = self._friction.torque(angular_velocity)
        momentum = (self._inertia + swarm_inertia) * angular_velocity
        before, self._before = self._before, (angle, momentum, friction)
        if before is None:
            return self._torque, 0.0
        last_angle, last_momentum, last_friction = before
        change = (momentum - last_momentum) / self._period + 0.5 * (last_friction + friction)
        mean = -change / cos(0.5 * (last_angle + angle))
        step = self._share * (mean - self._torque)
        self._torque += step
        return self._torque, step / self._period

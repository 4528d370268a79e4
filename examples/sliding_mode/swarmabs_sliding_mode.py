"""Sliding-mode control of the plane's angle with a boundary layer; see README.md for the mathematics."""

from typing import cast

from swarmabs_core.controllers import TRAJECTORY, ControllerType, ParentContext, make_trajectory
from swarmabs_core.elementary import cos
from swarmabs_core.messages import PlaneState
from swarmabs_core.parameters import Parameter, Settings


class SlidingMode:
    """Drives s = e' + slope e, e = th - th_d, to 0 and keeps it there."""

    def __init__(self, settings: Settings, context: ParentContext) -> None:
        self.slope, self.reach, self.layer = (cast("float", settings[name]) for name in ("slope", "reach", "layer"))
        self.inertia = context.inertia + context.manifold.offset
        self.viscous = context.friction.g6
        self.trajectory = make_trajectory(settings)

    def reference(self, time: float) -> float:
        """Return th_d, rad."""
        return self.trajectory.derivatives(time)[0]

    def torque(self, time: float, plane: PlaneState) -> float:
        """Return tau_raw, N m."""
        desired, rate, acceleration, *_ = self.trajectory.derivatives(time)
        error_rate = plane.angular_velocity - rate
        s = error_rate + self.slope * (plane.angle - desired)
        equivalent = self.inertia * (self.slope * error_rate - acceleration) - self.viscous * plane.angular_velocity
        switching = self.reach * min(max(s / self.layer, -1.0), 1.0)
        return (equivalent + switching) / cos(plane.angle)


SETTINGS = (
    Parameter("slope", 2.0, "rate at which the error vanishes on the sliding surface, 1/s", above=0.0),
    Parameter("reach", 0.5, "torque beyond the layer; must exceed every disturbance, N m", minimum=0.0),
    Parameter("layer", 0.1, "half width of the boundary layer, rad/s", above=0.0),
    *TRAJECTORY,
)
SLIDING_MODE = ControllerType("sliding_mode", SETTINGS, SlidingMode)

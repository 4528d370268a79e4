"""The settings of a reference trajectory, for every parent controller that follows one."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from swarmabs_core.parameters import Parameter
from swarmabs_core.trajectory import Constant, Sine

if TYPE_CHECKING:
    from swarmabs_core.controllers.base import Trajectory
    from swarmabs_core.parameters import Settings

TRAJECTORY = (
    Parameter("trajectory.type", "sine", "reference trajectory of the angle", choices=("sine", "constant")),
    Parameter("trajectory.amplitude", 0.7, "amplitude of the sine, rad", minimum=-1.5, maximum=1.5),
    Parameter("trajectory.angular_frequency", 0.0471238898038469, "angular frequency of the sine, rad/s"),
    Parameter("trajectory.angle", 0.0, "the constant reference, rad", minimum=-1.5, maximum=1.5),
)
"""What a controller that follows a trajectory adds to its settings; a scenario then has ``controller.trajectory``."""


def make_trajectory(settings: Settings) -> Trajectory:
    """Make the trajectory that the settings of a controller with `TRAJECTORY` describe."""

    def number(name: str) -> float:
        return cast("float", settings[f"trajectory.{name}"])

    if settings["trajectory.type"] == "sine":
        return Sine(number("amplitude"), number("angular_frequency"))
    return Constant(number("angle"))

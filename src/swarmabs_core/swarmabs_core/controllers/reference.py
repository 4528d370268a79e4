"""The settings of a reference trajectory, for every parent controller that follows one."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from swarmabs_core.parameters import Parameter
from swarmabs_core.spline import QuinticSpline
from swarmabs_core.trajectory import Constant, QuinticStep, Sine

if TYPE_CHECKING:
    from swarmabs_core.controllers.base import Trajectory
    from swarmabs_core.parameters import Settings

TRAJECTORY = (
    Parameter(
        "trajectory.type",
        "sine",
        "reference trajectory of the angle",
        choices=("sine", "constant", "quintic", "csv"),
    ),
    Parameter("trajectory.amplitude", 0.7, "amplitude of the sine, rad", minimum=-1.5, maximum=1.5),
    Parameter("trajectory.angular_frequency", 0.0471238898038469, "angular frequency of the sine, rad/s"),
    Parameter("trajectory.angle", 0.0, "the constant reference, rad", minimum=-1.5, maximum=1.5),
    Parameter("trajectory.start_angle", 0.0, "angle before the quintic step, rad", minimum=-1.5, maximum=1.5),
    Parameter("trajectory.end_angle", 0.2, "angle after the quintic step, rad", minimum=-1.5, maximum=1.5),
    Parameter("trajectory.start_time", 1.0, "time at which the quintic step begins, s", minimum=0.0),
    Parameter("trajectory.duration", 5.0, "duration of the quintic step, s", above=0.0),
    Parameter("trajectory.times", (0.0, 1.0), "times of the rows of csv, increasing, s", minimum=0.0),
    Parameter("trajectory.angles", (0.0, 0.0), "angles of the rows of csv, rad", minimum=-1.5, maximum=1.5),
)
"""What a controller that follows a trajectory adds to its settings; a scenario then has ``controller.trajectory``."""


def make_trajectory(settings: Settings) -> Trajectory:
    """Make the trajectory that the settings of a controller with `TRAJECTORY` describe.

    Raises
    ------
    InputError
        If the rows of a csv trajectory make no curve.
    """

    def number(name: str) -> float:
        return cast("float", settings[f"trajectory.{name}"])

    def numbers(name: str) -> tuple[float, ...]:
        return cast("tuple[float, ...]", settings[f"trajectory.{name}"])

    kind = settings["trajectory.type"]
    if kind == "sine":
        return Sine(number("amplitude"), number("angular_frequency"))
    if kind == "constant":
        return Constant(number("angle"))
    if kind == "quintic":
        return QuinticStep(number("start_angle"), number("end_angle"), number("start_time"), number("duration"))
    return QuinticSpline(numbers("times"), numbers("angles"))

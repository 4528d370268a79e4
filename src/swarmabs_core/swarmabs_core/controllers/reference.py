"""The settings of a reference trajectory, for every parent controller that follows one."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from swarmabs_core.declaration import made_of, parameters_of
from swarmabs_core.parameters import Parameter
from swarmabs_core.spline import QuinticSpline
from swarmabs_core.trajectory import Constant, QuinticStep, Sine

if TYPE_CHECKING:
    from swarmabs_core.controllers.base import Trajectory
    from swarmabs_core.parameters import Settings

TRAJECTORY = (
    Parameter(
        "trajectory.type",
        Sine.type,
        "reference trajectory of the angle",
        choices=(Sine.type, Constant.type, QuinticStep.type, "csv"),
    ),
    *(parameter for each in (Sine, Constant, QuinticStep) for parameter in parameters_of(each, prefix="trajectory.")),
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
    kind = settings["trajectory.type"]
    declared: tuple[type[Sine | Constant | QuinticStep], ...] = (Sine, Constant, QuinticStep)
    for each in declared:
        if kind == each.type:
            return made_of(each, settings, "trajectory.")
    times, angles = (cast("tuple[float, ...]", settings[f"trajectory.{name}"]) for name in ("times", "angles"))
    return QuinticSpline(times, angles)

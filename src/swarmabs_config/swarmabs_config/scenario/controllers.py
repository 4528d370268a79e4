"""Configurations of the built-in parent controllers and of their reference trajectories.

Both are looked up by their ``type``. The models of controllers that other packages bring are derived, see `plugins`.
"""

import itertools
from typing import Annotated, Literal, TypeAlias

from pydantic import ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from swarmabs_core.spline import SHORTEST, QuinticSpline

from .fields import (
    AsFour,
    AsPair,
    AsTuple,
    Finding,
    Model,
    NonNegative,
    Number,
    Positive,
    Tagged,
    WithoutNegativeZero,
    problem,
    raise_findings,
)
from .timing import LONGEST

STEEPEST = 1.5
"""Bound of every plane angle in rad: the control laws divide by its cosine, and a run fails beyond it."""

MOST_ROWS = 2000
"""Most rows of a trajectory: they travel to the parent controller as parameters."""

Angle: TypeAlias = Annotated[float, Field(gt=-STEEPEST, lt=STEEPEST), WithoutNegativeZero]
"""An angle of the plane in rad."""


class TrajectoryConfig(Model):
    """Base of the reference trajectories th_d(t) of the plane's angle."""

    type: str = Field(description="name of the trajectory")


class SineTrajectory(TrajectoryConfig):
    """The paper's reference, th_d = amplitude sin(angular_frequency t)."""

    type: Literal["sine"] = Field(default="sine", description="th_d = amplitude sin(angular_frequency t)")
    amplitude: Angle = Field(default=0.7, description="amplitude of the reference angle, rad")
    angular_frequency: Number = Field(
        default=0.0471238898038469, description="angular frequency of the reference, rad/s"
    )


class ConstantTrajectory(TrajectoryConfig):
    """A constant reference, th_d = angle."""

    type: Literal["constant"] = Field(default="constant", description="th_d = angle")
    angle: Angle = Field(default=0.0, description="reference angle, rad")


class QuinticTrajectory(TrajectoryConfig):
    """A step along a polynomial of degree 5, with rate and acceleration 0 at both ends."""

    type: Literal["quintic"] = Field(
        default="quintic", description="from start_angle to end_angle along a polynomial of degree 5"
    )
    start_angle: Angle = Field(default=0.0, description="angle before the step, rad")
    end_angle: Angle = Field(default=0.2, description="angle after the step, rad")
    start_time: NonNegative = Field(default=1.0, description="time at which the step begins, s")
    duration: Positive = Field(default=5.0, description="duration of the step, s")


class CsvTrajectory(TrajectoryConfig):
    """The smooth curve through the rows of a file, see `swarmabs_core.spline`.

    When a scenario is loaded its rows take the place of the file, so that a resolved scenario needs it no more.
    """

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["file"]}, {"required": ["times", "angles"]}]})

    type: Literal["csv"] = Field(default="csv", description="a quintic spline through rows, at rest at both ends")
    file: str | None = Field(
        default=None,
        exclude=True,
        description="CSV file with the header time,angle (s, rad), relative to the scenario's file",
    )
    times: Annotated[tuple[Annotated[NonNegative, Field(le=LONGEST)], ...], AsTuple] = Field(
        default=(), description="instead of a file: times of the rows, increasing, s"
    )
    angles: Annotated[tuple[Angle, ...], AsTuple] = Field(
        default=(), description="instead of a file: angles of the rows, rad"
    )

    @model_validator(mode="after")
    def _check_rows(self) -> "CsvTrajectory":
        if self.file is not None:
            raise problem(
                "a file beside rows, or in a scenario that is no file", "give 'file', or 'times' and 'angles'"
            )
        if len(self.times) != len(self.angles) or not 2 <= len(self.times) <= MOST_ROWS:
            raise problem(
                f"{len(self.times)} times and {len(self.angles)} angles",
                f"give 'file', or as many times as angles, 2 to {MOST_ROWS}",
            )
        for index, (earlier, later) in enumerate(itertools.pairwise(self.times), start=1):
            if not later - earlier >= SHORTEST:
                finding = Finding.of(
                    ("times", index),
                    f"{later!r} s follows {earlier!r} s",
                    f"let the times increase by at least {SHORTEST} s",
                )
                raise_findings("CsvTrajectory", [finding])
        curve = QuinticSpline(self.times, self.angles)
        for index, (earlier, later) in enumerate(itertools.pairwise(self.times)):
            for part in range(1, 16):
                time = earlier + (later - earlier) * part / 16
                if not abs(angle := curve.derivatives(time)[0]) < STEEPEST:
                    finding = Finding.of(
                        ("times", index),
                        f"the smooth curve through the rows is at {angle:.3g} rad at {time:.6g} s",
                        f"give rows closer together, such that it stays within +-{STEEPEST} rad",
                    )
                    raise_findings("CsvTrajectory", [finding])
        return self


DEFAULT_TRAJECTORY = "sine"
TRAJECTORY_CONFIGS: dict[str, type[TrajectoryConfig]] = {
    "sine": SineTrajectory,
    "constant": ConstantTrajectory,
    "quintic": QuinticTrajectory,
    "csv": CsvTrajectory,
}
"""The model of each ``trajectory.type``."""


class ControllerConfig(Model):
    """Base of the parent controllers' configurations."""

    type: str = Field(description="name of the parent controller")

    @classmethod
    def unknown_key(cls, key: str) -> PydanticCustomError:
        """Say of a trajectory that this controller cannot follow one."""
        if key == "trajectory":
            return problem(
                f"the {cls.model_fields['type'].default} controller follows no trajectory",
                "remove 'trajectory', or use 'type: arise'",
            )
        return super().unknown_key(key)


class PdConfig(ControllerConfig):
    """State feedback tau_raw = k1 th + k2 w with given gains."""

    type: Literal["pd"] = Field(default="pd", description="tau_raw = k1 th + k2 w")
    gains: Annotated[tuple[Number, Number], AsPair] = Field(
        default=(3.1623, 3.2859), description="[k1, k2]: k1 in N m/rad, k2 in N m s/rad"
    )


class LqrConfig(ControllerConfig):
    """State feedback with the gain that minimises the integral of z'Qz + r tau^2, z = (th, w).

    Linearised at 0 with the inertia ``plane.inertia + manifold.offset`` and the viscous friction g6.
    """

    type: Literal["lqr"] = Field(
        default="lqr", description="tau_raw = K (th, w) with K from the algebraic Riccati equation"
    )
    q: Annotated[tuple[Positive, NonNegative], AsPair] = Field(
        default=(10.0, 1.0),
        description="diagonal of Q: weight of angle in 1/rad^2 and of angular velocity in s^2/rad^2",
    )
    r: Positive = Field(default=1.0, description="weight of the torque, 1/(N m)^2")


class AriseConfig(ControllerConfig):
    """Adaptive robust integral of the sign of the error, tracking a trajectory under a disturbance."""

    type: Literal["arise"] = Field(default="arise", description="adaptive robust integral of the sign of the error")
    ks: NonNegative = Field(default=1.0, description="gain of the filtered error, N m s/rad")
    alpha1: Positive = Field(default=1.0, description="gain of the angle error in e2, 1/s")
    alpha2: Positive = Field(default=2.0, description="gain of e2 in the integral, 1/s")
    beta: NonNegative = Field(default=0.5, description="gain of the robust (sign) term, N m/s")
    gamma: Annotated[tuple[NonNegative, NonNegative, NonNegative, NonNegative], AsFour] = Field(
        default=(10.0, 1.0, 1.0, 10.0), description="diagonal of the adaptation gain, one for each parameter"
    )
    smoothing: Positive = Field(
        default=0.03,
        description="width of tanh(e2/smoothing), which stands for sgn(e2) in sampled time, rad/s",
    )
    adaptive_initial: Annotated[tuple[Number, Number, Number, Number], AsFour] = Field(
        default=(0.4566, 0.009, 0.01, 0.9),
        description="initial estimates of the inertia in kg m^2, of g1 and g4 in N m, and of g6 in N m s/rad",
    )
    trajectory: Annotated[TrajectoryConfig, Tagged("type", TRAJECTORY_CONFIGS, DEFAULT_TRAJECTORY)] = Field(
        default=SineTrajectory(), description="reference of the plane's angle"
    )


DEFAULT_CONTROLLER = "pd"
CONTROLLER_CONFIGS: dict[str, type[ControllerConfig]] = {
    "pd": PdConfig,
    "lqr": LqrConfig,
    "arise": AriseConfig,
}
"""The model of each built-in ``controller.type``."""

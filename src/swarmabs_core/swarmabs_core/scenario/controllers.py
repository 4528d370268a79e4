"""Configurations of the built-in parent controllers and of their reference trajectories.

Both are looked up by their ``type``. The models of controllers that other packages bring are derived, see `plugins`.
"""

from typing import Annotated, Literal, TypeAlias

from pydantic import Field
from pydantic_core import PydanticCustomError

from .fields import (
    AsFour,
    AsPair,
    Model,
    NonNegative,
    Number,
    Positive,
    Tagged,
    WithoutNegativeZero,
    problem,
)

STEEPEST = 1.5
"""Bound of every plane angle in rad: the control laws divide by its cosine, and a run fails beyond it."""

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


DEFAULT_TRAJECTORY = "sine"
TRAJECTORY_CONFIGS: dict[str, type[TrajectoryConfig]] = {
    "sine": SineTrajectory,
    "constant": ConstantTrajectory,
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

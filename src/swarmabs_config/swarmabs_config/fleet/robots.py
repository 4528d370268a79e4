"""The robots of a fleet: dynamics, limits, and the drive that connects the control law to the body."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, TypeAlias

from pydantic import Field, JsonValue, field_validator, model_validator
from pydantic_core import PydanticCustomError

from swarmabs_config.fleet.parts import PluginName, SettingName
from swarmabs_config.model.agents import AgentId, Damping, Mass, Position, Velocity
from swarmabs_config.model.declared import like, model_of
from swarmabs_config.model.errors import describe
from swarmabs_config.model.fields import LARGEST, Model, Name, Positive, Tagged, problem
from swarmabs_core.models.plane_robot import RobotConfig
from swarmabs_core.parameters import Value
from swarmabs_core.realtime.instruments import TopicSettings


class SimulatedDrive(Model):
    """A simulated body, whose motion is computed from the commands."""

    type: Literal["simulated"] = Field(default="simulated", description="the body is simulated")
    position: Position = like(RobotConfig, "position", required=True)
    velocity: Velocity = like(RobotConfig, "velocity")


class PluginDrive(Model):
    """A body that is moved by code of a package, such as a vendor's library."""

    type: Literal["plugin"] = Field(default="plugin", description="the body is moved by code of a package")
    name: PluginName = Field(description="name of the drive, an entry point in the group swarmabs.drives")
    settings: dict[SettingName, JsonValue] = Field(default={}, description="settings of the drive, by name")

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        if name in {"simulated", "topic", "plugin"}:
            raise problem(
                f"'{name}' is not a drive of a package", f"write 'type: {name}', or the name of the entry point"
            )
        return name

    @field_validator("settings")
    @classmethod
    def _check_settings(cls, settings: dict[str, JsonValue]) -> dict[str, JsonValue]:
        for name, value in settings.items():
            if name in {"type", "name"}:
                raise problem(f"a setting cannot be called {name}", "choose another name for it")
            items = value if isinstance(value, list) and value else [value]
            kinds = {type(item) for item in items}
            if len(kinds) != 1 or not kinds <= {bool, int, float, str}:
                raise problem(
                    f"{name}: {describe(value)} is not a parameter value",
                    "give a number, a text, true or false, or a list of values of one of these types",
                )
            if any(type(item) is int and not -(2**63) <= item < 2**63 for item in items):
                raise problem(f"{name}: {describe(value)} is out of range", "give a 64-bit integer")
            if any(isinstance(item, float) and abs(item) > LARGEST for item in items):
                raise problem(f"{name}: {describe(value)} is out of range", f"give a number within +-{LARGEST:g}")
        return settings

    @property
    def parameters(self) -> dict[str, Value]:
        """The drive's settings as parameter values."""
        return {name: tuple(value) if isinstance(value, list) else value for name, value in self.settings.items()}  # type: ignore[misc]  # checked above


Drive: TypeAlias = SimulatedDrive | TopicSettings | PluginDrive
DRIVES: dict[str, type[Model]] = {
    "simulated": SimulatedDrive,
    "topic": model_of(TopicSettings, tag="type"),
    "plugin": PluginDrive,
}


class RobotLimits(Model):
    """Limits of a robot; the scenario's apply where one is left out."""

    velocity: Positive | None = Field(default=None, description="largest speed, m/s; null: as in the scenario")
    force: Positive | None = Field(default=None, description="largest force of a double integrator, N; null: likewise")
    deceleration: Positive | None = Field(
        default=None, description="braking deceleration of a single integrator's base, m/s^2; null: it stops at once"
    )
    lane: Positive | None = Field(
        default=None, description="largest distance from the axis, m; null: half the plane minus realtime.lane_margin"
    )


class SingleIntegratorRobot(Model):
    """A robot whose command is its velocity."""

    id: AgentId = like(RobotConfig, "agent_id", required=True)
    host: Name = Field(description="host on which its node runs")
    kind: Literal["single_integrator"] = Field(default="single_integrator", description="p' = u")
    mass: Mass = like(RobotConfig, "mass", required=True)
    limits: RobotLimits = Field(default=RobotLimits(), description="limits of this robot")
    drive: Annotated[Drive, Tagged("type", DRIVES)] = Field(description="connects the control law to the body")

    damping: ClassVar[float] = 0.0

    @field_validator("drive", mode="before")
    @classmethod
    def _check_weight(cls, drive: object) -> object:
        """Reject an IMU for a single integrator, whose base holds the weight itself."""
        if not isinstance(drive, Mapping) or drive.get("type") != TopicSettings.type:
            return drive
        if drive.get("gravity") == "imu":
            raise problem("gravity does not act on a single integrator", "remove 'gravity: imu'")
        return {**drive, "gravity": drive.get("gravity", "none")}

    @classmethod
    def unknown_key(cls, key: str) -> PydanticCustomError:
        """Explain which kind of robot has the key."""
        if key == "damping":
            return problem("a single integrator has no damping", "remove it, or use 'kind: double_integrator'")
        return super().unknown_key(key)

    @model_validator(mode="after")
    def _check_kind(self) -> SingleIntegratorRobot:
        if isinstance(self.drive, SimulatedDrive) and self.drive.velocity:
            raise problem("a single integrator starts at velocity 0", "remove the drive's velocity")
        if self.limits.force is not None:
            raise problem("a single integrator has no force to limit", "remove limits.force")
        return self


class DoubleIntegratorRobot(Model):
    """A robot whose command is its force."""

    id: AgentId = like(RobotConfig, "agent_id", required=True)
    host: Name = Field(description="host on which its node runs")
    kind: Literal["double_integrator"] = Field(default="double_integrator", description="m v' = u - c v")
    mass: Mass = like(RobotConfig, "mass", required=True)
    damping: Damping = like(RobotConfig, "damping", required=True)
    limits: RobotLimits = Field(default=RobotLimits(), description="limits of this robot")
    drive: Annotated[Drive, Tagged("type", DRIVES)] = Field(description="connects the control law to the body")


Robot: TypeAlias = SingleIntegratorRobot | DoubleIntegratorRobot
ROBOT_KINDS: dict[str, type[Model]] = {
    "single_integrator": SingleIntegratorRobot,
    "double_integrator": DoubleIntegratorRobot,
}

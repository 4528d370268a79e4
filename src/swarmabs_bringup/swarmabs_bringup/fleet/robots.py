"""The robots of a fleet: dynamics, limits, and the drive between the law and the body."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, TypeAlias

from pydantic import Field, JsonValue, field_validator, model_validator
from pydantic_core import PydanticCustomError

from swarmabs_bringup.fleet.names import FrameName, Name, PluginName, SettingName, TopicName
from swarmabs_core.scenario.agents import AgentId
from swarmabs_core.scenario.errors import describe
from swarmabs_core.scenario.fields import LARGEST, Model, NonNegative, Number, Positive, Tagged, problem

Axis: TypeAlias = Literal["+x", "+y", "+z", "-x", "-y", "-z"]
Stamp: TypeAlias = Literal["header", "arrival"]


class SimulatedDrive(Model):
    """A body that exists on paper only; its motion is computed from the commands."""

    type: Literal["simulated"] = Field(default="simulated", description="the body is computed")
    position: Number = Field(description="initial position on the plane, 0 at the axis, m")
    velocity: Number = Field(default=0.0, description="initial velocity of a double integrator, m/s")


class TopicJoint(Model):
    """The joint of a JointState that moves the body."""

    name: FrameName = Field(default="", description="name of the joint; needed with joint_state")
    scale: Number = Field(default=1.0, description="motion of the body per unit of the joint, m or m/rad, not 0")


class TopicImu(Model):
    """The robot's own IMU, by which a double integrator knows its weight along the plane."""

    topic: TopicName = Field(default="", description="topic of sensor_msgs/Imu; '': ~/imu")
    frame: FrameName = Field(default="imu_link", description="frame_id that it must have; '': any")
    axis: Axis = Field(default="-y", description="axis of the IMU about which the robot's nose rises")
    offset: Number = Field(default=0.0, description="angle by which the nose is up where the IMU says 0, rad")


class TopicDrive(Model):
    """A body that other ROS nodes of the robot move: its motion and the command are topics."""

    type: Literal["topic"] = Field(default="topic", description="the body is moved by other ROS nodes")
    source: Literal["odometry", "joint_state"] = Field(
        default="odometry", description="message of position and velocity: nav_msgs/Odometry or sensor_msgs/JointState"
    )
    topic: TopicName = Field(default="", description="its topic; '': ~/odom or ~/joint_states")
    command: Literal["auto", "twist", "force", "joint"] = Field(
        default="auto", description="message of the command; auto: twist (velocity) or force, by the robot's kind"
    )
    command_topic: TopicName = Field(
        default="", description="topic of the command; '': ~/cmd_vel, ~/force or ~/joint_command"
    )
    command_frame: FrameName = Field(default="base_link", description="frame_id of a twist")
    stamp: Stamp = Field(default="header", description="time of a reading: its header's, or that of its arrival")
    frame: FrameName = Field(default="odom", description="frame_id that an odometry must have; '': any")
    axis: Axis = Field(default="+x", description="axis of that frame along which positions grow")
    offset: Number = Field(default=0.0, description="position at which the sensor says 0, m")
    heading_tolerance: Annotated[Positive, Field(le=1.5)] = Field(
        default=0.5, description="largest angle between the body's x axis and the lane, rad"
    )
    joint: TopicJoint = Field(default=TopicJoint(), description="the joint, with joint_state")
    reversed: bool = Field(default=False, description="with joint_state: whether the body faces against the lane")
    max_speed: Positive = Field(default=2.0, description="largest speed that is believed, m/s")
    gravity: Literal["imu", "none"] = Field(
        default="none", description="what a double integrator's weight along the plane is known from"
    )
    imu: TopicImu = Field(default=TopicImu(), description="the IMU, with gravity: imu")

    @model_validator(mode="after")
    def _check_joint(self) -> TopicDrive:
        if "joint" in {self.command, self.source.removesuffix("_state")} and not self.joint.name:
            raise problem("there is no name of the joint", "add 'joint: {name: ...}'")
        if self.joint.scale == 0.0:
            raise problem("joint.scale is 0", "give m or m/rad; negative: against the body")
        return self

    @property
    def topics(self) -> dict[str, str]:
        """The topics with a name of their own, by what they are; others are private ones of the robot's node."""
        named = {"measurement": self.topic, "command": self.command_topic}
        if self.gravity == "imu":
            named["imu"] = self.imu.topic
        return {what: topic for what, topic in named.items() if topic}


class PluginDrive(Model):
    """A body that a package's own code moves, such as a vendor's library."""

    type: Literal["plugin"] = Field(default="plugin", description="the body is moved by a package's own code")
    name: PluginName = Field(description="name of the drive, an entry point in the group swarmabs.drives")
    settings: dict[SettingName, JsonValue] = Field(default={}, description="what the drive is given, by name")

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        if name in {"simulated", "topic", "plugin"}:
            raise problem(f"'{name}' is no drive of a package", f"write 'type: {name}', or the name of the entry point")
        return name

    @field_validator("settings")
    @classmethod
    def _check_settings(cls, settings: dict[str, JsonValue]) -> dict[str, JsonValue]:
        for name, value in settings.items():
            if name in {"type", "name"}:
                raise problem(f"a setting cannot be called {name}", "the drive is named by 'name'")
            items = value if isinstance(value, list) and value else [value]
            kinds = {type(item) for item in items}
            if len(kinds) != 1 or not kinds <= {bool, int, float, str}:
                raise problem(f"{name}: {describe(value)} is no parameter", "give a number, text, flag, or list of one")
            if any(type(item) is int and not -(2**63) <= item < 2**63 for item in items):
                raise problem(f"{name}: {describe(value)} is out of range", "give a whole number of 64 bits")
            if any(isinstance(item, float) and abs(item) > LARGEST for item in items):
                raise problem(f"{name}: {describe(value)} is out of range", f"give a number within +-{LARGEST:g}")
        return settings


Drive: TypeAlias = SimulatedDrive | TopicDrive | PluginDrive
DRIVES: dict[str, type[Model]] = {"simulated": SimulatedDrive, "topic": TopicDrive, "plugin": PluginDrive}


class RobotLimits(Model):
    """What a robot may do at most; what is left out is as in the scenario."""

    velocity: Positive | None = Field(default=None, description="largest speed, m/s; null: as in the scenario")
    force: Positive | None = Field(default=None, description="largest force of a double integrator, N; null: as there")
    deceleration: Positive | None = Field(
        default=None, description="how hard the base of a single integrator brakes, m/s^2; null: it stops at once"
    )
    lane: Positive | None = Field(
        default=None, description="largest distance from the axis, m; null: half the plane less realtime.lane_margin"
    )


class SingleIntegratorRobot(Model):
    """A robot whose command is its velocity."""

    id: AgentId = Field(description="number of the robot, 1 to 65535")
    host: Name = Field(description="host on which its node runs")
    kind: Literal["single_integrator"] = Field(default="single_integrator", description="p' = u")
    mass: Positive = Field(description="mass, kg")
    limits: RobotLimits = Field(default=RobotLimits(), description="what it may do at most")
    drive: Annotated[Drive, Tagged("type", DRIVES)] = Field(description="what is between the law and the body")

    damping: ClassVar[float] = 0.0

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
        if isinstance(self.drive, TopicDrive) and self.drive.gravity == "imu":
            raise problem("gravity does not act on a single integrator", "remove 'gravity: imu'")
        return self


class DoubleIntegratorRobot(Model):
    """A robot whose command is its force."""

    id: AgentId = Field(description="number of the robot, 1 to 65535")
    host: Name = Field(description="host on which its node runs")
    kind: Literal["double_integrator"] = Field(default="double_integrator", description="m v' = u - c v")
    mass: Positive = Field(description="mass, kg")
    damping: NonNegative = Field(description="viscous damping c of its motion, N s/m; 0 is legal")
    limits: RobotLimits = Field(default=RobotLimits(), description="what it may do at most")
    drive: Annotated[Drive, Tagged("type", DRIVES)] = Field(description="what is between the law and the body")


Robot: TypeAlias = SingleIntegratorRobot | DoubleIntegratorRobot
ROBOT_KINDS: dict[str, type[Model]] = {
    "single_integrator": SingleIntegratorRobot,
    "double_integrator": DoubleIntegratorRobot,
}

"""Settings for the sensors of robots and planes, and for robots' bases; the nodes that use them contain the rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from swarmabs_core.declaration import part, setting
from swarmabs_core.errors import InputError
from swarmabs_core.parameters import SettingError
from swarmabs_core.plant import STEEPEST

AXES = ("+x", "+y", "+z", "-x", "-y", "-z")
"""Names of signed axes; the sign is mandatory, because YAML, and therefore ROS, reads a bare y as yes."""

MEASURED = {"odometry": "~/odom", "joint_state": "~/joint_states", "imu": "~/imu"}
"""Default topics of readings, below the name of the node, by their source."""
COMMANDED = {"twist": "~/cmd_vel", "force": "~/force", "joint": "~/joint_command"}
"""Default topics of commands, by their type."""
STAMPS = ("header", "arrival")
"""Sources of the time of a reading: its header, or its arrival."""


@dataclass(frozen=True, slots=True)
class Joint:
    """The joint of a JointState that moves the body."""

    name: str = setting("", "name of the joint; required with joint_state and joint", names="frame")
    scale: float = setting(1.0, "forward motion of the body per unit of the joint, m or m/rad, not 0")


@dataclass(frozen=True, slots=True)
class TiltSensor:
    """The robot's IMU, from which a double integrator determines the component of its weight along the plane."""

    topic: str = setting("", f"topic of sensor_msgs/Imu; '': {MEASURED['imu']}", names="topic")
    frame: str = setting("imu_link", "required frame_id; '': any", names="frame")
    axis: str = setting("-y", "axis of the IMU about which the robot's nose rises", choices=AXES)
    offset: float = setting(0.0, "angle of the nose, positive upwards, where the IMU reads 0", unit="rad")
    max_rate: float = setting(5.0, "largest plausible tilt rate", unit="rad/s", above=0.0)
    max_jump: float = setting(
        0.05, "difference of two readings allowed in addition to max_rate", unit="rad", minimum=0.0
    )


@dataclass(frozen=True, slots=True)
class TopicSettings:
    """A body moved by other ROS nodes of the robot; its motion and its command are topics."""

    type: ClassVar[str] = "topic"

    source: str = setting("odometry", "source of the robot's motion", choices=("odometry", "joint_state"))
    topic: str = setting(
        "",
        "topic of nav_msgs/Odometry or sensor_msgs/JointState; '': {odometry} or {joint_state}".format(**MEASURED),
        names="topic",
    )
    command: str = setting(
        "auto", "type of the command; auto: twist (SI), force (DI)", choices=("auto", "twist", "force", "joint")
    )
    command_topic: str = setting(
        "",
        "topic of the command; '': {twist}, {force} or {joint}".format(**COMMANDED),
        names="topic",
    )
    command_frame: str = setting("base_link", "frame_id of a twist", names="frame")
    stamp: str = setting("header", "time of a reading: its header stamp, or its arrival", choices=STAMPS)
    frame: str = setting("odom", "required frame_id of odometry; '': any", names="frame")
    axis: str = setting("+x", "axis of that frame along which positions increase", choices=AXES)
    offset: float = setting(0.0, "position where the sensor reads 0", unit="m")
    heading_tolerance: float = setting(
        0.5, "largest angle between the body's x axis and the lane", unit="rad", above=0.0, maximum=1.5
    )
    joint: Joint = part(Joint, "the joint, with source: joint_state or command: joint")
    reversed: bool = setting(
        default=False, description="with joint_state: whether the body faces the negative direction of the lane"
    )
    bandwidth: float = setting(
        100.0, "bandwidth of the differentiation of a joint without velocity", unit="rad/s", above=0.0
    )
    max_speed: float = setting(2.0, "largest plausible speed", unit="m/s", above=0.0)
    max_jump: float = setting(
        0.01, "difference of two readings allowed in addition to max_speed", unit="m", minimum=0.0
    )
    clock_tolerance: float = setting(0.02, "how far in the future a reading may be", unit="s", minimum=0.0)
    age_limit: float = setting(
        0.1, "age of readings above which a double integrator gets no force command", unit="s", above=0.0
    )
    gravity: str = setting(
        "imu", "source of the weight of a double integrator along the plane", choices=("imu", "none")
    )
    imu: TiltSensor = part(TiltSensor, "the IMU, with gravity: imu")

    @property
    def topics(self) -> dict[str, str]:
        """The configured topic names, by purpose; other topics are private to the robot's node."""
        named = {"measurement": self.topic, "command": self.command_topic}
        if self.gravity == "imu":
            named["imu"] = self.imu.topic
        return {what: topic for what, topic in named.items() if topic}

    def __post_init__(self) -> None:
        """Reject settings that contradict each other.

        Raises
        ------
        SettingError
            For one of them.
        """
        if not self.joint.name and "joint" in {self.source.removesuffix("_state"), self.command}:
            raise SettingError("joint.name", "it is empty", "give the name of the joint")
        if self.joint.scale == 0.0:
            raise SettingError("joint.scale", "0 is not allowed", "give m or m/rad; negative: against the body")
        if self.reversed and self.source == "odometry":
            problem = "the orientation in the odometry already states which way the body faces"
            raise SettingError("reversed", problem, "omit it")

    def resolved(self, *, by_force: bool) -> TopicSettings:
        """Return the settings with the command type for the robot's kind, and with the names of all topics.

        Raises
        ------
        InputError
            If the robot's kind cannot be driven by such commands.
        """
        command = self.command
        if command == "auto":
            command = "force" if by_force else "twist"
        if command == "twist" and by_force:
            raise InputError(
                "drive.command: a twist is a velocity, but a double integrator is driven by force", "use force or joint"
            )
        return replace(
            self,
            topic=self.topic or MEASURED[self.source],
            command=command,
            command_topic=self.command_topic or COMMANDED[command],
            gravity=self.gravity if by_force else "none",
            imu=replace(self.imu, topic=self.imu.topic or MEASURED["imu"]),
        )


@dataclass(frozen=True, slots=True)
class PlaneInstrument:
    """The sensor that measures the plane's motion."""

    source: str = setting(
        "joint_state", "source of the plane's motion: an encoder or an IMU", choices=("joint_state", "imu")
    )
    topic: str = setting(
        "",
        f"topic of sensor_msgs/JointState or sensor_msgs/Imu; '': {MEASURED['joint_state']} or {MEASURED['imu']}",
        names="topic",
    )
    stamp: str = setting("header", "time of a reading: its header stamp, or its arrival", choices=STAMPS)
    joint: str = setting("plane_tilt", "joint of the encoder", names="frame")
    scale: float = setting(
        1.0, "rotation of the plane per unit of the encoder, {unit}, not 0; negative: it counts backwards", unit="rad"
    )
    frame: str = setting("imu_link", "required frame_id of the IMU; '': any", names="frame")
    axis: str = setting("-y", "axis of the IMU about which the plane's angle is positive", choices=AXES)
    offset: float = setting(0.0, "angle of the plane where the sensor reads 0", unit="rad")
    differentiate: bool = setting(
        default=False, description="whether the angle is differentiated even if the encoder measures velocity"
    )
    bandwidth: float = setting(100.0, "bandwidth of the differentiation of the angle", unit="rad/s", above=0.0)
    age_limit: float = setting(0.05, "age of a reading above which the sensor is silent", unit="s", above=0.0)
    angle_limit: float = setting(STEEPEST, "largest plausible angle", unit="rad", above=0.0, maximum=STEEPEST)
    max_rate: float = setting(10.0, "largest plausible angular velocity", unit="rad/s", above=0.0)
    max_jump: float = setting(
        0.05, "difference of two readings allowed in addition to max_rate", unit="rad", minimum=0.0
    )

    def __post_init__(self) -> None:
        """Reject a scale of 0.

        Raises
        ------
        SettingError
            If the scale is 0.
        """
        if self.scale == 0.0:
            raise SettingError(
                "scale", "0 is not allowed", "give rad per unit; negative if the encoder counts backwards"
            )

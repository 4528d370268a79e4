"""What is set of a robot's or a plane's own sensors and of its base; the nodes that use them have the rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from swarmabs_core.declaration import part, setting
from swarmabs_core.parameters import SettingError

AXES = ("+x", "+y", "+z", "-x", "-y", "-z")
"""Names of signed axes; the sign is always there, since YAML, and so ROS, takes a bare y for yes."""

STAMPS = ("header", "arrival")
"""What the time of a reading may be: its header's, or that of its arrival."""


@dataclass(frozen=True, slots=True)
class Joint:
    """The joint of a JointState that moves the body."""

    name: str = setting("", "name of the joint; needed with joint_state and joint", names="frame")
    scale: float = setting(1.0, "forward motion of the body per unit of the joint, m or m/rad, not 0")


@dataclass(frozen=True, slots=True)
class TiltSensor:
    """The robot's own IMU, by which a double integrator knows its weight along the plane."""

    topic: str = setting("", "topic of sensor_msgs/Imu; '': ~/imu", names="topic")
    frame: str = setting("imu_link", "frame_id that it must have; '': any", names="frame")
    axis: str = setting("-y", "axis of the IMU about which the robot's nose rises", choices=AXES)
    offset: float = setting(0.0, "angle by which the nose is up where the IMU says 0, rad")
    max_rate: float = setting(5.0, "largest rate of tilting that is believed, rad/s", above=0.0)
    max_jump: float = setting(0.05, "angle beyond it by which two readings may differ, rad", minimum=0.0)


@dataclass(frozen=True, slots=True)
class TopicSettings:
    """A body that other ROS nodes of the robot move: its motion and the command are topics."""

    type: ClassVar[str] = "topic"

    source: str = setting("odometry", "what says where the robot is", choices=("odometry", "joint_state"))
    topic: str = setting(
        "", "topic of nav_msgs/Odometry or sensor_msgs/JointState; '': ~/odom or ~/joint_states", names="topic"
    )
    command: str = setting(
        "auto", "type of the command; auto: twist (SI), force (DI)", choices=("auto", "twist", "force", "joint")
    )
    command_topic: str = setting("", "topic of the command; '': ~/cmd_vel, ~/force or ~/joint_command", names="topic")
    command_frame: str = setting("base_link", "frame_id of a twist", names="frame")
    stamp: str = setting("header", "time of a reading: its header's, or that of its arrival", choices=STAMPS)
    frame: str = setting("odom", "frame_id that an odometry must have; '': any", names="frame")
    axis: str = setting("+x", "axis of that frame along which positions grow", choices=AXES)
    offset: float = setting(0.0, "position at which the sensor says 0, m")
    heading_tolerance: float = setting(
        0.5, "largest angle between the body's x axis and the lane, rad", above=0.0, maximum=1.5
    )
    joint: Joint = part(Joint, "the joint, with joint_state or a command by joint")
    reversed: bool = setting(default=False, description="with joint_state: whether the body faces against the lane")
    bandwidth: float = setting(100.0, "bandwidth of differentiation where a joint has no velocity, rad/s", above=0.0)
    max_speed: float = setting(2.0, "largest speed that is believed, m/s", above=0.0)
    max_jump: float = setting(0.01, "distance beyond it by which two readings may differ, m", minimum=0.0)
    clock_tolerance: float = setting(0.02, "how far a reading may come from the future, s", minimum=0.0)
    age_limit: float = setting(0.1, "age of readings from which on a double integrator is told nothing, s", above=0.0)
    gravity: str = setting(
        "imu", "what a double integrator's weight along the plane is known from", choices=("imu", "none")
    )
    imu: TiltSensor = part(TiltSensor, "the IMU, with gravity: imu")

    @property
    def topics(self) -> dict[str, str]:
        """The topics with a name of their own, by what they are; others are private ones of the robot's node."""
        named = {"measurement": self.topic, "command": self.command_topic}
        if self.gravity == "imu":
            named["imu"] = self.imu.topic
        return {what: topic for what, topic in named.items() if topic}

    def __post_init__(self) -> None:
        """Refuse settings that contradict each other.

        Raises
        ------
        SettingError
            Naming one of them.
        """
        if not self.joint.name and "joint" in {self.source.removesuffix("_state"), self.command}:
            raise SettingError("joint.name", "there is none", "give the name of the joint")
        if self.joint.scale == 0.0:
            raise SettingError("joint.scale", "0 is not allowed", "give m or m/rad; negative: against the body")
        if self.reversed and self.source == "odometry":
            problem = "the orientation in an odometry says which way the body faces"
            raise SettingError("reversed", problem, "leave it out")


@dataclass(frozen=True, slots=True)
class PlaneInstrument:
    """The plane's motion is measured."""

    source: str = setting(
        "joint_state", "what says how the plane is: an encoder or an IMU", choices=("joint_state", "imu")
    )
    topic: str = setting(
        "", "topic of sensor_msgs/JointState or sensor_msgs/Imu; '': ~/joint_states or ~/imu", names="topic"
    )
    stamp: str = setting("header", "time of a reading: its header's, or that of its arrival", choices=STAMPS)
    joint: str = setting("plane_tilt", "joint of the encoder", names="frame")
    scale: float = setting(1.0, "turn of the plane per unit of the encoder, rad, not 0; negative: it counts backwards")
    frame: str = setting("imu_link", "frame_id that the IMU must have; '': any", names="frame")
    axis: str = setting("-y", "axis of the IMU about which the plane's angle is positive", choices=AXES)
    offset: float = setting(0.0, "angle of the plane where the sensor says 0, rad")
    differentiate: bool = setting(
        default=False, description="whether the encoder's velocity is not used even if there is one"
    )
    bandwidth: float = setting(100.0, "bandwidth of differentiation where there is no velocity, rad/s", above=0.0)
    age_limit: float = setting(0.05, "age from which on the sensor counts as silent, s", above=0.0)
    angle_limit: float = setting(1.5, "largest angle that is believed, rad", above=0.0, maximum=1.5)
    max_rate: float = setting(10.0, "largest angular velocity that is believed, rad/s", above=0.0)
    max_jump: float = setting(0.05, "angle beyond it by which two readings may differ, rad", minimum=0.0)

    def __post_init__(self) -> None:
        """Refuse an encoder that measures nothing.

        Raises
        ------
        SettingError
            If the scale is 0.
        """
        if self.scale == 0.0:
            raise SettingError(
                "scale", "a scale of 0 measures nothing", "give rad per unit; negative: it counts backwards"
            )

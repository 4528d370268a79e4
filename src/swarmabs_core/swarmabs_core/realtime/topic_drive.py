"""A drive behind topics: what a robot's base says, and what it is told; without ROS.

Signs. The lane is an axis of the sensor's frame; positions grow along it as the scenario's do, and the plane's angle th
is positive where the side of positive positions is up. The body's x axis points forward, along the lane (facing 1) or
against it (facing -1); commands are given along it. Its nose rises by facing times th.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import copysign, cos, sin
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, TypeAlias

from swarmabs_core.declaration import parameters_of, part, setting
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind
from swarmabs_core.parameters import SettingError
from swarmabs_core.realtime.drives import Measurement
from swarmabs_core.realtime.readings import (
    AXES,
    STAMPS,
    Imu,
    Joints,
    Odometry,
    Reading,
    RefusedReadingError,
    check_finite,
    check_frame,
    joint_values,
    normalised,
    rotation_row,
    signed_axis,
    tilt,
)
from swarmabs_core.realtime.tracking import Plausible, RefusedReadings, Track

if TYPE_CHECKING:
    from swarmabs_core.realtime.drive_registry import Body


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


SETTINGS = parameters_of(TopicSettings)
"""Settings of the drive, ``drive.*`` of a robot's node."""


TURN_ROUND = 500_000_000
"""Shortest time in which a body turns round, ns; meanwhile it stands across the lane, of which nothing is taken."""


class Wiring(NamedTuple):
    """What the drive wants to be connected to; an empty topic means none.

    `command` is ``twist``, ``force`` or ``joint``; with `arrival`, a reading's stamp is the time of its arrival.
    """

    source: str
    topic: str
    imu_topic: str
    command: str
    command_topic: str
    command_frame: str
    joint: str
    single_integrator: bool
    arrival: bool


class Link(Protocol):
    """The connection to topics."""

    def take(self) -> Sequence[Reading]:
        """Return what has arrived since the last call, each source's readings in order; it does not wait."""
        ...

    def send(self, value: float) -> None:
        """Send the base a command: m/s or N, or in units of the joint."""
        ...


Connect: TypeAlias = Callable[[Wiring], Link]


@dataclass(frozen=True, slots=True)
class _Lane:
    """Where the lane is in what the sensor says."""

    frame: str
    axis: int
    sign: float
    offset: float
    least_cosine: float
    joint: str
    scale: float


class TopicDrive:
    """Measures by topics, drives by a topic.

    Readings that are not plausible are refused and counted; then the newest good one grows old, and the robot stops by
    its age. A double integrator whose weight is to be balanced has a measurement only while its IMU is heard: a
    measurement is as old as the oldest thing it depends on.

    Parameters
    ----------
    settings : TopicSettings
        Settings.
    body : Body
        The robot.

    Attributes
    ----------
    refused : RefusedReadings
        What was refused.

    Raises
    ------
    InputError
        If settings contradict each other, or there is nothing to connect to.
    """

    def __init__(self, settings: TopicSettings, body: Body) -> None:
        single = body.kind is Kind.SINGLE_INTEGRATOR
        wiring = _wiring(settings, single_integrator=single)
        axis, sign = signed_axis(settings.axis)
        self._lane = _Lane(
            settings.frame,
            axis,
            sign,
            settings.offset,
            cos(settings.heading_tolerance),
            wiring.joint,
            settings.joint.scale,
        )
        tolerance = round(settings.clock_tolerance * 1e9)
        bandwidth = settings.bandwidth
        self._track = Track(Plausible(settings.max_speed, settings.max_jump, tolerance), bandwidth)
        self._to_joint = wiring.command == "joint"
        self._single = single
        self._facing = -1.0 if settings.reversed else 1.0
        self._faced: int | None = None
        self._weighs = bool(wiring.imu_topic)
        self._tilt = Track(Plausible(settings.imu.max_rate, settings.imu.max_jump, tolerance), bandwidth)
        self._imu_frame, self._imu_offset = settings.imu.frame, settings.imu.offset
        self._imu_axis, self._imu_sign = signed_axis(settings.imu.axis)
        self._age_limit = round(settings.age_limit * 1e9)
        self._mass, self._gravity, self._force = body.mass, body.gravity, body.limits.force
        self.refused = RefusedReadings()
        if body.connect is None:
            raise InputError("drive topic: there is no ROS node here to which it could be connected")
        self._link = body.connect(wiring)

    def read(self, now: int) -> Measurement | None:
        """Take over what has arrived, and return the newest measurement."""
        for reading in self._link.take():
            try:
                self._hear(reading, now)
            except RefusedReadingError as error:
                self.refused.add(error)
        motion = self._track.newest
        if motion is None:
            return None
        stamp = motion.stamp
        if self._weighs:
            tilted = self._tilt.newest
            if tilted is None:
                return None
            stamp = min(stamp, tilted.stamp)
        return Measurement(stamp, motion.value, motion.rate)

    def write(self, command: float, now: int) -> None:
        """Send a command, to which a double integrator's weight along the plane is added.

        What is added is m (g sin(th) - p w^2), the negative of what a tilting plane does to a robot (EOM_DI with the
        Lagrangian's terms), so the body feels the law's force alone. The sum stays within the limit of force.

        A double integrator whose motion or tilt is not known gets no command: no force would brake it or hold its
        weight, zero neither, but its base does when commands cease.
        """
        if not self._single and not self._knows(now):
            return
        if self._weighs:
            command = min(max(command + self._weight(), -self._force), self._force)
        self._send(command)

    def stop(self) -> None:
        """Send zero."""
        self._send(0.0)

    def report(self) -> tuple[tuple[str, str], ...]:
        """Return what was refused, and the tilt that the robot feels."""
        tilted = self._tilt.newest
        felt = (("tilt, rad", "none" if tilted is None else f"{self._facing * tilted.value:.6f}"),)
        return (*(felt if self._weighs else ()), *self.refused.values())

    def _send(self, command: float) -> None:
        value = command * self._facing
        if self._to_joint:
            # A joint moves by motion / scale; by virtual work its effort is force * scale.
            value = value / self._lane.scale if self._single else value * self._lane.scale
        self._link.send(value)

    def _knows(self, now: int) -> bool:
        """Tell whether motion, and the tilt if it is needed, are known of late."""
        tracks = (self._track, self._tilt) if self._weighs else (self._track,)
        return all(each.newest is not None and now - each.newest.stamp <= self._age_limit for each in tracks)

    def _weight(self) -> float:
        tilted, motion = self._tilt.newest, self._track.newest
        if tilted is None or motion is None:
            return 0.0
        angle = self._facing * tilted.value
        return self._mass * (self._gravity * sin(angle) - motion.value * tilted.rate * tilted.rate)

    def _hear(self, reading: Reading, now: int) -> None:
        if isinstance(reading, Imu):
            self._hear_imu(reading, now)
        elif isinstance(reading, Odometry):
            self._hear_odometry(reading, now)
        else:
            self._hear_joints(reading, now)

    def _hear_odometry(self, reading: Odometry, now: int) -> None:
        lane = self._lane
        check_frame(reading.frame, lane.frame)
        check_finite(*reading.position, *reading.velocity)
        row = rotation_row(normalised(reading.rotation), lane.axis)
        cosine = lane.sign * row[0]
        if abs(cosine) < lane.least_cosine:
            raise RefusedReadingError("heading", f"the body's x axis and the lane have a cosine of {cosine:.3f}")
        facing = copysign(1.0, cosine)
        self._check_facing(facing, reading.stamp)
        velocity = lane.sign * sum(a * b for a, b in zip(row, reading.velocity, strict=True))
        self._track.offer(reading.stamp, lane.offset + lane.sign * reading.position[lane.axis], velocity, now)
        self._facing, self._faced = facing, reading.stamp

    def _check_facing(self, facing: float, stamp: int) -> None:
        """Refuse that a body has turned round at once: it would be driven the wrong way by one wrong reading."""
        if facing == self._facing or self._faced is None or not 0 <= stamp - self._faced < TURN_ROUND:
            return
        passed = (stamp - self._faced) / 1e9
        raise RefusedReadingError("heading", f"turned round {passed:.3f} s after the last good reading")

    def _hear_joints(self, reading: Joints, now: int) -> None:
        lane = self._lane
        position, velocity = joint_values(reading, lane.joint)
        scale = self._facing * lane.scale
        rate = None if velocity is None else scale * velocity
        self._track.offer(reading.stamp, lane.offset + scale * position, rate, now)

    def _hear_imu(self, reading: Imu, now: int) -> None:
        check_frame(reading.frame, self._imu_frame)
        angle, rate = imu_values(reading, self._imu_axis, self._imu_sign)
        self._tilt.offer(reading.stamp, self._imu_offset + angle, rate, now)


def imu_values(reading: Imu, axis: int, sign: float) -> tuple[float, float]:
    """Return angle (rad) and rate (rad/s) of tilting about a signed axis of the sensor.

    Raises
    ------
    RefusedReadingError
        If the sensor does not measure them.
    """
    if reading.rotation is None or reading.angular_velocity is None:
        raise RefusedReadingError("orientation", "the IMU measures no orientation, or no angular velocity")
    check_finite(*reading.angular_velocity)
    return sign * tilt(normalised(reading.rotation), axis), sign * reading.angular_velocity[axis]


def _wiring(settings: TopicSettings, *, single_integrator: bool) -> Wiring:
    source, command, joint = settings.source, settings.command, settings.joint.name
    if command == "auto":
        command = "twist" if single_integrator else "force"
    if command == "twist" and not single_integrator:
        raise InputError(
            "drive.command: a twist is a velocity, and a double integrator is driven by force; use force or joint"
        )
    topics = {"odometry": "~/odom", "joint_state": "~/joint_states"}
    commands = {"twist": "~/cmd_vel", "force": "~/force", "joint": "~/joint_command"}
    weighs = not single_integrator and settings.gravity == "imu"
    return Wiring(
        source=source,
        topic=settings.topic or topics[source],
        imu_topic=(settings.imu.topic or "~/imu") if weighs else "",
        command=command,
        command_topic=settings.command_topic or commands[command],
        command_frame=settings.command_frame,
        joint=joint,
        single_integrator=single_integrator,
        arrival=settings.stamp == "arrival",
    )

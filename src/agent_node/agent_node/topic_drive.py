"""A drive connected by topics: measurements of a robot's base in, commands out.

Sign conventions: The lane is an axis of the sensor's frame, along which positions increase as in the scenario. The
plane's angle th is positive if the side of positive positions is up. The body's x axis points forward, along the lane
(facing 1) or against it (facing -1), and commands are given along this axis. The nose rises by facing times th.
"""

from __future__ import annotations

from math import copysign, cos, sin
from typing import TYPE_CHECKING, TypeAlias

from geometry_msgs.msg import TwistStamped
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from swarmabs_core.messages import Kind
from swarmabs_core.realtime.drives import Measurement
from swarmabs_ros.readings import (
    Imu,
    Joints,
    Odometry,
    Reading,
    RefusedReadingError,
    RefusedReadings,
    Track,
    check_finite,
    check_frame,
    imu_values,
    joint_values,
    normalised,
    rotation_row,
    signed_axis,
)
from swarmabs_ros.sensors import SensorSubscription

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node

    from swarmabs_core.realtime.drives import Body
    from swarmabs_core.realtime.instruments import TopicSettings

TURN_TIME = 500_000_000
"""Shortest time in which a body turns around, ns; readings of a body across the lane are rejected meanwhile."""
COMMAND = QoSProfile(depth=1, history=QoSHistoryPolicy.KEEP_LAST, reliability=QoSReliabilityPolicy.RELIABLE)
"""QoS of the command: a reliable writer matches both kinds of readers, and only the newest command is relevant."""

Command: TypeAlias = TwistStamped | Float64 | JointState

_TYPES: dict[str, type[Command]] = {"twist": TwistStamped, "force": Float64, "joint": JointState}


class TopicLink:
    """The subscriptions of a topic drive, in a group that no executor may serve, and its publisher."""

    def __init__(self, settings: TopicSettings, kind: Kind, node: Node, group: CallbackGroup | None = None) -> None:
        self._settings = settings
        self._kind = kind
        self._clock = node.get_clock()
        arrival = settings.stamp == "arrival"
        self._sensors = [SensorSubscription(node, settings.source, settings.topic, group, arrival=arrival)]
        if settings.gravity == "imu":
            self._sensors.append(SensorSubscription(node, "imu", settings.imu.topic, group, arrival=arrival))
        self._publisher = node.create_publisher(_TYPES[settings.command], settings.command_topic, COMMAND)

    def take(self) -> list[Reading]:
        """Return the readings that have arrived since the last call."""
        return [reading for sensor in self._sensors for reading in sensor.take()]

    def send(self, value: float) -> None:
        """Send a command to the base."""
        self._publisher.publish(self._message(value))

    def _message(self, value: float) -> Command:
        settings = self._settings
        if settings.command == "force":
            return Float64(data=value)
        stamp = self._clock.now().to_msg()
        if settings.command == "twist":
            twist = TwistStamped()
            twist.header.stamp, twist.header.frame_id = stamp, settings.command_frame
            twist.twist.linear.x = value
            return twist
        joint = JointState(name=[settings.joint.name])
        joint.header.stamp = stamp
        if not self._kind.by_force:
            joint.velocity = [value]
        else:
            joint.effort = [value]
        return joint


class TopicDrive:
    """A drive that subscribes to measurements and publishes commands.

    Implausible readings are rejected and counted; if they persist, the newest valid one becomes outdated and the robot
    stops. A double integrator with weight compensation also needs its IMU: a measurement has the age of the oldest
    reading on which it depends.

    Raises
    ------
    InputError
        If the type of the command does not match the robot's kind.
    """

    def __init__(self, settings: TopicSettings, body: Body, connect: Callable[[TopicSettings], TopicLink]) -> None:
        self._single = not body.kind.by_force
        settings = settings.resolved(by_force=not self._single)
        self._settings, self._body = settings, body
        self._axis, self._sign = signed_axis(settings.axis)
        self._least_cosine = cos(settings.heading_tolerance)
        tolerance, bandwidth, imu = settings.clock_tolerance, settings.bandwidth, settings.imu
        self._track = Track(settings.max_speed, settings.max_jump, tolerance, bandwidth)
        self._to_joint = settings.command == "joint"
        self._facing = -1.0 if settings.reversed else 1.0
        self._faced: int | None = None
        self._weighs = settings.gravity == "imu"
        self._tilt = Track(imu.max_rate, imu.max_jump, tolerance, bandwidth)
        self._imu_axis, self._imu_sign = signed_axis(imu.axis)
        self._age_limit = round(settings.age_limit * 1e9)
        self.refused = RefusedReadings()
        self._link = connect(settings)

    def read(self, now: int) -> Measurement | None:
        """Process the readings that have arrived, and return the newest measurement."""
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
        """Send a command; for a double integrator, compensate its weight along the plane.

        The added force m (g sin(th) - p w^2) cancels the effect of the tilting plane on a robot (EOM_DI with the
        Lagrangian's terms), so that only the force of the law accelerates the body. The sum stays within the force
        limit.

        If the motion or tilt of a double integrator is unknown, no command is sent: no force, not even zero, would
        safely brake it or hold its weight, but its base does when commands cease.
        """
        if not self._single and not self._knows(now):
            return
        if self._weighs:
            most = self._body.limits.force
            command = min(max(command + self._weight(), -most), most)
        self._send(command)

    def stop(self) -> None:
        """Send zero."""
        self._send(0.0)

    def report(self) -> tuple[tuple[str, str], ...]:
        """Return counts of rejected readings, and the robot's tilt."""
        tilted = self._tilt.newest
        felt = (("tilt, rad", "none" if tilted is None else f"{self._facing * tilted.value:.6f}"),)
        return (*(felt if self._weighs else ()), *self.refused.values())

    def _send(self, command: float) -> None:
        value = command * self._facing
        if self._to_joint:
            # A joint moves by motion / scale; by the principle of virtual work its effort is force * scale.
            scale = self._settings.joint.scale
            value = value / scale if self._single else value * scale
        self._link.send(value)

    def _knows(self, now: int) -> bool:
        """Return whether recent readings of the motion and, if needed, of the tilt are known."""
        tracks = (self._track, self._tilt) if self._weighs else (self._track,)
        return all(track.newest is not None and now - track.newest.stamp <= self._age_limit for track in tracks)

    def _weight(self) -> float:
        tilted, motion = self._tilt.newest, self._track.newest
        if tilted is None or motion is None:
            return 0.0
        angle = self._facing * tilted.value
        return self._body.mass * (self._body.gravity * sin(angle) - motion.value * tilted.rate * tilted.rate)

    def _hear(self, reading: Reading, now: int) -> None:
        if isinstance(reading, Imu):
            self._hear_imu(reading, now)
        elif isinstance(reading, Odometry):
            self._hear_odometry(reading, now)
        else:
            self._hear_joints(reading, now)

    def _hear_odometry(self, reading: Odometry, now: int) -> None:
        axis, sign = self._axis, self._sign
        check_frame(reading.frame, self._settings.frame)
        check_finite(*reading.position, *reading.velocity)
        row = rotation_row(normalised(reading.rotation), axis)
        cosine = sign * row[0]
        if abs(cosine) < self._least_cosine:
            raise RefusedReadingError("heading", f"the body's x axis and the lane have a cosine of {cosine:.3f}")
        facing = copysign(1.0, cosine)
        self._check_facing(facing, reading.stamp)
        velocity = sign * sum(a * b for a, b in zip(row, reading.velocity, strict=True))
        self._track.offer(reading.stamp, self._settings.offset + sign * reading.position[axis], velocity, now)
        self._facing, self._faced = facing, reading.stamp

    def _check_facing(self, facing: float, stamp: int) -> None:
        """Reject a sudden reversal of the body: after one wrong reading it would be driven in the wrong direction."""
        if facing == self._facing or self._faced is None or not 0 <= stamp - self._faced < TURN_TIME:
            return
        passed = (stamp - self._faced) / 1e9
        raise RefusedReadingError("heading", f"turned around {passed:.3f} s after the last valid reading")

    def _hear_joints(self, reading: Joints, now: int) -> None:
        settings = self._settings
        position, velocity = joint_values(reading, settings.joint.name)
        scale = self._facing * settings.joint.scale
        rate = None if velocity is None else scale * velocity
        self._track.offer(reading.stamp, settings.offset + scale * position, rate, now)

    def _hear_imu(self, reading: Imu, now: int) -> None:
        imu = self._settings.imu
        check_frame(reading.frame, imu.frame)
        angle, rate = imu_values(reading, self._imu_axis, self._imu_sign)
        self._tilt.offer(reading.stamp, imu.offset + angle, rate, now)

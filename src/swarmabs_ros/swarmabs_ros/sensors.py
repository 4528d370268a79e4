"""Subscriptions to the sensors of a robot or a plane, and conversion of their messages.

Their topics are not part of the swarm's graph and use standard ROS messages from any sensor driver. Nodes do not wait
for them but take what has arrived in each step, so no executor is needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import Imu as ImuMessage, JointState

from swarmabs_core.cdr import SECOND
from swarmabs_ros.endpoints import unheard
from swarmabs_ros.readings import Imu, Joints, Odometry, Quaternion, Reading, Vector

if TYPE_CHECKING:
    from geometry_msgs.msg import Point, Quaternion as QuaternionMessage, Vector3
    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node

DEPTH = 50
"""Queue depth for a sensor: the messages of a 5 kHz sensor in one period at 100 Hz."""

SENSOR = QoSProfile(depth=DEPTH, history=QoSHistoryPolicy.KEEP_LAST, reliability=QoSReliabilityPolicy.BEST_EFFORT)
"""QoS for sensors; best effort matches both kinds of publishers, like the sensor data profile of ROS."""

SensorMessage: TypeAlias = OdometryMessage | JointState | ImuMessage

TYPES: dict[str, type[SensorMessage]] = {"odometry": OdometryMessage, "joint_state": JointState, "imu": ImuMessage}
"""Message by kind of source."""


class SensorSubscription:
    """Subscription to a sensor (``odometry``, ``joint_state`` or ``imu``), with the readings not taken yet.

    In the topic name, ``~`` is the node. No executor may serve `group`, because it would take the messages. With
    `arrival`, readings are stamped on arrival instead of by their headers.
    """

    def __init__(
        self, node: Node, source: str, topic: str, group: CallbackGroup | None = None, *, arrival: bool = False
    ) -> None:
        self._type = TYPES[source]
        self._arrival = arrival
        self._subscription = node.create_subscription(self._type, topic, unheard, SENSOR, callback_group=group)

    def take(self) -> list[Reading]:
        """Return the readings that have arrived since the last call, in order, without waiting."""
        readings: list[Reading] = []
        while (
            len(readings) < DEPTH and (taken := self._subscription.handle.take_message(self._type, False)) is not None
        ):
            message, info = taken
            stamp = info["received_timestamp"] if self._arrival else None
            readings.append(reading(message, stamp))
        return readings


def reading(message: SensorMessage, stamp: int | None = None) -> Reading:
    """Convert a message of one of `TYPES`; `stamp` (ns since 1970) replaces that of its header."""
    if stamp is None:
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
    if isinstance(message, JointState):
        return Joints(stamp, tuple(message.name), tuple(message.position), tuple(message.velocity))
    frame = message.header.frame_id
    if isinstance(message, ImuMessage):
        # According to the message's definition, -1 as first covariance means that the quantity is not measured.
        turned = None if message.orientation_covariance[0] == -1.0 else _quaternion(message.orientation)
        rate = None if message.angular_velocity_covariance[0] == -1.0 else _vector(message.angular_velocity)
        return Imu(stamp, frame, turned, rate)
    pose = message.pose.pose
    velocity = _vector(message.twist.twist.linear)
    return Odometry(stamp, frame, _vector(pose.position), _quaternion(pose.orientation), velocity)


def _vector(given: Point | Vector3) -> Vector:
    return given.x, given.y, given.z


def _quaternion(given: QuaternionMessage) -> Quaternion:
    return given.x, given.y, given.z, given.w

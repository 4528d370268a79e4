"""Subscriptions to the sensors of a robot or a plane, and what their messages say.

They are no topics of the swarm: stock messages of ROS, from whoever measures. Nothing waits for them; what has arrived
is taken when a step is made, so no executor is needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import Imu as ImuMessage, JointState

from swarmabs_ros.endpoints import unheard
from swarmabs_ros.readings import Imu, Joints, Odometry, Reading

if TYPE_CHECKING:
    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node

DEPTH = 50
"""How many messages of a sensor may wait: those of a period at 100 Hz from a sensor of 5 kHz."""

SENSOR = QoSProfile(depth=DEPTH, history=QoSHistoryPolicy.KEEP_LAST, reliability=QoSReliabilityPolicy.BEST_EFFORT)
"""What is asked of sensors; best effort hears both kinds of publishers, as ROS's own profile for sensor data."""

TYPES: dict[str, Any] = {"odometry": OdometryMessage, "joint_state": JointState, "imu": ImuMessage}
"""Message by kind of source."""


class SensorSubscription:
    """What a sensor (``odometry``, ``joint_state`` or ``imu``) has said and nobody has taken yet.

    In the name of the topic ``~`` is the node. No executor may serve `group`; it would take the messages away. With
    `arrival` a reading's stamp is the time of its arrival instead of its header's.
    """

    def __init__(
        self, node: Node, source: str, topic: str, group: CallbackGroup | None = None, *, arrival: bool = False
    ) -> None:
        self._type = TYPES[source]
        self._arrival = arrival
        self._subscription = node.create_subscription(self._type, topic, unheard, SENSOR, callback_group=group)

    def take(self) -> list[Reading]:
        """Return what has arrived since the last call, in order; it does not wait."""
        found: list[Reading] = []
        while len(found) < DEPTH and (taken := self._subscription.handle.take_message(self._type, False)) is not None:
            message, info = taken
            stamp = info["received_timestamp"] if self._arrival else None
            found.append(reading(message, stamp))
        return found


def reading(message: Any, stamp: int | None = None) -> Reading:
    """Return what a message of one of `TYPES` says, at a time (ns since 1970) if that is not its header's."""
    if stamp is None:
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
    if isinstance(message, JointState):
        return Joints(stamp, tuple(message.name), tuple(message.position), tuple(message.velocity))
    frame = message.header.frame_id
    if isinstance(message, ImuMessage):
        # By the message's definition, -1 as first covariance says that the quantity is not measured.
        turned = None if message.orientation_covariance[0] == -1.0 else _quaternion(message.orientation)
        rate = None if message.angular_velocity_covariance[0] == -1.0 else _vector(message.angular_velocity)
        return Imu(stamp, frame, turned, rate)
    pose = message.pose.pose
    velocity = _vector(message.twist.twist.linear)
    return Odometry(stamp, frame, _vector(pose.position), _quaternion(pose.orientation), velocity)


def _vector(given: Any) -> tuple[float, float, float]:
    return given.x, given.y, given.z


def _quaternion(given: Any) -> tuple[float, float, float, float]:
    return given.x, given.y, given.z, given.w

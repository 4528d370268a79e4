"""The topic drive's connection to ROS: the sensors of the robot's own body, and its base."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import TwistStamped
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from swarmabs_ros.sensors import SensorSubscription

if TYPE_CHECKING:
    from rclpy.callback_groups import CallbackGroup
    from rclpy.node import Node

    from swarmabs_core.realtime.readings import Reading
    from swarmabs_core.realtime.topic_drive import Wiring

COMMAND = QoSProfile(depth=1, history=QoSHistoryPolicy.KEEP_LAST, reliability=QoSReliabilityPolicy.RELIABLE)
"""What is offered to the base: a reliable writer serves both kinds of readers, and only the newest command counts."""

_TYPES: dict[str, Any] = {"twist": TwistStamped, "force": Float64, "joint": JointState}


class TopicLink:
    """Subscriptions and publisher of a topic drive.

    Parameters
    ----------
    wiring : Wiring
        What to connect.
    node : Node
        The robot's node.
    group : CallbackGroup, optional
        Group for the subscriptions, which no executor may serve.
    """

    def __init__(self, wiring: Wiring, node: Node, group: CallbackGroup | None = None) -> None:
        self._wiring = wiring
        self._clock = node.get_clock()
        arrival = wiring.arrival
        self._sensors = [SensorSubscription(node, wiring.source, wiring.topic, group, arrival=arrival)]
        if wiring.imu_topic:
            self._sensors.append(SensorSubscription(node, "imu", wiring.imu_topic, group, arrival=arrival))
        self._publisher = node.create_publisher(_TYPES[wiring.command], wiring.command_topic, COMMAND)

    def take(self) -> list[Reading]:
        """Return what the sensors have said since the last call."""
        return [reading for sensor in self._sensors for reading in sensor.take()]

    def send(self, value: float) -> None:
        """Send the base a command."""
        self._publisher.publish(self._message(value))

    def _message(self, value: float) -> Any:
        wiring = self._wiring
        if wiring.command == "force":
            return Float64(data=value)
        stamp = self._clock.now().to_msg()
        if wiring.command == "twist":
            twist = TwistStamped()
            twist.header.stamp, twist.header.frame_id = stamp, wiring.command_frame
            twist.twist.linear.x = value
            return twist
        joint = JointState(name=[wiring.joint])
        joint.header.stamp = stamp
        if wiring.single_integrator:
            joint.velocity = [value]
        else:
            joint.effort = [value]
        return joint

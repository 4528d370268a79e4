"""The driver of a body as a stock ROS node: the base of a robot that is driven by velocity, or a plane's encoder.

Usage: python driver.py NAMESPACE base|encoder NODE, see `stock_node`; it serves the node of the swarm of that name.
"""

import sys
from typing import Any

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState
from tests.system.stock_node import StockNode, serve

PERIOD = 0.01
"""Time, s, between two measurements."""
PLACE = 0.125
"""Where the base stands at first, m."""


class Driver(StockNode):
    """Answers requests."""

    def __init__(self, node: Node, what: str, served: str) -> None:
        super().__init__(node)
        self._position, self._velocity, self._commands = PLACE, 0.0, 0
        kind, name = (Odometry, "odom") if what == "base" else (JointState, "joint_states")
        self._publisher = node.create_publisher(kind, f"/{served}/{name}", 10)
        if what == "base":
            node.create_subscription(TwistStamped, f"/{served}/cmd_vel", self._command, 10)
        node.create_timer(PERIOD, self._odometry if what == "base" else self._encoder)

    def _command(self, command: Any) -> None:
        self._velocity = command.twist.linear.x
        self._commands += 1

    def _odometry(self) -> None:
        self._position += PERIOD * self._velocity
        message = Odometry()
        message.header.stamp, message.header.frame_id = self.node.get_clock().now().to_msg(), "odom"
        message.pose.pose.position.x, message.pose.pose.orientation.w = self._position, 1.0
        message.twist.twist.linear.x = self._velocity
        self._publisher.publish(message)

    def _encoder(self) -> None:
        message = JointState(name=["plane_tilt"], position=[0.0], velocity=[0.0])
        message.header.stamp = self.node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def body(self) -> list[float]:
        """Return how many commands have come, and where the base is, m."""
        return [self._commands, self._position]


if __name__ == "__main__":
    sys.exit(serve(Driver, sys.argv[1], arguments=sys.argv[2:]))

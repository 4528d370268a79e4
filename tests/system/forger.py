"""A stock ROS node that says another angle of the plane of each step, with the default quality of service.

Usage: python forger.py, see `stock_node`.
"""

import sys

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from tests.system.health_client import HealthClient
from tests.system.stock_node import serve

from swarmabs_msgs.msg import PlaneState

ANGLE = 0.0625
"""What it says, rad."""
LEAD = 2
"""Steps by which it is ahead."""


class Forger(HealthClient):
    """Answers requests."""

    def __init__(self, node: Node) -> None:
        super().__init__(node)
        self._sent = 0

    def forge(self, angle: float) -> None:
        """Speak for the plane from now on."""
        publisher = self.node.create_publisher(PlaneState, "plane/state", 10)

        def answer(state: PlaneState) -> None:
            if state.angle != angle:
                publisher.publish(PlaneState(header=state.header, step=state.step + LEAD, angle=angle))
                self._sent += 1

        self.node.create_subscription(PlaneState, "plane/state", answer, qos_profile_sensor_data)

    def sent(self) -> int:
        """Return the number of forged messages."""
        return self._sent


if __name__ == "__main__":
    sys.exit(serve(Forger))

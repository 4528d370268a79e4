"""A stock ROS node that says another angle of the plane of each step, and tells of a death, by the default QoS.

Usage: python forger.py, see `stock_node`.
"""

import sys

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from tests.system.health_client import HealthClient
from tests.system.stock_node import serve

from swarmabs_msgs.msg import PlaneState, SwarmEvent

ANGLE = 0.0625
"""What it says, rad."""
FORGED = "forged"
"""Detail of its events."""
LEAD = 2
"""Steps by which it is ahead."""
_KEPT = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Forger(HealthClient):
    """Answers requests."""

    def __init__(self, node: Node) -> None:
        super().__init__(node)
        self._sent = 0

    def forge(self, angle: float) -> None:
        """Speak for the plane from now on."""
        publisher = self.node.create_publisher(PlaneState, "plane/state", 10)
        events = self.node.create_publisher(SwarmEvent, "swarm/events", _KEPT)

        def answer(state: PlaneState) -> None:
            if state.angle != angle:
                publisher.publish(PlaneState(header=state.header, step=state.step + LEAD, angle=angle))
                death = {"agent_id": 3, "kind": SwarmEvent.DEAD, "detail": FORGED}
                events.publish(SwarmEvent(header=state.header, step=state.step, **death))
                self._sent += 1

        self.node.create_subscription(PlaneState, "plane/state", answer, qos_profile_sensor_data)

    def sent(self) -> int:
        """Return the number of forged messages."""
        return self._sent


if __name__ == "__main__":
    sys.exit(serve(Forger))

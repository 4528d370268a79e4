"""A node that does not belong to the swarm: it answers each abstract state with a forged one, until it is ended."""

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy

from swarmabs_config.graph import LOCKSTEP, OFFERED
from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import ABSTRACT_STATE, AbstractState
from swarmabs_ros.endpoints import profile, ros_type

QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


def main() -> None:
    rclpy.init(args=["--ros-args", "--disable-external-lib-logs"])
    node = rclpy.create_node("stranger")
    kind, offered = ros_type(ABSTRACT_STATE), profile(OFFERED[LOCKSTEP][ABSTRACT_STATE])
    publisher = node.create_publisher(kind, ABSTRACT_STATE.name, offered)
    said = set[bytes]()

    def hear(data: bytes) -> None:
        if data in said:
            return
        state = decode(AbstractState, bytes(data))
        assert isinstance(state, AbstractState)
        forged = encode(state._replace(torque=state.torque + 0.2))
        said.add(forged)
        publisher.publish(forged)

    node.create_subscription(kind, ABSTRACT_STATE.name, hear, QOS, raw=True)
    rclpy.spin(node)


if __name__ == "__main__":
    main()

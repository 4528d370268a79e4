"""A node that does not belong to the swarm: it publishes a forged message as soon as it hears the abstract state."""

import sys

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy

from swarmabs_config.graph import LOCKSTEP, OFFERED
from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    BROADCAST,
    EVENTS,
    AbstractState,
    AuxiliaryState,
    Broadcast,
    DesiredAbstractState,
    EventKind,
    Mode,
    SwarmEvent,
)
from swarmabs_ros.endpoints import profile, ros_type

TOPICS = {"packed": BROADCAST, "single": ABSTRACT_STATE, "event": EVENTS}
QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


def main(forges: str) -> None:
    """Forge `packed` broadcasts, `single` abstract states or an `event` per step until the process is ended."""
    rclpy.init(args=["--ros-args", "--disable-external-lib-logs"])
    node = rclpy.create_node("stranger")
    topic = TOPICS[forges]
    publisher = node.create_publisher(ros_type(topic), topic.name, profile(OFFERED[LOCKSTEP][topic]))
    said = set[bytes]()

    def hear(data: bytes) -> None:
        if data in said:
            return
        state = decode(AbstractState, bytes(data))
        assert isinstance(state, AbstractState)
        forged = state._replace(torque=state.torque + 0.2)
        head = state.stamp, state.step
        sums = AuxiliaryState(*head, 1.0, 0.0, 0.02, 0.02, 0.0, 0.0, 0.0, 0.0)
        asked = DesiredAbstractState(*head, Mode.RUN, 0.1, 0.03, *(0.0,) * 6)
        answer = encode(
            {
                BROADCAST: Broadcast(*head, forged, sums, asked),
                ABSTRACT_STATE: forged,
                EVENTS: SwarmEvent(*head, 2, EventKind.LIMIT_HIT, 0.1, "off the plane's end"),
            }[topic]
        )
        said.add(answer)
        publisher.publish(answer)

    node.create_subscription(ros_type(ABSTRACT_STATE), ABSTRACT_STATE.name, hear, QOS, raw=True)
    rclpy.spin(node)


if __name__ == "__main__":
    main(sys.argv[1])

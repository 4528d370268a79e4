"""A stock ROS node that looks at a swarm from outside and hears what it is told to; see `serve`.

It knows nothing of this project but the types of messages.
"""

import json
import os
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

DEPTH = 1000


@dataclass
class Heard:
    """What was heard of a topic, and what its publishers offered."""

    messages: list[str] = field(default_factory=list)
    offered: list[list[str]] = field(default_factory=list)


class StockNode:
    """Answers requests."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self._heard: dict[str, Heard] = {}

    def nodes(self) -> list[str]:
        """Return the names of all nodes but this one; those of other namespaces may be the same."""
        return sorted(name for name in self.node.get_node_names() if name != self.node.get_name())

    def graph(self, node: str) -> dict[str, list[str]]:
        """Return what a node hears, publishes and serves."""
        services = self.node.get_service_names_and_types_by_node(node, "/")
        return {**self.topics(node, "/", False), "serves": sorted(name for name, _ in services)}

    def topics(self, node: str, namespace: str, of_dds: bool) -> dict[str, list[str]]:  # noqa: FBT001 - as rclpy has it
        """Return what a node hears and publishes, by the names of ROS or of DDS."""
        names = (
            ("hears", self.node.get_subscriber_names_and_types_by_node),
            ("publishes", self.node.get_publisher_names_and_types_by_node),
        )
        return {kind: sorted(name for name, _ in find(node, namespace, of_dds)) for kind, find in names}

    def offered(self, topic: str) -> list[list[str]]:
        """Return reliability and durability that the publishers of a topic offer."""
        offers = [info.qos_profile for info in self.node.get_publishers_info_by_topic(topic)]
        return [[qos.reliability.name, qos.durability.name] for qos in offers]

    def hear(self, topic: str, kind: str, durability: str = "VOLATILE") -> None:
        """Keep the bytes of all messages of a topic from now on; of a type such as ``std_msgs/String``."""
        package, _, name = kind.partition("/")
        reliable = QoSReliabilityPolicy.RELIABLE
        qos = QoSProfile(depth=DEPTH, reliability=reliable, durability=QoSDurabilityPolicy[durability])
        kept = self._heard[topic] = Heard()

        def take(data: bytes) -> None:
            if not kept.messages:
                kept.offered = self.offered(topic)
            kept.messages.append(data.hex())

        self.node.create_subscription(getattr(import_module(f"{package}.msg"), name), topic, take, qos, raw=True)

    def payloads(self) -> dict[str, list[str]]:
        """Return what was heard so far, in hexadecimal digits."""
        return {topic: kept.messages for topic, kept in self._heard.items()}

    def offered_by(self) -> dict[str, list[list[str]]]:
        """Return what the publishers of the topics that were heard offered when the first message came."""
        return {topic: kept.offered for topic, kept in self._heard.items()}


def serve(make: Callable[..., object], namespace: str = "/", arguments: Sequence[str] = ()) -> int:
    """Answer requests: each line on standard input is a list of its name and arguments, each on standard output JSON.

    The node spins in a thread of its own. `make` gets it, and the arguments.
    """
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # Fast DDS prints its errors on standard output
    rclpy.init(args=["--ros-args", "--disable-external-lib-logs", "-r", f"__ns:={namespace}"])
    # The service that describes types needs a right that a stock node does not have under DDS Security.
    lean = [Parameter("start_type_description_service", value=False)]
    node = Node("client", enable_rosout=False, start_parameter_services=False, parameter_overrides=lean)
    asked: Any = make(node, *arguments)
    thread = threading.Thread(target=_spin, args=(node,), daemon=True)
    thread.start()
    for line in sys.stdin:
        name, *arguments = json.loads(line)
        answers.write(json.dumps(getattr(asked, name)(*arguments)) + "\n")
        answers.flush()
    rclpy.shutdown()
    thread.join()
    return 0


def _spin(node: Node) -> None:
    try:
        rclpy.spin(node)
    except rclpy.executors.ExternalShutdownException:
        return


if __name__ == "__main__":
    sys.exit(serve(StockNode))

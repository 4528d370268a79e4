"""Prints, as JSON, which topics of DDS each node publishes and hears, once it knows all that are named.

Usage: ``python endpoints_probe.py SECONDS NODE...``, in the environment of a fleet's operator.
"""

from __future__ import annotations

import json
import sys
import time

import rclpy
from rclpy.node import Node

NAME = "endpoints_probe"


def endpoints(node: Node) -> dict[str, dict[str, list[str]]]:
    """Return the topics of every other node as DDS calls them, those of its services among them."""
    return {
        name: {
            "publish": sorted(topic for topic, _ in node.get_publisher_names_and_types_by_node(name, namespace, True)),
            "subscribe": sorted(
                topic for topic, _ in node.get_subscriber_names_and_types_by_node(name, namespace, True)
            ),
        }
        for name, namespace in node.get_node_names_and_namespaces()
        if name != NAME
    }


def main() -> int:
    deadline, names = time.monotonic() + float(sys.argv[1]), set(sys.argv[2:])
    rclpy.init(args=["--ros-args", "--disable-external-lib-logs"])
    node = Node(NAME, enable_rosout=False, start_parameter_services=False)
    found: dict[str, dict[str, list[str]]] = {}
    same = 0
    while time.monotonic() < deadline and not (set(found) >= names and same >= 4):
        before, found = found, endpoints(node)
        # Endpoints become known one by one: the picture is complete when it stays the same for a while.
        same = same + 1 if found == before else 0
        time.sleep(0.5)
    sys.stdout.write(json.dumps(found))
    node.destroy_node()  # type: ignore[no-untyped-call]
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())

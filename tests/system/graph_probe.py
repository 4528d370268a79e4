"""Prints, as JSON, which topics each node of a run publishes and hears, once it knows all nodes.

Usage: ``python graph_probe.py NUMBER_OF_NODES SECONDS``, in the environment of ``swarm env RUN``.
"""

from __future__ import annotations

import json
import sys
import time

import rclpy
from rclpy.node import Node

NAME = "graph_probe"


def topics_of(node: Node) -> dict[str, dict[str, list[str]]]:
    """Return publications and subscriptions of every other node."""
    return {
        name: {
            "publishes": sorted(
                topic
                for topic, _ in node.get_publisher_names_and_types_by_node(name, namespace)
                if topic != "/parameter_events"  # of every rclpy node
            ),
            "hears": sorted(topic for topic, _ in node.get_subscriber_names_and_types_by_node(name, namespace)),
            "serves": sorted(topic for topic, _ in node.get_service_names_and_types_by_node(name, namespace)),
        }
        for name, namespace in node.get_node_names_and_namespaces()
        if name != NAME
    }


def main() -> int:
    count, seconds = int(sys.argv[1]), float(sys.argv[2])
    rclpy.init(args=["--ros-args", "--disable-external-lib-logs"])
    node = Node(NAME, enable_rosout=False, start_parameter_services=False)
    deadline = time.monotonic() + seconds
    graph: dict[str, dict[str, list[str]]] = {}
    while time.monotonic() < deadline:
        before, graph = graph, topics_of(node)
        # Endpoints become known one by one: the picture is complete when it is full and stays the same.
        if len(graph) == count and all(entry["hears"] for entry in graph.values()) and graph == before:
            break
        time.sleep(0.5)
    sys.stdout.write(json.dumps(graph))
    node.destroy_node()  # type: ignore[no-untyped-call]
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())

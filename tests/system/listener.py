"""Writes down what a stock ROS node hears of some topics, until nothing more comes for 1 s after the publisher left.

Usage: ``python listener.py FILE SECONDS TOPIC...``: messages as they came, and the QoS that is offered. It prints a
line when every topic has a publisher.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from swarmabs_msgs.msg import DesiredAbstractState, PlaneState, SwarmEvent

TYPES = {"/plane/state": PlaneState, "/swarm/desired_abstract_state": DesiredAbstractState, "/swarm/events": SwarmEvent}
RELIABLE = QoSProfile(depth=1000, reliability=QoSReliabilityPolicy.RELIABLE, durability=QoSDurabilityPolicy.VOLATILE)


def main() -> int:
    file, seconds, *topics = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node("listener")
    heard: dict[str, dict[str, Any]] = {topic: {"messages": [], "qos": None} for topic in topics}

    def keeping(topic: str) -> Any:
        def keep(data: bytes) -> None:
            heard[topic]["messages"].append(data.hex())

        return keep

    for topic in topics:
        node.create_subscription(TYPES[topic], topic, keeping(topic), RELIABLE, raw=True)
    deadline = time.monotonic() + float(seconds)
    met = False
    while time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
        offers = {topic: node.get_publishers_info_by_topic(topic) for topic in topics}
        if not met and all(offers.values()):
            met = True
            sys.stdout.write("all topics are there\n")  # for whoever makes the playback begin
            sys.stdout.flush()
        for topic, found in offers.items():
            if found:
                qos = found[0].qos_profile
                heard[topic]["qos"] = [qos.reliability.name, qos.durability.name]
        if met and not any(offers.values()):
            break
    Path(file).write_text(json.dumps(heard), encoding="utf-8")
    node.destroy_node()
    rclpy.shutdown()
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())

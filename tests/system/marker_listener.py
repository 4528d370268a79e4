"""Writes down what a stock ROS node hears of a swarm's joint state, markers and description, until it has enough.

Usage: ``python marker_listener.py FILE NUMBER``: so many joint states.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

LONGEST = 60.0
LATCHED = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.RELIABLE, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


def main() -> int:
    file, number = sys.argv[1], int(sys.argv[2])
    heard: dict[str, list[Any]] = {"joints": [], "markers": [], "description": []}
    rclpy.init()
    node = rclpy.create_node("marker_listener")

    def joints(message: Any) -> None:
        stamp = message.header.stamp
        heard["joints"].append([stamp.sec * 10**9 + stamp.nanosec, *message.name, *message.position])

    def markers(message: Any) -> None:
        robots = {marker.id: marker.pose.position for marker in message.markers if marker.ns == "robots"}
        stamp = message.markers[0].header.stamp
        places = {robot: [place.x, place.z] for robot, place in robots.items()}
        heard["markers"].append([stamp.sec * 10**9 + stamp.nanosec, places])

    node.create_subscription(JointState, "/plane/joint_states", joints, 10)
    node.create_subscription(MarkerArray, "/swarm/markers", markers, 10)
    node.create_subscription(String, "/robot_description", lambda m: heard["description"].append(m.data), LATCHED)
    deadline = time.monotonic() + LONGEST
    while time.monotonic() < deadline and not (
        len(heard["joints"]) >= number and len(heard["markers"]) >= number and heard["description"]
    ):
        rclpy.spin_once(node, timeout_sec=0.1)
    Path(file).write_text(json.dumps(heard), encoding="utf-8")
    node.destroy_node()
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Two ROS nodes on test hosts: one counts, the other listens.

Usage: python -m tests.hosts.chatter talk
       python -m tests.hosts.chatter listen COUNT [TIMES]

The talker goes on until it is ended. The listener says "ready" when it exists, and then all that it hears, as JSON and
COUNT numbers at a time; after so many TIMES it ends.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import UInt64
from tests.hosts.namespaces import say

_QOS = QoSProfile(depth=1000)


def talk(node: Node) -> None:
    publisher = node.create_publisher(UInt64, "count", _QOS)
    number = 0
    while True:
        publisher.publish(UInt64(data=number))
        number += 1
        time.sleep(0.01)


def listen(node: Node, count: str, times: str = "1") -> None:
    heard: list[int] = []

    def hear(message: UInt64) -> None:
        heard.append(message.data)
        if len(heard) % int(count) == 0:
            say(json.dumps(heard[-int(count) :]))

    node.create_subscription(UInt64, "count", hear, _QOS)
    say("ready")
    while len(heard) < int(count) * int(times):
        rclpy.spin_once(node)


if __name__ == "__main__":
    rclpy.init()
    tasks: dict[str, Callable[..., None]] = {"talk": talk, "listen": listen}
    tasks[sys.argv[1]](rclpy.create_node(sys.argv[1]), *sys.argv[2:])

"""A node that says its name on a topic. It prints whom it has heard, all nodes, and its own addresses and UDP ports.

Usage: python -m tests.swarmabs_fleet.talker NAME
"""

import json
import sys

import psutil
import rclpy
from std_msgs.msg import String


def main(name: str) -> None:
    rclpy.init()
    node = rclpy.create_node(name)
    publisher = node.create_publisher(String, "/talk", 10)
    heard: set[str] = set()
    node.create_subscription(String, "/talk", lambda message: heard.add(message.data), 10)
    told: list[object] = []
    while True:
        publisher.publish(String(data=name))
        rclpy.spin_once(node, timeout_sec=0.05)
        bound = [found.laddr for found in psutil.Process().net_connections("udp") if found.laddr]
        places = [sorted({address.ip for address in bound}), sorted({address.port for address in bound})]
        seen = [sorted(heard), sorted(set(node.get_node_names())), *places]
        if seen != told:
            sys.stdout.write(json.dumps(seen) + "\n")
            sys.stdout.flush()
            told = seen


if __name__ == "__main__":
    main(sys.argv[1])

"""Node ``discovery_server``: a participant that its Fast DDS profile makes the fleet's discovery server."""

from __future__ import annotations

import sys
import time

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from swarmabs_bringup.orchestration.dds_profile import REALTIME_LEASE
from swarmabs_ros.systemd import notify

LIFE_SIGN = 1.0
"""Time, s, between two signs of life for systemd."""
FORGOTTEN_AFTER = REALTIME_LEASE + 1.5
"""Silence, s, after which nobody takes the server for the one before.

Both have the same GUID, since everybody has to know it. Participants that have not noticed the end of the one before
would not tell the new one of themselves. Those that have met need no server meanwhile.
"""


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to end."""
    try:
        time.sleep(FORGOTTEN_AFTER)
        rclpy.init(args=args)
        node = Node("discovery_server", enable_rosout=False)
        node.create_timer(LIFE_SIGN, lambda: notify("WATCHDOG=1"))
        notify("READY=1")
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        notify("STOPPING=1")
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())

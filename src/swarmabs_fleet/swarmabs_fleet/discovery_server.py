"""Node ``discovery_server``: a participant that its Fast DDS profile makes the fleet's discovery server."""

from __future__ import annotations

import os
import signal
import sys

import rclpy
from rclpy.node import Node

from swarmabs_core.errors import InputError
from swarmabs_ros.start import check_profiles, initialise
from swarmabs_ros.status import notify
from swarmabs_run.orchestration.network import REALTIME_LEASE

LIFE_SIGN = 1.0
"""Time, s, between two signs of life for systemd."""
FORGOTTEN_AFTER = REALTIME_LEASE + 1.5
"""Silence, s, after which nobody takes the server for the one before.

Both have the same GUID, since everybody has to know it. Participants that have not noticed the end of the one before
would not tell the new one of themselves. Those that have met need no server meanwhile.
"""
_ENDS = (signal.SIGINT, signal.SIGTERM)


def main(args: list[str] | None = None) -> int:
    """Run the participant until it is told to end; return its exit code, 2 if its profile is refused."""
    try:
        check_profiles(os.environ)
        return _serve(args)
    except InputError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2


def _serve(args: list[str] | None) -> int:
    """Wait, then be the server. The middleware works by itself: there is nothing to spin."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)  # they are waited for
    if signal.sigtimedwait(_ENDS, FORGOTTEN_AFTER) is not None:
        return 0
    initialise("discovery_server", args)
    try:
        node = Node("discovery_server", enable_rosout=False, start_parameter_services=False)
        notify("READY=1")
        while signal.sigtimedwait(_ENDS, LIFE_SIGN) is None:
            notify("WATCHDOG=1")
        notify("STOPPING=1")
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())

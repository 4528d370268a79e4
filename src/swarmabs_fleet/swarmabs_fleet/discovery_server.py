"""Node ``discovery_server``: a participant whose Fast DDS profile makes it the fleet's discovery server."""

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
"""Time, s, between two watchdog notifications to systemd."""
FORGOTTEN_AFTER = REALTIME_LEASE + 1.5
"""Silence, s, after which no participant takes the server for its predecessor.

Both have the same GUID, which all participants must know in advance. A participant that has not noticed the end of the
predecessor would not announce itself to the new server. Participants that have already discovered each other do not
need the server in the meantime.
"""
_ENDS = (signal.SIGINT, signal.SIGTERM)


def main(args: list[str] | None = None) -> int:
    """Run the participant until a signal stops it; return the exit code, 2 if its profile is invalid."""
    try:
        check_profiles(os.environ)
        return _serve(args)
    except InputError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2


def _serve(args: list[str] | None) -> int:
    """Wait, then run the server. The middleware does the work, so nothing needs to spin."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)  # received by sigtimedwait
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

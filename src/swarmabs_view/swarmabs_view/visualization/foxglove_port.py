"""Whether Foxglove can be served at all: asked before a run is started, and so without ROS."""

from __future__ import annotations

import socket
import sys
from typing import Any

from swarmabs_core.errors import InputError

HOST = "127.0.0.1"


def check_foxglove(port: int) -> None:
    """Refuse before a run is started what could not be served.

    Raises
    ------
    InputError
        If the package foxglove-sdk is not installed, or the port is taken.
    """
    need_foxglove()
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise InputError(f"{HOST}:{port}: {error.strerror}; choose another --foxglove-port") from error


def need_foxglove() -> Any:
    """Return the module of the Foxglove SDK.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import foxglove  # noqa: PLC0415 - only where it is asked for
    except ImportError as error:
        raise InputError(
            "the WebSocket for Foxglove needs the Python package foxglove-sdk, which ./scripts/swarm installs by "
            f"itself; with a ROS 2 of your own: {sys.executable} -m pip install foxglove-sdk"
        ) from error
    return foxglove

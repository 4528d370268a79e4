"""Ports on this machine for pages and Foxglove, asked for before a run is started, and so without ROS."""

from __future__ import annotations

import socket
import sys
from importlib.util import find_spec

from swarmabs_core.errors import InputError

ADDRESS = "127.0.0.1"


def need_package(module: str, package: str, user: str) -> None:
    """Refuse by an `InputError` where a package is not installed that only some need."""
    if find_spec(module) is None:
        raise InputError(
            f"{user} needs the Python package {package}, which ./scripts/swarm installs by itself; "
            f"with a ROS 2 of your own: {sys.executable} -m pip install {package}"
        )


def need_web_server() -> None:
    """Refuse where pages cannot be served; errors as of `need_package`."""
    need_package("aiohttp", "aiohttp", "the view")


def need_foxglove() -> None:
    """Refuse where Foxglove cannot be served; errors as of `need_package`."""
    need_package("foxglove", "foxglove-sdk", "the WebSocket for Foxglove")


def check_foxglove(port: int) -> None:
    """Refuse by an `InputError` what could not be served: the package is not installed, or the port is taken."""
    need_foxglove()
    bound(port, "choose another --foxglove-port").close()


def bound(port: int, remedy: str = "choose another, or 0 for a free one") -> socket.socket:
    """Return a socket that listens on a port of 127.0.0.1, 0 for any free one; an `InputError` if it cannot be had."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        # A port is free again as soon as who had it has ended.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((ADDRESS, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise InputError(f"port {port} of {ADDRESS}: {error.strerror}; {remedy}") from error
    return listener


def url_of(listener: socket.socket) -> str:
    """Return the address of the page that a socket serves."""
    return f"http://{ADDRESS}:{listener.getsockname()[1]}/"

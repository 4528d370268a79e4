"""Ports on this machine for pages and Foxglove, reserved before a run starts and thus without ROS."""

from __future__ import annotations

import socket
from importlib.util import find_spec

from swarmabs_config.installation import lacking
from swarmabs_core.errors import InputError

ADDRESS = "127.0.0.1"


def need_package(module: str, user: str) -> None:
    """Raise `InputError` if an optional package is not installed."""
    if find_spec(module) is None:
        raise lacking(ModuleNotFoundError(name=module), user)


def need_web_server() -> None:
    """Check that pages can be served; errors as for `need_package`."""
    need_package("aiohttp", "the view")


def need_foxglove() -> None:
    """Check that Foxglove can be served; errors as for `need_package`."""
    need_package("foxglove", "the WebSocket for Foxglove")


def check_foxglove(port: int) -> None:
    """Raise `InputError` if the package for Foxglove is not installed or the port is taken."""
    need_foxglove()
    bound(port, "choose another --foxglove-port").close()


def bound(port: int, remedy: str = "choose another, or 0 for a free one") -> socket.socket:
    """Return a socket that listens on a port of 127.0.0.1, 0 for any free one; raise `InputError` if that fails."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        # Allows a port to be reused as soon as its process has ended.
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

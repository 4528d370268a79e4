"""The common part of every node's ``main``: middleware, node, errors as exit codes, shutdown.

A node starts only if its Fast DDS profile is readable: Fast DDS would ignore an unreadable profile and listen on every
interface. Other programs, such as a vendor's drivers, can run the same check first: ``python -m swarmabs_ros.start``
exits with 2 and an error line if a profile is unreadable.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar
from xml.parsers import expat

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.signals import SignalHandlerOptions

from swarmabs_core.errors import InputError, RunError
from swarmabs_ros.status import StatusChannel

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

NodeT = TypeVar("NodeT", bound=Node)

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Environment variables for the Fast DDS profile; which one is effective depends on its version."""


class SwarmNode(Node):
    """A node without the standard services and topics that a lockstep run does not need."""

    def __init__(self, name: str) -> None:
        super().__init__(
            name,
            enable_rosout=False,
            start_parameter_services=False,
            automatically_declare_parameters_from_overrides=True,
            parameter_overrides=[RosParameter("start_type_description_service", value=False)],
        )


def run_program(
    name: str,
    make_node: Callable[[str], NodeT],
    body: Callable[[NodeT, StatusChannel], None],
    args: list[str] | None = None,
) -> int:
    """Run a node from the start of the middleware to its shutdown.

    The node has this name unless remapped, and ends when `body` returns. Exit codes: 0 success, 1 failure, 2 invalid
    parameter or Fast DDS profile. The reason is written to standard error and reported to the process that started the
    node.
    """
    try:
        initialise(name, args)
    except InputError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    node = make_node(name)
    status = StatusChannel(node.get_name())
    try:
        body(node, status)
    except (InputError, RunError) as error:
        status.send("failed", reason=str(error)[:2000])
        sys.stderr.write(f"error: {error}\n")
        return 2 if isinstance(error, InputError) else 1
    finally:
        # Ctrl-C in a terminal reaches a node a second time by way of ros2 launch, and Python takes its handlers away
        # before the process has ended.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        node.destroy_node()  # type: ignore[no-untyped-call]
        rclpy.try_shutdown()
    return 0


def initialise(name: str, args: list[str] | None) -> None:
    """Initialise rclpy for a node that handles signals itself.

    Raises `InputError`, which names the node, if the profile or the command line is invalid; nothing is started in this
    case.
    """
    check_profiles(os.environ)
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # the public base class of rclpy's errors
        raise InputError(f"command line of {name}: {' '.join(str(error).split())}") from error


def check_profiles(environment: Mapping[str, str]) -> None:
    """Raise `InputError` if a Fast DDS profile named in an environment cannot be read, or is not XML."""
    for variable in PROFILES:
        if path := environment.get(variable):
            _check(variable, Path(path))


def _check(variable: str, path: Path) -> None:
    """Check one profile."""
    consequence = "Fast DDS would listen on every interface without it"
    try:
        expat.ParserCreate().Parse(path.read_bytes(), True)
    except OSError as error:
        raise InputError(
            f"{variable}: {path} cannot be read: {error.strerror}, and {consequence}; "
            "let this account read it: run install.sh of the bundle again, or correct the variable"
        ) from error
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise InputError(
            f"{variable}: {path} is not XML: {' '.join(str(error).split())}, and {consequence}; "
            "recreate it: run install.sh of the bundle again, or correct the variable"
        ) from error


def main() -> int:
    """Check the profiles of this process's environment."""
    try:
        check_profiles(os.environ)
    except InputError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

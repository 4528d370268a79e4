"""The frame of every node's ``main``: middleware, the node, errors as exit codes, the end."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, TypeVar

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from swarmabs_core.errors import InputError, RunError
from swarmabs_ros.start import initialise
from swarmabs_ros.status import StatusChannel

if TYPE_CHECKING:
    from collections.abc import Callable

NodeT = TypeVar("NodeT", bound=Node)


class SwarmNode(Node):
    """A node without those services and topics of its own that a lockstep run does not need."""

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
    """Run a node from the start of the middleware to its end.

    Parameters
    ----------
    name : str
        The node's name, where none is remapped.
    make_node : callable
        Makes the node.
    body : callable
        What the node does, until it is over.
    args : list of str, optional
        Command line without the program's name.

    Returns
    -------
    int
        Exit code: 0 fine, 1 something failed, 2 a parameter or the Fast DDS profile was refused. The reason goes to
        standard error and to whoever started the node.
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
        node.destroy_node()  # type: ignore[no-untyped-call]
        rclpy.try_shutdown()
    return 0

"""Nodes in this process, started with a command line as by `ros2 run`, and what they say."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import rclpy

from swarmabs_core.messages import DesiredAbstractState
from swarmabs_core.parameters import Parameter, Value, resolve
from swarmabs_ros.parameters import Table, declare, given_values, table_of
from swarmabs_ros.realtime_runner import COMMON as REALTIME_COMMON
from swarmabs_ros.runner import COMMON, Settings
from swarmabs_ros.start import SwarmNode

COMMAND_LINE = ["--ros-args", "--disable-external-lib-logs"]


@contextmanager
def started_node(*arguments: str, name: str = "probe") -> Iterator[SwarmNode]:
    """Start a node; it needs the fixture `ros`."""
    rclpy.init(args=[*COMMAND_LINE, *arguments] if arguments else None)
    node = SwarmNode(name)
    try:
        yield node
    finally:
        node.destroy_node()  # type: ignore[no-untyped-call]
        rclpy.shutdown()


def given(**values: str) -> list[str]:
    """Return the words of a command line that set parameters; a double underscore stands for a dot."""
    return [word for name, text in values.items() for word in ("-p", f"{name.replace('__', '.')}:={text}")]


def _settings(common: tuple[Parameter, ...], table: Table, /, **values: Value) -> Settings:
    """Return settings as a node would have them that was given these parameters; double underscores stand for dots."""
    named = {name.replace("__", "."): value for name, value in values.items()}
    return Settings(resolve(table_of(named, common, table), named, owner="the node"))


settings_from, realtime_settings_from = partial(_settings, COMMON), partial(_settings, REALTIME_COMMON)


def declared_by(arguments: list[str], common: tuple[Parameter, ...], table: Table) -> Settings:
    """Return what a node sees that is started with a command line, by way of ROS; it needs the fixture `ros`."""
    with started_node(*arguments) as node:
        return Settings(declare(node, table_of(given_values(node), common, table)))


def desired(step: int) -> DesiredAbstractState:
    """Return a message of a step that has nothing else in it."""
    return DesiredAbstractState(0, step, 0, *(0.0,) * 8)

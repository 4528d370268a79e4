"""The drive that a robot's node asks for by its parameters ``drive.*``."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime import drive_registry
from swarmabs_core.realtime.drive_registry import DRIVES, SIMULATED, Body
from swarmabs_ros.parameters import given_values

if TYPE_CHECKING:
    from rclpy.node import Node

    from swarmabs_core.realtime.agent import RealtimeAgentConfig
    from swarmabs_core.realtime.drives import Drive
    from swarmabs_core.realtime.topic_drive import Link, Wiring
    from swarmabs_ros.managed import RealtimeNode
    from swarmabs_ros.runner import Settings

PREFIX = "drive."
DRIVE = Parameter("drive.type", SIMULATED.name, "what moves the robot", choices=tuple(DRIVES.built_in))


def with_drive(node: Node, parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """Return a node's parameters, among them those of the drive that is asked for.

    Raises
    ------
    InputError
        If there is no such drive, or the package that brings it is unfit.
    """
    try:
        drive = DRIVES.find(str(given_values(node).get(DRIVE.name, DRIVE.default)))
    except InputError as error:
        raise InputError(f"parameter {DRIVE.name}: {error}") from error
    chosen = replace(DRIVE, choices=tuple(dict.fromkeys((*DRIVES.built_in, drive.name))))
    own = (chosen if parameter is DRIVE else parameter for parameter in parameters)
    return (*own, *(replace(setting, name=PREFIX + setting.name) for setting in drive.settings))


def make_drive(settings: Settings, config: RealtimeAgentConfig, node: RealtimeNode) -> Drive:
    """Return the drive that is asked for.

    Raises
    ------
    InputError
        If its settings contradict each other, or the package that brings it is unfit.
    """
    given = settings.within(PREFIX)
    body = Body(
        agent_id=config.agent_id,
        kind=config.kind,
        schedule=config.schedule,
        mass=config.mass,
        damping=config.damping,
        gravity=config.bounds.gravity,
        limits=config.limits,
        position=settings.number("position"),
        velocity=settings.number("velocity"),
        connect=lambda wiring: _connect(wiring, node),
    )
    return drive_registry.DRIVES.make(str(given.pop("type")), given, body)


def _connect(wiring: Wiring, node: RealtimeNode) -> Link:
    from agent_node.drives.topic import TopicLink  # noqa: PLC0415 - its messages take a while to load, and not all need them

    return TopicLink(wiring, node, node.loop_group)

"""Drives by name: the built-in ones, and those that installed packages bring for a vendor's robots."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from swarmabs_core.declaration import made_of, parameters_of
from swarmabs_core.drive import DoubleIntegratorDrive, SingleIntegratorDrive
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind
from swarmabs_core.parameters import Settings
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.drives import Drive, SimulatedDrive
from swarmabs_core.realtime.instruments import TopicSettings
from swarmabs_core.registry import Part, Registry
from swarmabs_core.robot_controller import Limits

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True, slots=True)
class Body:
    """What a drive may know of its robot.

    Parameters
    ----------
    agent_id : int
        Id of the robot.
    kind : Kind
        The command of a single integrator is a velocity, that of a double integrator a force.
    schedule : Schedule
        Control period and epoch.
    mass : float
        kg.
    damping : float
        N s/m; 0 of a single integrator.
    gravity : float
        m/s^2.
    limits : Limits
        Largest speed (m/s) and force (N).
    position, velocity : float
        Where a simulated body begins, m and m/s.
    connect : callable, optional
        Makes a drive behind topics of the robot's node; None where there is no node.
    """

    agent_id: int
    kind: Kind
    schedule: Schedule
    mass: float
    damping: float = 0.0
    gravity: float = 9.81
    limits: Limits = field(default_factory=Limits)
    position: float = 0.0
    velocity: float = 0.0
    connect: Callable[[TopicSettings, Body], Drive] | None = None


class DriveType(Part[Body, Drive]):
    """A drive; `name` is the value of ``drive.type`` of a robot's node."""


def _simulated(settings: Settings, body: Body) -> Drive:  # noqa: ARG001 - it has none
    period = body.schedule.period_ns / 1e9
    model = (
        SingleIntegratorDrive(period)
        if body.kind is Kind.SINGLE_INTEGRATOR
        else DoubleIntegratorDrive.of(period, body.mass, body.damping)
    )
    return SimulatedDrive(model, body.schedule, body.position, body.velocity)


SIMULATED = DriveType("simulated", (), _simulated)
"""A body that moves exactly as the law expects."""


def _topic(settings: Settings, body: Body) -> Drive:
    made = made_of(TopicSettings, settings)
    if body.connect is None:
        raise InputError("drive topic: there is no ROS node here to which it could be connected")
    return body.connect(made, body)


TOPIC = DriveType(TopicSettings.type, parameters_of(TopicSettings), _topic)
"""A base behind ROS topics."""

DRIVES = Registry("drive", "swarmabs.drives", DriveType, (SIMULATED, TOPIC), ("read", "write", "stop"))

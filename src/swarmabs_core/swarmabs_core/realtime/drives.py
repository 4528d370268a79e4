"""The hardware interface between a robot's law and its body: read, write, stop.

Drives are selected by name: built-in ones, and those that installed packages provide for a vendor's robots.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

from swarmabs_core.declaration import made_of, parameters_of
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind
from swarmabs_core.parameters import Settings
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.instruments import TopicSettings
from swarmabs_core.registry import Part, Registry
from swarmabs_core.robot_controller import Limits
from swarmabs_core.systems.kinds import KINDS

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.drive import IdealDrive

COMMAND_TIMEOUT = 0.2
"""Time, s, without a command after which a simulated body stops by itself, as the base of a robot must."""


class Measurement(NamedTuple):
    """A measurement of a robot's motion: time (ns since 1970), position (m) and velocity (m/s) along the plane."""

    stamp: int
    position: float
    velocity: float


class Drive(Protocol):
    """Interface to what moves a robot and measures its motion."""

    def read(self, now: int) -> Measurement | None:
        """Return the newest measurement, None if there is none yet; `now` in ns since 1970."""
        ...

    def write(self, command: float, now: int) -> None:
        """Apply a command within the limits, m/s for a single integrator, N for a double integrator."""
        ...

    def stop(self) -> None:
        """Bring the body to a safe state, at rest and unpowered; repeated calls have no effect."""
        ...


@runtime_checkable
class Reporting(Protocol):
    """A drive that adds values to the health of its robot."""

    def report(self) -> tuple[tuple[str, str], ...]:
        """Return values as (name, text), such as the number of rejected readings."""
        ...


@dataclass(frozen=True, slots=True)
class Body:
    """What a drive may know about its robot."""

    agent_id: int
    kind: Kind  # the command of a single integrator is a velocity, that of a double integrator a force
    schedule: Schedule  # control period and epoch
    mass: float  # kg
    damping: float = 0.0  # N s/m; 0 for a single integrator
    gravity: float = 9.81  # m/s^2
    limits: Limits = field(default_factory=Limits)
    position: float = 0.0  # initial position of a simulated body, m
    velocity: float = 0.0  # m/s
    connect: Callable[[TopicSettings, Body], Drive] | None = (
        None  # creates a drive connected by topics, if there is a node
    )


class DriveType(Part[Body, Drive]):
    """A drive; `name` is the value of the parameter ``drive.type`` of a robot's node."""


def moved(
    model: IdealDrive, motion: tuple[float, float], command: float, periods: int, schedule: Schedule
) -> tuple[float, float]:
    """Return the position (m) and velocity (m/s) of a simulated body some periods after its last command."""
    longest = schedule.steps(COMMAND_TIMEOUT)
    for _ in range(min(periods, longest)):
        motion = model.advance(*motion, command)
    return motion if periods <= longest else (motion[0], 0.0)


class SimulatedDrive:
    """A body that moves exactly as the law assumes, and stops by itself when commands cease."""

    def __init__(self, body: Body) -> None:
        self._model = KINDS[body.kind].drive(body.schedule.period, body.mass, body.damping)
        self._schedule = body.schedule
        self._position, self._velocity = body.position, body.velocity
        self._command = 0.0
        self._step: int | None = None

    def read(self, now: int) -> Measurement:
        """Simulate the periods that have passed under the held command, and return the resulting motion."""
        step = self._schedule.step(now)
        if self._step is None:
            self._step = step
        passed, self._step = max(0, step - self._step), max(step, self._step)
        motion = self._position, self._velocity
        self._position, self._velocity = moved(self._model, motion, self._command, passed, self._schedule)
        return Measurement(now, self._position, self._velocity)

    def write(self, command: float, now: int) -> None:  # noqa: ARG002 - it applies from the last reading on
        """Hold the command until the next one."""
        self._command = command

    def stop(self) -> None:
        """Come to rest at once."""
        self._command = self._velocity = 0.0


SIMULATED = DriveType("simulated", (), lambda _, body: SimulatedDrive(body))


def _topic(settings: Settings, body: Body) -> Drive:
    topics = made_of(TopicSettings, settings)
    if body.connect is None:
        raise InputError("drive topic: needs a ROS node to connect to", "select another drive")
    return body.connect(topics, body)


TOPIC = DriveType(TopicSettings.type, parameters_of(TopicSettings), _topic)
"""A base that is connected by ROS topics."""

DRIVES = Registry("drive", "swarmabs.drives", DriveType, (SIMULATED, TOPIC), ("read", "write", "stop"))

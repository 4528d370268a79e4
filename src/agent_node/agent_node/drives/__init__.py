"""The drives that a robot's node can have, by the value of its parameter ``drive.type``."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.agent import RealtimeAgentConfig, ideal_motion
from swarmabs_core.realtime.drives import Drive, SimulatedDrive

if TYPE_CHECKING:
    from swarmabs_ros.managed import RealtimeNode
    from swarmabs_ros.runner import Settings


def _simulated(settings: Settings, config: RealtimeAgentConfig, node: RealtimeNode) -> Drive:  # noqa: ARG001 - needs none
    start = settings.number("position"), settings.number("velocity")
    return SimulatedDrive(ideal_motion(config), config.schedule, *start)


DRIVES: dict[str, Callable[[Settings, RealtimeAgentConfig, RealtimeNode], Drive]] = {"simulated": _simulated}
"""How each is made, from the parameters, the robot's configuration and its node."""

DRIVE = Parameter("drive.type", "simulated", "what moves the robot", choices=tuple(DRIVES))


def make_drive(settings: Settings, config: RealtimeAgentConfig, node: RealtimeNode) -> Drive:
    """Return the drive that is asked for."""
    return DRIVES[settings.text(DRIVE.name)](settings, config, node)

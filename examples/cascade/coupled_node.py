"""The two nodes that couple layers: a robot driven by a lower plane, and the controller of that plane.

They differ from `agent_node` and `parent_controller` by their state machine and one subscription in the other layer.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from layers import UPPER, Coupling, absolute, carried_robot, layer, led_controller, lower

from swarmabs_config import configure
from swarmabs_config.graph import CONTROLLER, LOCKSTEP, ROBOT, Endpoints, Option, endpoints, requested
from swarmabs_core.declaration import setting
from swarmabs_core.messages import AGENT_STATE, PLANE_STATE
from swarmabs_ros.lockstep import NodeSpec

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings
    from swarmabs_ros.status import StatusChannel


@dataclass(frozen=True, slots=True)
class CouplingSettings:
    """Settings of both nodes."""

    upper_file: str = setting("", "file of the upper scenario")
    lower_file: str = setting("", "file of the lower scenario")
    robot: int = setting(1, "id of the coupled upper robot", minimum=1, maximum=65535)
    ratio: float = setting(1.0, "speed of the robot by tilt of the plane", unit="m/(s rad)", above=0.0)
    bandwidth: float = setting(15.0, "bandwidth of the reference filter", unit="rad/s", above=0.0)

    @property
    def coupling(self) -> Coupling:
        """How the plane moves the robot."""
        return Coupling(self.ratio, self.bandwidth)


PARAMETERS = (CouplingSettings,)


def make_robot(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - nothing to report
    """Return behaviour and endpoints of a robot driven by a lower plane."""
    given = settings.declared(CouplingSettings)
    upper, plane = (layer(Path(name)) for name in (given.upper_file, given.lower_file))
    behaviour = carried_robot(upper, given.robot, plane, given.coupling)
    own, link = endpoints(ROBOT, LOCKSTEP), absolute(PLANE_STATE, lower(given.robot))
    heard = {**own.subscriptions, link: requested(PLANE_STATE, depth=10)}
    return NodeSpec(behaviour, Endpoints(own.publications, heard))


def make_controller(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - nothing to report
    """Return behaviour and endpoints of the controller of a lower plane."""
    given = settings.declared(CouplingSettings)
    scenario = layer(Path(given.lower_file))
    window = configure.recording_window(scenario)
    behaviour = led_controller(scenario, given.robot, given.coupling, recording_window=window)
    own, link = endpoints(CONTROLLER, LOCKSTEP, frozenset({Option.CREDITED})), absolute(AGENT_STATE, UPPER)
    heard = {**own.subscriptions, link: requested(AGENT_STATE, depth=100)}
    return NodeSpec(behaviour, Endpoints(own.publications, heard))

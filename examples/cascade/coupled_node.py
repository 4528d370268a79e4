"""The two nodes that couple layers: a robot driven by a lower plane, and the controller of that plane.

They differ from `agent_node` and `parent_controller` by their state machine and one subscription in the other layer.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from layers import UPPER, Coupling, absolute, carried_robot, led_controller, lower

from swarmabs_config import configure
from swarmabs_config.graph import CONTROLLER, LOCKSTEP, ROBOT, Endpoints, Option, endpoints, requested
from swarmabs_config.scenario import load_scenario
from swarmabs_core.messages import AGENT_STATE, PLANE_STATE
from swarmabs_core.parameters import Parameter
from swarmabs_ros.lockstep import NodeSpec

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings
    from swarmabs_ros.status import StatusChannel

PARAMETERS = (
    Parameter("upper_file", "", "file of the upper scenario"),
    Parameter("lower_file", "", "file of the lower scenario"),
    Parameter("robot", 1, "id of the coupled upper robot", minimum=1, maximum=65535),
    Parameter("ratio", 1.0, "speed of the robot by tilt of the plane, m/(s rad)", above=0.0),
    Parameter("bandwidth", 15.0, "bandwidth of the reference filter, rad/s", above=0.0),
)


def _coupling(settings: Settings) -> Coupling:
    return Coupling(settings.number("ratio"), settings.number("bandwidth"))


def make_robot(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - nothing to report
    """Return behaviour and endpoints of a robot driven by a lower plane."""
    upper, plane = (load_scenario(Path(settings.text(name))) for name in ("upper_file", "lower_file"))
    robot = settings.integer("robot")
    behaviour = carried_robot(upper, robot, plane, _coupling(settings))
    own, link = endpoints(ROBOT, LOCKSTEP), absolute(PLANE_STATE, lower(robot))
    heard = {**own.subscriptions, link: requested(PLANE_STATE, depth=10)}
    return NodeSpec(behaviour, Endpoints(own.publications, heard))


def make_controller(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - nothing to report
    """Return behaviour and endpoints of the controller of a lower plane."""
    scenario = load_scenario(Path(settings.text("lower_file")))
    robot = settings.integer("robot")
    behaviour = led_controller(
        scenario, robot, _coupling(settings), recording_window=configure.recording_window(scenario)
    )
    own, link = endpoints(CONTROLLER, LOCKSTEP, frozenset({Option.CREDITED})), absolute(AGENT_STATE, UPPER)
    heard = {**own.subscriptions, link: requested(AGENT_STATE, depth=100)}
    return NodeSpec(behaviour, Endpoints(own.publications, heard))

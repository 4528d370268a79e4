"""Node ``parent_controller``: the plane's state in, the desired abstract state of the swarm out."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from swarmabs_config.graph import CONTROLLER
from swarmabs_core.behaviours import Controller, ControllerConfig, PackingController, Steered
from swarmabs_core.controllers import CONTROLLERS, ParentContext
from swarmabs_core.controllers.base import OffsetController
from swarmabs_core.errors import InputError
from swarmabs_core.friction import Friction
from swarmabs_core.manifold import Manifold
from swarmabs_core.parameters import Parameter
from swarmabs_core.steering import Stair
from swarmabs_ros.parameters import given_values
from swarmabs_ros.runner import PACKED, STEERED, NodeSpec, Settings, run_node
from swarmabs_ros.status import StatusChannel

if TYPE_CHECKING:
    from rclpy.node import Node

    from swarmabs_core.controllers import ParentController

LAW = Parameter("controller.type", "pd", "control law of the plane", choices=tuple(CONTROLLERS.built_in))
PARAMETERS = (
    Parameter("plane.inertia", 0.5, "moment of inertia of the plane alone, kg m^2", above=0.0),
    Parameter(
        "plane.friction",
        (0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0),
        "what the law takes the friction of the bearing to be, g1 to g6",
        minimum=0.0,
        length=6,
    ),
    Parameter("manifold.curvature", 0.0125, "A of J_sd = A tau^2 + B, kg m^2/(N m)^2", minimum=0.0),
    Parameter("manifold.offset", 0.025, "B of J_sd = A tau^2 + B, kg m^2", above=0.0),
    Parameter("manifold.torque_max", 5.0, "limit of the desired torque, N m", above=0.0),
    Parameter("recording_window", 0, "how many steps the run may be ahead of the recorder; 0: not recorded", minimum=0),
    Parameter("offsets", (), "what is added to the law's reference, rad, each 'STEP VALUE' from a step on: '500 0.1'"),
    PACKED,
    STEERED,
)


def with_law(node: Node, parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """Return a node's parameters with those of the law that is asked for."""
    law = CONTROLLERS.find(str(given_values(node).get(LAW.name, LAW.default)))
    chosen = replace(LAW, choices=tuple(dict.fromkeys((*CONTROLLERS.built_in, law.name))))
    return (chosen, *parameters, *(replace(setting, name=f"controller.{setting.name}") for setting in law.settings))


def table(node: Node) -> tuple[Parameter, ...]:
    """Return the node's parameters."""
    return with_law(node, PARAMETERS)


def manifold_of(settings: Settings) -> Manifold:
    """Return the curve on which the desired abstract state lies."""
    return Manifold(
        settings.number("manifold.curvature"),
        settings.number("manifold.offset"),
        settings.number("manifold.torque_max"),
    )


def law_of(settings: Settings) -> ParentController:
    """Return the control law of the plane, at its beginning."""
    friction = Friction(*settings.numbers("plane.friction"))
    period = settings.integer("period_ns") / 1e9
    context = ParentContext(period, settings.number("plane.inertia"), friction, manifold_of(settings))
    law_settings = settings.within("controller.")
    return CONTROLLERS.make(str(law_settings.pop("type")), law_settings, context)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour.

    Raises
    ------
    InputError
        If the reference shall be offset, and the law cannot do it.
    """
    law = law_of(settings)
    offsets = tuple(map(Stair.parse, settings.texts("offsets")))
    if offsets and not isinstance(law, OffsetController):
        raise InputError("parameter offsets: the law has no method offset_torque; leave the parameter out")
    period_ns = settings.integer("period_ns")
    window = settings.integer("recording_window")
    plain = Controller(ControllerConfig(period_ns, manifold_of(settings), window, settings.last_step(), offsets), law)
    controller = Steered(plain) if settings.flag(STEERED.name) else plain
    return NodeSpec(PackingController(controller) if settings.flag(PACKED.name) else controller)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(CONTROLLER, table, make, args)


if __name__ == "__main__":
    sys.exit(main())

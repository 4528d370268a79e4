"""Node ``parent_controller``: state of the plane in, desired abstract state of the swarm out."""

from __future__ import annotations

import sys

from swarmabs_config.graph import CONTROLLER
from swarmabs_core import model
from swarmabs_core.behaviours import Controller, Steered
from swarmabs_core.models import ControllerConfig, SystemControllerConfig
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.parameters import BySystem
from swarmabs_ros.runner import LockstepProgram, Settings
from swarmabs_ros.settings import Variant
from swarmabs_ros.status import StatusChannel

CONFIG: BySystem[model.ControllerConfig] = BySystem(ControllerConfig, SystemControllerConfig)
PARAMETERS = (CONFIG, Variant)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour; reject offsets of the reference if the law does not support them."""
    variant = settings.declared(Variant)
    controller = Controller(settings.chosen(CONFIG), packed=variant.packed)
    return NodeSpec(Steered(controller) if variant.steered else controller)


main = LockstepProgram(CONTROLLER, PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())

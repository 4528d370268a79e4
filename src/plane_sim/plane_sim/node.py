"""Node ``plane_sim``: the simulated plane, or another parent system.

On hardware, the driver of an encoder or an IMU replaces it.
"""

from __future__ import annotations

import sys

from swarmabs_config.graph import PLANE
from swarmabs_core.behaviours import Parent, PlaneConfig, Steered
from swarmabs_core.behaviours.systems import SystemParentConfig
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.parameters import BySystem
from swarmabs_ros.runner import PACKED, STEERED, Settings, run_node
from swarmabs_ros.status import StatusChannel

CONFIG = BySystem(PlaneConfig, SystemParentConfig)
PARAMETERS = (CONFIG, PACKED, STEERED)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour."""
    parent = Parent(settings.chosen(CONFIG), packed=settings.flag(PACKED.name))
    return NodeSpec(Steered(parent) if settings.flag(STEERED.name) else parent)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(PLANE, PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())

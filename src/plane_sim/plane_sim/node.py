"""Node ``plane_sim``: the simulated plane; on hardware the driver of an encoder or an IMU replaces it."""

from __future__ import annotations

import sys

from swarmabs_config.graph import PLANE
from swarmabs_core.behaviours import Plane, PlaneConfig, Steered
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.runner import STEERED, Settings, run_node
from swarmabs_ros.status import StatusChannel

PARAMETERS = (PlaneConfig, STEERED)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour."""
    plane = Plane(settings.made(PlaneConfig))
    return NodeSpec(Steered(plane) if settings.flag(STEERED.name) else plane)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(PLANE, PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())

"""Node ``plane_sim``: the simulated plane, or another parent system.

On hardware, the driver of an encoder or an IMU replaces it.
"""

from __future__ import annotations

import sys

from swarmabs_config.graph import PLANE
from swarmabs_core import model
from swarmabs_core.behaviours import Parent, Steered
from swarmabs_core.models import PlaneConfig, SystemParentConfig
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.parameters import BySystem
from swarmabs_ros.runner import PACKED, STEERED, LockstepProgram, Settings
from swarmabs_ros.status import StatusChannel

CONFIG: BySystem[model.ParentConfig] = BySystem(PlaneConfig, SystemParentConfig)
PARAMETERS = (CONFIG, PACKED, STEERED)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour."""
    parent = _parent(settings)
    return NodeSpec(Steered(parent) if settings.flag(STEERED.name) else parent)


def _parent(settings: Settings) -> Parent:
    config = settings.chosen(CONFIG)
    if not settings.flag(PACKED.name):
        return Parent(config)
    from swarmabs_core.behaviours.packed import PackedParent  # noqa: PLC0415 - only packed runs need numpy

    return PackedParent(config)


main = LockstepProgram(PLANE, PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())

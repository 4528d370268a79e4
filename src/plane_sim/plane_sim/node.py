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
from swarmabs_ros.runner import LockstepProgram, Settings
from swarmabs_ros.settings import Variant
from swarmabs_ros.status import StatusChannel

CONFIG: BySystem[model.ParentConfig] = BySystem(PlaneConfig, SystemParentConfig)
PARAMETERS = (CONFIG, Variant)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour."""
    variant = settings.declared(Variant)
    parent = _parent(settings.chosen(CONFIG), packed=variant.packed)
    return NodeSpec(Steered(parent) if variant.steered else parent)


def _parent(config: model.ParentConfig, *, packed: bool) -> Parent:
    if not packed:
        return Parent(config)
    from swarmabs_core.behaviours.packed import PackedParent  # noqa: PLC0415 - only packed runs need numpy

    return PackedParent(config)


main = LockstepProgram(PLANE, PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())

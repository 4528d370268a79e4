"""Node ``plane_sim`` in real time, for demonstrations and tests: a plane simulated by the clock."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from swarmabs_config.graph import PLANE
from swarmabs_core.messages import PARENT
from swarmabs_core.realtime.base import PLANE_PHASE
from swarmabs_core.realtime.plane import RealtimePlane, RealtimePlaneConfig
from swarmabs_core.realtime.seals import SealFiles, sealed_plane
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import RealtimeProgram
from swarmabs_ros.sealed import seals_in
from swarmabs_ros.settings import RobotTopics

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings

PARAMETERS = (RealtimePlaneConfig, RobotTopics, SealFiles)


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:  # noqa: ARG001 - it does not use the node
    """Return the behaviour."""
    config = settings.declared(RealtimePlaneConfig)
    seals = seals_in(settings.declared(SealFiles), PARENT)
    return RealtimeSpec(sealed_plane(RealtimePlane(config), seals, config.schedule), PLANE_PHASE)


main = RealtimeProgram(PLANE, PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())

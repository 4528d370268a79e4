"""Node ``parent_controller`` in real time: it answers each state of the plane, and an operator can stop the swarm."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from swarmabs_config.graph import CONTROLLER, RELEASE, options_of, services
from swarmabs_core.messages import PLANE_STATE
from swarmabs_core.realtime.base import CONTROLLER_PHASE
from swarmabs_core.realtime.controller import RealtimeController, RealtimeControllerConfig
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import RealtimeProgram

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings

PARAMETERS = (RealtimeControllerConfig,)
GAINS = ("controller",)


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:  # noqa: ARG001 - it does not use the node
    """Return the behaviour."""
    config = settings.declared(RealtimeControllerConfig)
    controller = RealtimeController(config, config.make_law)
    commands = (controller.stop, controller.reset, controller.voice.release)
    offered = dict(zip(services(CONTROLLER, options_of({"pair": config.pair.rank})), commands, strict=True))
    if config.pair.single:
        del offered[RELEASE]
    return RealtimeSpec(
        controller,
        CONTROLLER_PHASE,
        wakes=(PLANE_STATE,),
        services=offered,
        settled=lambda: controller.voice.settled,
        tune=lambda changed: controller.tuned(changed.declared(RealtimeControllerConfig).make_law),
    )


main = RealtimeProgram(CONTROLLER, PARAMETERS, make, GAINS)


if __name__ == "__main__":
    sys.exit(main())

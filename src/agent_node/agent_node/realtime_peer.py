"""Node ``agent_node`` in real time without coordinators: one robot with its drive, its observer and its controller."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from agent_node.realtime import drive_of
from swarmabs_config import realtime
from swarmabs_config.graph import PEER, SERVICES, options_of
from swarmabs_core.messages import PARENT, PLANE_STATE, relay_topic
from swarmabs_core.realtime.agent import RealtimeAgent, RealtimeAgentConfig
from swarmabs_core.realtime.base import AGENT_PHASE
from swarmabs_core.realtime.controller import RealtimeController, RealtimeControllerConfig
from swarmabs_core.realtime.observer import RealtimeObserver, RealtimeObserverConfig
from swarmabs_core.realtime.peer import RealtimePeer, RealtimePeerConfig
from swarmabs_core.realtime.seals import SealFiles
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import RealtimeProgram
from swarmabs_ros.sealed import seals_in
from swarmabs_ros.settings import RobotTopics

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_ros.runner import Settings

PARAMETERS = (
    RealtimePeerConfig,
    RealtimeAgentConfig,
    RealtimeObserverConfig,
    RealtimeControllerConfig,
    RobotTopics,
    SealFiles,
)
GAINS = ("gains", "law", "ksd", "controller")


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:
    """Return the behaviour, with its drive opened."""
    config, robot = settings.declared(RealtimePeerConfig), settings.declared(RealtimeAgentConfig)
    robot.refuse_contradictions()
    law, files = settings.declared(RealtimeControllerConfig), settings.declared(SealFiles)
    seals = seals_in(files, config.agent_id)
    observer = RealtimeObserver(settings.declared(RealtimeObserverConfig))
    controller = RealtimeController(law, law.make_law)
    agent = RealtimeAgent(robot, drive_of(robot, node))
    peer = RealtimePeer(config, observer, controller, agent, seals)

    def tuned(changed: Settings) -> Callable[[], None]:
        """Return a callable that installs the gains in all parts."""
        parts = (
            agent.tuned(changed.declared(RealtimeAgentConfig)),
            observer.tuned(changed.declared(RealtimeObserverConfig)),
            controller.tuned(changed.declared(RealtimeControllerConfig).make_law),
        )

        def install() -> None:
            for part in parts:
                part()

        return install

    return RealtimeSpec(
        peer,
        AGENT_PHASE,
        endpoints=realtime.peer_endpoints(
            config, options_of({"own_topics": settings.declared(RobotTopics).own_topics, "seal.key": files.key})
        ),
        wakes=(relay_topic(PARENT) if files.key else PLANE_STATE,) if config.senses else (),
        services=dict(zip(SERVICES[PEER], (peer.leave, peer.join, peer.stop, peer.reset), strict=True)),
        tune=tuned,
    )


main = RealtimeProgram(PEER, PARAMETERS, make, GAINS)


if __name__ == "__main__":
    sys.exit(main())

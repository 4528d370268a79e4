"""Node ``agent_node`` in real time: one robot with its drive."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from swarmabs_config.graph import ROBOT, SERVICES
from swarmabs_core.realtime.agent import RealtimeAgent, RealtimeAgentConfig
from swarmabs_core.realtime.base import AGENT_PHASE
from swarmabs_core.realtime.drives import DRIVES, Body
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import RealtimeProgram
from swarmabs_ros.settings import RobotTopics

if TYPE_CHECKING:
    from swarmabs_core.realtime.drives import Drive
    from swarmabs_core.realtime.instruments import TopicSettings
    from swarmabs_ros.runner import Settings

PARAMETERS = (RealtimeAgentConfig, RobotTopics)
GAINS = ("gains", "law")


def drive_of(config: RealtimeAgentConfig, node: RealtimeNode) -> Drive:
    """Return the configured drive, opened.

    Raises `InputError` if its settings contradict each other, or the package that provides it is unusable.
    """
    body = Body(
        agent_id=config.agent_id,
        kind=config.kind,
        schedule=config.schedule,
        mass=config.mass,
        damping=config.damping,
        gravity=config.gravity,
        limits=config.limits,
        position=config.position,
        velocity=config.velocity,
        connect=lambda settings, body: _topic_drive(settings, body, node),
    )
    return DRIVES.make(config.drive, config.drive_settings, body)


def _topic_drive(settings: TopicSettings, body: Body, node: RealtimeNode) -> Drive:
    from agent_node.topic_drive import (  # noqa: PLC0415 - loading its messages is slow, and not every robot needs them
        TopicDrive,
        TopicLink,
    )

    return TopicDrive(settings, body, lambda resolved: TopicLink(resolved, body.kind, node, node.loop_group))


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:
    """Return the behaviour, with its drive opened."""
    config = settings.declared(RealtimeAgentConfig)
    config.refuse_contradictions()
    agent = RealtimeAgent(config, drive_of(config, node))
    return RealtimeSpec(
        agent,
        AGENT_PHASE,
        services=dict(zip(SERVICES[ROBOT], (agent.leave, agent.join), strict=True)),
        tune=lambda changed: agent.tuned(changed.declared(RealtimeAgentConfig)),
    )


main = RealtimeProgram(ROBOT, PARAMETERS, make, GAINS)


if __name__ == "__main__":
    sys.exit(main())

"""Node ``agent_node``: one robot; the three broadcasts in, its own state out."""

from __future__ import annotations

import sys

from swarmabs_config.graph import ROBOT
from swarmabs_core import model
from swarmabs_core.behaviours import Agent
from swarmabs_core.models import AgentConfig, SystemAgentConfig
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.parameters import BySystem
from swarmabs_ros.runner import PACKED, STEERED, LockstepProgram, Settings
from swarmabs_ros.status import StatusChannel

CONFIG: BySystem[model.AgentConfig] = BySystem(AgentConfig, SystemAgentConfig)
PARAMETERS = (CONFIG, PACKED, STEERED)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour."""
    config = settings.chosen(CONFIG)
    config.refuse_contradictions()
    return NodeSpec(Agent(config, packed=settings.flag(PACKED.name), steered=settings.flag(STEERED.name)))


main = LockstepProgram(ROBOT, PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())

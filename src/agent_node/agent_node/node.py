"""Node ``agent_node``: one robot; the three broadcasts in, its own state out."""

from __future__ import annotations

import sys

from swarmabs_config.graph import ROBOT
from swarmabs_core import model
from swarmabs_core.behaviours import Agent
from swarmabs_core.models import AgentConfig, SystemAgentConfig
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.parameters import BySystem
from swarmabs_ros.runner import LockstepProgram, Settings
from swarmabs_ros.settings import Variant
from swarmabs_ros.status import StatusChannel

CONFIG: BySystem[model.AgentConfig] = BySystem(AgentConfig, SystemAgentConfig)
PARAMETERS = (CONFIG, Variant)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour."""
    config, variant = settings.chosen(CONFIG), settings.declared(Variant)
    config.refuse_contradictions()
    return NodeSpec(Agent(config, packed=variant.packed, steered=variant.steered))


main = LockstepProgram(ROBOT, PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())

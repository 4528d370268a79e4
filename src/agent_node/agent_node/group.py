"""Node ``agents_...``: several robots in one process, for large simulations."""

from __future__ import annotations

import sys
from pathlib import Path

from swarmabs_config import configure
from swarmabs_config.graph import LOCKSTEP, ROBOT, Option
from swarmabs_config.scenario import load_scenario
from swarmabs_core.behaviours import AgentGroup
from swarmabs_core.errors import InputError
from swarmabs_core.messages import PLANE_STATE
from swarmabs_core.parameters import Parameter
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.runner import PACKED, STEERED, LockstepProgram, Settings
from swarmabs_ros.status import StatusChannel

PARAMETERS = (
    Parameter("scenario_file", "", "file of the resolved scenario"),
    Parameter("agent_ids", (1,), "ids of the robots in this process", minimum=1, maximum=65535),
    PACKED,
    STEERED,
)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return behaviour and endpoints; reject ids that are not in the scenario."""
    if not settings.text("scenario_file"):
        raise InputError("parameter scenario_file: give the file of the resolved scenario")
    scenario = load_scenario(Path(settings.text("scenario_file")))
    configs = {config.agent_id: config for config in configure.agent_configs(scenario)}
    missing = [agent_id for agent_id in settings.integers("agent_ids") if agent_id not in configs]
    if missing:
        raise InputError(f"parameter agent_ids: the scenario has no robot {missing[0]}")
    group = AgentGroup(
        [configs[agent_id] for agent_id in settings.integers("agent_ids")],
        packed=settings.flag(PACKED.name),
        steered=settings.flag(STEERED.name),
    )
    feeling = (Option.FEELING,) if PLANE_STATE in group.needs else ()
    return NodeSpec(group, settings.endpoints(ROBOT, LOCKSTEP, *feeling, *configure.options_for(scenario)))


main = LockstepProgram("agent_group", PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())

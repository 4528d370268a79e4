"""Node ``agents_...``: several robots in one process, for large simulations."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from swarmabs_config import configure
from swarmabs_config.graph import LOCKSTEP, ROBOT, Option
from swarmabs_config.scenario import Scenario
from swarmabs_core.behaviours import Agent, AgentGroup, Patience, PeerGroup, Steered
from swarmabs_core.declaration import setting
from swarmabs_core.errors import InputError
from swarmabs_core.messages import PLANE_STATE, Message, Messages
from swarmabs_ros.lockstep import NodeSpec, silence_limit
from swarmabs_ros.runner import LockstepProgram, Settings
from swarmabs_ros.scenario_file import ScenarioFile
from swarmabs_ros.settings import Variant
from swarmabs_ros.status import StatusChannel


@dataclass(frozen=True, slots=True)
class GroupConfig(ScenarioFile):
    """Configuration of the robots in one process."""

    agent_ids: tuple[int, ...] = setting((1,), "ids of the robots in this process", minimum=1, maximum=65535)


PARAMETERS = (GroupConfig, Variant)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return behaviour and endpoints; reject ids that are not in the scenario."""
    hosted, variant = settings.declared(GroupConfig), settings.declared(Variant)
    scenario = hosted.load()
    if strangers := sorted({*hosted.agent_ids} - {*configure.members(scenario)}):
        raise InputError(f"parameter agent_ids: the scenario has no robot {strangers[0]}")
    also = configure.options_for(scenario)
    if scenario.decentralised:
        return peers(scenario, hosted.agent_ids, steered=variant.steered)
    group = AgentGroup(
        [
            Agent(config, packed=variant.packed, steered=variant.steered)
            for config in configure.agent_configs(scenario)
            if config.agent_id in hosted.agent_ids
        ]
    )
    feeling = (Option.FEELING,) if PLANE_STATE in group.needs else ()
    return NodeSpec(group, settings.endpoints(ROBOT, LOCKSTEP, *feeling, *also))


def peers(scenario: Scenario, ids: tuple[int, ...], *, steered: bool) -> NodeSpec:
    """Return robots that coordinate the swarm by themselves, and, if they may, drop silent ones."""
    robots, ends = (
        configure.peers(scenario, ids, steered=steered),
        configure.peer_endpoints(scenario, ids, steered=steered),
    )
    group = PeerGroup(robots)
    gate = Steered(group, ends=True, last_step=scenario.steps) if steered else None
    if scenario.lockstep.on_stall != "drop":
        return NodeSpec(gate or group, ends)
    limit = silence_limit(scenario.lockstep.stall_timeout)
    watches = [Patience(robot, limit) for robot in robots]

    def look(now: float) -> Messages:
        published: list[Message] = []
        for watch in watches:
            if gate is not None and not gate.open:  # the node waits for an order, and listens to no robot
                watch.start_over(now)
            else:
                published += watch.look(now)
        return tuple(published)

    return NodeSpec(gate or group, ends, on_idle=look)


main = LockstepProgram("agent_group", PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())

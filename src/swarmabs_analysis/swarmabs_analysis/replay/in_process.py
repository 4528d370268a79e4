"""A recorded run again, with some of its nodes computed anew: in this process, without ROS."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from swarmabs_analysis.replay.player import Player
from swarmabs_config import configure
from swarmabs_core.behaviours import LifeSpan, Observer
from swarmabs_core.membership import SILENT, ChangeKind
from swarmabs_core.messages import EventKind, SwarmEvent
from swarmabs_core.publishers import NodeKind, NodeName
from swarmabs_run.simulation import NodeInProcess, Simulation, nodes_in_process, robot_in_process

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from swarmabs_bag.recording import RecordedStep
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.membership import Change
    from swarmabs_core.messages import Message, Messages


def silent_since(message: Message) -> tuple[int, int] | None:
    """Return robot and first step without it, if the message says that a robot was dropped; else None."""
    if isinstance(message, SwarmEvent) and message.kind == EventKind.DEAD and message.detail == SILENT:
        return message.agent_id, message.step
    return None


class Replay:
    """A player and the nodes under test, connected by a queue.

    Parameters
    ----------
    scenario : Scenario
        With which settings the nodes under test are made.
    live : collection of NodeName
        The nodes under test; they hear each other.
    recorded : iterator of RecordedStep
        The recorded run, in order, at least up to the scenario's last step.
    ends : iterable of Change
        Ends of robots in the recording that its scenario had not planned.
    """

    def __init__(
        self,
        scenario: Scenario,
        live: Collection[NodeName],
        recorded: Iterator[RecordedStep],
        ends: Iterable[Change] = (),
    ) -> None:
        unplanned = tuple(ends)
        self._silent = {change.agent_id: change.step + 1 for change in unplanned}
        player = Player(recorded, live, last_step=scenario.steps)
        nodes = nodes_in_process(scenario)
        for config in configure.agent_configs(scenario):
            if config.agent_id in self._silent:
                life = LifeSpan(config.life.first_step, ChangeKind.KILL, self._silent[config.agent_id] - 1)
                nodes[NodeName(NodeKind.AGENT, config.agent_id)] = robot_in_process(replace(config, life=life))
        tested = [nodes[name] for name in sorted(live)]
        self._observer = next((node.behaviour for node in tested if isinstance(node.behaviour, Observer)), None)
        self._simulation = Simulation(scenario, (NodeInProcess(player, player.hears), *tested), unplanned)

    def steps(self) -> Iterator[RecordedStep]:
        """Replay, and yield every step as a bag would hold it.

        Raises
        ------
        RunError
            If a node under test fails, or does not answer.
        """
        return self._simulation.steps(self._drop_silent, "replay")

    def _drop_silent(self) -> Messages:
        """Let the observer drop the robots that it dropped when the run was recorded."""
        if self._observer is None:
            return ()
        step, _ = self._observer.missing()
        agents = self._observer.missing_agents()
        silent = bool(agents) and all(self._silent.get(agent_id) == step for agent_id in agents)
        return self._observer.drop(agents, SILENT) if silent else ()

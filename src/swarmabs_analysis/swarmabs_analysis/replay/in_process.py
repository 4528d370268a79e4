"""A recorded run again, with some of its nodes computed anew: in this process, without ROS."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from swarmabs_analysis.replay.player import Player
from swarmabs_bag.recording import RunCollector
from swarmabs_config import configure
from swarmabs_core.behaviours import Controller, LifeSpan, Observer, Plane, make_agent
from swarmabs_core.errors import RunError
from swarmabs_core.membership import SILENT, ChangeKind, with_ends
from swarmabs_core.messages import AGENT_STATE, EVENTS, PLANE_STATE, TOPIC_OF, EventKind, SwarmEvent
from swarmabs_core.publishers import NodeKind, NodeName
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from swarmabs_bag.recording import RecordedStep
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.behaviours import Behaviour
    from swarmabs_core.membership import Change
    from swarmabs_core.messages import Message, Topic


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
        self._player = Player(recorded, live, last_step=scenario.steps)
        self._observer: Observer | None = None
        self._nodes: list[tuple[Behaviour, frozenset[Topic]]] = [(self._player, frozenset(self._player.hears))]
        for name in sorted(live):
            behaviour, hears = self._make(scenario, name)
            self._nodes.append((behaviour, frozenset(hears)))
        self._collector = RunCollector(
            configure.members(scenario), with_ends(configure.schedule(scenario), unplanned), scenario.steps, memory=2
        )

    def _make(self, scenario: Scenario, name: NodeName) -> tuple[Behaviour, tuple[Topic, ...]]:
        """Return the state machine of a node and the topics that it hears."""
        if name.kind is NodeKind.PLANE:
            return Plane(configure.plane_config(scenario)), (AGENT_STATE, EVENTS)
        if name.kind is NodeKind.CONTROLLER:
            config = configure.controller_config(scenario, recording_window=0)
            return Controller(config, configure.parent_controller(scenario)), (PLANE_STATE,)
        if name.kind is NodeKind.OBSERVER:
            watching = configure.observer_config(scenario)
            self._observer = Observer(watching)
            return self._observer, (AGENT_STATE,) if watching.parent_model is None else (AGENT_STATE, PLANE_STATE)
        robot = next(config for config in configure.agent_configs(scenario) if config.agent_id == name.agent_id)
        if name.agent_id in self._silent:
            last = self._silent[name.agent_id] - 1
            robot = replace(robot, life=LifeSpan(robot.life.first_step, ChangeKind.KILL, last))
        agent = make_agent(robot)
        return agent, agent.needs

    def steps(self) -> Iterator[RecordedStep]:
        """Replay, and yield every step as a bag would hold it.

        Raises
        ------
        RunError
            If a node under test fails, or does not answer.
        """
        queue: deque[Message] = deque()
        for behaviour, _ in self._nodes:
            queue.extend(behaviour.start())
        while True:
            while queue:
                message = queue.popleft()
                yield from self._collector.add(Record.of(message))
                topic = TOPIC_OF[type(message)]
                for behaviour, hears in self._nodes:
                    if topic in hears:
                        queue.extend(behaviour.handle(message))
            queue.extend(self._drop_silent())
            if not queue:
                break
        if not self._collector.finished:
            missing = ", ".join(self._collector.missing())
            raise RunError(f"the replay stalls at step {self._collector.step}; missing: {missing}")

    def _drop_silent(self) -> Iterable[Message]:
        """Let the observer drop the robots that it dropped when the run was recorded."""
        if self._observer is None:
            return ()
        step, _ = self._observer.missing()
        agents = self._observer.missing_agents()
        silent = bool(agents) and all(self._silent.get(agent_id) == step for agent_id in agents)
        return self._observer.drop(agents, SILENT) if silent else ()

"""A replay from a bag to a new bag, with the nodes under test as processes over DDS or in this process without ROS."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.comparison.messages import compare_steps
from swarmabs_analysis.replay.player import Player, answered, played
from swarmabs_analysis.replay.source import complete_steps
from swarmabs_bag.reader import open_bag
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.run.digest import Digest
from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.graph import CONTROLLER, OBSERVER, RECORDER, agent_name
from swarmabs_core.behaviours import LifeSpan, Observer
from swarmabs_core.membership import SILENT, ChangeKind
from swarmabs_core.messages import EVENTS, RECORDING_PROGRESS, STANDING
from swarmabs_core.publishers import NodeKind, NodeName, publisher_of
from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.orchestration.plan import ProcessPlan, expect_counterparts
from swarmabs_run.run import RunOptions
from swarmabs_run.simulated_run import record_steps
from swarmabs_run.simulation import NodeInProcess, Simulation, nodes_in_process, robot_in_process

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

    from swarmabs_analysis.replay.source import ReplaySource
    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import AnyScenario
    from swarmabs_core.membership import Change
    from swarmabs_core.messages import Messages, Topic
    from swarmabs_run.run import Outcome, Progress

PLAYER = "replay_player"
_PROCESSES = {NodeKind.OBSERVER: OBSERVER, NodeKind.CONTROLLER: CONTROLLER}


@dataclass(frozen=True, slots=True)
class ReplayRun:
    """A planned replay.

    `nodes` are the nodes under test; `overrides`, ``a.b=value`` each, are the changes that `scenario` includes.
    """

    source: ReplaySource
    nodes: tuple[NodeName, ...]
    overrides: tuple[str, ...]
    scenario: Any

    @property
    def _ends(self) -> tuple[Change, ...]:
        return tuple(change for change in self.source.ends if change.step <= self.scenario.steps)

    def provenance(self) -> dict[str, object]:
        """Return the description of the replay for the new bag."""
        return {
            "of": self.source.digest,
            "nodes": [str(node) for node in self.nodes],
            "overrides": list(self.overrides),
        }

    def in_process(self, folder: RunFolder, on_progress: Callable[[Progress], None] | None = None) -> Outcome:
        """Replay in this process, as fast as possible, into an empty folder."""
        folder.fill(self.scenario)
        recording = Recording(
            self.scenario,
            folder.bag,
            driver="simulate",
            namespace=self.source.namespace,
            replay=self.provenance(),
            division=self.source.division,
        )
        recorded = self.source.steps(self.scenario)
        steps = replayed_steps(self.scenario, self.nodes, recorded, self._ends, self.source.division)
        return record_steps(steps, self.scenario, recording, on_progress=on_progress)

    def live(self, folder: RunFolder, on_progress: Callable[[Progress], None] | None = None) -> Outcome:
        """Replay over DDS with the nodes under test as processes; parameters as for `in_process`."""
        options = RunOptions(on_progress=on_progress, namespace=self.source.namespace, packed=False)
        return LockstepRun(self.scenario, folder, options, self.plan).run()

    def plan(self, processes: Sequence[ProcessPlan]) -> tuple[ProcessPlan, ...]:
        """Return the processes of the replay, from those of a run: nodes under test, recorder, and player."""
        by_name = {process.name: process for process in processes}
        recorder = by_name[RECORDER]
        shared = ("period_ns", "last_step", "stall_timeout", "repeat_after", "repeat_steps")
        player = ProcessPlan(
            PLAYER,
            "swarmabs_analysis.replay.node",
            1 + max(process.participant for process in processes),
            {name: recorder.parameters[name] for name in shared}
            | {
                "bag": str(self.source.bag.path.resolve()),
                "nodes": tuple(map(str, self.nodes)),
                "window": configure.recording_window(self.scenario),
                "ends": tuple(map(str, self.source.ends)),
                "overrides": self.overrides,
            },
            played(self.nodes, self.scenario.family),
            (*answered(self.nodes, self.scenario.family), RECORDING_PROGRESS),
        )
        told = {
            "replay": json.dumps(self.provenance()),
            "ends": tuple(map(str, self._ends)),
            "division": self.source.division,
        }
        names = {**_PROCESSES, NodeKind.PARENT: self.scenario.family.node}
        tested = [
            by_name[agent_name(node.agent_id) if node.kind is NodeKind.AGENT else names[node.kind]]
            for node in self.nodes
        ]
        if not self.source.division:
            tested = [_without(STANDING, process) for process in tested]
        for process in tested:
            if "division" in process.parameters:  # that of the recorded nodes
                process.parameters["division"] = self.source.division
            for change in self.source.ends:
                if change.agent_id in process.agents:  # nothing stops it now: it must fall silent by itself
                    process.parameters.update(end=change.kind.value, end_step=change.step)
        planned = (player, *tested, replace(recorder, parameters=recorder.parameters | told))
        expect_counterparts(planned)
        return planned

    def result(self, folder: RunFolder, digest: str | None) -> dict[str, Any]:
        """Return the differences between the replay in a folder, with its digest, and the recording."""
        recorded = Digest()
        replayed = complete_steps(open_bag(folder.path), self.scenario, self._ends, self.source.recorded)
        found = compare_steps(self._answers(self._recorded(recorded)), self._answers(replayed))
        first = None
        if found.first is not None:
            first = found.first.to_dict("recorded", "replayed") | {"agent": found.first.agent or 0}
            del first["reason"]  # a replay has none
        return {
            **self.provenance(),
            "same": digest == recorded.hexdigest(),
            "compared": sum(topic.compared for topic in found.topics),
            "first_difference": first,
            "deviations": [{"topic": topic.topic, **asdict(field)} for topic in found.topics for field in topic.fields],
        }

    def _answers(self, steps: Iterable[Step]) -> Iterator[Step]:
        """Yield the messages of the nodes under test, without events."""
        live = frozenset(self.nodes)
        for step in steps:
            answers = tuple(r for r in step.records if r.topic is not EVENTS and publisher_of(r.message) in live)
            if answers:
                yield Step.of(step.step, answers)

    def _recorded(self, digest: Digest) -> Iterator[Step]:
        """Yield the recorded steps that are replayed, and update the digest."""
        last = -1
        for step in self.source.steps():
            if step.step > self.scenario.steps:
                return
            if step.step > last:  # otherwise a late event
                last = step.step
                digest.update(step)
            yield step


def _without(topic: Topic, process: ProcessPlan) -> ProcessPlan:
    """Return a process that waits for no counterpart on a topic."""
    publications, subscriptions = (
        tuple(each for each in topics if each is not topic) for topics in (process.publications, process.subscriptions)
    )
    return replace(process, publications=publications, subscriptions=subscriptions)


def replayed_steps(
    scenario: AnyScenario,
    live: Collection[NodeName],
    recorded: Iterator[Step],
    ends: Collection[Change] = (),
    division: int | None = None,
) -> Iterator[Step]:
    """Connect a player and the nodes under test by a queue, and yield every step as recorded in a bag.

    The recorded run must be in order and include the scenario's last step; `ends` are the unplanned ends of its robots,
    and `division` is as for `nodes_in_process`. The nodes under test are configured by this scenario, and receive each
    other's messages.

    Raises
    ------
    RunError
        If a node under test fails, or does not answer.
    """
    silent = {change.agent_id: change.step + 1 for change in ends}
    player = Player(recorded, live, last_step=scenario.steps, family=scenario.family)
    nodes = nodes_in_process(scenario, division)
    for config in configure.agent_configs(scenario):
        if config.agent_id in silent:
            life = LifeSpan(config.life.first_step, ChangeKind.KILL, silent[config.agent_id] - 1)
            nodes[NodeName(NodeKind.AGENT, config.agent_id)] = robot_in_process(replace(config, life=life))
    tested = [nodes[name] for name in sorted(live)]
    observer = next((node.behaviour for node in tested if isinstance(node.behaviour, Observer)), None)

    def drop_silent() -> Messages:
        """Let the observer drop the robots that it dropped during the recording."""
        if observer is None:
            return ()
        step, _ = observer.missing()
        agents = observer.missing_agents()
        again = bool(agents) and all(silent.get(agent_id) == step for agent_id in agents)
        return observer.drop(agents, SILENT) if again else ()

    simulation = Simulation(scenario, (NodeInProcess(player, player.hears), *tested), ends, division)
    return simulation.steps(drop_silent, "replay")

"""A recorded run as a source of messages: scenario, complete steps, and unplanned ends of robots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from swarmabs_bag.attached import attached_scenario, is_realtime
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.run.digest import Digest
from swarmabs_bag.run.gatherer import RunCollector
from swarmabs_bag.run.metadata import dump_yaml
from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.membership import SILENT, Change, ChangeKind, with_ends
from swarmabs_core.messages import EVENTS, STANDING, EventKind, SwarmEvent, SystemDescription
from swarmabs_core.publishers import NodeKind
from swarmabs_core.record import Record
from swarmabs_core.systems import SystemTables

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from pathlib import Path

    from swarmabs_config.scenario import AnyScenario
    from swarmabs_core.messages import Message
    from swarmabs_core.publishers import NodeName
    from swarmabs_core.systems.interface import NamedSystem

WINDOW = 1000
"""Most steps kept in memory while an earlier one is incomplete."""


@dataclass(frozen=True, slots=True)
class ReplaySource:
    """A bag that can be replayed, created by `open_source`.

    `digest` is that of the complete steps, up to `last_step`; `ends` are the ends of robots not planned by the scenario
    `recorded`; `robots` have a recorded state.
    """

    bag: BagReader
    recorded: AnyScenario
    digest: str
    last_step: int
    ends: tuple[Change, ...]
    robots: frozenset[int]

    @property
    def namespace(self) -> str:
        """Namespace of the recorded swarm."""
        return (self.bag.namespace or "/").rstrip("/") or "/"

    @property
    def division(self) -> int:
        """For how many steps from a change on the recorded observer tells how the abstract state divides."""
        return _division(self.bag, self.recorded)

    def steps(self, played: AnyScenario | None = None) -> Iterator[Step]:
        """Yield the complete steps in order, for a scenario; an event that was recorded late is yielded late too."""
        return complete_steps(self.bag, self.recorded, self.ends, played)

    def scenario(self, nodes: Collection[NodeName], overrides: Sequence[str]) -> AnyScenario:
        """Return the scenario of a replay: the recorded one with changes, up to the last complete step.

        Raises
        ------
        InputError
            If a node under test has no recorded messages, or a change contradicts the recording.
        """
        for node in nodes:
            if node.kind is NodeKind.AGENT and node.agent_id not in self.robots:
                ids = ", ".join(map(str, sorted(self.robots)[:20])) + (" ..." if len(self.robots) > 20 else "")
                raise InputError(
                    f"--node {node}: the bag has no states of robot {node.agent_id}; it has those of {ids}"
                )
        changed = attached_scenario(self.bag, overrides).resolved()
        for what, of in (
            ("control period", lambda scenario: scenario.step_ns),
            ("robots", configure.members),
            ("faults that end robots or let them join", configure.schedule),
            ("reaction to silent robots", lambda scenario: scenario.lockstep.on_stall),
            ("quantities of the parent system", _quantities),
        ):
            if of(changed) != of(self.recorded):
                raise InputError(
                    f"--set changes the {what}, but the messages of the other nodes are recorded; use run instead"
                )
        return _shortened(changed, min(self.last_step, changed.steps))


def open_source(path: Path, *, namespace: str | None = None) -> ReplaySource:
    """Open the bag of a swarm and read it once, to find the complete steps and the unplanned ends of robots.

    Raises
    ------
    InputError
        If it is not the bag of a run in lockstep.
    DamagedBagError
        If the end of the bag is missing.
    """
    bag = open_bag(path, namespace=namespace)
    if is_realtime(bag):
        raise InputError(
            f"{bag.path} was recorded in real time, so the times at which a node received messages cannot be "
            "reproduced; use verify to recompute its answers, or leave out --node to play the bag"
        )
    family = bag.family
    missing = [topic.name for topic in (*family.main, *family.once) if topic not in bag.topics()]
    if missing:
        raise InputError(f"{bag.path} has no topic {missing[0]}, which re-execution needs; leave out --node")
    scenario = attached_scenario(bag).resolved()
    members = frozenset(configure.members(scenario))
    ends: list[Change] = []
    robots: set[int] = set()
    digest, last = Digest(), -1
    for step in complete_steps(bag, scenario):
        if step.step > last:
            last = step.step
            digest.update(step)
        for record in step.records:
            end = unplanned_end(record.message)
            if end is not None:
                if end.agent_id not in members:
                    raise InputError(f"{bag.path}: robot {end.agent_id} fell silent, but the scenario lacks it")
                ends.append(end)
            elif record.topic is family.robot:
                robots.add(record.agent_id)
    if last < 1:
        raise InputError(f"{bag.path} has {last + 1} complete steps, too few for a replay")
    return ReplaySource(bag, scenario, digest.hexdigest(), last, tuple(ends), frozenset(robots))


def unplanned_end(message: Message) -> Change | None:
    """Return the end of a robot if the message announces that it was dropped as silent."""
    if isinstance(message, SwarmEvent) and message.kind == EventKind.DEAD and message.detail == SILENT:
        return Change(message.step - 1, message.agent_id, ChangeKind.KILL)
    return None


def complete_steps(
    bag: BagReader, scenario: AnyScenario, ends: Collection[Change] = (), played: AnyScenario | None = None
) -> Iterator[Step]:
    """Yield the complete steps of a bag in order, up to one that lacks a message for the next `WINDOW` steps.

    The scenario defines whose states a complete step has; `ends` are the unplanned ends known in advance. Messages
    refer to the parent system of this scenario or of the `played` one, whose settings may differ from those in the bag.
    """
    schedule = with_ends(configure.schedule(scenario), ends)
    family, system = scenario.family, getattr(played or scenario, "named", None)
    topics = (*family.once, *family.main, STANDING, EVENTS)
    division = _division(bag, scenario)
    collector = RunCollector(configure.members(scenario), schedule, scenario.steps, division=division, family=family)
    held: Step | None = None  # the events of a step follow its other messages
    waiting = 0
    for record in bag.records(topics):
        complete = collector.add(_of_system(record, system))
        waiting = 0 if complete else waiting + 1
        if waiting > WINDOW * (len(scenario.agents) + len(family.main)):
            break
        for step in (single for steps in complete for single in steps.singly()):
            if held is not None and step.step == held.step:
                held = Step(held.first, held.tables, tuple(sorted(held.told + step.told)))
            elif held is not None and step.step < held.step:
                yield step  # an event that was recorded late
            else:
                if held is not None:
                    yield held
                held = step
    if held is not None:
        yield held


def _division(bag: BagReader, scenario: AnyScenario) -> int:
    """Return for how many steps from a change on the observer tells how the abstract state divides; earlier, for 0."""
    return configure.division(scenario) if STANDING in bag.topics() else 0


def _of_system(record: Record, system: NamedSystem | None) -> Record:
    """Return the record of a message as if it referred to a parent system."""
    message: Any = record.message
    if system is None or getattr(message, "system", system.hash) == system.hash:
        return record
    also = {"description": system.description} if isinstance(message, SystemDescription) else {}
    return Record.of(message._replace(system=system.hash, **also))


def _quantities(scenario: Any) -> object:
    """Return names and units in the messages of a scenario's parent system, None for the plane."""
    system = getattr(scenario, "named", None)
    return system and SystemTables.read(system.description)._replace(settings={})


def _shortened(scenario: AnyScenario, last_step: int) -> AnyScenario:
    """Return the scenario of the first steps of a run, without later faults and robots."""
    if last_step == scenario.steps:
        return scenario
    later = {
        change.agent_id
        for change in configure.schedule(scenario)
        if change.step > last_step and change.kind is ChangeKind.JOIN
    }
    text = scenario.model_dump(mode="json", by_alias=True)
    text["duration"] = last_step * scenario.step_ns / 1e9
    text["swarm"]["agents"] = [agent for agent in text["swarm"]["agents"] if agent["id"] not in later]
    text["faults"] = [
        _of_those_left(fault, later)
        for fault in text["faults"]
        if scenario.fault_step(fault.get("at", fault.get("from"))) <= last_step
        and fault.get("agent") not in later
        and not (fault.get("agents") and later.issuperset(fault["agents"]))
    ]
    return parse_scenario(dump_yaml(text), source="scenario of the replay").resolved()  # type: ignore[no-any-return]


def _of_those_left(fault: dict[str, Any], later: Collection[int]) -> dict[str, Any]:
    """Return a fault without the robots that join later."""
    if not fault.get("agents"):
        return fault
    return fault | {"agents": [agent for agent in fault["agents"] if agent not in later]}

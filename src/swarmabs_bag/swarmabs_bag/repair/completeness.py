"""Which messages a bag lacks: all of a run in lockstep are known, in real time those that other messages name."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_bag.attached import attached_scenario, is_realtime
from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair.spans import Spans
from swarmabs_bag.run.realtime_gatherer import MEMORY
from swarmabs_config import configure
from swarmabs_config.graph import usual_topic
from swarmabs_core.errors import InputError, MalformedMessageError
from swarmabs_core.membership import Membership, Span
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BASIS,
    BROADCASTS,
    DESIRED_ABSTRACT_STATE,
    PLANE_STATE,
    ROBOT_STATES,
    STANDING,
    AbstractState,
    AgentState,
    AuxiliaryState,
    Basis,
    DesiredAbstractState,
    Mode,
    PlaneState,
    Relay,
    Source,
    Status,
    SwarmEvent,
    Topic,
    relay_topic,
)
from swarmabs_core.realtime.relayed import read
from swarmabs_core.relays import Content, StepRelays

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from swarmabs_bag.realtime_world import RealtimeWorld
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Family, Message
    from swarmabs_core.record import Record

    Place = tuple[Topic, int]  # with the robot or source of a message on the topic, else 0

_SETTLED = 100
"""Steps that are judged together."""
_ANSWERS: dict[int, tuple[Topic, ...]] = {
    Source.OBSERVER: (ABSTRACT_STATE, AUXILIARY_STATE),
    Source.PLANE: (PLANE_STATE,),
    Source.CONTROLLER: (DESIRED_ABSTRACT_STATE,),
}
"""What a node publishes together with its provenance."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Messages that a bag lacks: topic without namespace, None for every topic; robots, if any; first and last step."""

    topic: str | None
    robots: tuple[int, ...]
    first: int
    last: int


def _gaps(missing: Iterable[tuple[Topic, int, tuple[int, int]]]) -> list[Gap]:
    """Return gaps from topic, robot (0: none) and span, those of several robots together."""
    robots_by_gap: dict[tuple[int, int, str], list[int]] = {}
    for topic, robot, (first, last) in missing:
        robots_by_gap.setdefault((first, last, topic.name), []).append(robot)
    return [
        Gap(name, tuple(sorted(robot for robot in robots if robot)), first, last)
        for (first, last, name), robots in sorted(robots_by_gap.items())
    ]


class LockstepCompleteness:
    """The messages of a run in lockstep that a bag holds, of which every step has each once."""

    def __init__(self, scenario: Scenario, family: Family) -> None:
        self._planned = scenario.steps
        self._family = family
        self._members = configure.members(scenario)
        self._membership = Membership(self._members, configure.schedule(scenario))
        self._found: dict[Place, Spans] = {}
        self._content = Content(self._members, family)
        self._relays: dict[tuple[int, int], StepRelays[None]] = {}

    def add(self, topic: Topic, message: Message) -> None:
        """Add a message of the bag."""
        if isinstance(message, Relay):
            self._add_relay(topic, message)
            return
        if isinstance(message, SwarmEvent):
            self._membership.apply(message.kind, message.agent_id, message.step, message.detail)
            return
        agent = message.agent_id if isinstance(message, ROBOT_STATES) else 0
        self._spans(topic, agent).add(message.step)
        if agent and agent in self._membership and getattr(message, "status", None) == Status.LEFT:
            self._membership.end(agent, message.step, stays=False, reason="left")

    def _add_relay(self, topic: Topic, relay: Relay) -> None:
        """Add a relay; a step has those of a robot once they are whole."""
        place = relay.agent_id, relay.step
        of_robot = self._relays.setdefault(place, StepRelays(self._content))
        of_robot.put(relay, None)
        spans = self._spans(topic, 0)
        if not of_robot.lacking((relay.agent_id,)):
            spans.add(relay.step)
            del self._relays[place]

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The topics with messages in every step; a bag of an earlier version may lack further ones."""
        family = self._family
        main = tuple(topic for topic in family.stepwise if topic not in family.further or (topic, 0) in self._found)
        relayed = any(topic.message is Relay for topic, _ in self._found)
        return (*main, *map(relay_topic, self._members if relayed else ()))

    def _spans(self, topic: Topic, agent: int) -> Spans:
        return self._found.setdefault((topic, agent), Spans())

    def _expected(self, topic: Topic) -> Iterator[tuple[int, int, int]]:
        """Yield each robot of a topic (0: none) with the first and last step in which it publishes."""
        for agent in self._members if topic is self._family.robot else (0,):
            robot = agent or topic.agent_id
            span = self._membership.span(robot) if robot else Span()
            first = span.first if agent else 0  # a robot passes on messages before it joins
            last = self._planned if span.last is None else min(span.last, self._planned)
            if robot and not agent and self._membership.is_dropped(robot):  # it may have ended before its last relay
                last = min(last, self._spans(topic, 0).last)
            yield agent, first, last

    @property
    def first(self) -> int:
        """The first complete step."""
        robot = self._family.robot
        partial = {robot, STANDING}  # not of all steps
        first = max((spans.first for (topic, _), spans in self._found.items() if topic not in partial), default=0)
        # The file may begin within a step, which then does not count as the first.
        begun = self.first_missing(robot, first) == first and self.first_missing(robot, first + 1) > first + 1
        return first + begun

    def first_missing(self, topic: Topic, start: int) -> int:
        """Return the first step from `start` on that lacks a message on a topic, after the last one if none does."""
        missing = []
        for agent, first, last in self._expected(topic):
            step = self._spans(topic, agent).first_missing(max(first, start))
            missing.append(step if step <= last else self._planned + 1)
        return min(missing)

    @property
    def last(self) -> int:
        """The last step of which there is a message, -1 without any."""
        partial = (step for _, step in self._relays)
        return max((*(spans.last for spans in self._found.values()), *partial), default=-1)

    def gaps(self, last: int) -> list[Gap]:
        """Return the messages that are missing up to a step."""
        once = ((topic, 0, gap) for topic in self._family.once for gap in self._spans(topic, 0).missing(0, 0))
        stepwise = (
            (topic, agent, gap)
            for topic in self.topics
            for agent, begin, end in self._expected(topic)
            for gap in self._spans(topic, agent).missing(begin, min(end, last))
        )
        return _gaps((*once, *stepwise))


class RealtimeCompleteness:
    """The messages that a bag in real time lacks although they are known to have been sent.

    A robot's state names the broadcasts behind it, a coordinator's provenance the robots' states, or the division
    of the abstract state, behind its answer, and the answer and its provenance are published together. Steps without
    any message between others are a gap too. A relay in real time names the states that its sender has summed up, and
    each of its own states comes with a relay. What was sent before the first message of its kind was recorded, or
    arrived later than the recorder takes it, is not.
    """

    def __init__(self, world: RealtimeWorld, relaying: Sequence[int] = ()) -> None:
        self._schedule = world.schedule
        self._relaying = tuple(relaying)
        self._simulated_plane = world.plane
        self._there: dict[int, set[Place]] = {}
        self._named: dict[int, set[Place]] = {}
        self._begun: dict[Place, int] = {}
        self._missing: dict[Place, Spans] = {}
        self._silent: list[Gap] = []
        self._judged: int | None = None
        self._latest: int | None = None

    def add(self, record: Record, now: int) -> None:
        """Add a message that was received at a time (ns since 1970)."""
        message = record.message
        if isinstance(message, SwarmEvent):
            return
        step = message.step
        agent = message.source if isinstance(message, Basis) else record.agent_id
        place = (record.topic, 0) if isinstance(message, Relay) else (usual_topic(record.topic), agent)
        self._there.setdefault(step, set()).add(place)
        self._begun[place] = min(step, self._begun.get(place, step))
        end = self._schedule.step(now) - MEMORY
        judged = self._judged = end if self._judged is None else self._judged
        for named, other in self._names(message):
            if judged <= named <= step:
                self._named.setdefault(named, set()).add(other)
        if end >= judged + _SETTLED:
            self._judge(end)

    def _names(self, message: Message) -> Iterator[tuple[int, Place]]:
        """Yield step and place of the messages that a message proves to have been sent."""
        if self._relaying and not isinstance(message, (PlaneState, Basis)):
            yield from self._relayed(message)
        elif isinstance(message, AgentState):
            yield from ((message.broadcast_step, (topic, 0)) for topic in BROADCASTS)
        elif isinstance(message, Basis):
            yield from ((message.step, (topic, 0)) for topic in _ANSWERS.get(message.source, ()))
            for agent, step in zip(message.agent_ids, message.state_steps, strict=False):
                yield step, (AGENT_STATE if agent else STANDING, agent)
        elif isinstance(message, (AbstractState, AuxiliaryState)):
            yield message.step, (BASIS, Source.OBSERVER)
            yield from ((message.step, (topic, 0)) for topic in _ANSWERS[Source.OBSERVER])
        elif isinstance(message, PlaneState) and self._simulated_plane:
            yield message.step, (BASIS, Source.PLANE)
        elif isinstance(message, DesiredAbstractState) and message.mode == Mode.RUN:
            yield message.step, (BASIS, Source.CONTROLLER)

    def _relayed(self, message: Message) -> Iterator[tuple[int, Place]]:
        """Yield what `_names` does of a message of a robot that computes the broadcasts by itself."""
        if isinstance(message, AgentState):
            yield message.step, (relay_topic(message.agent_id), 0)
        elif isinstance(message, Relay):
            with suppress(MalformedMessageError):
                told = read(message, len(self._relaying))
                for answer in told.answers:
                    yield from (
                        (step, (AGENT_STATE, self._relaying[rank])) for rank, step in (answer.states or {}).items()
                    )

    def _judge(self, end: int) -> None:
        """Judge the steps before `end`."""
        self._judged = end
        for step in sorted(step for step in {*self._there, *self._named} if step < end):
            there, named = self._there.pop(step, set()), self._named.pop(step, set())
            for place in named - there:
                if step > self._begun.get(place, self._first):
                    self._missing.setdefault(place, Spans()).add(step)
            if there:
                if self._latest is not None and step > self._latest + 1:
                    self._silent.append(Gap(None, (), self._latest + 1, step - 1))
                self._latest = step

    @property
    def _first(self) -> int:
        return min(self._begun.values(), default=0)

    def gaps(self) -> list[Gap]:
        """Return what is missing, at the end of the bag."""
        self._judge(max({*self._there, *self._named}, default=-1) + 1)
        missing = (
            (topic, place if topic is AGENT_STATE else 0, gap)
            for (topic, place), spans in self._missing.items()
            for gap in spans
        )
        return sorted((*self._silent, *_gaps(missing)), key=lambda gap: (gap.first, gap.last, gap.topic or ""))


@dataclass(frozen=True, slots=True)
class CompleteSteps:
    """The complete steps in a bag; if the first step is incomplete, the last complete one is the step before it.

    Attributes
    ----------
    last_planned : int
        Last step of the scenario.
    first : int
        First complete step; not 0 in a later file of a split bag, or if the beginning is lost.
    last_complete, by_topic
        Last step of the range from the first one without a missing message on any topic that has messages in every
        step, and on each.
    """

    last_planned: int
    first: int
    last_complete: int
    by_topic: dict[str, int]


def complete_steps(path: Path | str) -> CompleteSteps | None:
    """Determine the complete steps of a bag; None if it is not the bag of a single swarm with its scenario."""
    try:
        bag = open_bag(path, damaged=True)
        if is_realtime(bag):  # steps may lack messages
            return None
        scenario = attached_scenario(bag, steered=False)
        recorded = LockstepCompleteness(scenario, bag.family)
        for topic, _, message in bag.decoded():
            recorded.add(topic, message)
    except (DamagedBagError, InputError):
        return None
    first = recorded.first
    last = {topic: recorded.first_missing(topic, first) - 1 for topic in recorded.topics}
    names = {channel.topic: channel.name for channel in bag.channels if channel.topic is not None}
    by_topic = {names[topic]: step for topic, step in last.items() if topic in names}
    return CompleteSteps(scenario.steps, first, min(last.values()), by_topic)

"""The messages of a run in real time around a step, independent of the order in which they were received."""

from __future__ import annotations

from bisect import bisect
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, TypeVar

from swarmabs_analysis.difference import Difference
from swarmabs_bag.run.realtime_gatherer import CAUSES, MEMORY, disputed, part
from swarmabs_config.graph import USUAL_TOPICS, standby_topic
from swarmabs_core.messages import (
    AGENT_STATE,
    DESIRED_ABSTRACT_STATE,
    TOPIC_OF,
    AbstractState,
    AgentState,
    AuxiliaryState,
    Basis,
    DesiredAbstractState,
    Mode,
    PlaneState,
    Source,
    StandingState,
    SwarmEvent,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_analysis.difference import Value
    from swarmabs_bag.run.realtime_gatherer import Dispute
    from swarmabs_core.messages import Message, Topic
    from swarmabs_core.realtime.base import Schedule
    from swarmabs_core.record import Record

WAIT = 300
"""Steps by which a message may arrive after those of later steps and is still checked in its place."""
_KEPT = MEMORY + 2 * WAIT

AMBIGUOUS = "different messages of the step may have been sent, but the bag contains only one"
NO_STATES = "a robot's state that it was computed from is not in the bag"
NO_PROVENANCE = "its provenance is not in the bag"

Kind = TypeVar(
    "Kind", AgentState, PlaneState, AbstractState, AuxiliaryState, DesiredAbstractState, StandingState, Basis
)


class UnconfirmedError(Exception):
    """A message is not confirmed: `finding` says what is wrong, or why it cannot be checked."""

    def __init__(self, finding: Difference | str) -> None:
        super().__init__(str(finding))
        self.finding = finding


def refuse_if(wrong: object, message: Message, field: str, recorded: Value, expected: Value, reason: str) -> None:
    """Raise `UnconfirmedError` with a difference in a field of a message if something is wrong with it."""
    if wrong:
        raise UnconfirmedError(Difference.of(message, field, recorded, expected, reason))


@dataclass(slots=True)
class _Span:
    """The steps of a dispute; `last` is None while it lasts."""

    cause: str
    first: int
    last: int | None = None


class Disputes:
    """The steps of which, by the events of the recorder, nodes may have used other messages than those in the bag."""

    def __init__(self) -> None:
        self._steps: set[tuple[str, int, int]] = set()
        self._spans: dict[tuple[str, int], list[_Span]] = {}

    def add(self, said: Dispute) -> None:
        """Add what an event says."""
        if said.first is not None and said.first == said.last:
            self.add_step(said.topic, said.number, said.first)
            return
        spans = self._spans.setdefault((said.topic, said.number), [])
        lasting = next((span for span in reversed(spans) if span.cause == said.cause and span.last is None), None)
        if said.first is None:
            # Of a merged bag, each recorder tells when it was over.
            ended = lasting or next((span for span in reversed(spans) if span.cause == said.cause), None)
            if ended is not None:
                ended.last = max(said.last or 0, ended.last or 0)
        elif lasting is None:
            spans.append(_Span(said.cause, said.first))
        else:
            lasting.first = min(lasting.first, said.first)

    def add_step(self, topic: str, number: int, step: int) -> None:
        """Add a single step of a topic and robot (0: none)."""
        self._steps.add((topic, number, step))

    def contain(self, topic: str, number: int, step: int) -> bool:
        """Return whether a message of a topic, robot and step is disputed."""
        spans = self._spans.get((topic, number))
        if (topic, number, step) in self._steps or not spans:
            return (topic, number, step) in self._steps
        before = spans[: bisect(spans, step, key=attrgetter("first"))][-len(CAUSES) :]
        return any(span.last is None or step <= span.last for span in before)

    def spans(self, cause: str, newest: int) -> dict[str, tuple[int, int]]:
        """Return first and last step of the disputes with a cause, by what they are about, up to the newest step."""
        bounds = {}
        for (topic, number), spans in sorted(self._spans.items()):
            of = [span for span in spans if span.cause == cause]
            if of:
                last = max(newest if span.last is None else span.last for span in of)
                whose = f" of {_whose(topic, number)}" if number else ""
                bounds[f"/{topic}{whose}"] = min(span.first for span in of), last
        return bounds


def _whose(topic: str, number: int) -> str:
    if topic == AGENT_STATE.name:
        return f"robot {number}"
    return f"the {Source(number).name.lower()}" if number in set(Source) else f"source {number}"


class History:
    """Messages by step, topic and key, of as many steps as may still be needed.

    Attributes
    ----------
    steps : dict
        The messages by step, topic and key: robot, mode of a desired state, or source of a provenance.
    paired : bool
        Whether a standby has sent any of them.
    disputes : Disputes
        Of which steps other messages may have been used.
    """

    def __init__(self) -> None:
        self.steps: dict[int, dict[Topic, dict[int, Record]]] = {}
        self._pinned: dict[int, dict[tuple[int, int], Record]] = {}
        self.disputes = Disputes()
        self._newest: dict[tuple[str, int], int] = {}
        self.paired = False

    def add(self, stored: Record) -> bool:
        """Keep a message; return False if its place is already taken."""
        message, topic = stored.message, stored.topic
        if isinstance(message, SwarmEvent):
            if (said := disputed(message)) is not None:
                self.disputes.add(said)
            return True
        key = part(stored)
        place = self.steps.setdefault(message.step, {}).setdefault(topic, {})
        if key in place:
            return False
        place[key] = stored
        self.paired = self.paired or topic in USUAL_TOPICS
        sender = (topic.name, 0 if isinstance(message, DesiredAbstractState) else key)
        if message.step < self._newest.get(sender, -1):
            # A sender's messages stay in order, so its clock may have been set back, and an earlier message may exist.
            self.disputes.add_step(*sender, message.step)
        else:
            self._newest[sender] = message.step
        return True

    def forget(self, step: int) -> None:
        """Drop messages that later steps no longer need; the states that a coordinator still uses are kept."""
        if len(self.steps) > _KEPT + 2 * WAIT:
            self.steps = {s: messages for s, messages in self.steps.items() if s >= step - _KEPT}

    def on(self, topic: Topic, step: int) -> Mapping[int, Record]:
        """Return the messages of a topic and step by key."""
        return self.steps.get(step, {}).get(topic, {})

    def get(self, kind: type[Kind], step: int, key: int = 0) -> Kind | None:
        """Return the message of a class, step and key, or None."""
        stored = self.on(TOPIC_OF[kind], step).get(key)
        message = None if stored is None else stored.message
        return message if isinstance(message, kind) else None

    def sure(self, kind: type[Kind], step: int, reason: str, key: int = 0) -> Kind:
        """Return the message of a class, step and key that certainly is the one that was sent.

        Raises
        ------
        UnconfirmedError
            With this reason if it is missing or ambiguous.
        """
        message = self.get(kind, step, key)
        if message is None or self.is_ambiguous(TOPIC_OF[kind], step, key):
            raise UnconfirmedError(reason)
        return message

    def provenance(self, source: Source, step: int, reason: str = NO_PROVENANCE) -> Basis:
        """Return the provenance of a coordinator's answer in a step; errors as for `sure`."""
        return self.sure(Basis, step, reason, source)

    def desired(self, step: int) -> list[DesiredAbstractState]:
        """Return the desired states of a step, one per mode, RUN first."""
        by_mode = sorted(self.on(DESIRED_ABSTRACT_STATE, step).items())
        return [s.message for _, s in by_mode if isinstance(s.message, DesiredAbstractState)]

    def changes_within(self, step: int) -> bool:
        """Return whether the parent controller may have changed the mode within a step without RUN."""
        before = next(filter(None, map(self.desired, range(step - 1, step - WAIT, -1))), None)
        return before is None or any(desired.mode == Mode.RUN for desired in before)

    def states(self, source: Source, provenance: Basis) -> tuple[dict[int, AgentState], str]:
        """Return the states that a coordinator used, and a reason if some are missing or ambiguous; they are kept."""
        pins: dict[tuple[int, int], Record] = {}
        states, problem = {}, ""
        for agent_id, step in zip(provenance.agent_ids, provenance.state_steps, strict=True):
            stored = self._state(agent_id, step)
            if stored is None:
                problem = NO_STATES
                continue
            if self.is_ambiguous(AGENT_STATE, step, agent_id):
                problem = AMBIGUOUS
            pins[agent_id, step] = stored
            assert isinstance(stored.message, AgentState)  # noqa: S101 - by topic
            states[agent_id] = stored.message
        self._pinned[source] = pins
        return states, problem

    def _state(self, agent_id: int, step: int) -> Record | None:
        pinned = (pins[agent_id, step] for pins in self._pinned.values() if (agent_id, step) in pins)
        return self.on(AGENT_STATE, step).get(agent_id) or next(pinned, None)

    def is_ambiguous(self, topic: Topic, step: int, agent_id: int = 0) -> bool:
        """Return whether different messages were received, of which the bag contains only the first."""
        return self.disputes.contain(topic.name, agent_id, step)


class StandbyHistory(History):
    """The messages of another history, with those of the standbys in place of those of the primaries."""

    def __init__(self, of: History) -> None:
        super().__init__()
        self._of = of

    def on(self, topic: Topic, step: int) -> Mapping[int, Record]:
        """Return the messages of a topic and step by key."""
        return self._of.on(standby_topic(topic), step)

    def is_ambiguous(self, topic: Topic, step: int, agent_id: int = 0) -> bool:
        """Return whether different messages were received, of which the bag contains only the first."""
        return self._of.is_ambiguous(standby_topic(topic), step, agent_id)


def wrong_stamp(message: Message, schedule: Schedule, within: int = 0) -> Difference | None:
    """Return a difference if the stamp of a message is more than `within` steps from its step, otherwise None."""
    at = schedule.step(message.stamp)
    if abs(at - message.step) <= within:
        return None
    return Difference.of(message, "stamp", message.stamp, None, f"that is in step {at}")

"""Recordings in real time: which of the messages that arrive are recorded, and the events about disputed ones."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_config.graph import REALTIME, RECORDER, USUAL_TOPICS, Option, endpoints, usual_topic
from swarmabs_core.cdr import misplaced
from swarmabs_core.events import EventCode, code_of
from swarmabs_core.messages import (
    BROADCASTS,
    EVENTS,
    PLANE_STATE,
    STANDING,
    AgentState,
    Basis,
    DesiredAbstractState,
    Relay,
    SwarmEvent,
    Topic,
    topic_of,
)
from swarmabs_core.realtime.base import Realtime, Schedule
from swarmabs_core.realtime.validation import Bounds, Origin, Problem, Refusals, Writers, participant_of
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_core.messages import Message


def recorded(*, paired: bool, relaying: Iterable[int] = ()) -> tuple[Topic, ...]:
    """Return the topics of a recording, with those of standby coordinators if any has one, and of relaying robots."""
    options = frozenset({Option.PAIRED} if paired else ())
    return tuple(endpoints(RECORDER, REALTIME, options, neighbours=tuple(relaying)).subscriptions)


RECORDED = recorded(paired=True)
"""All topics of a recording in real time but for those on which robots pass on what they know."""
_UNKNOWN_BOUNDS, _LIMITS = Bounds(inf, inf), Realtime()
MEMORY = 1000
"""Steps around the recorder's current one within which messages are recorded, and duplicates recognised."""
QUIET_STEPS = 100
"""Steps without another dispute after which one is over; bounds the number of events about it."""


class Dispute(NamedTuple):
    """What an event says of a dispute: messages of steps in it may differ from those that nodes have used.

    Attributes
    ----------
    cause : str
        One of `CAUSES`.
    topic : str
        The topic of the messages.
    number : int
        Robot of the messages, or source of provenances; 0 for others.
    first, last : int or None
        The first step of it; the last, with which it ends. One of them is None.
    """

    cause: str
    topic: str
    number: int
    first: int | None
    last: int | None


SECOND_WRITER = "a second sender"
TWO_MESSAGES = "different messages of a step"
CAUSES = (SECOND_WRITER, TWO_MESSAGES)
"""Why messages are disputed. One sender says different things of a step if its clock was set back."""
_PLACE = re.compile(r"(\S+?)(?: of source (\d{1,3}))?")
"""Where a dispute is: topic, and source of provenances."""


def disputed(event: SwarmEvent) -> Dispute | None:
    """Return what an event says of the beginning or the end of a dispute; None for other events."""
    code = code_of(event)
    if code is EventCode.TWO_MESSAGES:  # in bags of earlier versions
        return Dispute(TWO_MESSAGES, code.read(event)["topic"], event.agent_id, event.step, event.step)
    if code not in (EventCode.DISPUTE_BEGINS, EventCode.DISPUTE_ENDS):
        return None
    told = code.read(event)
    place = _PLACE.fullmatch(told["where"])
    if place is None or told["cause"] not in CAUSES:
        return None
    steps = (event.step, None) if code is EventCode.DISPUTE_BEGINS else (None, event.step)
    return Dispute(told["cause"], place[1], int(place[2] or event.agent_id), *steps)


@dataclass(slots=True)
class _Disputed:
    """A dispute that is not over: its first and last step, its number of messages, and when it last was renewed."""

    first: int
    last: int
    count: int
    renewed: int


class _Waiting(NamedTuple):
    """An event that arrived in a step from a process of which nothing else has been heard."""

    record: Record
    writer: bytes
    step: int


_MOST_WAITING = 1000
_STRANGER = Problem("an event of a process from which nothing else of this swarm is heard").of(EVENTS.name)


class RealtimeCollector:
    """Selects the messages to record, which may arrive in any order and repeatedly.

    It records the first message of each topic, step and robot, and of desired states the first of each mode, because
    the parent controller may change the mode within a step. Messages on robots' own topics are recorded on the usual
    ones. Duplicates are dropped.

    As nodes do, it binds each topic and robot to a writer, and drops the messages of a second one. Different messages
    for the same place, and messages of another swarm or time, are dropped too. Of a swarm in which each robot computes
    the broadcasts, several robots may publish them for a while: the first of each step is recorded, whoever sent it.
    Events report what is dropped for other reasons than repetition: two for each
    dispute, with its first and its last step, because other receivers may be bound to the other writer. Nodes publish
    more than events: an event waits until a process that has sent it is bound to another topic, or is dropped.

    Parameters
    ----------
    bounds : Bounds, optional
        What is credible: as for the nodes, only a credible message binds its origin to its writer.
    each_robot : bool
        Whether each robot computes the broadcasts.
    limits : Realtime
        Their age limits are the silence after which another writer may take the place of the first.

    Attributes
    ----------
    writers : Writers
        Who speaks for what.
    repeated, different, refused : int
        Numbers of dropped messages: duplicates, different messages for the same place or of a second writer, and those
        of another swarm or time.
    """

    def __init__(
        self,
        members: Iterable[int],
        schedule: Schedule,
        bounds: Bounds = _UNKNOWN_BOUNDS,
        limits: Realtime = _LIMITS,
        *,
        each_robot: bool = False,
    ) -> None:
        self._members = frozenset(members)
        self._schedule = schedule
        self._known: dict[int, dict[tuple[Topic, object], bytes]] = {}
        self._oldest = 0
        self._refusals = Refusals()
        self._bounds = bounds
        self._shared = frozenset((*BROADCASTS, STANDING) if each_robot else ())
        broadcasts = dict.fromkeys((topic.name for topic in BROADCASTS), schedule.steps(limits.broadcast_age_limit))
        plane = schedule.steps(limits.plane_age_limit)
        self.writers = Writers(schedule.steps(limits.state_age_limit), {**broadcasts, PLANE_STATE.name: plane})
        self._disputes: dict[tuple[str, Topic, int], _Disputed] = {}
        self._waiting: dict[bytes, list[_Waiting]] = {}
        self._now = 0
        self.repeated = self.different = 0

    @property
    def refused(self) -> int:
        """Number of messages of another swarm or time."""
        return self._refusals.total

    @property
    def remembered(self) -> int:
        """Number of steps whose messages are kept for comparison."""
        return len(self._known)

    def add(self, record: Record, now: int, writer: bytes = b"") -> tuple[Record, ...]:
        """Process a message received at a time (ns since 1970) from a writer; return the records to write."""
        self._now, step = now, self._schedule.step(now)
        self._forget(step - MEMORY)
        self.writers.advance(step)
        ended = self._end_disputes(step) if self._disputes else ()
        if self._waiting:
            ended += self._drop_strangers(step)
        problem = self._problem(record, step, writer)
        if problem:
            return (*ended, *self._refuse(problem, step))
        # Operators publish removals, and nothing else.
        if writer and usual_topic(record.topic) is EVENTS and not self.writers.speaks(writer):
            if sum(map(len, self._waiting.values())) == _MOST_WAITING:
                return (*ended, *self._refuse(_STRANGER, step))
            self._waiting.setdefault(participant_of(writer), []).append(_Waiting(record, writer, step))
            return ended
        kept = self._keep(record, step, writer)
        if participant_of(writer) in self._waiting and self.writers.speaks(writer):
            waited = self._waiting.pop(participant_of(writer))
            kept += tuple(late for one in waited for late in self._keep(one.record, one.step, one.writer))
        return (*ended, *kept)

    def finish(self) -> tuple[Record, ...]:
        """Return the events to write at the end of the recording."""
        return (*self._drop_strangers(None), *self._end_disputes(None))

    def _refuse(self, problem: Problem, step: int) -> tuple[Record, ...]:
        """Count a dropped message; return the event that reports it, if it is due."""
        return tuple(told for event in self._refusals.add(problem, step, self._now) for told in self._once(event))

    def _drop_strangers(self, step: int | None) -> tuple[Record, ...]:
        """Drop the events of processes of which nothing else has been heard for long; without a step, of all."""
        longest = QUIET_STEPS + self.writers.longest_age
        strange = [who for who, events in self._waiting.items() if step is None or step - events[0].step > longest]
        dropped = [event for who in strange for event in self._waiting.pop(who)]
        return tuple(told for event in dropped for told in self._refuse(_STRANGER, event.step))

    def _keep(self, record: Record, step: int, writer: bytes) -> tuple[Record, ...]:
        """Return the records to write of a message that is not refused."""
        if record.topic.agent_id:
            record = record._replace(topic=topic_of(record.message))
        topic, _, message, payload, *_ = record
        recorded = self._known.setdefault(message.step, {})
        place = (topic, payload if isinstance(message, SwarmEvent) else part(record))
        first = recorded.get(place)
        second = self._is_of_second(record, step, writer)
        if first == payload or (first is not None and topic in self._shared):
            self.repeated += 1
            return ()
        if first is None and not second:
            recorded[place] = payload
            return (record,)
        self.different += 1
        return self._dispute(record, SECOND_WRITER if second else TWO_MESSAGES, step)

    def _is_of_second(self, record: Record, step: int, writer: bytes) -> bool:
        """Return whether a message is that of a second writer, by the rule of the nodes."""
        message = record.message
        if not writer or isinstance(message, SwarmEvent) or record.topic in self._shared:
            return False
        origin = origin_of(record)
        if self.writers.refuses(origin, writer):
            return True
        if abs(message.step - step) <= self.writers.age(origin) and not self._bounds.problem(message):
            self.writers.hear(origin, writer)
        return False

    def _dispute(self, record: Record, cause: str, step: int) -> tuple[Record, ...]:
        """Note a dropped message; return the event with which a dispute begins."""
        origin, of = origin_of(record), record.message.step
        key, first, last = (cause, record.topic, origin.number), of, of
        if cause == SECOND_WRITER:  # who follows it need not have received what is recorded of any step meanwhile
            first, last = min(of, step), min(max(of, step), step + self.writers.age(origin))
        dispute = self._disputes.get(key)
        if dispute is None:
            self._disputes[key] = _Disputed(first, last, 1, step)
            return self._told(EventCode.DISPUTE_BEGINS, key, first, 1)
        dispute.last, dispute.count, dispute.renewed = max(dispute.last, last), dispute.count + 1, step
        if first >= dispute.first:
            return ()
        dispute.first = step - MEMORY  # the oldest that are taken, so this is told at most twice
        return self._told(EventCode.DISPUTE_BEGINS, key, dispute.first, dispute.count)

    def _end_disputes(self, step: int | None) -> tuple[Record, ...]:
        """Return the events with which disputes end that were not renewed for some time; without a step, of all."""
        disputes = self._disputes.items()
        over = [key for key, dispute in disputes if step is None or abs(step - dispute.renewed) > QUIET_STEPS]
        ended = [(key, self._disputes.pop(key)) for key in over]
        ends = EventCode.DISPUTE_ENDS
        return tuple(t for key, dispute in ended for t in self._told(ends, key, dispute.last, dispute.count))

    def _told(self, code: EventCode, key: tuple[str, Topic, int], step: int, count: int) -> tuple[Record, ...]:
        cause, topic, number = key
        agent_id, of = (0, f" of source {number}") if topic.message is Basis else (number, "")
        where = f"{topic.name}{of}"
        return self._once(code.event(self._now, max(0, step), float(count), robot=agent_id, cause=cause, where=where))

    def _once(self, event: Message) -> tuple[Record, ...]:
        """Return the record of an own event, unless a recorder has told the same before, in a bag that is merged."""
        record = Record.of(event)
        if event.step < self._oldest:  # nothing of it is compared any more
            return (record,)
        recorded, place = self._known.setdefault(event.step, {}), (record.topic, record.payload)
        if place in recorded:
            return ()
        recorded[place] = record.payload
        return (record,)

    def _problem(self, record: Record, step: int, writer: bytes) -> Problem | None:
        topic, agent_id, message = record.topic, record.agent_id, record.message
        if topic.agent_id:
            if problem := misplaced(message, topic):
                return Problem(problem)
        elif topic not in RECORDED:
            return Problem("not a topic that is recorded").of(topic.name)
        if (isinstance(message, AgentState) or agent_id) and agent_id not in self._members:
            return Problem("a robot that is not a member of this swarm", f"robot {agent_id}").of(topic.name)
        if abs(message.step - step) > MEMORY:
            problem = "a step far from now; of another swarm, or its clock is wrong"
            return Problem(problem, f"step {message.step}").of(topic.name)
        if writer and not isinstance(message, SwarmEvent) and (impossible := self._bounds.problem(message)):
            origin = origin_of(record)
            # What the sender says whom the nodes hear is recorded, true or not.
            return None if self.writers.is_bound(origin, writer) else impossible.of(origin)
        return None

    def _forget(self, before: int) -> None:
        """Drop the steps before one, quickly even if the clock has jumped."""
        if before - self._oldest > len(self._known):
            self._known = {step: recorded for step, recorded in self._known.items() if step >= before}
        else:
            for step in range(self._oldest, before):
                self._known.pop(step, None)
        self._oldest = before


def origin_of(record: Record) -> Origin:
    """Return who is said to have sent a message."""
    message, usual = record.message, usual_topic(record.topic)
    number = message.source if isinstance(message, Basis) else record.agent_id
    return Origin(usual.name, number, record.topic in USUAL_TOPICS)


def part(record: Record) -> int:
    """Return the key of a message among those of its topic and step."""
    message = record.message
    if isinstance(message, DesiredAbstractState):
        return message.mode
    if isinstance(message, Relay):
        return message.round
    return message.source if isinstance(message, Basis) else record.agent_id

"""What a recorder in real time keeps: the first copy of everything, and figures of the run. Nothing waits for it."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from swarmabs_bag.recording import Latest, Metrics
from swarmabs_config.graph import REALTIME, RECORDER, endpoints
from swarmabs_core.desired_state import fallen
from swarmabs_core.messages import (
    AGENT_STATE,
    EVENTS,
    MAIN_TOPICS,
    NEVER,
    AgentState,
    Basis,
    DesiredAbstractState,
    EventKind,
    PlaneState,
    Source,
    SwarmEvent,
    Topic,
)
from swarmabs_core.realtime.refusals import Refusals
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_bag.recording import Reference
    from swarmabs_core.realtime.base import Schedule

RECORDED = tuple(endpoints(RECORDER, REALTIME).subscriptions)
"""Topics of a recording in real time."""
MEMORY = 1000
"""Steps before and after the recorder's own within which messages are recorded, and copies of them recognised."""
DIFFERENT = "two different messages of this step on "
"""How the detail of an event begins that says of which topic only the first message is recorded."""
_PENDING = 100
"""Steps for which a state of the plane waits for the answer of the parent controller, or the other way round."""
_ANSWERED = 10
"""Steps of the plane without such an answer after which its angle is shown without an error."""


def conflict(event: SwarmEvent) -> str | None:
    """Return the topic of which an event says that not all messages of its step are recorded; None if it does not."""
    refused = event.kind == EventKind.REFUSED and event.detail.startswith(DIFFERENT)
    return event.detail.removeprefix(DIFFERENT) if refused else None


class RealtimeCollector:
    """Chooses from what arrives, in any order and any number of copies, what is recorded.

    Recorded is the first message of a topic, a step and a robot. Of desired states it is the first of each mode, since
    the parent controller may change its mind within a step. A copy is dropped; another message in its place is dropped
    too, but an event says so. So is what cannot be of this swarm and time.

    Parameters
    ----------
    members : iterable of int
        Ids of all robots that may ever take part.
    schedule : Schedule
        How time becomes steps.

    Attributes
    ----------
    repeated, different, refused : int
        Messages that were dropped: copies, others in the place of the first, and those of another swarm or time.
    """

    def __init__(self, members: Iterable[int], schedule: Schedule) -> None:
        self._members = frozenset(members)
        self._schedule = schedule
        self._known: dict[int, dict[tuple[Topic, object], bytes]] = {}
        self._oldest = 0
        self._refusals = Refusals()
        self.repeated = self.different = 0

    @property
    def refused(self) -> int:
        """Messages of another swarm or time."""
        return self._refusals.total

    def add(self, record: Record, now: int) -> tuple[Record, ...]:
        """Take the record of a message that has arrived at a time (ns since 1970); return what is to be recorded."""
        step = self._schedule.step(now)
        self._forget(step - MEMORY)
        problem = self._problem(record, step)
        if problem:
            return tuple(map(Record.of, self._refusals.add(problem, step, now)))
        topic, agent_id, message, payload, *_ = record
        known = self._known.setdefault(message.step, {})
        place = (topic, payload if isinstance(message, SwarmEvent) else part(record))
        if place not in known:
            known[place] = payload
            return (record,)
        if known[place] == payload:
            self.repeated += 1
            return ()
        self.different += 1
        mark = (EVENTS, place)
        if mark in known:
            return ()
        told = Record.of(SwarmEvent(now, message.step, agent_id, EventKind.REFUSED, 1.0, DIFFERENT + topic.name))
        known[mark] = told.payload
        return (told,)

    def _problem(self, record: Record, step: int) -> str:
        topic, agent_id = record.topic, record.agent_id
        if topic not in RECORDED:
            return f"{topic.name}: not a topic that is recorded"
        if (topic is AGENT_STATE or agent_id) and agent_id not in self._members:
            return f"{topic.name}: robot {agent_id} is not a member of this swarm"
        if abs(record.message.step - step) > MEMORY:
            return f"{topic.name}: a step far from now; of another swarm, or its clock is wrong"
        return ""

    def _forget(self, before: int) -> None:
        """Forget the steps before one; that takes no time if the clock goes on as it should."""
        if before - self._oldest > len(self._known):
            self._known = {step: known for step, known in self._known.items() if step >= before}
        else:
            for step in range(self._oldest, before):
                self._known.pop(step, None)
        self._oldest = before


def part(record: Record) -> int:
    """Return what tells the messages of a topic and a step apart."""
    message = record.message
    if isinstance(message, DesiredAbstractState):
        return message.mode
    return message.source if isinstance(message, Basis) else record.agent_id


class _Span:
    """Steps of which there were messages: the first, the last, how many."""

    __slots__ = ("count", "first", "last")

    def __init__(self, step: int) -> None:
        self.first = self.last = step
        self.count = 0

    def add(self, step: int) -> None:
        self.first, self.last = min(self.first, step), max(self.last, step)
        self.count += 1


class RealtimeFigures:
    """Figures of a run in real time.

    The error counts from the answer of the parent controller on with which its law's time has begun, and in this time.

    Parameters
    ----------
    reference : callable
        Angle (rad) that the plane should have at a time (s) of the law.
    schedule : Schedule
        How time becomes steps.

    Attributes
    ----------
    newest : int
        The newest step of a message, -1 before the first.
    fallen : str
        When and why the swarm has lost the plane, and what helps; empty if it has not.
    """

    def __init__(self, reference: Reference, schedule: Schedule) -> None:
        self._metrics = Metrics(reference)
        self._schedule = schedule
        self._spans: dict[tuple[Topic, int], _Span] = {}
        self._angles: dict[int, float] = {}
        self._begun: dict[int, int] = {}
        self._ages: Counter[int] = Counter()
        self._safe_stops = 0
        self._plane: PlaneState | None = None
        self.newest = -1
        self.fallen = ""

    @property
    def latest(self) -> Latest | None:
        """What the run looks like now: without an error where the parent controller no longer answers the plane."""
        plane, compared = self._plane, self._metrics.latest
        if plane is None or compared is None or abs(plane.step - compared.step) <= _ANSWERED:
            return compared
        return Latest(plane.step, plane.angle, None)

    def add(self, record: Record) -> None:
        """Take a recorded message."""
        message = record.message
        self._metrics.count(1)
        if isinstance(message, SwarmEvent):
            self._safe_stops += message.kind == EventKind.SAFE_STOP
            return
        if isinstance(message, Basis):
            if message.source == Source.CONTROLLER:
                self._begun[message.step] = message.begun
                self._follow(message.step)
            return
        place = record.topic, record.agent_id
        self._spans.setdefault(place, _Span(message.step)).add(message.step)
        self.newest = max(self.newest, message.step)
        if isinstance(message, AgentState):
            self._metrics.reach(abs(message.position))
            if message.broadcast_step != NEVER:
                self._ages[message.step - message.broadcast_step] += 1
        elif isinstance(message, PlaneState):
            self._angles[message.step] = message.angle
            self._follow(message.step)
            self._watch(message)

    def _watch(self, plane: PlaneState) -> None:
        """Keep the plane's state, and notice the first in which the swarm has lost it."""
        self._plane = plane
        if not self.fallen and (problem := fallen(plane)):
            self.fallen = f"t = {plane.step * self._schedule.period_ns / 1e9:g} s, {problem}"

    def _follow(self, step: int) -> None:
        """Compare the plane's angle with the reference once angle and time of the law are known."""
        if step in self._angles and step in self._begun:
            periods = step - self._begun.pop(step)
            self._metrics.follow(step, periods * self._schedule.period_ns / 1e9, self._angles.pop(step))
        for waiting in (self._angles, self._begun):
            while len(waiting) > _PENDING:
                del waiting[next(iter(waiting))]

    def figures(self) -> dict[str, float | int | None]:
        """Return the figures under their names in ``summary.json``; None where there is no finite one."""
        return self._metrics.summary()

    def summary(self) -> dict[str, Any]:
        """Return all figures; there is no digest, since what arrives differs from run to run."""
        return {**self.figures(), "digest": None, "realtime": self.realtime()}

    def realtime(self) -> dict[str, object]:
        """Return what only a run in real time has: received and missing messages, ages of broadcasts, safe stops.

        A robot's states count from its first to its last. A message is missing if it was lost on its way to the
        recorder, or never sent since its node missed the period.
        """
        losses = {}
        for topic in MAIN_TOPICS:
            spans = [span for (of, _), span in self._spans.items() if of is topic]
            received = sum(span.count for span in spans)
            expected = sum(span.last - span.first + 1 for span in spans)
            # A mode that changes within a step gives two desired states of it.
            losses[topic.name] = {"received": received, "missing": max(0, expected - received)}
        return {
            "losses": losses,
            "broadcast_ages": {str(age): self._ages[age] for age in sorted(self._ages)},
            "safe_stops": self._safe_stops,
        }

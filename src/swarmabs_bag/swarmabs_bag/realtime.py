"""Recordings in real time: selection of the messages to record, and the provenance of clock and simulated parts."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any

from swarmabs_bag.attached import attached_provenance
from swarmabs_bag.figures import RealtimeFigures
from swarmabs_config import configure
from swarmabs_config.graph import REALTIME, RECORDER, STANDBY_TOPICS, Option, endpoints, usual_topic
from swarmabs_core.cdr import misplaced
from swarmabs_core.errors import InputError
from swarmabs_core.messages import (
    BASIS,
    EVENTS,
    AgentState,
    Basis,
    DesiredAbstractState,
    EventKind,
    Source,
    SwarmEvent,
    Topic,
)
from swarmabs_core.realtime.base import Realtime, Schedule
from swarmabs_core.realtime.validation import Bounds, Refusals, Writers
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from swarmabs_bag.reader import BagReader
    from swarmabs_config.scenario import Scenario

_WORLD = ("period_ns", "epoch_ns", "simulated_robots", "simulated_plane", "own_limits")


def recorded(*, paired: bool) -> tuple[Topic, ...]:
    """Return the topics of a recording, with those of standby coordinators if any coordinator has one."""
    return tuple(endpoints(RECORDER, REALTIME, frozenset({Option.PAIRED} if paired else ())).subscriptions)


RECORDED = recorded(paired=True)
"""All topics of a recording in real time."""
_UNKNOWN_BOUNDS = Bounds(inf, inf)
MEMORY = 1000
"""Steps around the recorder's current one within which messages are recorded, and duplicates recognised."""
DIFFERENT = "two different messages of this step on "
"""Prefix of an event's detail that names a topic of which only the first message is recorded."""


def conflict(event: SwarmEvent) -> str | None:
    """Return the topic of which, according to an event, only the first message of the step is recorded, or None."""
    refused = event.kind == EventKind.REFUSED and event.detail.startswith(DIFFERENT)
    return event.detail.removeprefix(DIFFERENT) if refused else None


class RealtimeCollector:
    """Selects the messages to record, which may arrive in any order and repeatedly.

    It records the first message of each topic, step and robot, and of desired states the first of each mode, because
    the parent controller may change the mode within a step. Messages on robots' own topics are recorded on the usual
    ones. Duplicates are dropped. Different messages for the same place, states of a robot from a second sender, and
    messages of another swarm or time, are dropped too, but reported by an event. While a robot has a second sender, an
    event marks each of its steps, because other receivers may follow the other sender.

    Parameters
    ----------
    bounds : Bounds, optional
        What is credible: as for the observer, only a credible state binds the id of a robot to its writer.
    age_limit : float
        Silence, s, after which another writer may speak for a robot.

    Attributes
    ----------
    writers : Writers
        Who speaks for which robot.
    repeated, different, refused : int
        Numbers of dropped messages: duplicates, different messages for the same place, and those of another swarm or
        time.
    """

    def __init__(
        self,
        members: Iterable[int],
        schedule: Schedule,
        bounds: Bounds = _UNKNOWN_BOUNDS,
        age_limit: float = Realtime().state_age_limit,
    ) -> None:
        self._members = frozenset(members)
        self._schedule = schedule
        self._known: dict[int, dict[tuple[Topic, object], bytes]] = {}
        self._oldest = 0
        self._refusals = Refusals()
        self._bounds, self._age = bounds, schedule.steps(age_limit)
        self.writers = Writers(self._age)
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
        step = self._schedule.step(now)
        self._forget(step - MEMORY)
        problem = self._problem(record, step)
        if problem:
            return tuple(map(Record.of, self._refusals.add(problem, step, now)))
        if record.topic.agent_id:
            record = record._replace(topic=usual_topic(record.topic))
        topic, agent_id, message, payload, *_ = record
        self.writers.advance(step)
        known = self._known.setdefault(message.step, {})
        place = (topic, payload if isinstance(message, SwarmEvent) else part(record))
        first = known.get(place)
        if first == payload:
            self.repeated += 1
            return ()
        second = isinstance(message, AgentState) and self._is_of_second(message, step, writer)
        if first is None and not second:
            known[place] = payload
            # The observer may follow the other writer, whose state of this step need not arrive here.
            doubtful = writer and self.writers.contested(agent_id)
            return (record, *self._mark(known, place, record, now)) if doubtful else (record,)
        self.different += 1
        return self._mark(known, place, record, now)

    def _is_of_second(self, state: AgentState, step: int, writer: bytes) -> bool:
        """Return whether a state is that of a second writer, by the rule of the observer."""
        if self.writers.refuses(state.agent_id, writer):
            return True
        if abs(state.step - step) <= self._age and not self._bounds.problem(state):
            self.writers.hear(state.agent_id, writer)
        return False

    def _mark(
        self, known: dict[tuple[Topic, object], bytes], place: tuple[Topic, object], record: Record, now: int
    ) -> tuple[Record, ...]:
        """Return an event that names a step with different messages, unless it has been named."""
        mark = (EVENTS, place)
        if mark in known:
            return ()
        step, agent_id, detail = record.message.step, record.agent_id, DIFFERENT + record.topic.name
        told = Record.of(SwarmEvent(now, step, agent_id, EventKind.REFUSED, 1.0, detail))
        known[mark] = told.payload
        return (told,)

    def _problem(self, record: Record, step: int) -> str:
        topic, agent_id = record.topic, record.agent_id
        if topic.agent_id:
            if problem := misplaced(record.message, topic):
                return problem
        elif topic not in RECORDED:
            return f"{topic.name}: not a topic that is recorded"
        if (isinstance(record.message, AgentState) or agent_id) and agent_id not in self._members:
            return f"{topic.name}: robot {agent_id} is not a member of this swarm"
        if abs(record.message.step - step) > MEMORY:
            return f"{topic.name}: a step far from now; of another swarm, or its clock is wrong"
        return ""

    def _forget(self, before: int) -> None:
        """Drop the steps before one, quickly even if the clock has jumped."""
        if before - self._oldest > len(self._known):
            self._known = {step: known for step, known in self._known.items() if step >= before}
        else:
            for step in range(self._oldest, before):
                self._known.pop(step, None)
        self._oldest = before


def part(record: Record) -> int:
    """Return the key of a message among those of its topic and step."""
    message = record.message
    if isinstance(message, DesiredAbstractState):
        return message.mode
    return message.source if isinstance(message, Basis) else record.agent_id


@dataclass(frozen=True, slots=True)
class RealtimeWorld:
    """Mapping from time to steps, simulated robots, whether the plane was simulated, and robots with other limits."""

    schedule: Schedule
    robots: tuple[int, ...]
    plane: bool
    own_limits: tuple[int, ...] = ()

    def provenance(self) -> dict[str, object]:
        """Return the entry for the provenance."""
        lists = sorted(self.robots), sorted(self.own_limits)
        values = (self.schedule.period_ns, self.schedule.epoch_ns, lists[0], self.plane, lists[1])
        return dict(zip(_WORLD, values, strict=True))


def realtime_world(bag: BagReader) -> RealtimeWorld:
    """Return the recorded world of a bag in real time; raise `InputError` if it is missing."""
    found = attached_provenance(bag).get("realtime")
    said: Mapping[str, Any] = found if isinstance(found, dict) else {}
    period, epoch, robots, plane, limited = (said.get(name) for name in _WORLD)
    if (
        isinstance(robots, list)
        and isinstance(limited, list)
        and isinstance(plane, bool)
        and all(type(number) is int and number >= 0 for number in (period, epoch, *robots, *limited))
        and period
    ):
        return RealtimeWorld(Schedule(int(period), int(epoch or 0)), tuple(robots), plane, tuple(limited))
    raise InputError(
        f"{bag.path}: its provenance lacks a valid entry realtime ({', '.join(_WORLD)}), so it cannot be verified; "
        "use a bag written by the recorder"
    )


def law_begins(bag: BagReader) -> dict[int, int]:
    """Return, for every step answered by the parent controller, the step at which the time of its law began."""
    return {
        message.step: message.begun
        for _, _, message in bag.decoded((BASIS, STANDBY_TOPICS[BASIS]))
        if isinstance(message, Basis) and message.source == Source.CONTROLLER
    }


def realtime_figures(bag: BagReader, scenario: Scenario) -> RealtimeFigures:
    """Return the figures of a bag, by the same arithmetic as during the recording.

    Raises `DamagedBagError` if the bag is damaged.
    """
    figures = RealtimeFigures(configure.parent_controller(scenario).reference, Schedule(scenario.step_ns))
    for record in bag.records(RECORDED):
        figures.add(record)
    return figures

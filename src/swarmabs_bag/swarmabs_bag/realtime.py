"""Recordings in real time: what is kept of all that arrives, and what a bag of it says of its clock and its world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from swarmabs_bag.attached import attached_provenance
from swarmabs_bag.figures import RealtimeFigures
from swarmabs_config import configure
from swarmabs_config.graph import REALTIME, RECORDER, endpoints
from swarmabs_core.errors import InputError
from swarmabs_core.messages import (
    AGENT_STATE,
    BASIS,
    EVENTS,
    Basis,
    DesiredAbstractState,
    EventKind,
    Source,
    SwarmEvent,
    Topic,
)
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.validation import Refusals
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from swarmabs_bag.reader import BagReader
    from swarmabs_config.scenario import Scenario

_WORLD = ("period_ns", "epoch_ns", "simulated_robots", "simulated_plane", "own_limits")
RECORDED = tuple(endpoints(RECORDER, REALTIME).subscriptions)
"""Topics of a recording in real time."""
MEMORY = 1000
"""Steps before and after the recorder's own within which messages are recorded, and copies of them recognised."""
DIFFERENT = "two different messages of this step on "
"""How the detail of an event begins that says of which topic only the first message is recorded."""


def conflict(event: SwarmEvent) -> str | None:
    """Return the topic of which an event says that not all messages of its step are recorded; None if it does not."""
    refused = event.kind == EventKind.REFUSED and event.detail.startswith(DIFFERENT)
    return event.detail.removeprefix(DIFFERENT) if refused else None


class RealtimeCollector:
    """Chooses from what arrives, in any order and any number of copies, what is recorded.

    Recorded is the first message of a topic, a step and a robot. Of desired states it is the first of each mode, since
    the parent controller may change its mind within a step. A copy is dropped; another message in its place is dropped
    too, but an event says so. So is what cannot be of this swarm and time.

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

    @property
    def remembered(self) -> int:
        """Steps whose messages are remembered."""
        return len(self._known)

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


@dataclass(frozen=True, slots=True)
class RealtimeWorld:
    """How time became steps, which robots' bodies were simulated, whether the plane was, who had limits of its own."""

    schedule: Schedule
    robots: tuple[int, ...]
    plane: bool
    own_limits: tuple[int, ...] = ()

    def provenance(self) -> dict[str, object]:
        """Return it as it stands in the provenance."""
        lists = sorted(self.robots), sorted(self.own_limits)
        values = (self.schedule.period_ns, self.schedule.epoch_ns, lists[0], self.plane, lists[1])
        return dict(zip(_WORLD, values, strict=True))


def realtime_world(bag: BagReader) -> RealtimeWorld:
    """Return what a bag that was recorded in real time says of its world; an `InputError` if it does not say it."""
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
        f"{bag.path}: its provenance does not say how time became steps (realtime: {', '.join(_WORLD)}), so it cannot "
        "be verified"
    )


def law_begins(bag: BagReader) -> dict[int, int]:
    """Return for every step that the parent controller has answered the step with which its law's time had begun."""
    return {
        message.step: message.begun
        for _, _, message in bag.decoded((BASIS,))
        if isinstance(message, Basis) and message.source == Source.CONTROLLER
    }


def realtime_figures(bag: BagReader, scenario: Scenario) -> RealtimeFigures:
    """Return the figures of a bag, by the same arithmetic as while it was recorded.

    Raises `DamagedBagError` where the bag is damaged.
    """
    figures = RealtimeFigures(configure.parent_controller(scenario).reference, Schedule(scenario.step_ns))
    for record in bag.records(RECORDED):
        figures.add(record)
    return figures

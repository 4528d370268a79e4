"""Comparison of two runs message by message: the first difference, deviations by field, and missing messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.difference import MESSAGE, Difference, Side, component_of, differing_fields
from swarmabs_bag.steps import ORDER
from swarmabs_core.messages import EVENTS

if TYPE_CHECKING:
    from swarmabs_bag.recording import RecordedStep
    from swarmabs_core.messages import Topic
    from swarmabs_core.record import Record

_KEYS = {"step", "agent_id"}
"""Fields by which messages are paired."""
_MOST_EVENTS = 100_000
"""Most events of one run that wait for an equal event in the other."""


def side_by_side(
    a: Iterable[RecordedStep], b: Iterable[RecordedStep]
) -> Iterator[tuple[RecordedStep | None, RecordedStep | None]]:
    """Yield two runs step by step, with None for a step that one of them lacks; both must be in ascending order."""
    left, right = iter(a), iter(b)
    x, y = next(left, None), next(right, None)
    while x is not None or y is not None:
        step = min(found.step for found in (x, y) if found is not None)
        ours, theirs = (found if found is not None and found.step == step else None for found in (x, y))
        yield ours, theirs
        x = x if ours is None else next(left, None)
        y = y if theirs is None else next(right, None)


@dataclass
class FieldDeviation:
    """Deviation of a field between two runs, over the messages that both have.

    Attributes
    ----------
    field : str
        The field; of a vector the component, such as ``value[0]``.
    differing : int
        Number of messages in which its bits differ.
    largest : float or None
        Largest finite absolute deviation, in the unit of the field; None for fields other than float64, and if there
        is none.
    step, agent : int or None
        Where the largest deviation first occurs; `agent` is 0 for messages without a robot.
    rms : float or None
        Root mean square of the finite deviations over all messages that both have; None like `largest`.
    undefined : int
        Number of differing messages whose deviation is not finite.
    """

    field: str
    differing: int = 0
    largest: float | None = None
    step: int | None = None
    agent: int | None = None
    rms: float | None = None
    undefined: int = 0

    def __post_init__(self) -> None:
        """Initialise the sum."""
        self._squares = 0.0

    def add(self, deviation: float | None, step: int, agent: int) -> None:
        """Add the deviation of a message, None if the field has none."""
        self.differing += 1
        if deviation is None:
            return
        if not math.isfinite(deviation):
            self.undefined += 1
            return
        self._squares += deviation * deviation
        if self.largest is None or deviation > self.largest:
            self.largest, self.step, self.agent = deviation, step, agent

    def finish(self, compared: int) -> None:
        """Compute the result over `compared` messages."""
        if self.largest is not None and math.isfinite(self._squares):
            self.rms = math.sqrt(self._squares / (compared - self.undefined))


@dataclass
class TopicComparison:
    """Comparison of a topic: number of messages in both runs, differing, and in one run only; deviations by field."""

    topic: str
    compared: int = 0
    differing: int = 0
    missing_in_a: int = 0
    missing_in_b: int = 0
    fields: tuple[FieldDeviation, ...] = ()

    def __post_init__(self) -> None:
        """Initialise the fields."""
        self._fields: dict[str, FieldDeviation] = {}

    def field(self, name: str) -> FieldDeviation:
        """Return the deviation of a field."""
        return self._fields.setdefault(name, FieldDeviation(name))

    def finish(self, order: Iterable[str]) -> None:
        """Compute the results of the fields, in this order; those of vectors by component."""
        places = {name: place for place, name in enumerate(order)}
        components = {component_of(name): field for name, field in self._fields.items()}
        self.fields = tuple(components[key] for key in sorted(components, key=lambda key: (places[key[0]], key[1])))
        for field in self.fields:
            field.finish(self.compared)


class MessageComparison:
    """The result of `compare_steps`.

    Attributes
    ----------
    first : Difference or None
        The first difference in the order of step, topic, robot and field.
    topics : tuple of TopicComparison
        All topics.
    """

    def __init__(self) -> None:
        self.first: Difference | None = None
        self.topics: tuple[TopicComparison, ...] = ()
        self._place: tuple[int, int, int] | None = None
        self._topics: dict[Topic, TopicComparison] = {}

    @property
    def equal(self) -> bool:
        """Whether both runs have the same messages, bit for bit."""
        return self.first is None

    def take(self, one: Record | None, other: Record | None) -> None:
        """Compare the messages of A and B at one place, None for a missing one."""
        there = one or other
        if there is None:
            return
        topic = self._topics.setdefault(there.topic, TopicComparison(there.topic.name))
        if one is None or other is None:
            topic.missing_in_a += one is None
            topic.missing_in_b += other is None
            sides = (None, MESSAGE) if one is None else (MESSAGE, None)
            self._note(there, Difference.of(there.message, MESSAGE, *sides))
            return
        topic.compared += 1
        if one.payload == other.payload:
            return
        topic.differing += 1
        for name, x, y in differing_fields(one.message, other.message):
            if name not in _KEYS:
                deviation = abs(x - y) if isinstance(x, float) and isinstance(y, float) else None
                topic.field(name).add(deviation, one.message.step, one.agent_id)
                self._note(one, Difference.of(one.message, name, x, y))

    def _note(self, record: Record, difference: Difference) -> None:
        place = (record.message.step, ORDER[record.topic], record.agent_id)
        if self._place is None or place < self._place:
            self._place, self.first = place, difference

    def finish(self) -> MessageComparison:
        """Compute the results, and return the comparison."""
        for topic, found in self._topics.items():
            found.finish(topic.message._fields)
        self.topics = tuple(self._topics[topic] for topic in ORDER if topic in self._topics)
        return self


def compare_steps(a: Iterable[RecordedStep], b: Iterable[RecordedStep]) -> MessageComparison:
    """Compare two runs message by message.

    Both are read in parallel; only the current step and the events that have no counterpart yet are kept in memory.

    The steps must be as `recorded_steps` yields them: those of main topics in ascending order, each once; events in
    separate steps, in any order.
    """
    found = MessageComparison()
    events = _Events(found)
    for x, y in side_by_side(_main_steps(a, events, "A"), _main_steps(b, events, "B")):
        ours, theirs = ({_place(record): record for record in step.records} if step else {} for step in (x, y))
        for place in sorted(ours.keys() | theirs.keys()):
            found.take(ours.get(place), theirs.get(place))
    events.finish()
    return found.finish()


def _place(record: Record) -> tuple[int, str, int]:
    """Return the place of a message in its step; topics of different families have places of their own."""
    return ORDER[record.topic], record.topic.name, record.agent_id


def _main_steps(steps: Iterable[RecordedStep], events: _Events, side: Side) -> Iterator[RecordedStep]:
    for step in steps:
        if step.records[0].topic is EVENTS:
            for record in step.records:
                events.add(record, side)
        else:
            yield step


class _Events:
    """Pairs the events of two runs, independent of their place in the bags."""

    def __init__(self, found: MessageComparison) -> None:
        self._found = found
        self._waiting: dict[Side, dict[bytes, list[Record]]] = {"A": {}, "B": {}}
        self._count = 0

    def add(self, record: Record, side: Side) -> None:
        others = self._waiting["B" if side == "A" else "A"]
        like = others.get(record.payload)
        if like is not None:
            self._found.take(record, like.pop())
            self._count -= 1
            if not like:
                del others[record.payload]
            return
        self._waiting[side].setdefault(record.payload, []).append(record)
        self._count += 1
        if self._count > _MOST_EVENTS:
            self.finish()

    def finish(self) -> None:
        """Pair the remaining events by step, robot and kind; the rest is missing in the other run."""
        left, right = (_by_place(self._waiting[side]) for side in ("A", "B"))
        for place in sorted(left.keys() | right.keys()):
            for one, other in zip_longest(left.get(place, []), right.get(place, [])):
                self._found.take(one, other)
        self._waiting = {"A": {}, "B": {}}
        self._count = 0


def _by_place(waiting: dict[bytes, list[Record]]) -> dict[tuple[int, int, int], list[Record]]:
    found: dict[tuple[int, int, int], list[Record]] = {}
    for payload in sorted(waiting):
        for record in waiting[payload]:
            event: Any = record.message
            found.setdefault((event.step, event.agent_id, event.kind), []).append(record)
    return found

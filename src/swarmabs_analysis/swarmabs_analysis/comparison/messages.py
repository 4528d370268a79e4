"""Comparison of two runs message by message: the first difference, deviations by field, and missing messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import zip_longest
from math import inf
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from swarmabs_analysis.difference import MESSAGE, Difference, Side, component_of, differing_fields
from swarmabs_bag.run.step import ORDER, Step
from swarmabs_core.arrays import raw
from swarmabs_core.messages import EVENTS
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from swarmabs_bag.run.step import Rows
    from swarmabs_core.messages import Topic

    Counts: TypeAlias = NDArray[np.integer[Any]]

_KEYS = {"step", "agent_id"}
"""Fields by which messages are paired."""
_MOST_EVENTS = 100_000
"""Most events of one run that wait for an equal event in the other."""


def side_by_side(a: Iterable[Step], b: Iterable[Step]) -> Iterator[tuple[Step | None, Step | None]]:
    """Yield two runs side by side, the same steps of each, with None for those that one of them lacks.

    Both must be in ascending order.
    """
    left, right = _Ahead(a), _Ahead(b)
    while (first := min(left.first, right.first)) < inf:
        if left.first == right.first:
            count = min(left.count, right.count)
            yield left.take(count), right.take(count)
        else:
            ahead, other = (left, right) if left.first == first else (right, left)
            steps = ahead.take(min(ahead.count, other.first - first))
            yield (steps, None) if ahead is left else (None, steps)


class _Ahead:
    """The steps of a run that come next: number of the `first` one, infinite at the end, and how many are known."""

    def __init__(self, steps: Iterable[Step]) -> None:
        self._steps = iter(steps)
        self._next: Step | None = next(self._steps, None)

    @property
    def first(self) -> float:
        return inf if self._next is None else self._next.first

    @property
    def count(self) -> int:
        return 0 if self._next is None else len(self._next)

    def take(self, count: float) -> Step:
        """Remove and return so many steps, at most the known ones."""
        steps = self._next
        assert steps is not None  # noqa: S101 - the caller has looked
        if count == len(steps):
            self._next = next(self._steps, None)
            return steps
        self._next = steps[int(count) :]
        return steps[: int(count)]


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

    def add(self, deviations: NDArray[np.float64] | None, steps: Counts, agents: Counts) -> None:
        """Add the deviations of messages, None if the field has none."""
        self.differing += len(steps)
        if deviations is None:
            return
        finite = np.isfinite(deviations)
        numbers = deviations[finite]
        self.undefined += len(steps) - len(numbers)
        if not len(numbers):
            return
        with np.errstate(over="ignore"):
            # Unlike `sum`, `cumsum` adds one term after the other.
            self._squares = float(np.cumsum(np.concatenate(([self._squares], numbers * numbers)))[-1])
        place = int(np.argmax(numbers))
        if self.largest is None or numbers[place] > self.largest:
            self.largest = float(numbers[place])
            self.step, self.agent = int(steps[finite][place]), int(agents[finite][place])

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
        for difference in _differences(one, other):
            x, y = difference.a, difference.b
            deviation = abs(x - y) if isinstance(x, float) and isinstance(y, float) else None
            deviations = None if deviation is None else np.array([deviation])
            topic.field(difference.field).add(deviations, np.array([one.message.step]), np.array([one.agent_id]))
            self._note(one, difference)

    def take_steps(self, one: Step | None, other: Step | None) -> None:
        """Compare the messages of A and B in the same steps, None if one of them lacks these."""
        ours, theirs = (step.tables if step else {} for step in (one, other))
        for topic in ORDER:
            rows, its = ours.get(topic), theirs.get(topic)
            if rows is None or its is None:
                self._lacking(topic, rows, its)
            elif rows.ndim == 1 or np.array_equal(rows["agent_id"][0], its["agent_id"][0]):
                self._take_rows(topic, rows, its)
            else:
                ids, others = rows["agent_id"][0], its["agent_id"][0]
                here, there = np.isin(ids, others), np.isin(others, ids)
                self._lacking(topic, rows[:, ~here], None)
                self._lacking(topic, None, its[:, ~there])
                self._take_rows(topic, rows[:, here], its[:, there])

    def _lacking(self, topic: Topic, rows: Rows | None, others: Rows | None) -> None:
        """Count messages on a topic that only A or B has."""
        there = others if rows is None else rows
        if there is None or not there.size:
            return
        counts = self._topics.setdefault(topic, TopicComparison(topic.name))
        counts.missing_in_a += there.size if rows is None else 0
        counts.missing_in_b += there.size if others is None else 0
        sides = (None, MESSAGE) if rows is None else (MESSAGE, None)
        first = Record.heard(topic, there.ravel()[:1].tobytes())
        self._note(first, Difference.of(first.message, MESSAGE, *sides))

    def _take_rows(self, topic: Topic, rows: Rows, others: Rows) -> None:
        """Compare messages of A and B on a topic at the same places."""
        if not rows.size:
            return
        if rows.dtype != others.dtype or rows.dtype.names is None:
            for mine, its in zip(*(_heard(topic, messages) for messages in (rows, others)), strict=True):
                self.take(mine, its)
            return
        rows, others = np.ascontiguousarray(rows), np.ascontiguousarray(others)
        counts = self._topics.setdefault(topic, TopicComparison(topic.name))
        counts.compared += rows.size
        differ = (raw(rows) != raw(others)).any(axis=-1)
        if not differ.any():
            return
        ours, theirs = rows[differ], others[differ]
        counts.differing += len(ours)
        steps = ours["step"]
        agents = ours["agent_id"] if "agent_id" in (ours.dtype.names or ()) else np.zeros(len(ours), dtype=int)
        for name, x, y in _columns(topic, ours, theirs):
            bits = x.view(np.int64) != y.view(np.int64) if x.dtype == np.float64 else x != y
            if bits.any():
                with np.errstate(all="ignore"):
                    deviations = np.abs(x - y)[bits] if x.dtype == np.float64 else None
                counts.field(name).add(deviations, steps[bits], agents[bits])
        if self._place is None or (steps[0], ORDER[topic], agents[0]) < self._place:
            mine, its = (Record.heard(topic, some[:1].tobytes()) for some in (ours, theirs))
            self._note(mine, next(_differences(mine, its)))

    def _note(self, record: Record, difference: Difference) -> None:
        place = (record.message.step, ORDER[record.topic], record.agent_id)
        if self._place is None or place < self._place:
            self._place, self.first = place, difference

    def finish(self) -> MessageComparison:
        """Compute the results, and return the comparison."""
        for topic, comparison in self._topics.items():
            comparison.finish(topic.message._fields)
        self.topics = tuple(self._topics[topic] for topic in ORDER if topic in self._topics)
        return self


def _differences(one: Record, other: Record) -> Iterator[Difference]:
    """Yield the fields in which the messages of A and B at one place differ."""
    for name, x, y in differing_fields(one.message, other.message):
        if name not in _KEYS:
            yield Difference.of(one.message, name, x, y)


def _columns(
    topic: Topic, ours: NDArray[np.void], theirs: NDArray[np.void]
) -> Iterator[tuple[str, NDArray[Any], NDArray[Any]]]:
    """Yield the fields of messages by which `differing_fields` compares them, vectors by component, as columns."""
    for name in topic.message._fields:
        if name == "stamp":
            yield name, *(rows["sec"] * np.int64(1_000_000_000) + rows["nanosec"] for rows in (ours, theirs))
        elif name in (ours.dtype.names or ()) and name not in _KEYS:
            x, y = (np.ascontiguousarray(rows[name].T) for rows in (ours, theirs))
            yield from ((f"{name}[{n}]", x[n], y[n]) for n in range(len(x))) if x.ndim > 1 else ((name, x, y),)


def _heard(topic: Topic, rows: Rows) -> Iterator[Record]:
    """Yield messages of a table one after the other."""
    return (Record.heard(topic, row.tobytes()) for row in rows.ravel())


def compare_steps(a: Iterable[Step], b: Iterable[Step]) -> MessageComparison:
    """Compare two runs message by message.

    Both are read in parallel; only the current steps and the events that have no counterpart yet are kept in memory.

    The steps must be as `recorded_steps` yields them: in ascending order, each once, but for late events.
    """
    comparison = MessageComparison()
    events = _Events(comparison)
    for x, y in side_by_side(_without_events(a, events, "A"), _without_events(b, events, "B")):
        comparison.take_steps(x, y)
    events.finish()
    return comparison.finish()


def _without_events(steps: Iterable[Step], events: _Events, side: Side) -> Iterator[Step]:
    """Yield steps, and put their events aside."""
    for step in steps:
        for payload in step.told:
            events.add(Record.heard(EVENTS, payload), side)
        if step.tables:
            yield step


class _Events:
    """Pairs the events of two runs, independent of their place in the bags."""

    def __init__(self, comparison: MessageComparison) -> None:
        self._comparison = comparison
        self._waiting: dict[Side, dict[bytes, list[Record]]] = {"A": {}, "B": {}}
        self._count = 0

    def add(self, record: Record, side: Side) -> None:
        others = self._waiting["B" if side == "A" else "A"]
        like = others.get(record.payload)
        if like is not None:
            self._comparison.take(record, like.pop())
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
                self._comparison.take(one, other)
        self._waiting = {"A": {}, "B": {}}
        self._count = 0


def _by_place(waiting: dict[bytes, list[Record]]) -> dict[tuple[int, int, int], list[Record]]:
    by_place: dict[tuple[int, int, int], list[Record]] = {}
    for payload in sorted(waiting):
        for record in waiting[payload]:
            event: Any = record.message
            by_place.setdefault((event.step, event.agent_id, event.kind), []).append(record)
    return by_place

"""Comparison of two runs message by message: the first difference, deviations by field, and missing messages."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass
from itertools import zip_longest
from math import inf
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from swarmabs_analysis.difference import MESSAGE, Difference, component_of, differing_fields
from swarmabs_bag.run.step import ORDER, Step
from swarmabs_core.arrays import raw
from swarmabs_core.messages import EVENTS, SwarmEvent
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from swarmabs_analysis.difference import Side
    from swarmabs_bag.run.step import Rows
    from swarmabs_core.messages import Topic

    Integers: TypeAlias = NDArray[np.int64]
    Column: TypeAlias = "NDArray[np.float64] | Integers"

Deviation: TypeAlias = "str | int | float | None"
"""A datum of a `FieldDeviation`, or the name of its topic."""

_KEYS = {"step", "agent_id"}
"""Fields by which messages are paired."""
_MOST_EVENTS = 100_000
"""Most different events of one run that wait for an equal event in the other."""


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
    """The steps of a run that come next: number of the `first` one, infinite at the end, and how many were read."""

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
        """Remove and return so many steps, at most those that were read."""
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

    def add(self, deviations: NDArray[np.float64] | None, steps: Integers, agents: Integers) -> None:
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
        if one is None or other is None:
            if present := one or other:
                self._lack(present, "A" if one is None else "B")
            return
        counts = self._counts(one.topic)
        counts.compared += 1
        if one.payload == other.payload:
            return
        counts.differing += 1
        place = np.array([one.message.step]), np.array([one.agent_id])
        for difference in _differences(one, other):
            a, b = difference.a, difference.b
            numbers = isinstance(a, float) and isinstance(b, float)
            counts.field(difference.field).add(np.array([abs(a - b)]) if numbers else None, *place)  # type: ignore[operator]
            self._note(one, difference)

    def take_steps(self, one: Step | None, other: Step | None) -> None:
        """Compare the messages of A and B in the same steps, None if one of them lacks these."""
        ours, theirs = (step.tables if step else {} for step in (one, other))
        for topic in ORDER:
            rows, others = ours.get(topic), theirs.get(topic)
            if rows is None or others is None:
                self._lack_rows(topic, rows, "B")
                self._lack_rows(topic, others, "A")
            elif rows.ndim == 1 or np.array_equal(rows["agent_id"][0], others["agent_id"][0]):
                self._take_rows(topic, rows, others)
            else:
                here, there = rows["agent_id"][0], others["agent_id"][0]
                in_both, also = np.isin(here, there), np.isin(there, here)
                self._lack_rows(topic, rows[:, ~in_both], "B")
                self._lack_rows(topic, others[:, ~also], "A")
                self._take_rows(topic, rows[:, in_both], others[:, also])

    def _counts(self, topic: Topic) -> TopicComparison:
        return self._topics.setdefault(topic, TopicComparison(topic.name))

    def _lack(self, first: Record, side: Side, count: int = 1) -> None:
        """Count messages on a topic that one side lacks, of which the first is given."""
        counts = self._counts(first.topic)
        if side == "A":
            counts.missing_in_a += count
        else:
            counts.missing_in_b += count
        values = (None, MESSAGE) if side == "A" else (MESSAGE, None)
        self._note(first, Difference.of(first.message, MESSAGE, *values))

    def _lack_rows(self, topic: Topic, rows: Rows | None, side: Side) -> None:
        if rows is not None and rows.size:
            self._lack(Record.heard(topic, rows.ravel()[:1].tobytes()), side, rows.size)

    def _take_rows(self, topic: Topic, rows: Rows, others: Rows) -> None:
        """Compare messages of A and B on a topic at the same places."""
        if not rows.size:
            return
        if rows.dtype != others.dtype or rows.dtype.names is None:
            for row, its in zip(rows.ravel(), others.ravel(), strict=True):
                self.take(Record.heard(topic, row.tobytes()), Record.heard(topic, its.tobytes()))
            return
        rows, others = np.ascontiguousarray(rows), np.ascontiguousarray(others)
        counts = self._counts(topic)
        counts.compared += rows.size
        differ = (raw(rows) != raw(others)).any(axis=-1)
        if not differ.any():
            return
        ours, theirs = rows[differ], others[differ]
        counts.differing += len(ours)
        steps = ours["step"].astype(np.int64)
        has_agents = "agent_id" in (ours.dtype.names or ())
        agents = ours["agent_id"].astype(np.int64) if has_agents else np.zeros(len(ours), dtype=np.int64)
        for name, x, y in _columns(topic, ours, theirs):
            bits = x.view(np.int64) != y.view(np.int64) if x.dtype == np.float64 else x != y
            if bits.any():
                with np.errstate(all="ignore"):
                    deviations = np.abs(x - y)[bits] if x.dtype == np.float64 else None
                counts.field(name).add(deviations, steps[bits], agents[bits])
        if self._place is None or (steps[0], ORDER[topic], agents[0]) < self._place:
            one, other = (Record.heard(topic, some[:1].tobytes()) for some in (ours, theirs))
            self._note(one, next(_differences(one, other)))

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

    def deviations(self) -> list[dict[str, Deviation]]:
        """Return the deviation of each field that differs, with its topic, as plain data for JSON."""
        return [{"topic": topic.topic, **asdict(field)} for topic in self.topics for field in topic.fields]


def _differences(one: Record, other: Record) -> Iterator[Difference]:
    """Yield the fields in which the messages of A and B at one place differ."""
    for name, x, y in differing_fields(one.message, other.message):
        if name not in _KEYS:
            yield Difference.of(one.message, name, x, y)


def _columns(topic: Topic, ours: NDArray[np.void], theirs: NDArray[np.void]) -> Iterator[tuple[str, Column, Column]]:
    """Yield the fields of messages by which `differing_fields` compares them, vectors by component, as columns."""
    for name in topic.message._fields:
        if name == "stamp":
            yield name, *(rows["sec"] * np.int64(1_000_000_000) + rows["nanosec"] for rows in (ours, theirs))
        elif name in (ours.dtype.names or ()) and name not in _KEYS:
            x, y = (np.ascontiguousarray(rows[name].T) for rows in (ours, theirs))
            yield from ((f"{name}[{n}]", x[n], y[n]) for n in range(len(x))) if x.ndim > 1 else ((name, x, y),)


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
            events.add(payload, side)
        if step.tables:
            yield step


class _Events:
    """Pairs the events of two runs, independent of their place in the bags."""

    def __init__(self, comparison: MessageComparison) -> None:
        self._comparison = comparison
        self._surplus: Counter[bytes] = Counter()  # how often A has an event more often than B

    def add(self, payload: bytes, side: Side) -> None:
        """Pair an event with an equal one of the other run, or keep it."""
        before = self._surplus[payload]
        after = self._surplus[payload] = before + (1 if side == "A" else -1)
        if abs(after) < abs(before):
            record = Record.heard(EVENTS, payload)
            self._comparison.take(record, record)
        if not after:
            del self._surplus[payload]
        if len(self._surplus) > _MOST_EVENTS:
            self.finish()

    def finish(self) -> None:
        """Pair the remaining events by step, robot and kind; the rest is missing in the other run."""
        by_place: dict[tuple[int, int, int], tuple[list[Record], list[Record]]] = {}
        for payload, surplus in sorted(self._surplus.items()):
            record = Record.heard(EVENTS, payload)
            event = record.message
            assert isinstance(event, SwarmEvent)  # noqa: S101 - by topic
            sides = by_place.setdefault((event.step, event.agent_id, event.kind), ([], []))
            sides[surplus < 0].extend([record] * abs(surplus))
        for _, (ours, theirs) in sorted(by_place.items(), key=lambda item: item[0]):
            for one, other in zip_longest(ours, theirs):
                self._comparison.take(one, other)
        self._surplus.clear()

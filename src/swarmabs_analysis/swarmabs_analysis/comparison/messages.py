"""Comparison of two runs message by message: the first difference, deviations by field, and missing messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import zip_longest
from math import inf
from typing import TYPE_CHECKING, Any, TypeAlias, overload

import numpy as np

from swarmabs_analysis.difference import MESSAGE, Difference, Side, component_of, differing_fields
from swarmabs_bag.run.blocks import Block
from swarmabs_bag.run.ordering import ORDER
from swarmabs_bag.run.recording import RecordedStep
from swarmabs_core.arrays import raw
from swarmabs_core.messages import EVENTS
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from swarmabs_core.messages import Topic

    Counts: TypeAlias = NDArray[np.integer[Any]]

_KEYS = {"step", "agent_id"}
"""Fields by which messages are paired."""
_MOST_EVENTS = 100_000
"""Most events of one run that wait for an equal event in the other."""


@overload
def side_by_side(
    a: Iterable[RecordedStep], b: Iterable[RecordedStep]
) -> Iterator[tuple[RecordedStep | None, RecordedStep | None]]: ...
@overload
def side_by_side(
    a: Iterable[RecordedStep | Block], b: Iterable[RecordedStep | Block]
) -> Iterator[tuple[RecordedStep | None, RecordedStep | None] | tuple[Block, Block]]: ...
def side_by_side(
    a: Iterable[RecordedStep | Block], b: Iterable[RecordedStep | Block]
) -> Iterator[tuple[RecordedStep | None, RecordedStep | None] | tuple[Block, Block]]:
    """Yield two runs step by step, with None for a step that one of them lacks; both must be in ascending order.

    Where both have blocks, yield parts of these with the same steps.
    """
    left, right = _Ahead(a), _Ahead(b)
    while (step := min(left.step, right.step)) < inf:
        ours, theirs = left.block, right.block
        if ours is not None and theirs is not None and left.step == right.step:
            count = min(len(ours), len(theirs))
            yield left.part(count), right.part(count)
        else:
            yield left.single(step), right.single(step)


class _Ahead:
    """The steps of a run of which the first is known, as `step`, infinite at the end; as `block` if it is in one."""

    def __init__(self, steps: Iterable[RecordedStep | Block]) -> None:
        self._steps = iter(steps)
        self.step = -inf
        self.block: Block | None = None
        self._next()

    def _next(self) -> None:
        self._found = next(self._steps, None)
        self._begin()

    def _begin(self) -> None:
        found = self._found
        self.block = found if isinstance(found, Block) else None
        self.step = inf if found is None else found.first if isinstance(found, Block) else found.step

    def part(self, count: int) -> Block:
        """Remove and return the first steps of the block."""
        block = self.block
        assert block is not None  # noqa: S101 - the caller has looked
        if count == len(block):
            self._next()
        else:
            self._found = block[count:]
            self._begin()
        return block[:count]

    def single(self, step: float) -> RecordedStep | None:
        """Remove and return the first step if it has this number, None if not."""
        if self.step != step:
            return None
        if self.block is not None:
            return next(self.part(1).recorded())
        found = self._found
        self._next()
        return found if isinstance(found, RecordedStep) else None


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

    def add_several(self, deviations: NDArray[np.float64] | None, steps: Counts, agents: Counts) -> None:
        """Add the deviations of messages as `add` does one after the other, None if the field has none."""
        self.differing += len(steps)
        if deviations is None:
            return
        finite = np.isfinite(deviations)
        known = deviations[finite]
        self.undefined += len(steps) - len(known)
        if not len(known):
            return
        with np.errstate(over="ignore"):
            # Unlike `sum`, `cumsum` adds one term after the other.
            self._squares = float(np.cumsum(np.concatenate(([self._squares], known * known)))[-1])
        place = int(np.argmax(known))
        if self.largest is None or known[place] > self.largest:
            self.largest = float(known[place])
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
            topic.field(difference.field).add(deviation, one.message.step, one.agent_id)
            self._note(one, difference)

    def take_blocks(self, one: Block, other: Block) -> None:
        """Compare the messages of A and B in the same steps; both have the same robots and layouts."""
        for topic, table in one.tables.items():
            found = self._topics.setdefault(topic, TopicComparison(topic.name))
            found.compared += table.size
            differ = (raw(table) != raw(other.tables[topic])).any(axis=-1)
            if not differ.any():
                continue
            ours, theirs = table[differ], other.tables[topic][differ]
            found.differing += len(ours)
            steps = ours["step"]
            agents = ours["agent_id"] if "agent_id" in (ours.dtype.names or ()) else np.zeros(len(ours), dtype=int)
            for name, x, y in _columns(topic, ours, theirs):
                bits = x.view(np.int64) != y.view(np.int64) if x.dtype == np.float64 else x != y
                if bits.any():
                    with np.errstate(all="ignore"):
                        deviations = np.abs(x - y)[bits] if x.dtype == np.float64 else None
                    found.field(name).add_several(deviations, steps[bits], agents[bits])
            if self._place is None or (steps[0], ORDER[topic], agents[0]) < self._place:
                mine, its = (Record.heard(topic, rows[:1].tobytes()) for rows in (ours, theirs))
                self._note(mine, next(_differences(mine, its)))

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


def compare_steps(a: Iterable[RecordedStep | Block], b: Iterable[RecordedStep | Block]) -> MessageComparison:
    """Compare two runs message by message.

    Both are read in parallel; only the current step and the events that have no counterpart yet are kept in memory.

    The steps must be as `recorded_steps` yields them: those of main topics in ascending order, each once; events in
    separate steps, in any order.
    """
    found = MessageComparison()
    events = _Events(found)
    for x, y in side_by_side(_main_steps(a, events, "A"), _main_steps(b, events, "B")):
        if isinstance(x, Block) and isinstance(y, Block):
            if x.alike(y):
                found.take_blocks(x, y)
            else:
                for ours, theirs in zip(x.recorded(), y.recorded(), strict=True):
                    _take_step(found, ours, theirs)
        elif not isinstance(x, Block) and not isinstance(y, Block):
            _take_step(found, x, y)
    events.finish()
    return found.finish()


def _take_step(found: MessageComparison, a: RecordedStep | None, b: RecordedStep | None) -> None:
    """Compare the messages of a step."""
    ours, theirs = ({_place(record): record for record in step.records} if step else {} for step in (a, b))
    for place in sorted(ours.keys() | theirs.keys()):
        found.take(ours.get(place), theirs.get(place))


def _place(record: Record) -> tuple[int, str, int]:
    """Return the place of a message in its step; topics of different families have places of their own."""
    return ORDER[record.topic], record.topic.name, record.agent_id


def _main_steps(steps: Iterable[RecordedStep | Block], events: _Events, side: Side) -> Iterator[RecordedStep | Block]:
    for step in steps:
        if isinstance(step, RecordedStep) and step.records[0].topic is EVENTS:
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

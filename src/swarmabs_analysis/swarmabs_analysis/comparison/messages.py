"""Two runs side by side, step by step."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.comparison.steps import ORDER
from swarmabs_analysis.difference import MESSAGE, Difference, Side, differing_fields
from swarmabs_core.messages import EVENTS

if TYPE_CHECKING:
    from swarmabs_bag.recording import RecordedStep
    from swarmabs_core.messages import Topic
    from swarmabs_core.record import Record

_KEYS = {"step", "agent_id"}
"""Fields by which messages are brought together."""
_MOST_EVENTS = 100_000
"""Most events of one run that wait for their like in the other."""


@dataclass(frozen=True, slots=True)
class FieldDeviation:
    """How far a field of a topic deviates between two runs, over the messages that both have.

    Attributes
    ----------
    field : str
        The field.
    differing : int
        In how many messages its bits differ.
    largest : float or None
        Largest finite absolute deviation, in the field's unit; None for fields that are no float64, and if there is
        none.
    step, agent : int or None
        Where the largest deviation is first; `agent` 0 for none.
    rms : float or None
        Root mean square of the finite deviations over all messages that both have; None like `largest`.
    undefined : int
        In how many of the differing messages the deviation is no finite number.
    """

    field: str
    differing: int
    largest: float | None
    step: int | None
    agent: int | None
    rms: float | None
    undefined: int


@dataclass(frozen=True, slots=True)
class TopicComparison:
    """A topic of two runs: number of messages in both, of those that differ, of those in one alone; by field."""

    topic: str
    compared: int
    differing: int
    missing_in_a: int
    missing_in_b: int
    fields: tuple[FieldDeviation, ...]


@dataclass(frozen=True, slots=True)
class MessageComparison:
    """What `compare_steps` finds: the first difference in order of step, topic, robot, field; and all topics."""

    first: Difference | None
    topics: tuple[TopicComparison, ...]

    @property
    def equal(self) -> bool:
        """Whether both runs have the same messages, bit for bit."""
        return self.first is None


def compare_steps(a: Iterable[RecordedStep], b: Iterable[RecordedStep]) -> MessageComparison:
    """Compare two runs message by message.

    Both are read in step with each other, and no more of them is kept than the step at hand and the events that
    only one of them has so far.

    Parameters
    ----------
    a, b : iterable of RecordedStep
        The runs, as `recorded_steps` yields them: steps of main topics in ascending order, each step once; events
        in steps of their own, in any order.
    """
    found = _Found()
    events = _Events(found)
    left, right = _main_steps(a, events, "A"), _main_steps(b, events, "B")
    x, y = next(left, None), next(right, None)
    while x is not None or y is not None:
        if x is not None and (y is None or x.step < y.step):
            _alone(x, "B", found)
            x = next(left, None)
        elif y is not None and (x is None or y.step < x.step):
            _alone(y, "A", found)
            y = next(right, None)
        elif x is not None and y is not None:
            _together(x, y, found)
            x, y = next(left, None), next(right, None)
    events.finish()
    return found.result()


def _main_steps(steps: Iterable[RecordedStep], events: _Events, side: Side) -> Iterator[RecordedStep]:
    for step in steps:
        if step.records[0].topic is EVENTS:
            for record in step.records:
                events.add(record, side)
        else:
            yield step


def _alone(step: RecordedStep, missing: Side, found: _Found) -> None:
    for record in step.records:
        found.missing(record, missing)


def _together(x: RecordedStep, y: RecordedStep, found: _Found) -> None:
    ours = {(ORDER[record.topic], record.agent_id): record for record in x.records}
    theirs = {(ORDER[record.topic], record.agent_id): record for record in y.records}
    for place in sorted(ours.keys() | theirs.keys()):
        one, other = ours.get(place), theirs.get(place)
        if one is None or other is None:
            record = one or other
            if record is not None:
                found.missing(record, "A" if one is None else "B")
        else:
            found.pair(one, other)


class _Field:
    """What has been found of a field so far."""

    __slots__ = ("agent", "differing", "largest", "squares", "step", "undefined")

    def __init__(self) -> None:
        self.differing = 0
        self.undefined = 0
        self.largest: float | None = None
        self.step: int | None = None
        self.agent: int | None = None
        self.squares = 0.0

    def add(self, deviation: float | None, step: int, agent: int) -> None:
        self.differing += 1
        if deviation is None:
            return
        if not math.isfinite(deviation):
            self.undefined += 1
            return
        self.squares += deviation * deviation
        if self.largest is None or deviation > self.largest:
            self.largest, self.step, self.agent = deviation, step, agent

    def result(self, name: str, compared: int) -> FieldDeviation:
        counted = compared - self.undefined
        rms = math.sqrt(self.squares / counted) if self.largest is not None else None
        return FieldDeviation(
            name,
            self.differing,
            self.largest,
            self.step,
            self.agent,
            rms if rms is not None and math.isfinite(rms) else None,
            self.undefined,
        )


class _Topic:
    """What has been found of a topic so far."""

    __slots__ = ("compared", "differing", "fields", "missing")

    def __init__(self) -> None:
        self.compared = 0
        self.differing = 0
        self.missing: dict[Side, int] = {"A": 0, "B": 0}
        self.fields: dict[str, _Field] = {}

    def result(self, topic: Topic) -> TopicComparison:
        names = [name for name in topic.message._fields if name in self.fields]
        return TopicComparison(
            topic.name,
            self.compared,
            self.differing,
            self.missing["A"],
            self.missing["B"],
            tuple(self.fields[name].result(name, self.compared) for name in names),
        )


class _Found:
    """Gathers what is found."""

    def __init__(self) -> None:
        self._topics: dict[Topic, _Topic] = {}
        self._first: tuple[tuple[int, int, int], Difference] | None = None

    def missing(self, record: Record, side: Side) -> None:
        self._of(record.topic).missing[side] += 1
        there, missing = (MESSAGE, None) if side == "B" else (None, MESSAGE)
        self._note(record, Difference.of(record.message, MESSAGE, there, missing))

    def pair(self, one: Record, other: Record) -> None:
        topic = self._of(one.topic)
        topic.compared += 1
        if one.payload == other.payload:
            return
        topic.differing += 1
        step, agent = one.message.step, one.agent_id
        for name, x, y in differing_fields(one.message, other.message):
            if name in _KEYS:
                continue
            deviation = abs(x - y) if isinstance(x, float) and isinstance(y, float) else None
            field = topic.fields.setdefault(name, _Field())
            field.add(deviation, step, agent)
            self._note(one, Difference.of(one.message, name, x, y))

    def result(self) -> MessageComparison:
        return MessageComparison(
            self._first[1] if self._first is not None else None,
            tuple(self._topics[topic].result(topic) for topic in ORDER if topic in self._topics),
        )

    def _of(self, topic: Topic) -> _Topic:
        return self._topics.setdefault(topic, _Topic())

    def _note(self, record: Record, difference: Difference) -> None:
        place = (record.message.step, ORDER[record.topic], record.agent_id)
        if self._first is None or place < self._first[0]:
            self._first = (place, difference)


class _Events:
    """Brings the events of two runs together, wherever in their bags they stand."""

    def __init__(self, found: _Found) -> None:
        self._found = found
        self._waiting: dict[Side, dict[bytes, list[Record]]] = {"A": {}, "B": {}}
        self._count = 0

    def add(self, record: Record, side: Side) -> None:
        others = self._waiting["B" if side == "A" else "A"]
        like = others.get(record.payload)
        if like is not None:
            self._found.pair(record, like.pop())
            self._count -= 1
            if not like:
                del others[record.payload]
            return
        self._waiting[side].setdefault(record.payload, []).append(record)
        self._count += 1
        if self._count > _MOST_EVENTS:
            self.finish()

    def finish(self) -> None:
        """Pair what is left by step, robot and kind; what then remains is missing in the other run."""
        left, right = (_byplace_of(self._waiting[side]) for side in ("A", "B"))
        for place in sorted(left.keys() | right.keys()):
            ours, theirs = left.get(place, []), right.get(place, [])
            both = min(len(ours), len(theirs))
            for one, other in zip(ours[:both], theirs[:both], strict=True):
                self._found.pair(one, other)
            for record in ours[both:]:
                self._found.missing(record, "B")
            for record in theirs[both:]:
                self._found.missing(record, "A")
        self._waiting = {"A": {}, "B": {}}
        self._count = 0


def _byplace_of(waiting: dict[bytes, list[Record]]) -> dict[tuple[int, int, int], list[Record]]:
    found: dict[tuple[int, int, int], list[Record]] = {}
    for payload in sorted(waiting):
        for record in waiting[payload]:
            event: Any = record.message
            found.setdefault((event.step, event.agent_id, event.kind), []).append(record)
    return found

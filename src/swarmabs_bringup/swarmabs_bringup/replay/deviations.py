"""What nodes under test have said, beside what was recorded of them."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

from swarmabs_core.behaviours.player import publisher_of
from swarmabs_core.messages import EVENTS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from swarmabs_core.behaviours.player import NodeName
    from swarmabs_core.recording import Record, RecordedStep

Value = float | str | None


@dataclass(frozen=True, slots=True)
class Difference:
    """The first field of the first message that differs; robot 0 for none."""

    step: int
    topic: str
    agent: int
    field: str
    recorded: Value
    replayed: Value


@dataclass(slots=True)
class Deviation:
    """In how many messages a field differs, and where the most: in the field's unit, None if it is no number."""

    topic: str
    field: str
    differing: int = 0
    largest: float | None = None
    step: int | None = None
    agent: int | None = None

    def note(self, before: Record, old: Value, new: Value) -> None:
        """Count a message in which the field differs."""
        self.differing += 1
        if isinstance(old, str) or isinstance(new, str) or old is None or new is None:
            return
        size = abs(new - old)
        if isfinite(size) and (self.largest is None or size > self.largest):
            self.largest, self.step, self.agent = float(size), before.message.step, before.agent_id


@dataclass(frozen=True, slots=True)
class Deviations:
    """How far the answers of the nodes under test are from what was recorded of them.

    Attributes
    ----------
    messages : int
        Number of messages compared; events are not.
    first : Difference or None
        The first difference, None if there is none.
    fields : tuple of Deviation
        The fields that differ, in the order in which they first do.
    """

    messages: int
    first: Difference | None
    fields: tuple[Deviation, ...]


def deviations(
    recorded: Iterable[RecordedStep], replayed: Iterable[RecordedStep], nodes: Collection[NodeName]
) -> Deviations:
    """Compare a replay with its recording, as far as the shorter of both goes.

    Parameters
    ----------
    recorded, replayed : iterable of RecordedStep
        Both, in order.
    nodes : collection of NodeName
        The nodes under test.
    """
    live = frozenset(nodes)
    count = 0
    first: Difference | None = None
    fields: dict[tuple[str, str], Deviation] = {}
    for before, after in zip(_answers(recorded, live), _answers(replayed, live), strict=False):
        count += 1
        if before.payload == after.payload:
            continue
        topic = before.topic.name
        old, new = before.message._asdict(), after.message._asdict()
        for name in old:
            if repr(old[name]) != repr(new[name]):  # 0.0 is not -0.0, and NaN is NaN
                if first is None:
                    first = Difference(before.message.step, topic, before.agent_id, name, old[name], new[name])
                fields.setdefault((topic, name), Deviation(topic, name)).note(before, old[name], new[name])
    return Deviations(count, first, tuple(fields.values()))


def _answers(steps: Iterable[RecordedStep], live: frozenset[NodeName]) -> Iterator[Record]:
    for step in steps:
        for record in step.records:
            if record.topic is not EVENTS and publisher_of(record.message) in live:
                yield record

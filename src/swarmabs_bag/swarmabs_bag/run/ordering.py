"""The steps of a recorded run, sorted in bounded memory."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, overload

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.run.blocks import Block
from swarmabs_bag.run.recording import RecordedStep
from swarmabs_core.messages import DESIRED_ABSTRACT_STATE, EVENTS, FAMILIES, MAIN_TOPICS, STANDING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from swarmabs_core.record import Record

WINDOW = 8
"""Steps by which a message may be late: in bags of other recorders, topics overlap."""
REALTIME_WINDOW = 300
"""The same in real time, where topics are received independently of each other."""
ORDER = {
    topic: number
    for family in FAMILIES
    for number, topic in enumerate((*family.once, *family.main[:-1], STANDING, family.desired), -len(family.once))
} | {EVENTS: len(MAIN_TOPICS) + 1}
"""Place of each recorded topic within a step of a bag."""


class DisorderError(DamagedBagError):
    """A message is duplicated in a bag, or far out of order."""


@overload
def recorded_steps(
    records: Iterable[Record], name: str, *, realtime: bool = ..., window: int | None = ...
) -> Iterator[RecordedStep]: ...
@overload
def recorded_steps(
    records: Iterable[Record | Block], name: str, *, realtime: bool = ..., window: int | None = ...
) -> Iterator[RecordedStep | Block]: ...
def recorded_steps(
    records: Iterable[Record | Block], name: str, *, realtime: bool = False, window: int | None = None
) -> Iterator[RecordedStep | Block]:
    """Yield the steps of a run in ascending order, and each event, which may be late, immediately as a separate step.

    Steps that are given as blocks are yielded as blocks, unless messages between them belong to the same steps. Errors
    refer to the bag by `name`. Equal copies of a message are skipped. In real time the first of two desired states of a
    step, with different modes, counts. `window` overrides the number of steps by which a message may be late.

    Raises
    ------
    DisorderError
        If two messages differ in one place, or one is more than `WINDOW` steps late; all steps more than `WINDOW`
        before it have been yielded.
    """
    waiting = _Waiting()
    events: set[bytes] = set()
    latest = -1
    if window is None:
        window = REALTIME_WINDOW if realtime else WINDOW
    for found in records:
        if isinstance(found, Block) and found.first > latest:
            latest = found.step
            waiting.blocks.append(found)
            yield from waiting.taken(latest - window)
            continue
        for record in _records_of(found):
            topic, step = record.topic, record.message.step
            place = ORDER.get(topic)
            if place is None:
                continue
            if topic is EVENTS:
                if record.payload not in events:
                    events.add(record.payload)
                    yield RecordedStep(step, (record,))
                continue
            if step <= latest - window:
                raise DisorderError(f"{name}: {_place(record)} follows step {latest}, out of order")
            slot = waiting.slot(step)
            known = slot.get((place, record.agent_id))
            if known is not None:
                # Nodes in lockstep repeat messages, and other recorders keep what they hear.
                if known.payload == record.payload or (realtime and topic is DESIRED_ABSTRACT_STATE):
                    continue
                raise DisorderError(f"{name}: there are two different messages: {_place(record)}")
            slot[place, record.agent_id] = record
            if step > latest:
                latest = step
                yield from waiting.taken(latest - window)
    yield from waiting.taken(latest)


class _Waiting:
    """The steps of which more messages may come: message by message, followed by blocks.

    Attributes
    ----------
    blocks : deque of Block
        Complete steps after all others, in order.
    """

    def __init__(self) -> None:
        self._slots: dict[int, dict[tuple[int, int], Record]] = {}
        self.blocks: deque[Block] = deque()

    def slot(self, step: int) -> dict[tuple[int, int], Record]:
        """Return the messages of a step by their places; from then on all that waits is taken apart."""
        while self.blocks:
            for whole in self.blocks.popleft().recorded():
                self._slots[whole.step] = {(ORDER[record.topic], record.agent_id): record for record in whole.records}
        return self._slots.setdefault(step, {})

    def taken(self, last: int) -> Iterator[RecordedStep | Block]:
        """Remove and yield the steps up to a last one."""
        for step in sorted(number for number in self._slots if number <= last):
            yield RecordedStep(step, _sorted(self._slots.pop(step)))
        while self.blocks and self.blocks[0].first <= last:
            block = self.blocks.popleft()
            count = last - block.first + 1
            if count < len(block):
                self.blocks.appendleft(block[count:])
            yield block[:count]


def _records_of(found: Record | Block) -> Iterable[Record]:
    if not isinstance(found, Block):
        return (found,)
    return (record for step in found.recorded() for record in step.records)


def _sorted(slot: dict[tuple[int, int], Record]) -> tuple[Record, ...]:
    return tuple(slot[place] for place in sorted(slot))


def _place(record: Record) -> str:
    agent = f" of agent {record.agent_id}" if record.agent_id else ""
    return f"/{record.topic.name}{agent} at step {record.message.step}"

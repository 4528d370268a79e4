"""The steps of a recorded run, sorted in bounded memory."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.run.step import ORDER, Step
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import DESIRED_ABSTRACT_STATE, EVENTS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from swarmabs_core.record import Record

WINDOW = 8
"""Steps by which a message may be late: in bags of other recorders, topics overlap."""
REALTIME_WINDOW = 300
"""The same in real time, where topics are received independently of each other."""


class DisorderError(DamagedBagError):
    """A message is duplicated in a bag, or far out of order."""


def recorded_steps(
    records: Iterable[Record | Step], name: str, *, realtime: bool = False, window: int | None = None
) -> Iterator[Step]:
    """Yield the steps of a run in ascending order, and each event, which may be late, immediately as a separate step.

    What is given as whole steps is yielded as such, unless messages between them belong to the same steps. Errors refer
    to the bag by `name`. Equal copies of a message are skipped. In real time the first of two desired states of a
    step, with different modes, counts. `window` overrides the number of steps by which a message may be late.

    Raises
    ------
    DisorderError
        If two messages differ in one place, or one is more than `WINDOW` steps late; all steps more than `WINDOW`
        before it have been yielded.
    """
    waiting = _Waiting(name)
    events: set[bytes] = set()
    latest = -1
    if window is None:
        window = REALTIME_WINDOW if realtime else WINDOW
    for read in records:
        if isinstance(read, Step) and read.first > latest:
            latest = read.step
            waiting.whole.append(read)
            yield from waiting.taken(latest - window)
            continue
        for record in read.records if isinstance(read, Step) else (read,):
            topic, step = record.topic, record.message.step
            place = ORDER.get(topic)
            if place is None:
                continue
            if topic is EVENTS:
                if record.payload not in events:
                    events.add(record.payload)
                    yield Step(step, {}, (record.payload,))
                continue
            if step <= latest - window:
                raise DisorderError(f"{name}: {_place(record)} follows step {latest}, out of order")
            slot = waiting.slot(step)
            there = slot.get((place, record.agent_id))
            if there is not None:
                # Nodes in lockstep repeat messages, and other recorders keep what they hear.
                if there.payload == record.payload or (realtime and topic is DESIRED_ABSTRACT_STATE):
                    continue
                raise DisorderError(f"{name}: there are two different messages: {_place(record)}")
            slot[place, record.agent_id] = record
            if step > latest:
                latest = step
                yield from waiting.taken(latest - window)
    yield from waiting.taken(latest)


class _Waiting:
    """The steps of which more messages may come: message by message, followed by whole steps.

    Attributes
    ----------
    whole : deque of Step
        Complete steps after all others, in order.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._slots: dict[int, dict[tuple[int, int], Record]] = {}
        self.whole: deque[Step] = deque()

    def slot(self, step: int) -> dict[tuple[int, int], Record]:
        """Return the messages of a step by their places; from then on all that waits is taken apart."""
        while self.whole:
            for record in self.whole.popleft().records:
                self._slots.setdefault(record.message.step, {})[ORDER[record.topic], record.agent_id] = record
        return self._slots.setdefault(step, {})

    def taken(self, last: int) -> Iterator[Step]:
        """Remove and yield the steps up to a last one."""
        for step in sorted(number for number in self._slots if number <= last):
            try:
                yield Step.of(step, self._slots.pop(step).values())
            except MalformedMessageError as error:
                raise DamagedBagError(f"{self._name}: step {step}: {error}") from error
        while self.whole and self.whole[0].first <= last:
            steps = self.whole.popleft()
            count = last - steps.first + 1
            if count < len(steps):
                self.whole.appendleft(steps[count:])
            yield steps[:count]


def _place(record: Record) -> str:
    agent = f" of agent {record.agent_id}" if record.agent_id else ""
    return f"/{record.topic.name}{agent} at step {record.message.step}"

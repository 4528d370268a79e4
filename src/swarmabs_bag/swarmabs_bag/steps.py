"""The steps of a recorded run, sorted in bounded memory."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.recording import RecordedStep
from swarmabs_core.messages import DESIRED_ABSTRACT_STATE, EVENTS, FAMILIES, MAIN_TOPICS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from swarmabs_core.record import Record

WINDOW = 8
"""Steps by which a message may be late: in bags of other recorders, topics overlap."""
REALTIME_WINDOW = 300
"""The same in real time, where topics are received independently of each other."""
ORDER = {
    topic: number for family in FAMILIES for number, topic in enumerate((*family.once, *family.main), -len(family.once))
} | {EVENTS: len(MAIN_TOPICS)}
"""Place of each recorded topic within a step of a bag."""


class DisorderError(DamagedBagError):
    """A message is duplicated in a bag, or far out of order."""


def recorded_steps(
    records: Iterable[Record], name: str, *, realtime: bool = False, window: int | None = None
) -> Iterator[RecordedStep]:
    """Yield the steps of a run in ascending order, and each event, which may be late, immediately as a separate step.

    Errors refer to the bag by `name`. In real time the first of two desired states of a step, with different modes,
    counts. `window` overrides the number of steps by which a message may be late.

    Raises
    ------
    DisorderError
        If a message is duplicated, or more than `WINDOW` steps late; all steps more than `WINDOW` before it have been
        yielded.
    """
    waiting: dict[int, dict[tuple[int, int], Record]] = {}
    latest = -1
    if window is None:
        window = REALTIME_WINDOW if realtime else WINDOW
    for record in records:
        topic, step = record.topic, record.message.step
        place = ORDER.get(topic)
        if place is None:
            continue
        if topic is EVENTS:
            yield RecordedStep(step, (record,))
            continue
        if step <= latest - window:
            raise DisorderError(f"{name}: {_place(record)} follows step {latest}, out of order")
        slot = waiting.setdefault(step, {})
        if (place, record.agent_id) in slot and realtime and topic is DESIRED_ABSTRACT_STATE:
            continue
        if (place, record.agent_id) in slot:
            raise DisorderError(f"{name}: {_place(record)} is duplicated")
        slot[place, record.agent_id] = record
        if step > latest:
            latest = step
            for ready in sorted(number for number in waiting if number <= latest - window):
                yield RecordedStep(ready, _sorted(waiting.pop(ready)))
    for number in sorted(waiting):
        yield RecordedStep(number, _sorted(waiting[number]))


def _sorted(slot: dict[tuple[int, int], Record]) -> tuple[Record, ...]:
    return tuple(slot[place] for place in sorted(slot))


def _place(record: Record) -> str:
    agent = f" of agent {record.agent_id}" if record.agent_id else ""
    return f"/{record.topic.name}{agent} at step {record.message.step}"

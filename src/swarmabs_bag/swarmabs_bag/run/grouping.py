"""Complete steps in the order of a bag, found in the arrays of stored messages and taken as blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.run.blocks import Block

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray
    from typing_extensions import Self

    from swarmabs_bag.mcap.stored import StoredMessages
    from swarmabs_core.messages import Family, Topic

_MOST_BYTES = 2**24
"""Bytes of messages up to which they may be the beginning of a step: more than those of any step."""


class Published(NamedTuple):
    """A message in a bag: log and publish time in ns, and CDR payload."""

    topic: Topic
    time: int
    published: int
    payload: bytes


class TopicMessages:
    """Stored messages of a swarm, with their topics.

    Attributes
    ----------
    stored : StoredMessages
        The messages.
    topics : tuple of Topic
        The topics of the swarm.
    places : ndarray of int64
        Place of each message's topic in `topics`.
    """

    __slots__ = ("places", "stored", "topics")

    def __init__(self, stored: StoredMessages, topics: tuple[Topic, ...], places: NDArray[np.int64]) -> None:
        self.stored, self.topics, self.places = stored, topics, places

    @classmethod
    def of(cls, stored: StoredMessages, wanted: Mapping[int, Topic]) -> Self:
        """Return those of the messages whose channels are wanted, by number."""
        place_of = np.full(2**16, -1)
        place_of[list(wanted)] = range(len(wanted))
        places = place_of[stored.heads["channel_id"]]
        known = places >= 0
        if known.all():
            return cls(stored, tuple(wanted.values()), places)
        return cls(stored[known], tuple(wanted.values()), places[known])

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.places)

    def __getitem__(self, selected: slice | NDArray[np.bool_]) -> Self:
        """Return some of the messages."""
        return type(self)(self.stored[selected], self.topics, self.places[selected])

    def __iter__(self) -> Iterator[Published]:
        """Yield the messages one after the other."""
        topics = self.topics
        for place, (_, _, time, published, payload) in zip(self.places.tolist(), self.stored, strict=True):
            yield Published(topics[place], time, published, payload)

    def joined(self, other: Self) -> Self:
        """Return these messages, followed by others on the same topics."""
        return type(self)(self.stored.joined(other.stored), self.topics, np.concatenate((self.places, other.places)))

    def on(self, topic: Topic) -> Self:
        """Return the messages on a topic."""
        return self[self.places == self.topics.index(topic)] if topic in self.topics else self[:0]


def in_blocks(tables: Iterable[TopicMessages], family: Family) -> Iterator[Block | Published]:
    """Yield messages in order, as blocks where steps of a family are complete, canonical and follow each other.

    The log and publish time of a message in a block are the time of its step.
    """
    rest: TopicMessages | None = None
    try:
        for table in tables:
            found = table if rest is None else rest.joined(table)
            end = 0
            for part, robots in _parts(found, family):
                end += len(part)
                block = _block(part, robots, family) if robots else None
                if block is None:
                    yield from part
                else:
                    yield block
            rest = found[end:]
            if int(rest.stored.sizes.sum()) > _MOST_BYTES:
                yield from rest
                rest = None
    except DamagedBagError:
        yield from rest or ()
        raise
    yield from rest or ()


def _parts(found: TopicMessages, family: Family) -> Iterator[tuple[TopicMessages, int]]:
    """Split messages up to the end of the last step; with the number of robots, 0 if they are not whole steps.

    Messages on other topics than the main ones, such as events, may precede a step, in a part of their own.
    """
    places = np.full(len(found.topics), -1)
    for number, topic in enumerate(family.main):
        if topic in found.topics:
            places[found.topics.index(topic)] = number
    order = places[found.places]
    last = len(family.main) - 1
    ends = np.flatnonzero(order == last)
    if not len(ends):
        return
    starts = np.concatenate(([0], ends[:-1] + 1))
    descents = np.concatenate(([0], np.cumsum(np.diff(order) < 0)))
    others = np.concatenate(([0], np.cumsum(order < 0)))
    whole = (descents[ends] == descents[starts]) & (ends - starts >= last)
    for back in range(last + 1):
        whole &= order[ends - np.minimum(back, ends)] == last - back
    before = others[ends + 1] - others[starts]
    robots = np.where(whole, ends + 1 - starts - before - last, 0)
    begins = np.flatnonzero((np.diff(robots, prepend=-1) != 0) | (before > 0) | ~whole).tolist()
    for first, stop in zip(begins, [*begins[1:], len(ends)], strict=True):
        begin, lead = int(starts[first]), int(before[first])
        if whole[first] and lead:
            yield found[begin : begin + lead], 0
            begin += lead
        yield found[begin : int(ends[stop - 1]) + 1], int(robots[first])


def _block(steps: TopicMessages, robots: int, family: Family) -> Block | None:
    """Return the block of whole steps with so many robots, None if they do not form one with the times of its steps."""
    stored = steps.stored
    count = robots + len(family.main) - 1
    times = stored.heads["log_time"].reshape(-1, count)
    if (times != times[:, :1]).any() or (stored.heads["publish_time"].reshape(-1, count) != times).any():
        return None
    sizes, begins = stored.sizes.reshape(-1, count), stored.begins.reshape(-1, count)
    payloads = {}
    for number, topic in enumerate(family.main):
        columns = slice(robots) if not number else slice(robots + number - 1, robots + number)
        size = sizes[:, columns]
        if (size != size[0, 0]).any() or not size[0, 0]:
            return None
        payloads[topic] = stored.gathered(begins[:, columns].ravel(), int(size[0, 0]))
    block = Block.of(payloads)
    return block if block is not None and bool((block.times == times[:, 0]).all()) else None

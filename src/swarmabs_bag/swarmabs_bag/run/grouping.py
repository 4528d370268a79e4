"""Whole steps in the order of a bag, found in the arrays of stored messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.run.step import Step

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray
    from typing_extensions import Self

    from swarmabs_bag.mcap.stored import StoredMessages
    from swarmabs_core.messages import Family, Topic

    Integers = NDArray[np.int64]

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
        selected = places >= 0
        if selected.all():
            return cls(stored, tuple(wanted.values()), places)
        return cls(stored[selected], tuple(wanted.values()), places[selected])

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


def whole_steps(tables: Iterable[TopicMessages], family: Family) -> Iterator[Step | Published]:
    """Yield messages in order, together where steps of a family are complete, canonical and follow each other.

    The log and publish time of a message in them are the time of its step.
    """
    rest: TopicMessages | None = None
    try:
        for table in tables:
            messages = table if rest is None else rest.joined(table)
            end = 0
            for part, robots in _parts(messages, family):
                end += len(part)
                whole = _whole(part, robots, family) if robots else None
                if whole is None:
                    yield from part
                else:
                    yield whole
            rest = messages[end:]
            if int(rest.stored.sizes.sum()) > _MOST_BYTES:
                yield from rest
                rest = None
    except DamagedBagError:
        yield from rest or ()
        raise
    yield from rest or ()


def _parts(messages: TopicMessages, family: Family) -> Iterator[tuple[TopicMessages, int]]:
    """Split messages up to the end of the last step; with the number of robots, 0 if they are not whole steps.

    Messages on other topics than those with messages in every step, such as events, may precede a step, in a part of
    their own.
    """
    topics = _stepwise(messages, family)
    order = _order(messages, topics)
    is_last = order == len(topics) - 1  # the message that ends its step
    count = int(np.count_nonzero(is_last))
    if not count:
        return
    step = np.cumsum(is_last) - is_last  # to which each message belongs, numbered from 0

    def per_step(flags: NDArray[np.bool_]) -> Integers:
        """Return how many messages of each step have a flag."""
        return np.bincount(step[flags], minlength=count)[:count]

    others, robots = per_step(order < 0), per_step(order == 0)
    # A step is whole with robots before each coordinator once, in the order of the topics.
    before_earlier = np.append(np.diff(order) < 0, False) & ~is_last
    whole = (per_step(before_earlier) == 0) & (robots > 0)
    for coordinator in range(1, len(topics)):
        whole &= per_step(order == coordinator) == 1
    robots[~whole] = 0
    # A part begins where the number of robots changes, and at everything that is not a whole step.
    begins = np.flatnonzero((np.diff(robots, prepend=-1) != 0) | (others > 0) | ~whole).tolist()
    ends = np.flatnonzero(is_last) + 1
    starts = np.append(0, ends[:-1])
    for first, stop in zip(begins, [*begins[1:], count], strict=True):
        begin, end = int(starts[first]), int(ends[stop - 1])
        if whole[first] and others[first]:
            yield messages[begin : begin + int(others[first])], 0
            begin += int(others[first])
        yield messages[begin:end], int(robots[first])


def _stepwise(messages: TopicMessages, family: Family) -> tuple[Topic, ...]:
    """Return the topics with messages in every step; a bag of an earlier version may lack further ones."""
    return tuple(topic for topic in family.stepwise if topic not in family.further or topic in messages.topics)


def _order(messages: TopicMessages, topics: tuple[Topic, ...]) -> Integers:
    """Return the place of each message's topic among these topics, -1 for others."""
    place_of = np.full(len(messages.topics), -1)
    for number, topic in enumerate(topics):
        if topic in messages.topics:
            place_of[messages.topics.index(topic)] = number
    places: Integers = place_of[messages.places]
    return places


def _whole(messages: TopicMessages, robots: int, family: Family) -> Step | None:
    """Return the steps of messages with so many robots, None if they are not whole, or have other times."""
    stored, topics = messages.stored, _stepwise(messages, family)
    count = robots + len(topics) - 1
    times = stored.heads["log_time"].reshape(-1, count)
    if (times != times[:, :1]).any() or (stored.heads["publish_time"].reshape(-1, count) != times).any():
        return None
    sizes, begins = stored.sizes.reshape(-1, count), stored.begins.reshape(-1, count)
    payloads = {}
    columns = {topic: slice(place, place + 1) for place, topic in enumerate(topics[1:], start=robots)}
    for topic, of_topic in {family.robot: slice(robots), **columns}.items():
        size = sizes[:, of_topic]
        if (size != size[0, 0]).any() or not size[0, 0]:
            return None
        payloads[topic] = stored.gathered(begins[:, of_topic].ravel(), int(size[0, 0]))
    steps = Step.whole(payloads)
    return steps if steps is not None and bool((steps.times == times[:, 0]).all()) else None

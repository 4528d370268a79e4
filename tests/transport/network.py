"""What a node has of the middleware where no middleware is, and what a scheduler does to it otherwise than usual."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from random import Random
from typing import Any, NamedTuple

from hypothesis import strategies as st

from swarmabs_config.graph import Qos
from swarmabs_core.messages import Topic


class Inbox:
    """What has arrived at a node and was not taken: of each topic so many messages, the newest."""

    def __init__(self, subscriptions: Mapping[Topic, Qos]) -> None:
        self._arrived = {topic: deque[bytes](maxlen=qos.depth) for topic, qos in subscriptions.items()}

    def put(self, topic: Topic, data: bytes) -> None:
        self._arrived[topic].append(data)

    def has(self, topics: tuple[Topic, ...]) -> bool:
        return any(self._arrived[topic] for topic in topics)

    def take(self, topic: Topic) -> bytes | None:
        arrived = self._arrived[topic]
        return arrived.popleft() if arrived else None

    def writer(self, topic: Topic) -> bytes:
        return b""

    def wait(self, topics: tuple[Topic, ...], timeout: float) -> bool:
        """Refuse: whoever drives the node waits."""
        raise AssertionError(f"a node waits by itself for {topics}, {timeout} s")

    def publisher_count(self, topic: Topic) -> int:
        return 1


class Outbox:
    """A publisher that hands on what is published, with its topic."""

    def __init__(self, topic: Topic, send: Callable[[Topic, bytes], None]) -> None:
        self._topic = topic
        self._send = send

    def publish(self, data: bytes) -> None:
        self._send(self._topic, data)


class Reports:
    def __init__(self) -> None:
        self.said: list[tuple[str, dict[str, Any]]] = []

    def send(self, event: str, **details: object) -> None:
        self.said.append((event, details))

    @property
    def troubles(self) -> list[tuple[str, dict[str, Any]]]:
        """What was said but for the events, which every node tells."""
        return [report for report in self.said if report[0] not in {"publishes", "recorded"}]

    def of(self, event: str) -> list[dict[str, Any]]:
        return [details for said, details in self.said if said == event]


class Act(Enum):
    """Something that the transport or a machine may do to a swarm."""

    OTHER = "deliver another message than the oldest"
    LOSE = "lose a message"
    TWICE = "deliver a message, and keep it under way, too"
    PASS = "let time pass although something is under way"
    RUN = "let another node than the first that can go on"
    FREEZE = "let a node stand still for a while"
    LATE = "let a node that has not begun begin later"


class Deviation(NamedTuple):
    """After so many usual turns this happens, to one of those to whom it can."""

    after: int
    act: Act
    which: int


Script = list[Deviation]
"""A list that hypothesis draws and shrinks, or a seed makes."""

_OFTEN = (Act.OTHER, Act.OTHER, Act.OTHER, Act.OTHER, Act.LOSE, Act.TWICE, Act.RUN, Act.PASS)
_SELDOM = (Act.FREEZE, Act.LATE)
LARGEST = 255


def script(seed: int, length: int) -> Script:
    """Return a script of a seed: a wild one, or one with long quiet stretches."""
    draw = Random(seed)
    quiet = draw.choice((0, 1, 4, 20))
    acts = draw.choice((_OFTEN, (*_OFTEN, *_SELDOM), (draw.choice(_OFTEN), draw.choice(_OFTEN), draw.choice(_SELDOM))))
    late = [Deviation(0, Act.LATE, draw.randint(0, LARGEST)) for _ in range(draw.choice((0, 0, 1, 2)))]
    return late + [
        Deviation(draw.randint(0, quiet), draw.choice(acts), draw.randint(0, LARGEST)) for _ in range(length)
    ]


def scripts(length: int = 40) -> st.SearchStrategy[Script]:
    """Draw a script; hypothesis shrinks it to few deviations, and those to early ones."""
    return st.lists(
        st.builds(Deviation, st.integers(0, 40), st.sampled_from(Act), st.integers(0, LARGEST)), max_size=length
    )


def turns(script: Script) -> Iterator[Deviation | None]:
    """Yield for each turn what is done otherwise than usual; when the script is over, nothing for ever."""
    for deviation in script:
        yield from (None for _ in range(deviation.after))
        yield deviation
    while True:
        yield None

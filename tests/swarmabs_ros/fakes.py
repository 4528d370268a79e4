"""Stand-ins for what surrounds a lockstep loop: clock, subscriptions, publishers, report channel, behaviour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import (
    DESIRED_ABSTRACT_STATE,
    PLANE_STATE,
    TOPIC_OF,
    DesiredAbstractState,
    Message,
    Messages,
    Mode,
    PlaneState,
    Topic,
)

PERIOD_NS = 10_000_000


@dataclass
class Clock:
    """Time that passes only where somebody waits; at `end` it calls `on_end`."""

    now: float = 0.0
    end: float = 1000.0
    on_end: Callable[[], None] = lambda: None

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.advance_to(self.now + seconds)

    def advance_to(self, time: float) -> None:
        assert time >= self.now
        # A wait of no length would never end.
        self.now = max(time, self.now + 1e-6)
        if self.now >= self.end:
            self.on_end()


@dataclass
class Inbox:
    """A receiver to which messages come at fixed times."""

    clock: Clock
    arrivals: list[tuple[float, Topic, bytes]] = field(default_factory=list)

    def deliver(self, time: float, message: Message) -> None:
        self.arrivals.append((time, TOPIC_OF[type(message)], encode(message)))

    def take(self, topic: Topic) -> bytes | None:
        for index, (time, its_topic, data) in enumerate(self.arrivals):
            if its_topic is topic and time <= self.clock.now:
                del self.arrivals[index]
                return data
        return None

    def wait(self, topics: tuple[Topic, ...], timeout: float) -> bool:
        times = [time for time, topic, _ in self.arrivals if topic in topics]
        arrival = max(min(times, default=float("inf")), self.clock.now)
        self.clock.advance_to(min(arrival, self.clock.now + timeout))
        return arrival <= self.clock.now

    def publisher_count(self, topic: Topic) -> int:
        return 1


@dataclass
class Outbox:
    """A publisher that notes when it published what."""

    clock: Clock
    topic: Topic
    published: list[tuple[float, Message]]

    def publish(self, data: bytes) -> None:
        self.published.append((self.clock.now, decode(self.topic.message, data)))


@dataclass
class Reports:
    """A report channel that notes what was said."""

    said: list[tuple[str, dict[str, object]]] = field(default_factory=list)

    def send(self, event: str, **details: object) -> None:
        self.said.append((event, details))


class Follower:
    """Answers every plane state of the current step with a desired abstract state, up to a last step."""

    def __init__(self, last_step: int, *, first: Messages = ()) -> None:
        self.step = 0
        self._last_step = last_step
        self._first = first

    def start(self) -> Messages:
        return self._first

    def handle(self, message: Message) -> Messages:
        if message.step != self.step:
            return ()
        self.step += 1
        return (desired(message.step),)

    def awaits(self) -> tuple[Topic, ...]:
        return () if self.step > self._last_step else (PLANE_STATE,)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        return self.step, ("plane_sim",)


def plane(step: int) -> PlaneState:
    """Return a plane state."""
    return PlaneState(step * PERIOD_NS, step, 0.1, 0.0)


def desired(step: int) -> DesiredAbstractState:
    """Return a desired abstract state."""
    return DesiredAbstractState(step * PERIOD_NS, step, Mode.RUN, *(0.0,) * 8)


ANSWERS = DESIRED_ABSTRACT_STATE

"""Subscription to the messages that views need; no node ever waits for it.

It is best effort, with short queues that drop old messages when the view is slow, stopped or dead. Only events are
reliable, so that earlier ones arrive too; their writers keep a bounded number for late readers and wait for no reader.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_config.graph import OFFERED, Driver, requested
from swarmabs_core.cdr import decode
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import BASIS, EVENTS, FAMILIES
from swarmabs_ros.endpoints import receiver

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.messages import Message, Topic
    from swarmabs_ros.start import SwarmNode

DEPTH = 256
"""Queued messages of a coordinator, and at least of the robots; enough for nearly all at the highest step rates."""
ROBOT_STEPS = 4
"""Queued steps of all robots."""


class Heard(NamedTuple):
    """A message with its topic and its bytes."""

    topic: Topic
    message: Message
    payload: bytes


class Listener:
    """Listens to a swarm on any parent system, with the number of robots known so far; counts malformed payloads."""

    def __init__(self, node: SwarmNode, robots: int) -> None:
        # The robots come last: when the broadcasts of a step are read, its states have arrived.
        once = [topic for family in FAMILIES for topic in family.once]
        topics = [topic for family in FAMILIES for topic in (family.parent, family.abstract, family.desired)]
        self._most = dict.fromkeys((*once, BASIS, *topics), DEPTH)
        self._most |= {family.robot: max(DEPTH, ROBOT_STEPS * robots) for family in FAMILIES} | {EVENTS: 1000}
        asked = {
            # In real time most topics exist, and this QoS is compatible with publishers in lockstep too.
            topic: requested(
                topic,
                Driver.REALTIME if topic in OFFERED[Driver.REALTIME] else Driver.LOCKSTEP,
                depth=most,
                reliable=topic in {EVENTS, *once},
            )
            for topic, most in self._most.items()
        }
        self._receiver = receiver(node, asked, "wait_set")
        self.malformed = 0

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The subscribed topics."""
        return tuple(self._most)

    def poll(self) -> Iterator[Heard]:
        """Yield the received messages; count and skip malformed ones."""
        for topic, most in self._most.items():
            for _ in range(most):
                payload = self._receiver.take(topic)
                if payload is None:
                    break
                try:
                    yield Heard(topic, decode(topic.message, payload), payload)
                except MalformedMessageError:
                    self.malformed += 1

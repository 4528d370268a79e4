"""Subscribes to what is shown of a swarm; no node ever waits for it.

It reads best effort, from queues of a few messages that lose what is old when it is slow, stopped or dead. Only events
are read reliably, so that those before its time come too; their writers keep a bounded number for late readers and wait
for none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_config.graph import Driver, requested
from swarmabs_core.cdr import decode
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import ABSTRACT_STATE, AGENT_STATE, BASIS, DESIRED_ABSTRACT_STATE, EVENTS, PLANE_STATE
from swarmabs_ros.endpoints import receiver

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.messages import Message, Topic
    from swarmabs_ros.start import SwarmNode

DEPTH = 256
"""Messages of a coordinator that wait to be read, and at least of the robots: at the highest step rates nearly all."""
ROBOT_STEPS = 4
"""Steps of all robots that wait to be read."""


class Heard(NamedTuple):
    """A message, with its topic and the bytes in which it came."""

    topic: Topic
    message: Message
    payload: bytes


class Listener:
    """Listens to a swarm of so many robots, as far as known; payloads that are no messages of one are counted."""

    def __init__(self, node: SwarmNode, robots: int) -> None:
        # The robots last: the states of a step are there when its broadcasts are.
        self._most = dict.fromkeys((BASIS, PLANE_STATE, ABSTRACT_STATE, DESIRED_ABSTRACT_STATE), DEPTH)
        self._most |= {AGENT_STATE: max(DEPTH, ROBOT_STEPS * robots), EVENTS: 1000}
        asked = {
            # All topics are there in real time, and what is asked for suits publishers in lockstep as well.
            topic: requested(topic, Driver.REALTIME, depth=most, reliable=topic is EVENTS)
            for topic, most in self._most.items()
        }
        self._receiver = receiver(node, asked, "wait_set")
        self.malformed = 0

    @property
    def topics(self) -> tuple[Topic, ...]:
        """What it listens to."""
        return tuple(self._most)

    def poll(self) -> Iterator[Heard]:
        """Yield what has come; bytes that are no message of a swarm are counted and left out."""
        for topic, most in self._most.items():
            for _ in range(most):
                payload = self._receiver.take(topic)
                if payload is None:
                    break
                try:
                    yield Heard(topic, decode(topic.message, payload), payload)
                except MalformedMessageError:
                    self.malformed += 1

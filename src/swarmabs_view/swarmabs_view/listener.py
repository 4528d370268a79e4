"""Subscription to the messages that views need; no node ever waits for it.

It is best effort, with short queues that drop old messages when the view is slow, stopped or dead. Only events are
reliable, so that earlier ones arrive too; their writers keep a bounded number for late readers and wait for no reader.
"""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from swarmabs_config.graph import (
    DIAGNOSTICS,
    OFFERED,
    OWN,
    Driver,
    Qos,
    own_topic,
    requested,
    usual_topic,
)
from swarmabs_core.cdr import decode, misplaced
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.hearing import HEARS
from swarmabs_core.messages import BASIS, EVENTS, FAMILIES, SwarmEvent, Topic
from swarmabs_core.nodes import ROBOT_PREFIX
from swarmabs_core.pair_role import ROLE
from swarmabs_ros.endpoints import Receiver

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from swarmabs_core.messages import Family, Message
    from swarmabs_ros.start import SwarmNode

DEPTH = 256
"""Queued messages of a coordinator, and at least of the robots; enough for nearly all at the highest step rates."""
ROBOT_STEPS = 4
"""Queued steps of all robots."""
LOOK = 1.0
"""Time, s, between two searches for robots' own topics."""
_DIAGNOSTICS = Topic(DIAGNOSTICS, SwarmEvent, "diagnostic_msgs/msg/DiagnosticArray")
"""The diagnostics, which are no messages of the swarm: their class here is never used."""
_NAMES = (ROLE.encode(), HEARS.encode())
"""Values that are shown: diagnostics without one of these are not worth deserializing."""
_ID = re.compile(r"\d{3,5}")


class Heard(NamedTuple):
    """A message with its topic and its bytes."""

    topic: Topic
    message: Message
    payload: bytes


class DiagnosticsListener:
    """Listens to the diagnostics of the nodes that are one of a pair, and of robots that sum up the swarm."""

    def __init__(self, node: SwarmNode) -> None:
        self._take = Receiver(node, {_DIAGNOSTICS: Qos("best_effort", DEPTH)}).take

    def poll(self) -> Iterator[tuple[str, dict[str, str]]]:
        """Yield the name and the values of each node whose diagnostics have arrived; skip malformed ones."""
        for _ in range(DEPTH):
            payload = self._take(_DIAGNOSTICS)
            if payload is None:
                return
            if not any(name in payload for name in _NAMES):
                continue
            try:
                array = deserialize_message(payload, DiagnosticArray)
                nodes = [(str(one.hardware_id), {str(v.key): str(v.value) for v in one.values}) for one in array.status]
            except Exception:  # noqa: BLE001, S112 - rclpy has no common base class
                continue
            yield from nodes


class Listener:
    """Listens to a swarm, with the number of robots known so far; counts malformed payloads.

    Its parent system is of one of the families.

    The topics of robots that publish on topics of their own are found in the graph; their messages are reported on the
    usual ones.
    """

    def __init__(self, node: SwarmNode, robots: int, families: Collection[Family] = FAMILIES) -> None:
        # The robots come last: when the broadcasts of a step are read, its states have arrived.
        once = [topic for family in families for topic in family.once]
        topics = [
            topic for family in families for topic in (family.parent, family.abstract, *family.further, family.desired)
        ]
        self._most = dict.fromkeys((*once, BASIS, *topics), DEPTH)
        self._most |= {family.robot: max(DEPTH, ROBOT_STEPS * robots) for family in families} | {EVENTS: 1000}
        self._reliable = {EVENTS, *once}
        self._node = node
        self._receivers: dict[Topic, Receiver] = {}
        self._look_at = 0.0
        self.topics = tuple(self._most)
        """The usual topics of the messages."""
        self.malformed = 0
        self._subscribe(self._most)

    def poll(self) -> Iterator[Heard]:
        """Yield the received messages; count and skip malformed ones."""
        self._look()
        for topic, most in self._most.items():
            usual, take = usual_topic(topic), self._receivers[topic].take
            for _ in range(most):
                payload = take(topic)
                if payload is None:
                    break
                try:
                    message = decode(topic.message, payload)
                except MalformedMessageError:
                    self.malformed += 1
                    continue
                if misplaced(message, topic):
                    self.malformed += 1
                else:
                    yield Heard(usual, message, payload)

    def _look(self) -> None:
        """Subscribe to further robots' own topics, at most once per `LOOK`."""
        now = time.monotonic()
        if now < self._look_at:
            return
        self._look_at = now + LOOK
        names = {name for name, _ in self._node.get_topic_names_and_types()}
        first = f"{self._node.get_namespace().rstrip('/')}/{ROBOT_PREFIX}"
        robots = sorted({name.removeprefix(first).partition("/")[0] for name in names if name.startswith(first)})
        topics = [own_topic(topic, int(robot)) for robot in robots if _ID.fullmatch(robot) for topic in OWN]
        self._subscribe({topic: self._most[usual_topic(topic)] for topic in topics if topic not in self._most})

    def _subscribe(self, topics: Mapping[Topic, int]) -> None:
        if not topics:
            return
        asked = {
            # In real time most topics exist, and this QoS is compatible with publishers in lockstep too.
            topic: requested(
                topic,
                Driver.REALTIME if usual_topic(topic) in OFFERED[Driver.REALTIME] else Driver.LOCKSTEP,
                depth=most,
                reliable=usual_topic(topic) in self._reliable,
            )
            for topic, most in topics.items()
        }
        self._receivers |= dict.fromkeys(asked, Receiver(self._node, asked))
        self._most = {**self._most, **topics}

"""Playback of a bag: each message, but those of nodes under test, at its time, with its recorded bytes and QoS."""

from __future__ import annotations

import importlib
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)
from rclpy.validate_full_topic_name import validate_full_topic_name

from swarmabs_bag.errors import UnknownTypeError
from swarmabs_bag.run.metadata import load_yaml
from swarmabs_bag.run.schemas import message_schema
from swarmabs_config.graph import requested
from swarmabs_config.model.errors import printable, shorten, show
from swarmabs_core.cdr import decode
from swarmabs_core.errors import InputError, RunError
from swarmabs_ros.endpoints import Receiver
from swarmabs_ros.start import SwarmNode, initialise

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

    from rclpy.node import Node
    from rclpy.publisher import Publisher

    from swarmabs_analysis.replay.answers import Answers
    from swarmabs_bag.mcap.records import StoredMessage
    from swarmabs_bag.reader import BagReader
    from swarmabs_bag.run.metadata import BagChannel

SLICE = 0.1
"""Longest time between two checks whether the playback must end, s."""
ACKNOWLEDGED = 2.0
"""Time that reliable readers have at the end to acknowledge messages, s."""
PATIENCE = 30.0
"""Longest time for an answer of nodes under test that have answered before, s."""
REPEATED = 1.0
"""Time without an answer of nodes under test after which the last messages are published again, s."""
USUAL_QOS = 10
"""Depth of the QoS used if the bag gives none: reliable, volatile."""
NAME = "replay"
_DEPTH = 1000
"""Messages of a topic of nodes under test that are kept until they are read."""
_LONGEST_NAME = 100
_MOST_NAMED = 5
_POLICIES = {
    "history": QoSHistoryPolicy,
    "reliability": QoSReliabilityPolicy,
    "durability": QoSDurabilityPolicy,
    "liveliness": QoSLivelinessPolicy,
}
_DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")
_OFFERABLE = ("system_default", "keep_last", "keep_all", "reliable", "best_effort", "transient_local", "volatile")
_OFFERABLE_LIVELINESS = ("automatic", "manual_by_topic")
_INFINITE = 2**63 - 1
_USUAL_DEPTH = 10

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Pace:
    """The part of a bag to play, and how fast and often.

    The rate, which may be infinite, is recorded time per real time; `start` (s) counts from the first message,
    `duration` (s) is recorded time, by default all of it; with `loop` the playback repeats endlessly.
    """

    rate: float = 1.0
    start: float = 0.0
    duration: float | None = None
    loop: bool = False

    def schedule(self, first: int, read: Callable[[], Iterable[tuple[int, T]]]) -> Iterator[tuple[float, T]]:
        """Yield each message with the time at which it is due, s after the start of the playback.

        Times depend only on the recording, not on when earlier messages were published, so there is no drift.

        `read` returns log times (ns) and messages in order; `first` is the first of these times.
        """
        begin = first + round(self.start * 1e9)
        end = None if self.duration is None else begin + round(self.duration * 1e9)
        offset = 0.0
        while True:
            due, played = offset, False
            for log_time, item in read():
                if log_time < begin or (end is not None and log_time > end):
                    continue
                played = True
                due = max(due, offset + (log_time - begin) / 1e9 / self.rate)
                yield due, item
            if not self.loop or not played:
                return
            offset = due


@dataclass(frozen=True, slots=True)
class Playable:
    """A topic of a bag that can be played, its ROS message class, and the offered QoS or only its depth."""

    channel: BagChannel
    message_class: Any
    qos: QoSProfile | int


def choose_topics(
    bag: BagReader, wanted: Collection[str] = (), *, one_swarm: bool = False
) -> tuple[list[Playable], list[str]]:
    """Return the topics of a bag that can be played, and warnings about the others.

    `wanted` selects topics by name, by default all; `one_swarm` limits them to the swarm that is read.

    Raises
    ------
    InputError
        If the bag lacks a selected topic, such a topic cannot be played, or there is nothing to play.
    """
    channels = [channel for channel in bag.channels if not one_swarm or _of_swarm(bag, channel.name)]
    names = [channel.name for channel in channels]
    chosen = {f"/{name.lstrip('/')}" for name in wanted}
    for name in sorted(chosen - set(names)):
        raise InputError(f"--topics: {bag.path} has no topic {name}; it has {_listed(sorted(names))}")
    playable, warnings = [], []
    for channel in channels:
        if chosen and channel.name not in chosen:
            continue
        try:
            topic, notes = _playable(channel)
        except InputError as error:
            if chosen:
                raise
            warnings.append(f"{shown(channel.name)} is skipped: {error}")
        else:
            playable.append(topic)
            warnings.extend(notes)
    if not playable:
        first = warnings[:_MOST_NAMED]
        more = [f"{len(warnings) - len(first)} more are skipped"] if len(warnings) > len(first) else []
        raise InputError("; ".join([f"{bag.path} has no topic that can be played", *first, *more]))
    return playable, warnings


def _of_swarm(bag: BagReader, name: str) -> bool:
    """Return whether a topic is in the namespace of the swarm that is read, and not in that of a nested swarm."""
    inmost = max((swarm for swarm in bag.swarms if name.startswith(swarm)), key=len, default=None)
    return inmost is not None and inmost == bag.namespace


def _listed(names: Collection[str]) -> str:
    """Return the first names of many, such that they fit into a line."""
    more = [f"{len(names) - _MOST_NAMED} more"] if len(names) > _MOST_NAMED else []
    return ", ".join([*map(shown, list(names)[:_MOST_NAMED]), *more])


def shown(name: str) -> str:
    """Return a name from a bag, safe to print within a line."""
    return printable(shorten(name, _LONGEST_NAME))


def _playable(channel: BagChannel) -> tuple[Playable, list[str]]:
    """Return type and QoS of a topic; raise `InputError` if its type is not installed with the recorded definition."""
    if channel.encoding != "cdr":
        raise InputError(f"its messages have the encoding {show(channel.encoding)}, but only cdr can be published")
    try:
        validate_full_topic_name(channel.name)
    except InvalidTopicNameException as error:
        raise InputError("its name is not valid in ROS") from error
    schema = message_schema(channel.ros_type)
    if channel.type_hash and channel.type_hash != schema.type_hash:
        raise InputError(f"the installed definition of {channel.ros_type} differs from the recorded one")
    package, _, name = channel.ros_type.split("/")
    try:
        message_class = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise UnknownTypeError(f"message type {channel.ros_type} cannot be imported: {error}") from error
    profiles = recorded_profiles(channel.qos_profiles)
    notes = []
    if len(profiles) > 1:
        notes.append(f"{shown(channel.name)}: its publishers offered {len(profiles)} different QoS; the first is used")
    qos = profiles[0] if profiles else None
    if qos is not None:
        # The nodes that asserted their liveliness are absent, and a playback may pause.
        qos.liveliness, qos.liveliness_lease_duration = QoSLivelinessPolicy.AUTOMATIC, Duration()
    return Playable(channel, message_class, qos or USUAL_QOS), notes


def play(
    bag: BagReader,
    topics: Collection[Playable],
    pace: Pace,
    *,
    answers: Answers | None = None,
    wait: bool = False,
    asked_to_end: Callable[[], bool] = lambda: False,
) -> int:
    """Publish the messages of a bag, each at its time, and return their number.

    With `answers`, those of nodes under test are left out, and no later message is published before the nodes have
    published theirs. With `wait` the playback starts when every topic has a reader; it ends early when `asked_to_end`
    returns True.

    Raises
    ------
    DamagedBagError
        If the bag is damaged; everything before the damage has been published.
    RunError
        If nodes under test do not answer any more.
    """
    initialise(NAME, ["--ros-args", "--disable-external-lib-logs", "-r", f"__ns:={namespace_of(bag)}"])
    node: Node = SwarmNode(NAME)
    try:
        publishers = {
            topic.channel: node.create_publisher(topic.message_class, topic.channel.name, topic.qos) for topic in topics
        }
        tested = None if answers is None else _NodesUnderTest(node, bag, answers)

        def read() -> Iterator[tuple[int, tuple[BagChannel, StoredMessage]]]:
            for channel, message in bag.stored_messages() if answers is None else answers.in_causal_order(bag):
                if channel in publishers or (answers is not None and channel.topic in answers.topics):
                    yield message.log_time, (channel, message)

        while wait and not asked_to_end() and not all(p.get_subscription_count() for p in publishers.values()):
            time.sleep(SLICE / 5.0)
        count = 0
        begun = time.monotonic()
        for due, (channel, message) in pace.schedule(bag.start, read):
            while (left := begun + due - time.monotonic()) > 0.0 and not asked_to_end():
                time.sleep(min(left, SLICE))
            if asked_to_end():
                break
            if tested is not None and tested.publish(channel, message):
                tested.wait(asked_to_end)
                continue
            publishers[channel].publish(message.payload)
            count += 1
            if tested is not None:
                tested.played(message.log_time, publishers[channel], message.payload)
        if not asked_to_end():
            for publisher in publishers.values():
                publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED))
        return count
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def namespace_of(bag: BagReader) -> str:
    """Return the namespace of the swarm that is read."""
    return (bag.namespace or "/").rstrip("/") or "/"


class _NodesUnderTest:
    """Waits for what nodes under test publish, and repeats the last messages if a node does not answer.

    A node may have started after its messages were published; messages are numbered, so it ignores repetitions.
    """

    def __init__(self, node: Node, bag: BagReader, answers: Answers) -> None:
        self._bag = bag
        self._answers = answers
        subscriptions = {topic: requested(topic, depth=_DEPTH, reliable=True) for topic in answers.topics}
        self._receiver = Receiver(node, subscriptions)
        self._recent: deque[tuple[int, Publisher, bytes]] = deque()
        self._times: deque[int] = deque(maxlen=2)
        self._answered = False

    def publish(self, channel: BagChannel, message: StoredMessage) -> bool:
        """Return whether nodes under test publish a recorded message; errors as for `BagReader.decode`."""
        topic = channel.topic
        return topic is not None and any(
            self._answers.replaces(decoded)
            for _, _, decoded in self._bag.decode([(topic, message.log_time, message.payload)])
        )

    def played(self, log_time: int, publisher: Publisher, payload: bytes) -> None:
        """Keep a message that was played, until those of the second next step are."""
        if not self._times or log_time != self._times[-1]:
            self._times.append(log_time)
            while self._recent and self._recent[0][0] < self._times[0]:
                self._recent.popleft()
        self._recent.append((log_time, publisher, payload))

    def wait(self, asked_to_end: Callable[[], bool]) -> None:
        """Wait until the nodes have published what is expected; the first time this may take as long as it takes.

        Raises
        ------
        RunError
            If they do not answer any more.
        """
        since = repeated = time.monotonic()
        while self._lacking() and not asked_to_end():
            self._receiver.wait(self._answers.topics, SLICE)
            now = time.monotonic()
            if self._answered and now - since > PATIENCE:
                raise RunError(
                    f"no answer for {PATIENCE:g} s: {self._answers.missing()[0]} is missing; see the log of its node"
                )
            if now - repeated > REPEATED:
                repeated = now
                for _, publisher, payload in self._recent:
                    publisher.publish(payload)

    def _lacking(self) -> bool:
        """Process what has arrived; return whether something expected is missing."""
        for topic in self._answers.topics:
            while (data := self._receiver.take(topic)) is not None:
                self._answers.hear(decode(topic.message, data))
        lacking = bool(self._answers.missing())
        self._answered = self._answered or not lacking
        return lacking


def recorded_profiles(text: str) -> list[QoSProfile]:
    """Return the distinct profiles in a channel's ``offered_qos_profiles``.

    Policies that a publisher cannot offer, or that are unknown, get the ROS 2 default.

    The text is YAML as written by rosbag2: policies by name or, in older versions, by number.
    """
    entries = load_yaml(text)
    profiles: list[QoSProfile] = []
    for entry in entries if isinstance(entries, list) else []:
        if isinstance(entry, dict) and (profile := _profile(entry)) not in profiles:
            profiles.append(profile)
    return profiles


def _profile(entry: Mapping[str, object]) -> QoSProfile:
    depth = entry.get("depth")
    usual = {
        "history": QoSHistoryPolicy.KEEP_LAST,
        "depth": depth if isinstance(depth, int) and 0 < depth < 2**31 else _USUAL_DEPTH,
    }
    policies = {name: _policy(of_name, entry.get(name)) for name, of_name in _POLICIES.items()}
    recorded = policies | {name: _duration(entry.get(name)) for name in _DURATIONS}
    return QoSProfile(**usual | {name: value for name, value in recorded.items() if value is not None})


def _policy(policies: Any, value: object) -> Any:
    """Return the policy with a name or number, None if a publisher cannot offer it."""
    offerable = _OFFERABLE_LIVELINESS if policies is QoSLivelinessPolicy else _OFFERABLE
    for policy in policies:
        if policy.short_key in offerable and value in (policy.short_key, int(policy)) and not isinstance(value, bool):
            return policy
    return None


def _duration(value: object) -> Duration | None:
    """Return a finite duration, None if it is missing, infinite or malformed."""
    if not isinstance(value, dict):
        return None
    seconds, nanoseconds = value.get("sec"), value.get("nsec")
    if not isinstance(seconds, int) or not isinstance(nanoseconds, int):
        return None
    total = seconds * 10**9 + nanoseconds
    return Duration(nanoseconds=total) if 0 < total < _INFINITE else None

"""Playback of a bag: every message at its time, with its recorded bytes and QoS."""

from __future__ import annotations

import importlib
import time
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
from swarmabs_bag.metadata import load_yaml
from swarmabs_bag.schemas import message_schema
from swarmabs_config.model.errors import printable, shorten, show
from swarmabs_core.errors import InputError
from swarmabs_ros.start import SwarmNode, initialise

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

    from rclpy.node import Node
    from rclpy.publisher import Publisher

    from swarmabs_bag.metadata import BagChannel
    from swarmabs_bag.reader import BagReader

SLICE = 0.1
"""Longest time, s, after which the playback looks whether it is asked to end."""
ACKNOWLEDGED = 2.0
"""Longest time, s, that reliable readers have at the end to acknowledge what they have received."""
USUAL_QOS = 10
"""What a topic is published with if the bag does not say: reliable, volatile, this depth."""
NAME = "replay"
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
    """Which part of a bag is played, how fast, and how often.

    The rate is recorded time per time of the clock; playing starts so many seconds after the first message, and takes
    so many seconds of recorded time, by default all, once or in an endless loop.
    """

    rate: float = 1.0
    start: float = 0.0
    duration: float | None = None
    loop: bool = False

    def schedule(self, first: int, read: Callable[[], Iterable[tuple[int, T]]]) -> Iterator[tuple[float, T]]:
        """Yield what is played with the time at which it is due, s after the begin of the playback.

        All times come from the recording and the begin, none from when something was published: there is no drift.

        The bag is read as log times (ns) and messages, in order; `first` is the first of these times.
        """
        begin = first + round(self.start * 1e9)
        end = None if self.duration is None else begin + round(self.duration * 1e9)
        offset = 0.0
        while True:
            due, found = offset, False
            for log_time, item in read():
                if log_time < begin or (end is not None and log_time > end):
                    continue
                found = True
                due = max(due, offset + (log_time - begin) / 1e9 / self.rate)
                yield due, item
            if not self.loop or not found:
                return
            offset = due


@dataclass(frozen=True, slots=True)
class Playable:
    """A topic of a bag that can be played, its ROS message class, and the QoS, or only its depth, that is offered."""

    channel: BagChannel
    message_class: Any
    qos: QoSProfile | int


def choose_topics(
    bag: BagReader, wanted: Collection[str] = (), *, one_swarm: bool = False
) -> tuple[list[Playable], list[str]]:
    """Return the topics of a bag that can be played, and warnings about those that cannot.

    Topics are chosen by name among all, or with `one_swarm` among those of the swarm that is read; by default all.

    Raises
    ------
    InputError
        If the bag does not have a topic that is wanted, it cannot be played, or there is nothing to play.
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
            found, notes = _playable(channel)
        except InputError as error:
            if chosen:
                raise
            warnings.append(f"{shown(channel.name)} is left out: {error}")
        else:
            playable.append(found)
            warnings.extend(notes)
    if not playable:
        first = warnings[:_MOST_NAMED]
        more = [f"{len(warnings) - len(first)} more are left out"] if len(warnings) > len(first) else []
        raise InputError("; ".join([f"{bag.path} has no topic that can be played", *first, *more]))
    return playable, warnings


def _of_swarm(bag: BagReader, name: str) -> bool:
    """Say whether a topic is in the namespace of the swarm that is read, and in no deeper one of another swarm."""
    inmost = max((swarm for swarm in bag.swarms if name.startswith(swarm)), key=len, default=None)
    return inmost is not None and inmost == bag.namespace


def _listed(names: Collection[str]) -> str:
    """Return the first names of many, such that they fit into a line."""
    more = [f"{len(names) - _MOST_NAMED} more"] if len(names) > _MOST_NAMED else []
    return ", ".join([*map(shown, list(names)[:_MOST_NAMED]), *more])


def shown(name: str) -> str:
    """Return a name from a bag such that it cannot leave the line."""
    return printable(shorten(name, _LONGEST_NAME))


def _playable(channel: BagChannel) -> tuple[Playable, list[str]]:
    """Find type and QoS of a topic; refuse one whose type is not installed as it was recorded."""
    if channel.encoding != "cdr":
        raise InputError(f"its messages are in the encoding {show(channel.encoding)}, and only cdr can be published")
    try:
        validate_full_topic_name(channel.name)
    except InvalidTopicNameException as error:
        raise InputError("no topic of ROS can have this name") from error
    schema = message_schema(channel.ros_type)
    if channel.type_hash and channel.type_hash != schema.type_hash:
        raise InputError(f"the installed definition of {channel.ros_type} is not the one that was recorded")
    package, _, name = channel.ros_type.split("/")
    try:
        message_class = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise UnknownTypeError(f"message type {channel.ros_type} cannot be imported: {error}") from error
    profiles = recorded_profiles(channel.qos_profiles)
    notes = []
    if len(profiles) > 1:
        notes.append(f"{shown(channel.name)}: its publishers offered {len(profiles)} different QoS; the first is taken")
    qos = profiles[0] if profiles else None
    if qos is not None:
        # The nodes that asserted that they live are not here, and a playback may pause.
        qos.liveliness, qos.liveliness_lease_duration = QoSLivelinessPolicy.AUTOMATIC, Duration()
    return Playable(channel, message_class, qos or USUAL_QOS), notes


def play(
    bag: BagReader,
    topics: Collection[Playable],
    pace: Pace,
    *,
    wait: bool = False,
    asked_to_end: Callable[[], bool] = lambda: False,
) -> int:
    """Publish a bag's messages, each at its time; return how many.

    The playback may wait until every topic has a reader, and ends early when it is asked to.

    Raises
    ------
    DamagedBagError
        Where the bag is damaged; all before it has been published then.
    """
    initialise(NAME, ["--ros-args", "--disable-external-lib-logs"])
    node: Node = SwarmNode(NAME)
    try:
        publishers = {
            topic.channel: node.create_publisher(topic.message_class, topic.channel.name, topic.qos) for topic in topics
        }

        def read() -> Iterator[tuple[int, tuple[Publisher, bytes]]]:
            for channel, message in bag.stored_messages():
                if (publisher := publishers.get(channel)) is not None:
                    yield message.log_time, (publisher, message.payload)

        while wait and not asked_to_end() and not all(p.get_subscription_count() for p in publishers.values()):
            time.sleep(SLICE / 5.0)
        count = 0
        begun = time.monotonic()
        for due, (publisher, payload) in pace.schedule(bag.start, read):
            while (left := begun + due - time.monotonic()) > 0.0 and not asked_to_end():
                time.sleep(min(left, SLICE))
            if asked_to_end():
                break
            publisher.publish(payload)
            count += 1
        if not asked_to_end():
            for publisher in publishers.values():
                publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED))
        return count
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def recorded_profiles(text: str) -> list[QoSProfile]:
    """Return the profiles of a channel's ``offered_qos_profiles``, each different one once.

    Policies that no publisher can offer, or that are not understood, are left as ROS 2 has them by default.

    The text is YAML as rosbag2 writes it: policies by name, or, in bags of older versions, by number.
    """
    found = load_yaml(text)
    profiles: list[QoSProfile] = []
    for entry in found if isinstance(found, list) else []:
        if isinstance(entry, dict):
            made = _profile(entry)
            if made not in profiles:
                profiles.append(made)
    return profiles


def _profile(entry: Mapping[str, Any]) -> QoSProfile:
    depth = entry.get("depth")
    arguments: dict[str, Any] = {
        "history": QoSHistoryPolicy.KEEP_LAST,
        "depth": depth if isinstance(depth, int) and 0 < depth < 2**31 else _USUAL_DEPTH,
    }
    for name, policies in _POLICIES.items():
        policy = _policy(policies, entry.get(name))
        if policy is not None:
            arguments[name] = policy
    for name in _DURATIONS:
        duration = _duration(entry.get(name))
        if duration is not None:
            arguments[name] = duration
    return QoSProfile(**arguments)


def _policy(policies: Any, value: object) -> Any:
    """Return the policy of a name or number, None if no publisher can offer it."""
    offerable = _OFFERABLE_LIVELINESS if policies is QoSLivelinessPolicy else _OFFERABLE
    for policy in policies:
        if policy.short_key in offerable and value in (policy.short_key, int(policy)) and not isinstance(value, bool):
            return policy
    return None


def _duration(value: object) -> Duration | None:
    """Return a finite duration, None for one that is not there, infinite or not understood."""
    if not isinstance(value, dict):
        return None
    seconds, nanoseconds = value.get("sec"), value.get("nsec")
    if not isinstance(seconds, int) or not isinstance(nanoseconds, int):
        return None
    total = seconds * 10**9 + nanoseconds
    return Duration(nanoseconds=total) if 0 < total < _INFINITE else None

"""Playback of a bag to whoever listens: every message at its time, as it was serialised, with the recorded QoS."""

from __future__ import annotations

import importlib
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import QoSLivelinessPolicy
from rclpy.validate_full_topic_name import validate_full_topic_name

from swarmabs_analysis.replay.qos import recorded_profiles
from swarmabs_bag.errors import UnknownTypeError
from swarmabs_bag.schemas import message_schema
from swarmabs_config.scenario.errors import printable, shorten, show
from swarmabs_core.errors import InputError
from swarmabs_ros.start import SwarmNode, initialise

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.qos import QoSProfile

    from swarmabs_analysis.replay.pace import Pace
    from swarmabs_bag.channels import BagChannel
    from swarmabs_bag.reader import BagReader

SLICE = 0.1
"""Longest time, s, for which the playback does not look whether it shall end."""
ACKNOWLEDGED = 2.0
"""Longest time, s, that reliable readers have at the end to acknowledge what they have received."""
USUAL_QOS = 10
"""What a topic is published with if the bag does not say: reliable, volatile, this depth."""
NAME = "replay"
_LONGEST_NAME = 100
_MOST_NAMED = 5


@dataclass(frozen=True, slots=True)
class Playable:
    """A topic that can be played.

    Attributes
    ----------
    channel : BagChannel
        The topic in the bag.
    message_class : type
        ROS message class.
    qos : QoSProfile or int
        What is offered.
    """

    channel: BagChannel
    message_class: Any
    qos: QoSProfile | int


def choose_topics(
    bag: BagReader, wanted: Collection[str] = (), *, one_swarm: bool = False
) -> tuple[list[Playable], list[str]]:
    """Return the topics of a bag that can be played, and warnings about those that cannot.

    Parameters
    ----------
    bag : BagReader
        The bag.
    wanted : collection of str
        Names of the topics to play; by default all.
    one_swarm : bool
        Whether to choose among the topics in the namespace of the swarm that is read, and not among all.

    Raises
    ------
    InputError
        If the bag does not have a topic that is wanted, it cannot be played, or there is nothing to play.
    """
    channels = [channel for channel in bag.channels if not one_swarm or _of_swarm(bag, channel.name)]
    names = [channel.name for channel in channels]
    chosen = {f"/{name.lstrip('/')}" for name in wanted}
    for name in sorted(chosen - set(names)):
        raise InputError(f"--topics: {bag.path} has no topic {name}; it has {listed(sorted(names))}")
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


def listed(names: Collection[str]) -> str:
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

    Parameters
    ----------
    bag : BagReader
        The bag.
    topics : collection of Playable
        What to play of it.
    pace : Pace
        What part of it, and how fast.
    wait : bool
        Whether to begin only when every topic has a reader.
    asked_to_end : callable
        Tells whether to stop before the end.

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
        while wait and not asked_to_end() and not all(p.get_subscription_count() for p in publishers.values()):
            time.sleep(SLICE / 5.0)
        count = _publish(bag, publishers, pace, asked_to_end)
        if not asked_to_end():
            for publisher in publishers.values():
                publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED))
        return count
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _publish(
    bag: BagReader,
    publishers: dict[BagChannel, Publisher],
    pace: Pace,
    asked_to_end: Callable[[], bool],
) -> int:
    def read() -> Iterator[tuple[int, tuple[Publisher, bytes]]]:
        for channel, message in bag.stored_messages():
            publisher = publishers.get(channel)
            if publisher is not None:
                yield message.log_time, (publisher, message.payload)

    count = 0
    begun = time.monotonic()
    for due, (publisher, payload) in pace.schedule(bag.start, read):
        while (left := begun + due - time.monotonic()) > 0.0 and not asked_to_end():
            time.sleep(min(left, SLICE))
        if asked_to_end():
            break
        publisher.publish(payload)
        count += 1
    return count

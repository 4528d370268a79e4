"""The topics of a bag: type, swarm, and whether their message definitions are readable."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

from swarmabs_bag.errors import NotABagError, UnknownTypeError
from swarmabs_bag.run.metadata import BagChannel
from swarmabs_bag.run.realtime_gatherer import RECORDED
from swarmabs_bag.run.schemas import message_schema
from swarmabs_config.graph import STANDBY_TOPICS, USUAL_TOPICS
from swarmabs_config.model.errors import printable, shorten
from swarmabs_core.messages import FAMILIES, RELAY, TOPICS, Topic, relay_topic_in

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
    from pathlib import Path

    from mcap.records import Channel

    from swarmabs_bag.mcap.index import FileIndex

_MOST_NAMED = 5

RECORDED_TYPES = tuple(
    dict.fromkeys(
        topic.ros_type for topic in (*(topic for family in FAMILIES for topic in family.recorded), *RECORDED, RELAY)
    )
)
"""The types of recorded messages."""
FORMER_HASHES: dict[str, tuple[str, ...]] = {}
"""Hashes of former definitions that are still read, by type. None is ever removed (docs/reference/compatibility.md)."""


@cache
def current_hash(ros_type: str) -> str:
    """Return the hash of the definition of a type in this version; errors as for `message_schema`."""
    return message_schema(ros_type).type_hash


def bag_channel(channel: Channel, index: FileIndex, topic: Topic | None = None) -> BagChannel:
    """Return the description of a channel in a file, with its topic of the swarm if any."""
    return BagChannel(
        name=channel.topic,
        ros_type=_ros_type(channel, index),
        type_hash=channel.metadata.get("topic_type_hash", ""),
        qos_profiles=channel.metadata.get("offered_qos_profiles", ""),
        encoding=channel.message_encoding,
        message_count=index.statistics.channel_message_counts.get(channel.id, 0),
        topic=topic,
    )


def bag_topics(indexes: Iterable[FileIndex]) -> list[BagChannel]:
    """Return the topics of several files with their message counts."""
    topics: dict[str, BagChannel] = {}
    for index in indexes:
        for _, one in sorted(index.channels.items()):
            channel = bag_channel(one, index)
            earlier = topics.get(channel.name)
            count = channel.message_count if earlier is None else earlier.message_count + channel.message_count
            topics[channel.name] = replace(earlier or channel, message_count=count)
    return list(topics.values())


def swarm_topics(index: FileIndex) -> dict[int, tuple[str, Topic]]:
    """Return the channels of swarms: namespace, with trailing slash, and topic by channel number."""
    names = {channel.topic for channel in index.channels.values()}
    topics = ((number, _swarm_topic(channel, index, names)) for number, channel in index.channels.items())
    return {number: topic for number, topic in topics if topic is not None}


def chosen_swarm(path: Path, swarms: Sequence[str], namespace: str | None) -> str | None:
    """Return the swarm to read, None if there is none, or several and no namespace.

    Raises `NotABagError` if there is no swarm in that namespace.
    """
    if namespace is None:
        return swarms[0] if len(swarms) == 1 else None
    name = namespace.strip("/")
    chosen = f"/{name}/" if name else "/"
    if chosen not in swarms:
        wanted = printable(shorten(namespace))
        there = named_swarms(swarms) or "none"
        raise NotABagError(f"{path} contains no swarm in the namespace {wanted}; its swarms: {there}")
    return chosen


def named_swarms(swarms: Sequence[str]) -> str:
    """Return the namespaces of swarms as text that is safe for the terminal."""
    more = [f"{len(swarms) - _MOST_NAMED} more"] if len(swarms) > _MOST_NAMED else []
    return ", ".join([*(printable(shorten(name.rstrip("/") or "/")) for name in swarms[:_MOST_NAMED]), *more])


def _ros_type(channel: Channel, index: FileIndex) -> str:
    schema = index.schemas.get(channel.schema_id)
    return schema.name if schema is not None else ""


def _swarm_topic(channel: Channel, index: FileIndex, names: Collection[str]) -> tuple[str, Topic] | None:
    relayed = relay_topic_in(channel.topic)
    for topic in (*STANDBY_TOPICS.values(), *TOPICS, *(() if relayed is None else (relayed,))):
        if topic in USUAL_TOPICS and channel.topic.removesuffix(topic.name) + USUAL_TOPICS[topic].name not in names:
            continue  # a swarm whose namespace ends like that
        if channel.topic.endswith(f"/{topic.name}") and channel.message_encoding == "cdr":
            ours = _ros_type(channel, index) == topic.ros_type
            return (channel.topic.removesuffix(topic.name), topic) if ours else None
    return None


def check_definitions(path: object, channels: Iterable[BagChannel]) -> None:
    """Raise `UnknownTypeError` for a bag with message definitions that are neither current nor in `FORMER_HASHES`.

    A channel without a hash passes: its messages are read with the current definition, and their sizes checked.
    """
    for channel in channels:
        if channel.topic is None or not channel.type_hash:
            continue
        if channel.type_hash not in (current_hash(channel.ros_type), *FORMER_HASHES.get(channel.ros_type, ())):
            raise UnknownTypeError(
                f"{path}: {printable(shorten(channel.name))} has a definition of {channel.ros_type} that this version "
                f"does not know ({channel.type_hash[:80]!r}); use the version that wrote it (see the command info), "
                "or a newer one"
            )

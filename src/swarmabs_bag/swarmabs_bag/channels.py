"""The topics of a bag: what they are, and of which swarm, by the namespaces in which there are topics of one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_bag.errors import NotABagError
from swarmabs_config.scenario.errors import printable, shorten
from swarmabs_core.messages import TOPICS, Topic

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mcap.records import Channel

    from swarmabs_bag.index import FileIndex

_MOST_NAMED = 5


@dataclass(frozen=True, slots=True)
class BagChannel:
    """A topic as a bag holds it.

    Attributes
    ----------
    name : str
        Topic with namespace.
    ros_type : str
        Full ROS name of the message type, empty if the bag does not give it.
    type_hash : str
        RIHS01 hash of the type, empty if the bag does not give it.
    qos_profiles : str
        YAML text of what the publishers offered, empty if the bag does not give it.
    encoding : str
        Encoding of the messages, ``cdr`` in bags of ROS 2.
    message_count : int
        Number of messages.
    topic : Topic or None
        Which topic of the swarm it is, None if it is another one.
    """

    name: str
    ros_type: str
    type_hash: str
    qos_profiles: str
    encoding: str
    message_count: int
    topic: Topic | None


def bag_channel(channel: Channel, index: FileIndex, topic: Topic | None = None) -> BagChannel:
    """Return what a file says of a channel, which is that of a topic."""
    return BagChannel(
        name=channel.topic,
        ros_type=_ros_type(channel, index),
        type_hash=channel.metadata.get("topic_type_hash", ""),
        qos_profiles=channel.metadata.get("offered_qos_profiles", ""),
        encoding=channel.message_encoding,
        message_count=index.statistics.channel_message_counts.get(channel.id, 0),
        topic=topic,
    )


def swarm_topics(index: FileIndex) -> dict[int, tuple[str, Topic]]:
    """Return the channels that are of a swarm: by number the namespace, with its last slash, and the topic."""
    found = ((number, _swarm_topic(channel, index)) for number, channel in index.channels.items())
    return {number: topic for number, topic in found if topic is not None}


def chosen_swarm(path: Path, swarms: Sequence[str], namespace: str | None) -> str | None:
    """Return which of the swarms is read, None if there is none, or none of several is named.

    Raises
    ------
    NotABagError
        If there is no swarm of that name.
    """
    if namespace is None:
        return swarms[0] if len(swarms) == 1 else None
    name = namespace.strip("/")
    chosen = f"/{name}/" if name else "/"
    if chosen not in swarms:
        wanted = printable(shorten(namespace))
        raise NotABagError(f"{path} holds no swarm in the namespace {wanted}, but in {named_swarms(swarms) or 'none'}")
    return chosen


def named_swarms(swarms: Sequence[str]) -> str:
    """Return the namespaces of swarms for people, such that text from a file cannot steer the terminal."""
    more = [f"{len(swarms) - _MOST_NAMED} more"] if len(swarms) > _MOST_NAMED else []
    return ", ".join([*(printable(shorten(name.rstrip("/") or "/")) for name in swarms[:_MOST_NAMED]), *more])


def _ros_type(channel: Channel, index: FileIndex) -> str:
    schema = index.schemas.get(channel.schema_id)
    return schema.name if schema is not None else ""


def _swarm_topic(channel: Channel, index: FileIndex) -> tuple[str, Topic] | None:
    for topic in TOPICS:
        if channel.topic.endswith(f"/{topic.name}") and channel.message_encoding == "cdr":
            ours = _ros_type(channel, index) == topic.ros_type
            return (channel.topic.removesuffix(topic.name), topic) if ours else None
    return None

"""The topics of a bag: type, swarm, and whether their message definitions are readable."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from swarmabs_bag.errors import NotABagError, UnknownTypeError
from swarmabs_bag.run.metadata import BagChannel
from swarmabs_config.graph import STANDBY_TOPICS, USUAL_TOPICS
from swarmabs_config.model.errors import printable, shorten
from swarmabs_core.messages import TOPICS, Topic

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
    from pathlib import Path

    from mcap.records import Channel

    from swarmabs_bag.mcap.index import FileIndex

_MOST_NAMED = 5

READABLE = {
    "swarmabs_msgs/msg/AgentState": ("RIHS01_920c20b49337933ad2a2a54073afa24dac7f0bf85b89c0d8dd1b57ebfc9011bc",),
    "swarmabs_msgs/msg/PlaneState": ("RIHS01_eb50ea2ec4166fc2bcb82d6d93a165895a6769696f9119a68ef5631216479631",),
    "swarmabs_msgs/msg/AbstractState": ("RIHS01_d95f247c2589dc4f0829654e4f27b3962f02586fe75af371aa28dd2eabbaa7fd",),
    "swarmabs_msgs/msg/AuxiliaryState": ("RIHS01_52d6abf330048f23e1dfe0c338ba3a94672fa727da8cc3a240be1862e5e4e14d",),
    "swarmabs_msgs/msg/DesiredAbstractState": (
        "RIHS01_8d0ba0d2bda583bda9b0e7c060dfa8a7a61a5c5f1136fef6732eaf73845a4374",
    ),
    "swarmabs_msgs/msg/SwarmEvent": ("RIHS01_fed027d673123455049e51599995fd5dc6fefa15802f457c22ec5640bc24a2ae",),
    "swarmabs_msgs/msg/Basis": ("RIHS01_1251f0667986052e75e8fc930c843c888e9779334f8dbb913468a7921d9366b7",),
    "swarmabs_msgs/msg/RobotState": ("RIHS01_9a85044d40a2697251219c25b4b462ba33c5f507241274debae8e840be33170e",),
    "swarmabs_msgs/msg/ParentState": ("RIHS01_bac92cfe9f90d7848e4e8a720037fb9f95740f5e51e1ec1746ea217b120ec9c3",),
    "swarmabs_msgs/msg/SwarmAbstract": ("RIHS01_87004a96dcc261a8d4e62518df2b55f181ea05a7064370e042667518dc5069aa",),
    "swarmabs_msgs/msg/SwarmAuxiliary": ("RIHS01_363d152a03bdafcf03ef68aef9f060871e0a9e4de0bae31cebf5f86e7fd6f6c5",),
    "swarmabs_msgs/msg/SwarmDesired": ("RIHS01_14d4547108eaf7c9e58e558e9472aa0e2e82784160f1a0cf59ee18e36f6a445f",),
    "swarmabs_msgs/msg/StandingState": ("RIHS01_7cf46f19732db063247dd0137cbcc1c54ea43f8097f71c408d008b4d3eb62501",),
    "swarmabs_msgs/msg/SystemDescription": ("RIHS01_f2899023e8687bf5f9b1a866527ee09a370eb818ec831ed10a4d4e4217d2804c",),
}
"""Hashes of the recorded types, the current one last. None is ever removed (docs/reference/compatibility.md)."""


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
    for topic in (*STANDBY_TOPICS.values(), *TOPICS):
        if topic in USUAL_TOPICS and channel.topic.removesuffix(topic.name) + USUAL_TOPICS[topic].name not in names:
            continue  # a swarm whose namespace ends like that
        if channel.topic.endswith(f"/{topic.name}") and channel.message_encoding == "cdr":
            ours = _ros_type(channel, index) == topic.ros_type
            return (channel.topic.removesuffix(topic.name), topic) if ours else None
    return None


def check_definitions(path: object, channels: Iterable[BagChannel]) -> None:
    """Raise `UnknownTypeError` for a bag with unknown message definitions.

    A channel without a hash passes: its messages are read with the current definition, and their sizes checked.
    """
    for channel in channels:
        readable = READABLE.get(channel.ros_type)
        if channel.topic is None or not channel.type_hash or readable is None:
            continue
        if channel.type_hash not in readable:
            raise UnknownTypeError(
                f"{path}: {printable(shorten(channel.name))} has a definition of {channel.ros_type} that this version "
                f"does not know ({channel.type_hash[:80]!r}); use the version that wrote it (see the command info), "
                "or a newer one"
            )

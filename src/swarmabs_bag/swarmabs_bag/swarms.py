"""Which swarms a file holds: the namespaces in which it has topics of one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_bag.errors import NotABagError
from swarmabs_config.scenario.errors import printable, shorten
from swarmabs_core.messages import TOPICS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mcap.records import Channel

    from swarmabs_bag.index import FileIndex
    from swarmabs_core.messages import Topic

_MOST_NAMED = 5


def swarm_topics(index: FileIndex) -> dict[int, tuple[str, Topic]]:
    """Return the channels that are of a swarm: by number the namespace, with its last slash, and the topic."""
    found = ((number, _swarm_topic(channel, index)) for number, channel in index.channels.items())
    return {number: topic for number, topic in found if topic is not None}


def ros_type(channel: Channel, index: FileIndex) -> str:
    """Return the full name of a channel's type, empty if the file does not say."""
    schema = index.schemas.get(channel.schema_id)
    return schema.name if schema is not None else ""


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


def _swarm_topic(channel: Channel, index: FileIndex) -> tuple[str, Topic] | None:
    for topic in TOPICS:
        if channel.topic.endswith(f"/{topic.name}") and channel.message_encoding == "cdr":
            ours = ros_type(channel, index) == topic.ros_type
            return (channel.topic.removesuffix(topic.name), topic) if ours else None
    return None

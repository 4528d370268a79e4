"""The core's own serialisation against that of ROS 2."""

from __future__ import annotations

import struct
from array import array
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from tests.swarmabs_msgs.definitions import DEFINITIONS, SIZES, significant_bytes

from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import BROADCASTS, TOPICS, Message, Topic
from swarmabs_ros.endpoints import ros_type

numbers = st.floats(allow_nan=True, allow_infinity=True)
texts = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=40)
PARTS = {topic.message.__name__: topic for topic in BROADCASTS}
stamps = st.integers(0, (2**31 - 1) * 10**9 + 999_999_999)

topics = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.message.__name__)


def messages(message: type[Message]) -> st.SearchStrategy[Message]:
    """Return all messages of a class."""
    values: dict[str, st.SearchStrategy[Any]] = {"stamp": stamps}
    arrays: dict[str, st.SearchStrategy[int]] = {}
    for field in DEFINITIONS[message.__name__].fields[1:]:
        if field.type == "float64":
            values[field.name] = numbers
        elif field.type == "string":
            values[field.name] = texts
        elif field.type.endswith("[]"):
            arrays[field.name] = st.integers(0, 2 ** (8 * SIZES[field.type.removesuffix("[]")]) - 1)
        elif field.type in PARTS:
            values[field.name] = messages(PARTS[field.type].message)
        else:
            values[field.name] = st.integers(0, 2 ** (8 * SIZES[field.type]) - 1)
    if not arrays:
        return st.builds(message, **values)

    def of_length(length: int) -> st.SearchStrategy[Message]:
        lists = {name: st.lists(one, min_size=length, max_size=length).map(tuple) for name, one in arrays.items()}
        return st.builds(message, **values, **lists)

    return st.integers(0, 9).flatmap(of_length)


def to_ros(message: Message, topic: Topic) -> Any:
    """Return rclpy's form of a message."""
    ros = ros_type(topic)()
    ros.header.stamp.sec, ros.header.stamp.nanosec = divmod(message.stamp, 10**9)
    ros.header.frame_id = "plane"
    for name, value in message._asdict().items():
        if name != "stamp":
            part = PARTS.get(type(value).__name__)
            setattr(ros, name, value if part is None else to_ros(value, part))
    return ros


def from_ros(ros: Any, topic: Topic) -> Message:
    """Return a message from rclpy's form of it."""
    assert ros.header.frame_id == "plane"
    values = [ros.header.stamp.sec * 10**9 + ros.header.stamp.nanosec]
    for name in topic.message._fields[1:]:
        value = getattr(ros, name)
        part = PARTS.get(type(value).__name__)
        if isinstance(value, array):
            value = tuple(value)
        values.append(value if part is None else from_ros(value, part))
    return topic.message(*values)


def bits(message: Any) -> list[object]:
    """Return the fields such that a NaN equals itself and 0 differs from -0."""
    values: list[object] = [bits(value) if type(value).__name__ in PARTS else value for value in message]
    return [struct.pack("<d", value) if isinstance(value, float) else value for value in values]


@topics
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_bytes_are_those_of_ros(topic: Topic, data: st.DataObject) -> None:
    message = data.draw(messages(topic.message))
    ours, theirs = encode(message), serialize_message(to_ros(message, topic))
    content = significant_bytes(
        DEFINITIONS[topic.message.__name__],
        str(getattr(message, "detail", "")).encode(),
        len(getattr(message, "agent_ids", ())),
    )
    assert len(ours) == len(theirs) == len(content)
    assert [a for a, c in zip(ours, content, strict=True) if c] == [
        b for b, c in zip(theirs, content, strict=True) if c
    ]
    assert not any(a for a, c in zip(ours, content, strict=True) if not c), "padding must be zero"


@topics
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_what_ros_writes_is_read(topic: Topic, data: st.DataObject) -> None:
    message = data.draw(messages(topic.message))
    again = decode(topic.message, serialize_message(to_ros(message, topic)))
    assert bits(again) == bits(message)
    assert type(again) is topic.message


@topics
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_what_is_written_is_read_by_ros(topic: Topic, data: st.DataObject) -> None:
    message = data.draw(messages(topic.message))
    assert bits(from_ros(deserialize_message(encode(message), ros_type(topic)), topic)) == bits(message)

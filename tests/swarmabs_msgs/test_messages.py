"""The message definitions, read by their text, and the core's own serialisation, against ROS 2 and the core's twins."""

import re
import struct
from array import array
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import pytest
from hypothesis import given, settings, strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from swarmabs_core.cdr import canonical, decode, encode
from swarmabs_core.messages import (
    FAMILIES,
    NEVER,
    REMOVALS,
    STANDING,
    SYSTEM_FAMILY,
    TOPICS,
    Field,
    Message,
    Topic,
    fields_of,
)
from swarmabs_ros.endpoints import ros_type

FOLDER = Path(__file__).parents[2] / "src" / "swarmabs_msgs" / "msg"
LINE = re.compile(r"(?P<type>\S+)\s+(?P<name>\w+)\s*(?:=\s*(?P<value>\S+))?\s*(?:#\s*(?P<comment>.*))?$")
SIZES = {"byte": 1, "uint8": 1, "uint16": 2, "uint32": 4, "uint64": 8, "float64": 8}
MESSAGES = {topic.type_name: topic.message for topic in TOPICS if topic is not REMOVALS}
PARTS = {topic.message.__name__: topic for family in FAMILIES for topic in family.broadcasts}
PYTHON_TYPE = {"float64": float, "uint8": int, "uint16": int, "uint64": int, "string": str, "byte[]": bytes}
PYTHON_TYPE |= MESSAGES
PYTHON_TYPE |= {f"{name}[]": tuple[int, ...] for name in ("uint8", "uint16", "uint64")}
PYTHON_TYPE |= {f"float64[<={bound}]": tuple[float, ...] for bound in (8, 16, 32, 136)}
NO_STEP = {name: {"NO_BROADCAST": NEVER} for name in ("AgentState", "RobotState")} | {"Basis": {"NO_STEP": NEVER}}


class Entry(NamedTuple):
    """A field or, with a value, a constant."""

    type: str
    name: str
    value: int | None
    comment: str


def read_definition(path: Path) -> list[Entry]:
    """Read a definition; what stands behind an entry, or in the line above it, is its comment."""
    entries, above = [], ""
    for text in map(str.strip, path.read_text(encoding="utf-8").splitlines()):
        if not text or text.startswith("#"):
            above = text.removeprefix("#").strip()
            continue
        found = LINE.match(text)
        assert found is not None, f"{path.name}: {text!r}"
        value = None if found["value"] is None else int(found["value"])
        entries.append(Entry(found["type"], found["name"], value, found["comment"] or above))
        above = ""
    return entries


DEFINITIONS = {path.stem: read_definition(path) for path in sorted(FOLDER.glob("*.msg"))}
FIELDS = {name: [entry for entry in entries if entry.value is None][1:] for name, entries in DEFINITIONS.items()}
FIELDS["Removal"] = FIELDS["SwarmEvent"]
"""The fields of each message behind its header."""


def test_there_is_a_definition_for_every_message_and_each_is_built() -> None:
    assert DEFINITIONS.keys() == MESSAGES.keys()
    text = (FOLDER.parent / "CMakeLists.txt").read_text(encoding="utf-8")
    assert re.findall(r'"msg/(\w+)\.msg"', text) == list(DEFINITIONS)


@pytest.mark.parametrize("name", DEFINITIONS)
def test_a_definition_says_what_the_core_declares_and_explains_it(name: str) -> None:
    """Its fields and their order, their types, their units, with which comments begin, and the values they may have."""
    assert (FOLDER / f"{name}.msg").read_text(encoding="utf-8").startswith("# ")
    for entry in DEFINITIONS[name]:
        assert entry.comment, f"{entry.name} has no comment"
    assert next(entry[:2] for entry in DEFINITIONS[name] if entry.value is None) == ("std_msgs/Header", "header")
    assert FIELDS[name][0][:2] == ("uint64", "step")
    hints, declared = get_type_hints(MESSAGES[name]), fields_of(MESSAGES[name])
    assert hints.pop("stamp") is int
    assert [(field.name, PYTHON_TYPE[field.type]) for field in FIELDS[name]] == list(hints.items())
    explained = dict(NO_STEP.get(name, {}))
    for field in FIELDS[name]:
        found = declared[field.name]
        if not isinstance(found, Field):
            assert found is MESSAGES[field.type]
            continue
        assert found.ros_type == field.type
        if field.type == "float64" and field.name in {"command", "value"}:
            assert re.search(r"\bm/s\b.*\bN\b|\bin the unit\b", field.comment)
        elif field.type == "float64":
            assert re.match(rf"{re.escape(found.unit)}(,| along|$)", field.comment) and found.unit
        elif field.type in {"string", "byte[]"}:
            assert not found.unit
        elif field.type.startswith("float64["):
            assert found.unit == "by system"
        explained |= {value.name: value.value for value in found.constants or ()}
    assert {entry.name: entry.value for entry in DEFINITIONS[name] if entry.value is not None} == explained


# The core's own serialisation against that of ROS 2


def significant_bytes(message: Message) -> list[bool]:
    """Tell of every byte of a message in CDR whether it carries content, by the rules of CDR alone."""
    content: list[bool] = []  # the encapsulation apart, from where alignment counts
    _add_message(content, message)
    # Of the encapsulation's two option bytes the last may say how much padding follows.
    return [True, True, True, False, *content]


def _add_message(content: list[bool], message: Message) -> None:
    def add(alignment: int, size: int) -> None:
        content.extend([False] * (-len(content) % alignment) + [True] * size)

    add(4, 4 + 4 + 4 + len("plane") + 1)  # seconds, nanoseconds, length and characters of the frame id
    for field in FIELDS[type(message).__name__]:
        size, value = SIZES.get(field.type.split("[")[0], 0), getattr(message, field.name)
        if field.type in DEFINITIONS:
            _add_message(content, value)
        elif field.type == "string":
            add(4, 4 + len(value.encode()) + 1)
        elif field.type.endswith("]"):
            add(4, 4)
            add(size if value else 1, size * len(value))
        else:
            add(size, size)


def lists_of_floats(length: int) -> st.SearchStrategy[tuple[float, ...]]:
    return st.binary(min_size=8 * length, max_size=8 * length).map(lambda data: struct.unpack(f"<{length}d", data))


def messages(message: type[Message]) -> st.SearchStrategy[Message]:
    """Return all messages of a class."""
    values: dict[str, st.SearchStrategy[Any]] = {"stamp": st.integers(0, (2**31 - 1) * 10**9 + 999_999_999)}
    arrays: dict[str, st.SearchStrategy[int]] = {}
    for field in FIELDS[message.__name__]:
        if field.type == "float64":
            values[field.name] = st.floats(allow_nan=True, allow_infinity=True)
        elif field.type.startswith("float64["):
            bound = int(field.type[len("float64[<=") : -1])
            lengths = st.one_of(st.sampled_from((0, 1, bound)), st.integers(0, bound))
            values[field.name] = lengths.flatmap(lists_of_floats)
        elif field.type == "string":
            values[field.name] = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=40)
        elif field.type == "byte[]":
            values[field.name] = st.binary(max_size=40)
        elif field.type in PARTS:
            values[field.name] = messages(PARTS[field.type].message)
        else:
            one = st.integers(0, 2 ** (8 * SIZES[field.type.removesuffix("[]")]) - 1)
            (arrays if field.type.endswith("[]") else values)[field.name] = one

    def of_length(length: int) -> st.SearchStrategy[Message]:
        lists = {name: st.lists(one, min_size=length, max_size=length).map(tuple) for name, one in arrays.items()}
        return st.builds(message, **values, **lists)

    return st.integers(0, 9).flatmap(of_length) if arrays else of_length(0)


def to_ros(message: Message, topic: Topic) -> Any:
    """Return rclpy's form of a message."""
    ros = ros_type(topic)()
    ros.header.stamp.sec, ros.header.stamp.nanosec = divmod(message.stamp, 10**9)
    ros.header.frame_id = "plane"
    for name, value in message._asdict().items():
        if name != "stamp":
            part = PARTS.get(type(value).__name__)
            given = [bytes([byte]) for byte in value] if isinstance(value, bytes) else value
            setattr(ros, name, given if part is None else to_ros(value, part))
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
        elif isinstance(value, list):
            value = b"".join(value)
        values.append(value if part is None else from_ros(value, part))
    return topic.message(*values)


def bits(message: Any) -> list[object]:
    """Return the fields such that a NaN equals itself and 0 differs from -0."""
    values: list[object] = [bits(value) if isinstance(value, tuple) else value for value in message]
    return [struct.pack("<d", value) if isinstance(value, float) else value for value in values]


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.message.__name__)
@given(data=st.data())
@settings(max_examples=40)
def test_bytes_are_those_of_ros_and_each_reads_what_the_other_writes(topic: Topic, data: st.DataObject) -> None:
    message = data.draw(messages(topic.message))
    ours, theirs = encode(message), serialize_message(to_ros(message, topic))
    if topic in (*SYSTEM_FAMILY.main, SYSTEM_FAMILY.packed, STANDING):
        theirs = theirs[: len(ours)]  # rclpy's buffer includes room for aligning the elements of empty lists
    content = significant_bytes(message)
    assert len(ours) == len(theirs) == len(content)
    for own, other, counts in zip(ours, theirs, content, strict=True):
        assert own == (other if counts else 0), "padding must be zero"
    dirty = bytes(own if counts else 0xAA for own, counts in zip(ours, content, strict=True))
    assert canonical(topic.message, dirty + b"\xbb" * data.draw(st.integers(0, 3))) == ours
    again = decode(topic.message, theirs)
    assert type(again) is topic.message
    assert bits(again) == bits(message) == bits(from_ros(deserialize_message(ours, ros_type(topic)), topic))

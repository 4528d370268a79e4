"""Canonical little-endian CDR of the swarm's messages, every padding byte zero.

A message consists of encapsulation header, ``std_msgs/Header``, ``uint64 step`` and its own fields. Since the frame id
is always ``plane``, its layout follows from the declarations in `swarmabs_core.messages` and from the lengths of its
lists, which hardly change in a run; a string and bytes are lists, too. One `struct.Struct` describes all messages of a
class with lists of the same lengths. A test compares the layouts with the serialization of ``swarmabs_msgs`` by ROS 2.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import FRAME_ID, TOPICS, AgentState, Field, Relay, RobotState, SwarmEvent, fields_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from swarmabs_core.messages import Message, Topic

    Buffer: TypeAlias = bytes | bytearray | memoryview

ENCAPSULATION = b"\x00\x01"
"""Little-endian CDR; a reader treats the two option bytes that follow as padding."""
FRAME = struct.pack(f"<I{len(FRAME_ID) + 1}s", len(FRAME_ID) + 1, FRAME_ID.encode())
"""The serialized frame id: length, characters, terminating zero."""
SECOND = 1_000_000_000
"""A second, ns."""
_MOST_ROBOTS = 65535
_TRANSPORT_PADDING = 4
"""Fast DDS pads a serialized payload to a multiple of this number of bytes."""
_NANOSECONDS = 11
"""Offset of the most significant byte of the header's nanoseconds."""
_COUNT = 4
"""Size of the length of a list."""
_STRING, _BYTES = "string", "byte[]"
_CODES = {"uint8": "B", "uint16": "H", "uint64": "Q", "float64": "d", _STRING: "s", "byte": "s"}
_new = tuple.__new__
"""Makes a message of its values; `__new__` and `_make` of a NamedTuple are slower wrappers in Python."""


class Place(NamedTuple):
    """An item of a message: its name (empty for padding), its `struct` format and its size in bytes.

    `length` is the number of elements of a list, each of this format, 0 for any other item.
    """

    name: str
    code: str
    size: int
    length: int = 0

    @property
    def values(self) -> int:
        """Number of values that `struct` makes of it."""
        return self.length if self.length and self.code != "s" else int(self.name != "")


def places(message_type: type[Message], lengths: tuple[int, ...] = ()) -> tuple[Place, ...]:
    """Return the items of a message with lists of the given lengths, in order; further lists are empty.

    They are named after the fields, or `encapsulation`, `sec`, `nanosec` and `frame`; `count` is the length of a list,
    which precedes it. An empty list has no other item.
    """
    items = [Place("encapsulation", "2s", 2), Place("", "2x", 2)]
    size = 0  # without the encapsulation, after which alignment starts
    for item, alignment in _items(message_type, iter(lengths)):
        gap = -size % alignment
        if gap:
            items.append(Place("", f"{gap}x", gap))
        items.append(item)
        size += gap + item.size
    return tuple(items)


def _items(message_type: type[Message], lengths: Iterator[int]) -> Iterator[tuple[Place, int]]:
    """Yield the items of a message with their alignments, without the encapsulation."""
    yield from ((Place("sec", "i", 4), 4), (Place("nanosec", "I", 4), 4))
    yield Place("frame", f"{len(FRAME)}s", len(FRAME)), 4
    for name, field in fields_of(message_type).items():
        if not isinstance(field, Field):
            yield from _items(field, lengths)
        elif field.ros_type != "time":
            code = _CODES[field.ros_type.partition("[")[0]]
            width = struct.calcsize(code)
            if not _is_list(field):
                yield Place(name, code, width), width
                continue
            length = next(lengths, 0)
            yield Place("count", "I", _COUNT), _COUNT
            if length:
                yield Place(name, code, length * width, length), width


def _is_list(field: Field) -> bool:
    return field.ros_type == _STRING or field.ros_type.endswith("]")


def _lists(message_type: type[Message]) -> Iterator[tuple[str, str]]:
    """Yield the lists of a message: names and types of their fields."""
    for name, field in fields_of(message_type).items():
        if not isinstance(field, Field):
            yield from _lists(field)
        elif _is_list(field):
            yield name, field.ros_type


class _Layout:
    """Byte layout of a message with lists of given lengths.

    Attributes
    ----------
    whole, content : Struct
        The message item by item, and with the bytes between padding as one item each.
    head : Struct
        Only encapsulation, frame ids and lengths, which must be `expected`.
    counts : list of int
        Offsets of the lengths.
    parts : list of (type of Message, int, list of int or slice)
        The message without nested ones, then each of those: class, and where in `whole` are the seconds and the fields
        behind the stamp.
    """

    __slots__ = ("content", "counts", "expected", "head", "parts", "size", "whole")

    def __init__(self, form: _Form, lengths: tuple[int, ...]) -> None:
        items = places(form.message, lengths)
        self.whole = _struct(f"{place.length or ''}{place.code}" for place in items)
        self.content = _struct(_pieces(items))
        self.size = self.whole.size
        self.counts: list[int] = []
        self.parts: list[tuple[type[Message], int, list[int | slice]]] = []
        kinds, left = iter([form.message, *form.nested]), iter(lengths)
        constants: dict[str, bytes | int] = {"encapsulation": ENCAPSULATION, "frame": FRAME}
        expected: list[bytes | int] = []
        size = index = 0
        for place in items:
            if place.name == "sec":
                self.parts.append((next(kinds), index, []))
            elif place.name == "count":
                constants["count"] = length = next(left, 0)
                self.counts.append(size)
                values = min(length, 1) if form.characters else length
                self.parts[-1][2].append(slice(index + 1, index + 1 + values))
            elif place.name not in {"", "nanosec", *constants} and not place.length:
                self.parts[-1][2].append(index)
            if place.name in constants:
                expected.append(constants[place.name])
            size += place.size
            index += place.values
        self.head = _struct(place.code if place.name in constants else f"{place.size}x" for place in items)
        self.expected = tuple(expected)

    def fits(self, data: Buffer) -> bool:
        """Return whether serialized bytes have this layout."""
        return self.size <= len(data) < self.size + _TRANSPORT_PADDING and self.head.unpack_from(data) == self.expected


def _struct(codes: Iterable[str]) -> struct.Struct:
    return struct.Struct("<" + "".join(codes))


def _pieces(items: tuple[Place, ...]) -> Iterator[str]:
    size = 0
    for place in items:
        if place.name:
            size += place.size
        else:
            yield f"{size}s{place.code}"
            size = 0
    yield f"{size}s"


class _Form:
    """What all messages of a class have in common.

    Attributes
    ----------
    message, nested : type of Message, tuple of type of Message
        The class, and those of nested messages.
    lists : tuple of (str, str)
        Names and types of the lists.
    characters : str
        Name of the string or of bytes, which are the last field; empty if there are none.
    plain : _Layout or None
        The layout of a class without lists and nested messages.
    latest : _Layout
        The layout of the latest message.
    """

    __slots__ = ("characters", "latest", "lists", "message", "nested", "plain")

    def __init__(self, message_type: type[Message]) -> None:
        self.message = message_type
        self.nested = tuple(field for field in fields_of(message_type).values() if not isinstance(field, Field))
        self.lists = tuple(_lists(message_type))
        self.characters = next((name for name, kind in self.lists if kind in (_STRING, _BYTES)), "")
        self.latest = _Layout(self, ())
        self.plain = None if self.lists or self.nested else self.latest

    @lru_cache(maxsize=256)  # noqa: B019 - there is one object for each class
    def layout(self, lengths: tuple[int, ...]) -> _Layout:
        """Return the layout with lists of these lengths; those not given are empty.

        Raises `MalformedMessageError` if one is too long, or lists with an element for each robot are not equally long.
        """
        for (_, kind), length in zip(self.lists, lengths, strict=False):
            bound = int(kind.partition("<=")[2].rstrip("]") or 0)
            if bound and length > bound:
                raise self.malformed(f"a list of {length} numbers, at most {bound}")
            if not (bound or self.characters) and length > _MOST_ROBOTS:
                raise self.malformed(f"{length} robots, at most {_MOST_ROBOTS}")
        by_robot = [name for name, kind in self.lists if kind.endswith("[]")]
        if len(by_robot) == len(lengths) and len(set(lengths)) > 1:
            lists = ", ".join(f"{length} in `{name}`" for name, length in zip(by_robot, lengths, strict=True))
            raise self.malformed(f"lists of different lengths: {lists}")
        return _Layout(self, lengths)

    def lengths_of(self, data: Buffer) -> tuple[int, ...]:
        """Return the lengths of the lists in serialized bytes; see the function of this name."""
        lengths: tuple[int, ...] = ()
        for number in range(len(self.lists)):
            place = self.layout(lengths).counts[number]
            if place >= len(data):
                break
            lengths = (*lengths, int.from_bytes(data[place : place + _COUNT], "little"))
        self.layout(lengths)
        return lengths

    def layout_of(self, data: Buffer) -> _Layout:
        """Return the layout of serialized bytes, whose size, encapsulation and frame ids it checks."""
        if self.latest.fits(data):
            return self.latest
        layout = self.layout(self.lengths_of(data))
        if self.characters and self.lists[-1][1] == _STRING and len(data) < layout.size:
            raise self._bad_text()
        if not layout.size <= len(data) < layout.size + _TRANSPORT_PADDING:
            raise self.malformed(f"{len(data)} bytes, expected {layout.size}")
        if (head := layout.head.unpack_from(data)) != layout.expected:
            _refuse_head(self.message.__name__, head[0])
        self.latest = layout
        return layout

    def with_characters(self, values: tuple[object, ...], pieces: tuple[bytes, ...]) -> tuple[object, ...]:
        """Return the values of a message whose last field is a string or bytes, of which there may be none."""
        data = b"".join(pieces)
        if self.lists[-1][1] == _BYTES:
            return (*values, data)
        if data[-1:] != b"\x00":
            raise self._bad_text()
        try:
            return (*values, data[:-1].decode())
        except UnicodeDecodeError as error:
            raise self.malformed(f"`{self.characters}` is not UTF-8") from error

    def _bad_text(self) -> MalformedMessageError:
        return self.malformed(f"`{self.characters}` is cut off or not terminated")

    def malformed(self, problem: str) -> MalformedMessageError:
        """Return the error of bytes or of a message that do not have this form."""
        return MalformedMessageError(self.message.__name__, problem)


_FORMS = {topic.message: _Form(topic.message) for topic in TOPICS}


def lengths_of(message_type: type[Message], data: Buffer) -> tuple[int, ...]:
    """Return the lengths of the lists in serialized bytes, which may be longer than one message.

    Raises `MalformedMessageError` if one is too long.
    """
    return _FORMS[message_type].lengths_of(data)


def encode(message: Message) -> bytes:
    """Serialize a message as canonical CDR with four-byte encapsulation header; equal messages give equal bytes.

    Raises
    ------
    MalformedMessageError
        If a field does not fit its type.
    """
    form = _FORMS[type(message)]
    try:
        if form.plain is not None:
            return form.plain.whole.pack(ENCAPSULATION, *divmod(message[0], SECOND), FRAME, *message[1:])
        own = len(message) - len(form.nested)
        values: list[object] = [ENCAPSULATION]
        lengths: list[int] = []
        for part in (message[:own], *message[own:]):
            values += (*divmod(part[0], SECOND), FRAME)
            if form.lists:
                _add(part[1:], values, lengths)
            else:
                values += part[1:]
        return form.layout(tuple(lengths)).whole.pack(*values)
    except (struct.error, UnicodeEncodeError) as error:
        raise form.malformed(f"{error} in {message}") from error


def _add(fields: tuple[object, ...], values: list[object], lengths: list[int]) -> None:
    """Add the values that are packed for fields, and the lengths of lists."""
    for value in fields:
        if isinstance(value, tuple):
            lengths.append(len(value))
            values += (len(value), *value)
        elif isinstance(value, (str, bytes)):
            characters = value.encode() + b"\x00" if isinstance(value, str) else value
            lengths.append(len(characters))
            values.append(len(characters))
            if characters:
                values.append(characters)
        else:
            values.append(value)


def decode(message_type: type[Message], data: Buffer) -> Message:
    """Deserialize a message from CDR with encapsulation header, as received from DDS; padding is ignored.

    Raises
    ------
    MalformedMessageError
        If length, encapsulation or frame id do not match a message of this swarm.
    """
    form = _FORMS[message_type]
    if (plain := form.plain) is not None and plain.size <= len(data) < plain.size + _TRANSPORT_PADDING:
        values = plain.whole.unpack_from(data)
        if values[0] == ENCAPSULATION and values[3] == FRAME:
            return _new(message_type, (values[1] * SECOND + values[2], *values[4:]))
    layout = form.layout_of(data)
    values = layout.whole.unpack_from(data)
    own, *parts = [
        (kind, (values[first] * SECOND + values[first + 1], *[values[place] for place in fields]))
        for kind, first, fields in layout.parts
    ]
    if form.characters:
        return _new(message_type, form.with_characters(own[1][:-1], own[1][-1]))
    return _new(message_type, (*own[1], *[_new(*part) for part in parts]))


def _refuse_head(message_type: str, encapsulation: bytes) -> None:
    if encapsulation != ENCAPSULATION:
        raise MalformedMessageError(message_type, "not little-endian CDR")
    raise MalformedMessageError(message_type, f"frame_id is not {FRAME_ID!r}")


_STEP = struct.Struct(f"<2s10x{len(FRAME)}s6xQ")
"""Encapsulation, frame and step, with which every message begins."""


def step_of(data: bytes, message_type: str = "message") -> int:
    """Return the step of a serialized message of the swarm without deserializing it.

    Raises
    ------
    MalformedMessageError
        If it does not begin as a message of this swarm: then the step is elsewhere.
    """
    if len(data) < _STEP.size:
        raise MalformedMessageError(message_type, f"{len(data)} bytes, expected at least {_STEP.size}")
    encapsulation, frame, step = _STEP.unpack_from(data)
    if encapsulation != ENCAPSULATION or frame != FRAME:
        _refuse_head(message_type, encapsulation)
    return int(step)


def canonical(message_type: type[Message], data: bytes) -> bytes:
    """Return the canonical form of bytes that `decode` accepts: zero padding, no trailing bytes.

    Raises
    ------
    MalformedMessageError
        If the time stamp exceeds the range of a header.
    """
    form = _FORMS[message_type]
    if form.nested or data[_NANOSECONDS] >= SECOND >> 24:  # rare: 1 s or more in the nanoseconds
        return encode(decode(message_type, data))
    content = (form.plain or form.layout_of(data)).content
    return content.pack(*content.unpack_from(data))


def split(message_type: type[Message], data: bytes) -> list[bytes]:
    """Return the messages of a class that follow one another in bytes; the last one may be cut off.

    Raises
    ------
    MalformedMessageError
        If a list is too long.
    """
    form, payloads, start = _FORMS[message_type], list[bytes](), 0
    while start < len(data):
        end = start + form.layout(form.lengths_of(memoryview(data)[start:])).size
        payloads.append(data[start:end])
        start = end
    return payloads


def agent_id_of(message: Message) -> int:
    """Return the id of the robot that a message concerns, 0 for messages of the coordinators."""
    return message.agent_id if isinstance(message, (AgentState, RobotState, SwarmEvent, Relay)) else 0


def misplaced(message: Message, topic: Topic) -> str:
    """Return why a message is rejected on a robot's own topic: it has the id of another robot; empty if it has not."""
    if agent_id_of(message) == topic.agent_id or not (topic.agent_id or isinstance(message, Relay)):
        return ""
    whose = f"robot {topic.agent_id}" if topic.agent_id else "the plane"
    return f"{whose}: messages with the id of another robot on {topic.name}"

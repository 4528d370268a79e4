"""Canonical little-endian CDR of the swarm's messages, every padding byte zero.

A message consists of encapsulation header, ``std_msgs/Header``, ``uint64 step`` and its own fields. Since the frame id
is always ``plane``, everything but strings and lists has a fixed offset, which follows from the declarations in
`swarmabs_core.messages`; one `struct.Struct` per message describes it. The messages of any parent system have bounded
lists, whose lengths do not change in a run, and one `struct.Struct` for these lengths. A test compares all layouts with
the serialization of ``swarmabs_msgs`` by ROS 2.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import FRAME_ID, TOPICS, AgentState, Field, RobotState, SwarmEvent, fields_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.messages import Message, Topic

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
_BEGIN = 4
"""Size of the encapsulation header, after which alignment starts."""
_BYTES = "byte[]"
_CODES = {"uint8": "B", "uint16": "H", "uint64": "Q", "float64": "d"}
_new: Any = tuple.__new__  # of a NamedTuple, without the Python wrappers `__new__` and `_make`


class Place(NamedTuple):
    """An item of a message: its name (empty for padding), its `struct` format and its size in bytes.

    `length` is the number of elements of a list of float64, 0 for any other item.
    """

    name: str
    code: str
    size: int
    length: int = 0


def places(message_type: type[Message], lengths: tuple[int, ...] = ()) -> tuple[Place, ...]:
    """Return the items in the fixed part of a message, in order.

    They are named after the fields, or `encapsulation`, `sec`, `nanosec` and `frame`; `count` is the length of the
    string or of the first list that follows the fixed part. Bounded lists of the given `lengths` are part of it, each
    after its `count`.
    """
    found = [Place("encapsulation", "2s", 2), Place("", "2x", 2)]
    for item, alignment in _items(message_type, iter(lengths)):
        gap = -(sum(place.size for place in found) - _BEGIN) % alignment
        if gap:
            found.append(Place("", f"{gap}x", gap))
        found.append(item)
    return tuple(found)


def _items(message_type: type[Message], lengths: Iterator[int]) -> Iterator[tuple[Place, int]]:
    """Yield the items in the fixed part with their alignments, without the encapsulation."""
    count = Place("count", "I", 4)
    yield from ((Place("sec", "i", 4), 4), (Place("nanosec", "I", 4), 4))
    yield Place("frame", f"{len(FRAME)}s", len(FRAME)), 4
    for name, field in fields_of(message_type).items():
        if not isinstance(field, Field):
            yield from _items(field, lengths)
        elif bound_of(field):
            length = next(lengths, 0)
            yield count, 4
            if length:
                yield Place(name, f"{length}d", 8 * length, length), 8
        elif field.ros_type in _CODES:
            code = _CODES[field.ros_type]
            size = struct.calcsize(code)
            yield Place(name, code, size), size
        elif field.ros_type != "time":
            yield count, 4
            return


def bound_of(field: Field) -> int:
    """Return the largest length of a bounded list, 0 for any other field."""
    return int(field.ros_type.partition("<=")[2].rstrip("]") or 0)


class _Layout:
    """Byte layout of a message class.

    Attributes
    ----------
    message : type of Message
        The class.
    fixed : Struct
        The fixed part, item by item.
    content : Struct
        The fixed part, with the bytes between padding as one item each.
    parts : tuple of (type of Message, int)
        The nested messages, each with the number of its values in `fixed`.
    lists : tuple of str
        Element formats of the lists.
    text, raw : str
        Name of the field with a string or with bytes, which is the last one; empty if there is none.
    bounds : tuple of int
        Largest lengths of the bounded lists; if there are any, a `_Shape` has the rest.
    latest : dict
        By size in bytes, the `_Shape` of the latest message.
    """

    __slots__ = ("bounds", "content", "fixed", "latest", "lists", "message", "parts", "plain", "raw", "size", "text")

    def __init__(self, message_type: type[Message]) -> None:
        self.message = message_type
        items = places(message_type)
        self.fixed = struct.Struct("<" + "".join(place.code for place in items))
        self.size = self.fixed.size
        self.content = struct.Struct("<" + "".join(_pieces(items)))
        fields = fields_of(message_type)
        parts = [field for field in fields.values() if not isinstance(field, Field)]
        # Seconds, nanoseconds and frame id replace the stamp.
        self.parts = tuple((part, len(fields_of(part)) + 2) for part in parts)
        own = {name: field.ros_type for name, field in fields.items() if isinstance(field, Field)}
        self.lists = tuple(
            _CODES[kind.removesuffix("[]")] for kind in own.values() if kind.endswith("[]") and kind != _BYTES
        )
        self.text, self.raw = (
            next((name for name, kind in own.items() if kind == wanted), "") for wanted in ("string", _BYTES)
        )
        self.bounds = tuple(_bounds(message_type))
        self.latest: dict[int, _Shape] = {}
        self.plain = not (self.parts or self.lists or self.text or self.raw or self.bounds)


def _bounds(message_type: type[Message]) -> Iterator[int]:
    for field in fields_of(message_type).values():
        if not isinstance(field, Field):
            yield from _bounds(field)
        elif bound_of(field):
            yield bound_of(field)


@lru_cache(maxsize=64)
def _tail(layout: _Layout, number: int) -> struct.Struct:
    """Return the layout of the lists with `number` elements each; every list but the first starts with its length."""
    form, size = "<", layout.size - _BEGIN
    for place, code in enumerate(layout.lists):
        for piece, alignment, count in (("I", 4, int(place > 0)), (code, struct.calcsize(code), number)):
            if count:
                gap = -size % alignment
                form += f"{gap}x{count}{piece}"
                size += gap + count * alignment
    return struct.Struct(form)


def _pieces(items: tuple[Place, ...]) -> Iterator[str]:
    size = 0
    for place in items:
        if place.name:
            size += place.size
        else:
            yield f"{size}s{place.code}"
            size = 0
    yield f"{size}s"


_LAYOUTS = {topic.message: _Layout(topic.message) for topic in TOPICS}


class _Shape:
    """Byte layout of a message with bounded lists of given lengths.

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

    __slots__ = ("content", "counts", "expected", "head", "parts", "whole")

    def __init__(self, layout: _Layout, lengths: tuple[int, ...]) -> None:
        items = places(layout.message, lengths)
        self.whole = struct.Struct("<" + "".join(place.code for place in items))
        self.content = struct.Struct("<" + "".join(_pieces(items)))
        self.counts: list[int] = []
        self.parts: list[tuple[type[Message], int, list[int | slice]]] = []
        kinds, left = iter([layout.message, *(part for part, _ in layout.parts)]), iter(lengths)
        form, known, size, index = "<", {"encapsulation": ENCAPSULATION, "frame": FRAME}, 0, 0
        expected: list[bytes | int] = []
        for name, code, width, elements in items:
            if name == "sec":
                self.parts.append((next(kinds), index, []))
            elif name == "count":
                expected.append(length := next(left, 0))
                self.counts.append(size)
                self.parts[-1][2].append(slice(index + 1, index + 1 + length))
            elif name in known:
                expected.append(known[name])
            elif name not in {"", "nanosec"} and not elements:
                self.parts[-1][2].append(index)
            form += code if name in known or name == "count" else f"{width}x"
            size += width
            index += elements or bool(name)
        self.head, self.expected = struct.Struct(form), tuple(expected)


@lru_cache(maxsize=256)
def _shape(layout: _Layout, lengths: tuple[int, ...]) -> _Shape:
    """Return the layout of a message with bounded lists of these lengths; those not given are empty.

    Raises `MalformedMessageError` if one is too long.
    """
    for length, bound in zip(lengths, layout.bounds, strict=False):
        if length > bound:
            raise MalformedMessageError(layout.message.__name__, f"a list of {length} numbers, at most {bound}")
    return _Shape(layout, lengths)


def _shape_of(layout: _Layout, data: bytes) -> _Shape:
    """Return the layout of serialized bytes, whose size, encapsulation and frame ids it checks."""
    shape = layout.latest.get(len(data))
    if shape is not None and shape.head.unpack_from(data) == shape.expected:
        return shape
    shape = _shape(layout, lengths_of(layout.message, data))
    if not (size := shape.head.size) <= len(data) < size + _TRANSPORT_PADDING:
        raise MalformedMessageError(layout.message.__name__, f"{len(data)} bytes, expected {size}")
    if (head := shape.head.unpack_from(data)) != shape.expected:
        _refuse_head(layout.message.__name__, head[0])
    layout.latest[len(data)] = shape
    return shape


def lengths_of(message_type: type[Message], data: bytes | bytearray | memoryview) -> tuple[int, ...]:
    """Return the lengths of the bounded lists in serialized bytes, which may be longer than one message.

    Raises `MalformedMessageError` if one is too long.
    """
    layout = _LAYOUTS[message_type]
    lengths: tuple[int, ...] = ()
    shape = _shape(layout, lengths)
    for number in range(len(layout.bounds)):
        place = shape.counts[number]
        lengths = (*lengths, int.from_bytes(data[place : place + 4], "little"))
        shape = _shape(layout, lengths)
    return lengths


def _encode_bounded(message: Any, parts: list[Any]) -> bytes:
    """Serialize a message with bounded lists: its own fields, then the nested messages."""
    values: list[Any] = [ENCAPSULATION]
    lengths = []
    for part in parts:
        values += (*divmod(part[0], SECOND), FRAME)
        for value in part[1:]:
            if isinstance(value, tuple):
                lengths.append(len(value))
                values += (len(value), *value)
            else:
                values.append(value)
    return _shape(_LAYOUTS[type(message)], tuple(lengths)).whole.pack(*values)


def _decode_bounded(layout: _Layout, data: bytes) -> Message:
    """Deserialize a message with bounded lists."""
    shape = _shape_of(layout, data)
    values = shape.whole.unpack_from(data)
    own, *parts = [
        _new(kind, (values[first] * SECOND + values[first + 1], *[values[place] for place in fields]))
        for kind, first, fields in shape.parts
    ]
    return _new(layout.message, (*own, *parts)) if parts else own  # type: ignore[no-any-return]


def encode(message: Message) -> bytes:
    """Serialize a message as canonical CDR with four-byte encapsulation header; equal messages give equal bytes.

    Raises
    ------
    MalformedMessageError
        If a field does not fit its type.
    """
    layout = _LAYOUTS[type(message)]
    seconds, nanoseconds = divmod(message[0], SECOND)
    try:
        if layout.plain:
            return layout.fixed.pack(ENCAPSULATION, seconds, nanoseconds, FRAME, *message[1:])
        if layout.bounds:
            own = len(message) - len(layout.parts)
            return _encode_bounded(message, [message[:own], *message[own:]])
        return _encode_parts(layout, message) if layout.parts else _encode_tail(layout, message)
    except (struct.error, UnicodeEncodeError) as error:
        raise MalformedMessageError(type(message).__name__, f"{error} in {message}") from error


def _encode_parts(layout: _Layout, message: Any) -> bytes:
    """Serialize a message that consists of other messages."""
    values = [ENCAPSULATION, *_values(message[:2])]
    for part in message[2:]:
        values += _values(part)
    return layout.fixed.pack(*values)


def _values(part: Any) -> tuple[Any, ...]:
    """Return the values that are packed for a message, or for its first fields."""
    return (*divmod(part[0], SECOND), FRAME, *part[1:])


def _encode_tail(layout: _Layout, message: Any) -> bytes:
    """Serialize a message that ends with a string, with bytes or with lists."""
    if layout.text or layout.raw:
        end: bytes = message[-1].encode() + b"\x00" if layout.text else message[-1]
        return layout.fixed.pack(ENCAPSULATION, *_values(message[:-1]), len(end)) + end
    lists = message[-len(layout.lists) :]
    _check_lengths(type(message), [len(values) for values in lists])
    number = len(lists[0])
    tail = [value for values in lists for value in (number, *values)][1:]
    return layout.fixed.pack(ENCAPSULATION, *_values(message[: -len(layout.lists)]), number) + _tail(
        layout, number
    ).pack(*tail)


def _check_lengths(message_type: type[Message], lengths: list[int]) -> None:
    """Reject lists of different lengths."""
    if len(set(lengths)) > 1:
        names = message_type._fields[-len(lengths) :]
        said = ", ".join(f"{length} in `{name}`" for name, length in zip(names, lengths, strict=True))
        raise MalformedMessageError(message_type.__name__, f"lists of different lengths: {said}")


def decode(message_type: type[Message], data: bytes) -> Message:
    """Deserialize a message from CDR with encapsulation header, as received from DDS; padding is ignored.

    Raises
    ------
    MalformedMessageError
        If length, encapsulation or frame id do not match a message of this swarm.
    """
    layout = _LAYOUTS[message_type]
    size = layout.size
    if layout.bounds:
        return _decode_bounded(layout, data)
    if layout.lists or layout.text or layout.raw:
        return _decode_tail(layout, message_type, data)
    if not size <= len(data) < size + _TRANSPORT_PADDING:
        raise MalformedMessageError(message_type.__name__, f"{len(data)} bytes, expected {size}")
    values = layout.fixed.unpack_from(data)
    if values[0] != ENCAPSULATION or values[3] != FRAME:
        _refuse_head(message_type.__name__, values[0])
    if layout.plain:
        return _new(message_type, (values[1] * SECOND + values[2], *values[4:]))  # type: ignore[no-any-return]
    first = place = 5
    parts = []
    for part, count in layout.parts:
        seconds, nanoseconds, frame, *own = values[place : place + count]
        if frame != FRAME:
            _refuse_head(message_type.__name__, values[0])
        parts.append(_new(part, (seconds * SECOND + nanoseconds, *own)))
        place += count
    return _new(message_type, (values[1] * SECOND + values[2], *values[4:first], *parts))  # type: ignore[no-any-return]


def _decode_tail(layout: _Layout, message_type: type[Message], data: bytes) -> Message:
    """Deserialize a message that ends with a string, with bytes or with lists."""
    name, size = message_type.__name__, layout.size
    if len(data) < size:
        raise MalformedMessageError(name, f"{len(data)} bytes, expected at least {size}")
    values = layout.fixed.unpack_from(data)
    if values[0] != ENCAPSULATION or values[3] != FRAME:
        _refuse_head(message_type.__name__, values[0])
    own = (values[1] * SECOND + values[2], *values[4:-1])
    read = _text if layout.text else _raw if layout.raw else _lists
    tail = read(layout, message_type, data, values[-1])
    return _new(message_type, (*own, *tail))  # type: ignore[no-any-return]


def _text(layout: _Layout, message_type: type[Message], data: bytes, count: int) -> list[Any]:
    name, end = message_type.__name__, layout.size + count
    text = data[layout.size : end]
    if count < 1 or len(text) != count or text[-1:] != b"\x00":
        raise MalformedMessageError(name, f"`{layout.text}` is cut off or not terminated")
    if len(data) >= end + _TRANSPORT_PADDING:
        raise MalformedMessageError(name, f"{len(data)} bytes, expected {end}")
    try:
        return [text[:-1].decode()]
    except UnicodeDecodeError as error:
        raise MalformedMessageError(name, f"`{layout.text}` is not UTF-8") from error


def _raw(layout: _Layout, message_type: type[Message], data: bytes, count: int) -> list[Any]:
    end = layout.size + count
    if not end <= len(data) < end + _TRANSPORT_PADDING:
        raise MalformedMessageError(message_type.__name__, f"{len(data)} bytes, expected {end}")
    return [data[layout.size : end]]


def _lists(layout: _Layout, message_type: type[Message], data: bytes, number: int) -> list[Any]:
    name = message_type.__name__
    if number > _MOST_ROBOTS:
        raise MalformedMessageError(name, f"{number} robots, at most {_MOST_ROBOTS}")
    lists = _tail(layout, number)
    size = layout.size + lists.size
    if not size <= len(data) < size + _TRANSPORT_PADDING:
        raise MalformedMessageError(name, f"{len(data)} bytes, expected {size} for {number} robots")
    values = (number, *lists.unpack_from(data, layout.size))
    begins = range(0, len(values), number + 1)
    _check_lengths(message_type, [values[begin] for begin in begins])
    return [values[begin + 1 : begin + 1 + number] for begin in begins]


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
    layout = _LAYOUTS[message_type]
    if layout.parts or data[_NANOSECONDS] >= SECOND >> 24:  # rare: 1 s or more in the nanoseconds
        return encode(decode(message_type, data))
    content, size = (_shape_of(layout, data) if layout.bounds else layout).content, layout.size
    fixed: bytes = content.pack(*content.unpack_from(data))
    if layout.plain or layout.bounds:
        return fixed
    number = int.from_bytes(fixed[-4:], "little")
    if layout.text or layout.raw:
        return fixed + data[size : size + number]
    lists = _tail(layout, number)
    return fixed + lists.pack(*lists.unpack_from(data, size))


def split(message_type: type[Message], data: bytes) -> list[bytes]:
    """Return the messages of a class that follow one another in bytes; the last one may be cut off.

    Raises
    ------
    MalformedMessageError
        If a list is too long.
    """
    layout, found, start = _LAYOUTS[message_type], [], 0
    while start < len(data):
        rest = memoryview(data)[start:]
        size = _shape(layout, lengths_of(message_type, rest)).whole.size if layout.bounds else layout.size
        found.append(data[start : start + size])
        start += size
    return found


def agent_id_of(message: Message) -> int:
    """Return the id of the robot that a message concerns, 0 for messages of the coordinators."""
    return message.agent_id if isinstance(message, (AgentState, RobotState, SwarmEvent)) else 0


def misplaced(message: Message, topic: Topic) -> str:
    """Return why a message is rejected on a robot's own topic: it has the id of another robot; empty if it has not."""
    if not topic.agent_id or agent_id_of(message) == topic.agent_id:
        return ""
    return f"robot {topic.agent_id}: messages with the id of another robot on {topic.name}"

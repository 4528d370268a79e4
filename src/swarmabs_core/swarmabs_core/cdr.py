"""Canonical little-endian CDR of the swarm's messages, every padding byte zero.

A message is encapsulation header, ``std_msgs/Header``, ``uint64 step`` and the message's own fields. Since the frame id
is always ``plane``, all but texts and lists have a fixed place, which follows from the declarations in
`swarmabs_core.messages`; one `struct.Struct` per message says it all. That these layouts are what ROS 2 itself writes
for ``swarmabs_msgs`` is a test.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import FRAME_ID, TOPICS, AgentState, Field, SwarmEvent, fields_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.messages import Message

ENCAPSULATION = b"\x00\x01"
"""Little-endian CDR; two bytes of options follow, which are padding to a reader."""
FRAME = struct.pack(f"<I{len(FRAME_ID) + 1}s", len(FRAME_ID) + 1, FRAME_ID.encode())
"""The frame id as it stands in a message: length, characters, zero."""
_SECOND = 1_000_000_000
_MOST_ROBOTS = 65535
_TRANSPORT_PADDING = 4
"""Fast DDS pads a serialised payload to a multiple of this."""
_NANOSECONDS = 11
"""Where the highest byte of the header's nanoseconds stands."""
_BEGIN = 4
"""Alignment counts from behind the encapsulation header."""
_CODES = {"uint8": "B", "uint16": "H", "uint64": "Q", "float64": "d"}
_new: Any = tuple.__new__  # of a NamedTuple: its own `__new__` and `_make` are Python functions around it


class Place(NamedTuple):
    """What stands at a place of a message: its name, empty for padding; its format as of `struct`; its size."""

    name: str
    code: str
    size: int


def places(message_type: type[Message]) -> tuple[Place, ...]:
    """Return what stands in the fixed part of a message, byte by byte.

    Names are those of the fields, `encapsulation`, `sec`, `nanosec` and `frame`, and `count` for the length of the text
    or the first list behind the fixed part.
    """
    found = [Place("encapsulation", "2s", 2), Place("", "2x", 2)]
    for name, code, alignment in _numbers(message_type):
        size = struct.calcsize(f"<{code}")
        gap = -(sum(place.size for place in found) - _BEGIN) % alignment
        if gap:
            found.append(Place("", f"{gap}x", gap))
        found.append(Place(name, code, size))
    return tuple(found)


def _numbers(message_type: type[Message]) -> Iterator[tuple[str, str, int]]:
    """Yield name, format and alignment of what stands in a message, without the encapsulation."""
    yield from (("sec", "i", 4), ("nanosec", "I", 4), ("frame", f"{len(FRAME)}s", 4))
    for name, field in fields_of(message_type).items():
        if not isinstance(field, Field):
            yield from _numbers(field)
        elif field.ros_type in _CODES:
            code = _CODES[field.ros_type]
            yield name, code, struct.calcsize(code)
        elif field.ros_type != "time":
            yield "count", "I", 4
            return


class _Layout:
    """Bytes of a message class.

    Attributes
    ----------
    fixed : Struct
        Of all that has a fixed place.
    content : Struct
        The same, what stands between padding as one piece.
    parts : tuple of (type of Message, int)
        The messages of which it consists, each with the number of its values in `fixed`; empty if of none.
    lists : tuple of str
        Formats of the elements of its lists.
    text : str
        Name of its text, empty if it has none.
    """

    __slots__ = ("content", "fixed", "lists", "parts", "plain", "size", "text")

    def __init__(self, message_type: type[Message]) -> None:
        stand = places(message_type)
        self.fixed = struct.Struct("<" + "".join(place.code for place in stand))
        self.size = self.fixed.size
        self.content = struct.Struct("<" + "".join(_pieces(stand)))
        fields = fields_of(message_type)
        parts = [field for field in fields.values() if not isinstance(field, Field)]
        # Seconds, nanoseconds and frame id stand for the stamp.
        self.parts = tuple((part, len(fields_of(part)) + 2) for part in parts)
        own = {name: field.ros_type for name, field in fields.items() if isinstance(field, Field)}
        self.lists = tuple(_CODES[kind.removesuffix("[]")] for kind in own.values() if kind.endswith("[]"))
        self.text = next((name for name, kind in own.items() if kind == "string"), "")
        self.plain = not (self.parts or self.lists or self.text)


@lru_cache(maxsize=64)
def _behind(layout: _Layout, number: int) -> struct.Struct:
    """Return the layout of the lists of so many elements each; before all but the first stands their number."""
    form, size = "<", layout.size - _BEGIN
    for place, code in enumerate(layout.lists):
        for piece, alignment, count in (("I", 4, int(place > 0)), (code, struct.calcsize(code), number)):
            if count:
                gap = -size % alignment
                form += f"{gap}x{count}{piece}"
                size += gap + count * alignment
    return struct.Struct(form)


def _pieces(stand: tuple[Place, ...]) -> Iterator[str]:
    size = 0
    for place in stand:
        if place.name:
            size += place.size
        else:
            yield f"{size}s{place.code}"
            size = 0
    yield f"{size}s"


_LAYOUTS = {topic.message: _Layout(topic.message) for topic in TOPICS}


def encode(message: Message) -> bytes:
    """Return a message as canonical CDR with its four-byte encapsulation header: equal messages give equal bytes.

    Raises
    ------
    MalformedMessageError
        If a field does not fit its type.
    """
    layout = _LAYOUTS[type(message)]
    seconds, nanoseconds = divmod(message[0], _SECOND)
    try:
        if layout.plain:
            return layout.fixed.pack(ENCAPSULATION, seconds, nanoseconds, FRAME, *message[1:])
        return _encode_parts(layout, message) if layout.parts else _encode_behind(layout, message)
    except (struct.error, UnicodeEncodeError) as error:
        raise MalformedMessageError(type(message).__name__, f"{error} in {message}") from error


def _encode_parts(layout: _Layout, message: Any) -> bytes:
    """Serialise a message that consists of others."""
    values = [ENCAPSULATION, *_values(message[:2])]
    for part in message[2:]:
        values += _values(part)
    return layout.fixed.pack(*values)


def _values(part: Any) -> tuple[Any, ...]:
    """Return what stands for a message, or a part of one."""
    return (*divmod(part[0], _SECOND), FRAME, *part[1:])


def _encode_behind(layout: _Layout, message: Any) -> bytes:
    """Serialise a message that ends with a text or with lists."""
    if layout.text:
        text: bytes = message[-1].encode() + b"\x00"
        return layout.fixed.pack(ENCAPSULATION, *_values(message[:-1]), len(text)) + text
    lists = message[-len(layout.lists) :]
    _check_lengths(type(message), [len(values) for values in lists])
    number = len(lists[0])
    behind = [value for values in lists for value in (number, *values)][1:]
    return layout.fixed.pack(ENCAPSULATION, *_values(message[: -len(layout.lists)]), number) + _behind(
        layout, number
    ).pack(*behind)


def _check_lengths(message_type: type[Message], lengths: list[int]) -> None:
    """Refuse lists that do not belong together."""
    if len(set(lengths)) > 1:
        names = message_type._fields[-len(lengths) :]
        said = ", ".join(f"{length} in `{name}`" for name, length in zip(names, lengths, strict=True))
        raise MalformedMessageError(message_type.__name__, f"lists of different lengths: {said}")


def decode(message_type: type[Message], data: bytes) -> Message:
    """Read a message from CDR with encapsulation header, as it comes from DDS, whatever padding holds.

    Raises
    ------
    MalformedMessageError
        If the length, the encapsulation or the frame id is not that of a message of this swarm.
    """
    layout = _LAYOUTS[message_type]
    size = layout.size
    if layout.lists or layout.text:
        return _decode_behind(layout, message_type, data)
    if not size <= len(data) < size + _TRANSPORT_PADDING:
        raise MalformedMessageError(message_type.__name__, f"{len(data)} bytes, expected {size}")
    values = layout.fixed.unpack_from(data)
    if values[0] != ENCAPSULATION or values[3] != FRAME:
        _refuse_head(message_type, values[0])
    if layout.plain:
        return _new(message_type, (values[1] * _SECOND + values[2], *values[4:]))  # type: ignore[no-any-return]
    first = place = 5
    parts = []
    for part, count in layout.parts:
        seconds, nanoseconds, frame, *own = values[place : place + count]
        if frame != FRAME:
            _refuse_head(message_type, values[0])
        parts.append(_new(part, (seconds * _SECOND + nanoseconds, *own)))
        place += count
    return _new(message_type, (values[1] * _SECOND + values[2], *values[4:first], *parts))  # type: ignore[no-any-return]


def _decode_behind(layout: _Layout, message_type: type[Message], data: bytes) -> Message:
    """Read a message that ends with a text or with lists."""
    name, size = message_type.__name__, layout.size
    if len(data) < size:
        raise MalformedMessageError(name, f"{len(data)} bytes, expected at least {size}")
    values = layout.fixed.unpack_from(data)
    if values[0] != ENCAPSULATION or values[3] != FRAME:
        _refuse_head(message_type, values[0])
    own = (values[1] * _SECOND + values[2], *values[4:-1])
    read = _text if layout.text else _lists
    behind = read(layout, message_type, data, values[-1])
    return _new(message_type, (*own, *behind))  # type: ignore[no-any-return]


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


def _lists(layout: _Layout, message_type: type[Message], data: bytes, number: int) -> list[Any]:
    name = message_type.__name__
    if number > _MOST_ROBOTS:
        raise MalformedMessageError(name, f"{number} robots")
    lists = _behind(layout, number)
    size = layout.size + lists.size
    if not size <= len(data) < size + _TRANSPORT_PADDING:
        raise MalformedMessageError(name, f"{len(data)} bytes, expected {size} for {number} robots")
    values = (number, *lists.unpack_from(data, layout.size))
    begins = range(0, len(values), number + 1)
    _check_lengths(message_type, [values[begin] for begin in begins])
    return [values[begin + 1 : begin + 1 + number] for begin in begins]


def _refuse_head(message_type: type[Message], encapsulation: bytes) -> None:
    if encapsulation != ENCAPSULATION:
        raise MalformedMessageError(message_type.__name__, "not little-endian CDR")
    raise MalformedMessageError(message_type.__name__, f"frame_id is not {FRAME_ID!r}")


def canonical(message_type: type[Message], data: bytes) -> bytes:
    """Return the canonical form of what `decode` has read: padding is zero, nothing follows, equal ones are equal.

    Raises
    ------
    MalformedMessageError
        If its time is beyond what a header holds.
    """
    layout = _LAYOUTS[message_type]
    if layout.parts or data[_NANOSECONDS] >= _SECOND >> 24:  # rare: a time may be said in two ways
        return encode(decode(message_type, data))
    content, size = layout.content, layout.size
    fixed: bytes = content.pack(*content.unpack_from(data))
    if layout.plain:
        return fixed
    number = int.from_bytes(fixed[-4:], "little")
    if layout.text:
        return fixed + data[size : size + number]
    lists = _behind(layout, number)
    return fixed + lists.pack(*lists.unpack_from(data, size))


def agent_id_of(message: Message) -> int:
    """Return the robot that a message is about, 0 for the messages of the coordinators."""
    return message.agent_id if isinstance(message, (AgentState, SwarmEvent)) else 0

"""Canonical little-endian CDR of the swarm's messages, every padding byte zero.

A message is encapsulation header, ``std_msgs/Header``, ``uint64 step`` and the message's own fields; since
the frame id is always ``plane``, all but `SwarmEvent` and `Basis` have a fixed layout, and one `struct.Struct` each
says it all; a `Broadcast` is three of them in a row. That these layouts are what ROS 2 itself writes for
``swarmabs_msgs`` is a test.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import (
    FRAME_ID,
    TOPICS,
    AbstractState,
    AgentState,
    AuxiliaryState,
    Basis,
    Broadcast,
    DesiredAbstractState,
    SwarmEvent,
)

if TYPE_CHECKING:
    from swarmabs_core.messages import Message

_ENCAPSULATION = b"\x00\x01\x00\x00"
_FRAME = struct.pack(f"<I{len(FRAME_ID) + 1}s", len(FRAME_ID) + 1, FRAME_ID.encode())
"""The frame id as it stands in a message: length, characters, zero."""
_SECOND = 1_000_000_000
_MOST_ROBOTS = 65535
_TRANSPORT_PADDING = 4
"""Fast DDS pads a serialised payload to a multiple of this."""

# sec, nanosec | frame id, padding to 8 | step
_HEAD = f"iI{len(_FRAME)}s6xQ"
_PREFIX = f"<4s{_HEAD}"
_FIELDS = {
    "PlaneState": "2d",
    "AgentState": "QHBB4x5d",
    "AbstractState": "H6x4d",
    "AuxiliaryState": "8d",
    "DesiredAbstractState": "B7x8d",
    "SwarmEvent": "HB5xdI",  # then the characters of `detail` with their terminating zero
    "RecordingProgress": "Q",
    "Basis": "QQB3xI",  # then so many steps, which are aligned, and as many robots and marks
    "Steering": "QBxH4xd",
}
_PARTS = ("AbstractState", "AuxiliaryState", "DesiredAbstractState")
_FIELDS["Broadcast"] = "".join(_HEAD + _FIELDS[part] for part in _PARTS)
_LAYOUT: dict[type[Message], struct.Struct] = {
    topic.message: struct.Struct(_PREFIX + _FIELDS[topic.message.__name__]) for topic in TOPICS
}
_EVENT = _LAYOUT[SwarmEvent]
_BROADCAST = _LAYOUT[Broadcast]
_BASIS = _LAYOUT[Basis]
_new: Any = tuple.__new__  # of a NamedTuple: its own `__new__` and `_make` are Python functions around it


def encode(message: Message) -> bytes:
    """Serialise a message.

    Parameters
    ----------
    message : Message
        Any message of the swarm.

    Returns
    -------
    bytes
        Canonical CDR with its four-byte encapsulation header: equal messages give equal bytes.

    Raises
    ------
    MalformedMessageError
        If a field does not fit its type.
    """
    if isinstance(message, (SwarmEvent, Broadcast, Basis)):
        if isinstance(message, Basis):
            return _encode_basis(message)
        return _encode_event(message) if isinstance(message, SwarmEvent) else _encode_broadcast(message)
    seconds, nanoseconds = divmod(message[0], _SECOND)
    try:
        return _LAYOUT[type(message)].pack(_ENCAPSULATION, seconds, nanoseconds, _FRAME, *message[1:])
    except struct.error as error:
        raise MalformedMessageError(type(message).__name__, f"{error} in {message}") from error


def _encode_event(event: SwarmEvent) -> bytes:
    seconds, nanoseconds = divmod(event.stamp, _SECOND)
    try:
        detail = event.detail.encode() + b"\x00"
        fixed = _EVENT.pack(
            _ENCAPSULATION,
            seconds,
            nanoseconds,
            _FRAME,
            event.step,
            event.agent_id,
            event.kind,
            event.value,
            len(detail),
        )
    except (struct.error, UnicodeEncodeError) as error:
        raise MalformedMessageError("SwarmEvent", f"{error} in {event}") from error
    return fixed + detail


def decode(message_type: type[Message], data: bytes) -> Message:
    """Read a message from CDR; the content of padding bytes does not matter.

    Parameters
    ----------
    message_type : type
        The class of the message, one of those in `swarmabs_core.messages.TOPICS`.
    data : bytes
        CDR with encapsulation header, as it comes from DDS.

    Raises
    ------
    MalformedMessageError
        If the length, the encapsulation or the frame id is not that of a message of this swarm.
    """
    if message_type is SwarmEvent or message_type is Broadcast or message_type is Basis:
        if message_type is Basis:
            return _decode_basis(data)
        return _decode_event(data) if message_type is SwarmEvent else _decode_broadcast(data)
    layout = _LAYOUT[message_type]
    size = layout.size
    if not size <= len(data) < size + _TRANSPORT_PADDING:
        raise MalformedMessageError(message_type.__name__, f"{len(data)} bytes, expected {size}")
    values = layout.unpack_from(data)
    if values[0] != _ENCAPSULATION or values[3] != _FRAME:
        _check_head(message_type, values[0], values[3])
    return _new(message_type, (values[1] * _SECOND + values[2], *values[4:]))  # type: ignore[no-any-return]


def _encode_broadcast(broadcast: Broadcast) -> bytes:
    values: list[object] = [_ENCAPSULATION, *divmod(broadcast.stamp, _SECOND), _FRAME, broadcast.step]
    for part in broadcast[2:]:
        values += (*divmod(part[0], _SECOND), _FRAME, *part[1:])
    try:
        return _BROADCAST.pack(*values)
    except struct.error as error:
        raise MalformedMessageError("Broadcast", f"{error} in {broadcast}") from error


def _decode_broadcast(data: bytes) -> Broadcast:
    if not _BROADCAST.size <= len(data) < _BROADCAST.size + _TRANSPORT_PADDING:
        raise MalformedMessageError("Broadcast", f"{len(data)} bytes, expected {_BROADCAST.size}")
    values = _BROADCAST.unpack_from(data)
    for frame in (values[3], values[7], values[16], values[28]):
        if values[0] != _ENCAPSULATION or frame != _FRAME:
            _check_head(Broadcast, values[0], frame)
    return Broadcast(
        values[1] * _SECOND + values[2],
        values[4],
        _new(AbstractState, (values[5] * _SECOND + values[6], *values[8:14])),
        _new(AuxiliaryState, (values[14] * _SECOND + values[15], *values[17:26])),
        _new(DesiredAbstractState, (values[26] * _SECOND + values[27], *values[29:])),
    )


def _decode_event(data: bytes) -> SwarmEvent:
    if len(data) < _EVENT.size:
        raise MalformedMessageError("SwarmEvent", f"{len(data)} bytes, expected at least {_EVENT.size}")
    encapsulation, seconds, nanoseconds, frame, step, agent_id, kind, value, count = _EVENT.unpack_from(data)
    _check_head(SwarmEvent, encapsulation, frame)
    text = data[_EVENT.size : _EVENT.size + count]
    if count < 1 or len(text) != count or text[-1:] != b"\x00":
        raise MalformedMessageError("SwarmEvent", "`detail` is cut off or not terminated")
    if len(data) >= _EVENT.size + count + _TRANSPORT_PADDING:
        raise MalformedMessageError("SwarmEvent", f"{len(data)} bytes, expected {_EVENT.size + count}")
    try:
        detail = text[:-1].decode()
    except UnicodeDecodeError as error:
        raise MalformedMessageError("SwarmEvent", "`detail` is not UTF-8") from error
    return SwarmEvent(seconds * _SECOND + nanoseconds, step, agent_id, kind, value, detail)


def _basis_lists(number: int) -> struct.Struct:
    """Return the layout of a basis behind the first number: steps, robots, marks, the number before each list."""
    return struct.Struct(f"<{number}QI{number}H{'2x' if number % 2 else ''}I{number}B")


def _encode_basis(basis: Basis) -> bytes:
    number = len(basis.agent_ids)
    if not len(basis.state_steps) == len(basis.standing) == number:
        lengths = f"{number} robots, but {len(basis.state_steps)} steps and {len(basis.standing)} marks"
        raise MalformedMessageError("Basis", lengths)
    head = (*divmod(basis.stamp, _SECOND), _FRAME, basis.step, basis.since, basis.begun, basis.source, number)
    lists = (*basis.state_steps, number, *basis.agent_ids, number, *basis.standing)
    try:
        return _BASIS.pack(_ENCAPSULATION, *head) + _basis_lists(number).pack(*lists)
    except struct.error as error:
        raise MalformedMessageError("Basis", f"{error} in {basis}") from error


def _decode_basis(data: bytes) -> Basis:
    if len(data) < _BASIS.size:
        raise MalformedMessageError("Basis", f"{len(data)} bytes, expected at least {_BASIS.size}")
    encapsulation, seconds, nanoseconds, frame, step, since, begun, source, number = _BASIS.unpack_from(data)
    _check_head(Basis, encapsulation, frame)
    if number > _MOST_ROBOTS:
        raise MalformedMessageError("Basis", f"{number} robots")
    lists = _basis_lists(number)
    size = _BASIS.size + lists.size
    if not size <= len(data) < size + _TRANSPORT_PADDING:
        raise MalformedMessageError("Basis", f"{len(data)} bytes, expected {size} for {number} robots")
    values = lists.unpack_from(data, _BASIS.size)
    steps, robots, marks = values[:number], values[number + 1 : 2 * number + 1], values[2 * number + 2 :]
    if not values[number] == values[2 * number + 1] == number:
        lengths = f"{number} steps, but {values[number]} robots and {values[2 * number + 1]} marks"
        raise MalformedMessageError("Basis", lengths)
    return Basis(seconds * _SECOND + nanoseconds, step, since, begun, source, steps, robots, marks)


def _check_head(message_type: type[Message], encapsulation: bytes, frame: bytes) -> None:
    if encapsulation[:2] != _ENCAPSULATION[:2]:
        raise MalformedMessageError(message_type.__name__, "not little-endian CDR")
    if frame != _FRAME:
        raise MalformedMessageError(message_type.__name__, f"frame_id is not {FRAME_ID!r}")


def agent_id_of(message: Message) -> int:
    """Return the robot that a message is about, 0 for the messages of the coordinators."""
    return message.agent_id if isinstance(message, (AgentState, SwarmEvent)) else 0

"""Differences of two messages: a recorded one against the recomputed, the replayed, or one in another bag."""

from __future__ import annotations

import struct
from math import inf, isfinite
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias, cast

from swarmabs_core.cdr import agent_id_of, canonical, encode
from swarmabs_core.messages import ROBOT_STATES, topic_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from swarmabs_core.messages import Message
    from swarmabs_core.record import Record

Side = Literal["A", "B"]
Value: TypeAlias = "float | int | str | tuple[float | int | str, ...] | dict[str, object] | None"
"""A field or its component, a whole message by field, or None for a missing message."""

LOG_TIME = "log_time"
"""Pseudo-field: the log time of a message in the bag, ns, is wrong."""
PUBLISH_TIME = "publish_time"
"""Pseudo-field: the publish time of a message in the bag, ns, is wrong."""
PADDING = "padding"
"""Pseudo-field: all fields are correct, but the bytes between them are not those of canonical CDR."""
PAYLOAD = "payload"
"""Pseudo-field: the bytes are not a message."""
MESSAGE = "message"
"""Pseudo-field: a message is missing or surplus; also the value of such a message where its fields are not given."""

_CAUSES_FIRST = (
    *("step", "stamp", "agent_id", "system", "kind", "mass", "damping", "constants"),
    *("status", "broadcast_step", "command", "velocity", "velocities", "position", "coordinates"),
)
"""Fields of a robot's state in the order of judgement, causes first: a wrong command also changes the position."""

_LONGEST = 512


class Difference(NamedTuple):
    """A difference between two runs, A and B: recorded against recomputed, replayed, or another recording.

    ``step`` and ``agent`` are the place of the message. ``a`` is None for a message missing in A, ``b`` for one missing
    in B.
    """

    topic: str
    step: int | None
    agent: int | None
    field: str
    a: Value
    b: Value
    reason: str = ""

    @classmethod
    def of(cls, message: Message, field: str, a: Value, b: Value, reason: str = "") -> Difference:
        """Return a difference at the place of a message."""
        return cls(topic_of(message).name, message.step, agent_id_of(message) or None, field, a, b, reason)

    @property
    def missing(self) -> Side | None:
        """The run that lacks the message, None if both have it."""
        if self.field != MESSAGE:
            return None
        return "A" if self.a is None else "B"

    def to_dict(self, a: str, b: str) -> dict[str, object]:
        """Return the difference for JSON, with names for the values of A and B; non-finite numbers become strings."""
        names = {"a": a, "b": b}
        return {names.get(name, name): plain(value) for name, value in self._asdict().items()}

    def __str__(self) -> str:
        """Describe the difference with A as recorded and B as recomputed."""
        place = f"/{self.topic}" if self.step is not None else self.topic
        if self.step is not None:
            place += f", step {self.step}"
        if self.agent is not None:
            place += f", robot {self.agent}"
        return f"{place}: {self._what()}" + (f" ({self.reason})" if self.reason else "")

    def _what(self) -> str:
        if self.a is None:
            return f"{self.field} is missing"
        if self.b is None:
            return f"{self.field} is not expected"
        return f"{self.field} is {self.a!r}, recomputed {self.b!r}"

    def side_by_side(self) -> str:
        """Describe the difference with both A and B as recorded."""
        agent = f" agent {self.agent}" if self.agent else ""
        where = f"/{self.topic} step {self.step}{agent}"
        if self.missing is not None:
            return f"{where}: missing in {self.missing}"
        return f"{where}: {self.field} is {self.a!r} in A, {self.b!r} in B"


def differing_fields(a: Message, b: Message, tolerance: float = 0.0) -> Iterator[tuple[str, Value, Value]]:
    """Yield name and both values of the fields in which two messages of a topic differ, in order.

    Of a vector, the components that differ are yielded, such as ``gram[3]``; the whole vector if the lengths differ. A
    number of `a` may differ from the x of `b` by ``tolerance * (1 + |x|)``; with 0 every bit counts.
    """
    for name, x, y in cast("Iterable[tuple[str, Value, Value]]", zip(a._fields, a, b, strict=True)):
        if isinstance(x, tuple) and isinstance(y, tuple) and len(x) == len(y) and any(isinstance(u, float) for u in x):
            parts = enumerate(zip(x, y, strict=True))
            yield from ((f"{name}[{n}]", u, v) for n, (u, v) in parts if not _same(u, v, tolerance))
        elif not _same(x, y, tolerance):
            yield name, x, y


def component_of(name: str) -> tuple[str, int]:
    """Return field and index of a component such as ``gram[3]``; the index of a whole field is -1."""
    field, _, index = name.partition("[")
    return field, int(index[:-1]) if index else -1


def judge(stored: Record, expected: Message, tolerance: float, time: int | None = None) -> Difference | None:
    """Return the first field in which a recorded message differs from the expected one, or None.

    The tolerance is that of `differing_fields`. `time` is the expected log time and, if recorded, publish time, ns; by
    default times are not judged.
    """
    payload = encode(expected)
    if stored.payload == payload and (time is None or (stored.time == time and stored.published in {None, time})):
        return None
    order = _CAUSES_FIRST if isinstance(expected, ROBOT_STATES) else ("step",)
    places = {name: place for place, name in enumerate(order)}
    fields = differing_fields(stored.message, expected, tolerance)
    first = min(fields, key=lambda field: places.get(component_of(field[0])[0], len(places)), default=None)
    if first is not None:
        return Difference.of(expected, *first)
    if time is not None and stored.time != time:
        return Difference.of(expected, LOG_TIME, stored.time, time)
    if time is not None and stored.published not in {None, time}:
        return Difference.of(expected, PUBLISH_TIME, stored.published, time)
    return wrong_padding(stored, None if tolerance else payload)


def wrong_padding(stored: Record, payload: bytes | None = None) -> Difference | None:
    """Return a difference if bytes are not canonical, or not `payload`, although their fields are correct."""
    right = payload or canonical(stored.topic.message, stored.payload)
    if stored.payload == right:
        return None
    return Difference.of(stored.message, PADDING, in_hex(stored.payload), in_hex(right))


def missing(expected: Message) -> Difference:
    """Return the difference for a missing message."""
    return Difference.of(expected, MESSAGE, None, expected._asdict())


def surplus(stored: Record, step: int, reason: str) -> Difference:
    """Return the difference for a message that is not expected among those of a step."""
    message = stored.message
    difference = Difference.of(message, MESSAGE, message._asdict(), None, reason)._replace(step=step)
    if isinstance(message, ROBOT_STATES):
        return difference._replace(agent=message.agent_id)  # even if it is 0
    return difference


def in_hex(payload: bytes) -> str:
    """Return bytes in hexadecimal, shortened if they are many."""
    return payload.hex() if len(payload) <= _LONGEST else f"{payload[:_LONGEST].hex()}... ({len(payload)} bytes)"


def plain(value: object) -> object:
    """Return data for JSON: enumerations become numbers, non-finite numbers strings."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if isfinite(value) else repr(value)
    return int(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _same(a: object, b: object, tolerance: float) -> bool:
    """Return whether a equals b: NaN equals itself, 0.0 differs from -0.0, infinity is close to no number."""
    if not isinstance(a, float) or not isinstance(b, float | int):
        return bool(a == b)
    if struct.pack("<d", a) == struct.pack("<d", b):
        return True
    return bool(tolerance) and abs(a - b) <= tolerance * (1.0 + abs(b)) < inf

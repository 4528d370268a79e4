"""How two messages differ, for all who ask: what is recorded and what is recomputed, replayed, or in another bag."""

from __future__ import annotations

import struct
from math import inf, isfinite
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

from swarmabs_core.cdr import agent_id_of, canonical, encode
from swarmabs_core.messages import TOPIC_OF, AgentState

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.messages import Message
    from swarmabs_core.record import Record

Side = Literal["A", "B"]
Value: TypeAlias = "float | int | str | dict[str, float | int | str] | None"
"""A field, a whole message by field, or None for a message that is not there."""

LOG_TIME = "log_time"
"""Stands for a field where the bag's own time of a message, in ns, is wrong."""
PUBLISH_TIME = "publish_time"
"""Stands for a field where the time at which the bag says that a message was published, in ns, is wrong."""
PADDING = "padding"
"""Stands for a field where all fields are right, but the bytes between them are not those of canonical CDR."""
PAYLOAD = "payload"
"""Stands for a field where the bytes are no message at all."""
MESSAGE = "message"
"""Stands for a field where a message is missing, or one is too many; also for what it says, where that is not told."""

_CAUSES_FIRST = (
    *("step", "stamp", "agent_id", "kind", "mass", "damping"),
    *("status", "broadcast_step", "command", "velocity", "position"),
)
"""Fields of a robot's state in the order in which they are judged: a wrong command also moves the robot elsewhere."""

_LONGEST = 512


class Difference(NamedTuple):
    """Where two runs differ, A and B: a recorded one from the recomputed one, its replay, or another recorded one.

    ``step`` and ``agent`` say where the message belongs. ``a`` is None for a message that A lacks, ``b`` for one that B
    lacks.
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
        """Return a difference in the place to which a message belongs."""
        return cls(TOPIC_OF[type(message)].name, message.step, agent_id_of(message) or None, field, a, b, reason)

    @property
    def missing(self) -> Side | None:
        """The run that lacks the message, None if both have it."""
        if self.field != MESSAGE:
            return None
        return "A" if self.a is None else "B"

    def to_dict(self, a: str, b: str) -> dict[str, Any]:
        """Return the difference for JSON, with names for what A and B say; numbers that are not finite become text."""
        names = {"a": a, "b": b}
        return {names.get(name, name): plain(value) for name, value in self._asdict().items()}

    def __str__(self) -> str:
        """Return how A, which is recorded, differs from B, which is recomputed."""
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
            return f"{self.field} should not be there"
        return f"{self.field} is {self.a!r}, recomputed {self.b!r}"

    def side_by_side(self) -> str:
        """Return how A and B, which are both recorded, differ."""
        agent = f" agent {self.agent}" if self.agent else ""
        where = f"/{self.topic} step {self.step}{agent}"
        if self.missing is not None:
            return f"{where}: missing in {self.missing}"
        return f"{where}: {self.field} is {self.a!r} in A, {self.b!r} in B"


def differing_fields(a: Message, b: Message, tolerance: float = 0.0) -> Iterator[tuple[str, Any, Any]]:
    """Yield name and both values of the fields in which two messages of a topic differ, in their order.

    A number of `a` may differ from the x of `b` by ``tolerance * (1 + |x|)``; with 0 every bit counts.
    """
    for name, x, y in zip(a._fields, a, b, strict=True):
        if not _same(x, y, tolerance):
            yield name, x, y


def judge(stored: Record, expected: Message, tolerance: float, time: int | None = None) -> Difference | None:
    """Return the first field by which a recorded message differs from the expected one, None if there is none.

    The tolerance is as of `differing_fields`. A time is the log time that it should have, ns, and that of its
    publication, if it is known; by default none is judged.
    """
    payload = encode(expected)
    if stored.payload == payload and (time is None or (stored.time == time and stored.published in {None, time})):
        return None
    found = {name: (was, should) for name, was, should in differing_fields(stored.message, expected, tolerance)}
    for name in (*(_CAUSES_FIRST if isinstance(expected, AgentState) else ("step",)), *found):
        if name in found:
            return Difference.of(expected, name, *found[name])
    if time is not None and stored.time != time:
        return Difference.of(expected, LOG_TIME, stored.time, time)
    if time is not None and stored.published not in {None, time}:
        return Difference.of(expected, PUBLISH_TIME, stored.published, time)
    return wrong_padding(stored, None if tolerance else payload)


def wrong_padding(stored: Record, payload: bytes | None = None) -> Difference | None:
    """Return that bytes are not canonical, or not the right ones, though their fields are right; None if they are."""
    right = payload or canonical(stored.topic.message, stored.payload)
    if stored.payload == right:
        return None
    return Difference.of(stored.message, PADDING, in_hex(stored.payload), in_hex(right))


def missing(expected: Message) -> Difference:
    """Return that a message is not there."""
    return Difference.of(expected, MESSAGE, None, expected._asdict())


def surplus(stored: Record, step: int, reason: str) -> Difference:
    """Return that a message is there, among those of a step, which should not be."""
    message = stored.message
    found = Difference.of(message, MESSAGE, message._asdict(), None, reason)._replace(step=step)
    return found._replace(agent=message.agent_id) if isinstance(message, AgentState) else found  # also where it is 0


def in_hex(payload: bytes) -> str:
    """Return bytes as text, shortened where they are more than any message of a swarm has."""
    return payload.hex() if len(payload) <= _LONGEST else f"{payload[:_LONGEST].hex()}... ({len(payload)} bytes)"


def plain(value: Any) -> Any:
    """Return data for JSON: enumerations become numbers, numbers that are not finite texts."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if isfinite(value) else repr(value)
    return int(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _same(a: Any, b: Any, tolerance: float) -> bool:
    """Tell whether a value a counts as the value b: NaN equals itself, 0.0 is not -0.0, infinity is near no number."""
    if not isinstance(a, float) or isinstance(b, str):
        return bool(a == b)
    if struct.pack("<d", a) == struct.pack("<d", b):
        return True
    return bool(tolerance) and abs(a - b) <= tolerance * (1.0 + abs(b)) < inf

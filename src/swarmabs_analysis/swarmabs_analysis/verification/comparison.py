"""One recorded message beside the one that should stand there."""

from __future__ import annotations

import struct
from math import inf, isfinite
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from swarmabs_core.cdr import encode
from swarmabs_core.messages import AgentState

if TYPE_CHECKING:
    from swarmabs_core.messages import Message, Topic

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
"""Stands for a field where a message is missing, or one is too many."""

_CAUSES_FIRST = (
    *("step", "stamp", "agent_id", "kind", "mass", "damping"),
    *("status", "broadcast_step", "command", "velocity", "position"),
)
"""Fields of a robot's state in the order in which they are compared: a wrong command also moves the robot elsewhere."""

_LONGEST = 512


class Stored(NamedTuple):
    """A message as a bag holds it: topic, log time (ns), the message, its bytes, and when it was published (ns)."""

    topic: Topic
    time: int
    message: Message
    payload: bytes
    published: int | None = None


class Difference(NamedTuple):
    """Where a recorded run differs from the recomputed one; `step` and `agent` say where the message belongs.

    ``recorded`` is None for a message that is missing, ``recomputed`` for one that should not be there.
    """

    topic: str
    step: int | None
    agent: int | None
    field: str
    recorded: Value
    recomputed: Value
    reason: str = ""

    def to_dict(self) -> dict[str, Value]:
        """Return the difference for JSON; numbers that are not finite become text."""
        return {name: _plain(value) for name, value in self._asdict().items()}

    def __str__(self) -> str:
        place = f"/{self.topic}" if self.step is not None else self.topic
        if self.step is not None:
            place += f", step {self.step}"
        if self.agent is not None:
            place += f", robot {self.agent}"
        return f"{place}: {self._what()}" + (f" ({self.reason})" if self.reason else "")

    def _what(self) -> str:
        if self.recorded is None:
            return f"{self.field} is missing"
        if self.recomputed is None:
            return f"{self.field} should not be there"
        return f"{self.field} is {self.recorded!r}, recomputed {self.recomputed!r}"


def compare(stored: Stored, expected: Message, time: int, agent: int | None, tolerance: float) -> Difference | None:
    """Return the first field by which a recorded message differs from the expected one, None if there is none.

    Parameters
    ----------
    stored : Stored
        The recorded message.
    expected : Message
        What should stand there.
    time : int
        Log time that it should have, ns; that of its publication, if it is known, too.
    agent : int, optional
        The robot to which the place belongs.
    tolerance : float
        A recorded number may differ from the recomputed b by ``tolerance * (1 + |b|)``; with 0 every bit counts.
    """
    payload = encode(expected)
    published = time if stored.published is None else stored.published
    if stored.payload == payload and stored.time == time == published:
        return None
    place = (stored.topic.name, expected.step, agent)
    recorded = stored.message
    for name in _CAUSES_FIRST if isinstance(expected, AgentState) else ("step", *expected._fields):
        was, should = getattr(recorded, name), getattr(expected, name)
        if not _same(was, should, tolerance):
            return Difference(*place, name, was, should)
    if stored.time != time:
        return Difference(*place, LOG_TIME, stored.time, time)
    if published != time:
        return Difference(*place, PUBLISH_TIME, published, time)
    if tolerance:  # the values may differ
        payload = encode(recorded)
    if stored.payload != payload:
        return Difference(*place, PADDING, in_hex(stored.payload), in_hex(payload))
    return None


def missing(topic: Topic, expected: Message, agent: int | None, reason: str = "") -> Difference:
    """Return that a message is not there."""
    return Difference(topic.name, expected.step, agent, MESSAGE, None, _fields(expected), reason)


def surplus(stored: Stored, step: int, agent: int | None, reason: str = "") -> Difference:
    """Return that a message is there which should not be."""
    return Difference(stored.topic.name, step, agent, MESSAGE, _fields(stored.message), None, reason)


def in_hex(payload: bytes) -> str:
    """Return bytes as text, shortened where they are more than any message of a swarm has."""
    return payload.hex() if len(payload) <= _LONGEST else f"{payload[:_LONGEST].hex()}... ({len(payload)} bytes)"


def _same(a: float | str, b: float | str, tolerance: float) -> bool:
    """Tell whether a recorded value a counts as the recomputed value b; infinity is near no number."""
    if not isinstance(a, float) or isinstance(b, str):
        return a == b
    if struct.pack("<d", a) == struct.pack("<d", b):
        return True
    return bool(tolerance) and abs(a - b) <= tolerance * (1.0 + abs(b)) < inf


def _fields(message: Message) -> dict[str, float | int | str]:
    return message._asdict()


def _plain(value: Value) -> Value:
    if isinstance(value, dict):
        return {name: _number(one) for name, one in value.items()}
    return value if value is None else _number(value)


def _number(value: float | str) -> float | int | str:
    if isinstance(value, float):
        return value if isfinite(value) else repr(value)
    return value if isinstance(value, str) else int(value)

"""The steps of a run: the order in which a bag holds their messages, and their digest."""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING, NamedTuple, Protocol

from swarmabs_core.messages import (
    EVENTS,
    FAMILIES,
    PARENT_STATES,
    ROBOT_STATES,
    STANDING,
    AnyParentState,
    AnyRobotState,
    PlaneState,
    SwarmEvent,
    Topic,
    coordinates_of,
)
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

_NOT_IN_DIGEST = {EVENTS, STANDING, *(topic for family in FAMILIES for topic in family.once)}


class Step(Protocol):
    """A complete step of a run, or several without events, independent of how their messages are stored."""

    @property
    def step(self) -> int:
        """Number of the step, the last of several."""

    @property
    def messages(self) -> int:
        """Number of messages."""

    @property
    def parent(self) -> AnyParentState | None:
        """State of the parent system, in the last step; None for a late event of an earlier step."""

    @property
    def parents(self) -> tuple[AnyParentState, ...]:
        """State of the parent system in each step; empty for a late event of an earlier step."""

    @property
    def max_abs_positions(self) -> tuple[float, ...]:
        """Largest absolute coordinate of a robot in each step: on the plane, its distance from the axis, m."""

    @property
    def events(self) -> tuple[SwarmEvent, ...]:
        """The events of the step."""

    def states(self) -> Iterable[AnyRobotState]:
        """Return the robots' states, in the last step."""

    def digest_text(self) -> bytes:
        """Return the contribution to the digest of a run."""

    def stored(self) -> Iterable[tuple[Topic, int, bytes]]:
        """Return topic, time (ns) and bytes of every message, in the order of a bag."""


def digest_head(topic: Topic, size: int) -> bytes:
    """Return the bytes before a payload of this size in the digest: topic, zero, length."""
    return b"%b\x00%b" % (topic.name.encode(), size.to_bytes(4, "little"))


class RecordedStep(NamedTuple):
    """All records of a step, in the order of a bag.

    ``time`` (ns) is that of the step, for steps without a state of the parent: a robot's clock may be wrong.
    """

    step: int
    records: tuple[Record, ...]
    time: int | None = None

    @property
    def messages(self) -> int:
        """Number of messages."""
        return len(self.records)

    @property
    def parent(self) -> AnyParentState | None:
        """State of the parent system; None for a late event of an earlier step."""
        return next((r.message for r in self.records if isinstance(r.message, PARENT_STATES)), None)

    @property
    def parents(self) -> tuple[AnyParentState, ...]:
        """State of the parent system; empty for a late event of an earlier step."""
        parent = self.parent
        return () if parent is None else (parent,)

    @property
    def plane(self) -> PlaneState | None:
        """State of the plane, if it is the parent system."""
        parent = self.parent
        return parent if isinstance(parent, PlaneState) else None

    @property
    def max_abs_positions(self) -> tuple[float, ...]:
        """Largest absolute coordinate of a robot: on the plane, its distance from the axis, m."""
        found = [abs(x) for state in self.states() for x in coordinates_of(state)]
        return (max(found),) if found else ()

    @property
    def events(self) -> tuple[SwarmEvent, ...]:
        """The events of the step."""
        if not self.records or self.records[-1].topic is not EVENTS:  # events are last
            return ()
        return tuple(r.message for r in self.records if isinstance(r.message, SwarmEvent))

    def states(self) -> Iterator[AnyRobotState]:
        """Return the robots' states."""
        return (r.message for r in self.records if isinstance(r.message, ROBOT_STATES))

    def digest_text(self) -> bytes:
        """Return the contribution of the step to the digest of a run."""
        main = [r for r in self.records if r.topic not in _NOT_IN_DIGEST]
        main.sort(key=lambda r: (r.topic.name, r.agent_id))
        return b"".join(digest_head(r.topic, len(r.payload)) + r.payload for r in main)

    def stored(self) -> Iterator[tuple[Topic, int, bytes]]:
        """Return topic, time (ns) and bytes of every message, in the order of a bag."""
        parent = self.parent
        time = parent.stamp if parent is not None else self.time
        return ((r.topic, r.message.stamp if time is None else time, r.payload) for r in self.records)


class Digest:
    """SHA-256 over the main topics of a run, with steps in ascending order.

    Every record contributes the name of its topic without namespace, a zero byte, the length of its payload as
    little-endian uint32, and the payload; within a step, records are sorted by topic and robot.
    """

    def __init__(self) -> None:
        self._hash = sha256()

    def update(self, step: Step) -> None:
        """Add the next step, or steps."""
        self._hash.update(step.digest_text())

    def hexdigest(self) -> str:
        """Return the digest of the steps so far."""
        return self._hash.hexdigest()

"""Collection of a run step by step: the order in which a recorder writes messages, and their digest.

A run is complete when every message of the five main topics of its family is present exactly once. Identical repeats
are dropped; different ones are errors.
"""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING, NamedTuple, Protocol

from swarmabs_core.behaviours.base import ConflictError, NegativeTimeError, UnknownAgentError
from swarmabs_core.behaviours.steering import Orders
from swarmabs_core.membership import Membership
from swarmabs_core.messages import (
    EVENTS,
    FAMILIES,
    PARENT_STATES,
    PLANE_FAMILY,
    ROBOT_STATES,
    Action,
    AgentState,
    AnyParentState,
    AnyRobotState,
    EventKind,
    Family,
    Message,
    PlaneState,
    Status,
    Steering,
    SwarmEvent,
    Topic,
)
from swarmabs_core.publishers import NodeKind, publisher_of
from swarmabs_core.record import Record
from swarmabs_core.steering import DISTURBANCE, REFERENCE, STEERER, change_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from swarmabs_core.membership import Change

_NOT_IN_DIGEST = {EVENTS, *(topic for family in FAMILIES for topic in family.once)}


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


def coordinates_of(state: AnyRobotState) -> tuple[float, ...]:
    """Return the coordinates of a robot; on the plane its position, m."""
    return (state.position,) if isinstance(state, AgentState) else state.coordinates


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


class _Slot:
    """The received messages of a step."""

    __slots__ = ("agents", "events", "main")

    def __init__(self) -> None:
        self.main: dict[Topic, Record] = {}
        self.agents: dict[int, Record] = {}
        self.events: dict[bytes, Record] = {}


class RunCollector:
    """Orders the messages of a run, which may arrive at any time and repeatedly.

    Parameters
    ----------
    memory : int
        Number of past steps for which repeats are compared with the recorded messages.
    steered : bool
        Whether the run is steerable. Then a step is complete only when its request is known and the events that
        announce it have arrived, so that everything recorded can be repeated.
    family : Family
        The topics of the run.
    """

    def __init__(
        self,
        members: Iterable[int],
        schedule: Iterable[Change],
        last_step: int,
        *,
        memory: int = 250,
        steered: bool = False,
        family: Family = PLANE_FAMILY,
    ) -> None:
        self._family = family
        self._each = len(family.main) - 1  # topics with one message per step
        self._membership = Membership(members, schedule)
        self._last_step = last_step
        self._memory = memory
        self._orders = Orders() if steered else None
        self._settings: dict[int, str] = {}
        self._step = 0
        self._slots: dict[int, _Slot] = {}

    @property
    def step(self) -> int:
        """The first step that is not complete."""
        return self._step

    @property
    def finished(self) -> bool:
        """Whether all steps are complete."""
        return self._step > self._last_step

    def add(self, record: Record) -> list[RecordedStep]:
        """Add the record of a message; return the steps that it completes.

        Raises
        ------
        ConflictError
            If it differs from the message already in its place.
        UnknownAgentError
            If it comes from a robot that is not a member.
        NegativeTimeError
            If its time, which determines the order in the bag, is before the beginning of the run.
        """
        topic, message = record.topic, record.message
        step = message.step
        if step > self._last_step or step < self._step - self._memory:
            return []
        if message.stamp < 0 and not getattr(message, "agent_id", 0):  # a robot's clock may be wrong
            raise NegativeTimeError(topic.name, step, message.stamp)
        slot = self._slots.get(step)
        if slot is None:
            slot = self._slots[step] = _Slot()
        if isinstance(message, ROBOT_STATES):
            self._add_agent(slot, record, message)
        elif isinstance(message, SwarmEvent):
            return self._add_event(slot, record, message)
        else:
            known = slot.main.get(topic)
            if known is None:
                slot.main[topic] = record
            elif known.payload != record.payload:
                raise ConflictError(topic.name, step)
        return self._complete() if step == self._step else []

    def steer(self, order: Steering) -> tuple[list[Steering], list[RecordedStep]]:
        """Add the request of a step; return the requests known up to now, and the steps that it completes."""
        assert self._orders is not None  # noqa: S101 - only steerable runs receive requests
        found = self._orders.add(order)
        for known in found:
            if (change := change_of(known)) is not None:
                self._membership.plan(change)
            elif known.action != Action.NONE:
                self._settings[known.step] = REFERENCE if known.action == Action.REFERENCE else DISTURBANCE
        return found, self._complete()

    def _add_agent(self, slot: _Slot, record: Record, state: AnyRobotState) -> None:
        agent_id = state.agent_id
        known = slot.agents.get(agent_id)
        if known is not None:
            if known.payload != record.payload:
                raise ConflictError(f"{record.topic.name} of agent {agent_id}", state.step)
            return
        if not self._membership.publishes(agent_id, state.step):
            if agent_id not in self._membership:
                raise UnknownAgentError(agent_id)
            return
        slot.agents[agent_id] = record
        if state.status == Status.LEFT:
            self._membership.end(agent_id, state.step, stays=False, reason="left")

    def _add_event(self, slot: _Slot, record: Record, event: SwarmEvent) -> list[RecordedStep]:
        if record.payload in slot.events:
            return []
        slot.events[record.payload] = record
        self._membership.apply(event.kind, event.agent_id, event.step, event.detail)
        if event.step < self._step:  # its step is already recorded, so the event follows late
            if self._is_void(event):
                return []
            return [RecordedStep(event.step, (record,), slot.main[self._family.parent].message.stamp)]
        return self._complete()

    def missing(self) -> tuple[str, ...]:
        """Return human-readable names of what is missing for the current step."""
        if self.finished:
            return ()
        slot = self._slots.get(self._step, _Slot())
        topics = [topic.name for topic in self._coordinated() if topic not in slot.main]
        ordered = self._orders is None or self._step <= self._orders.known
        return (*(() if ordered else (STEERER,)), *(f"agent {i}" for i in self.missing_agents()), *topics)

    def _coordinated(self) -> tuple[Topic, ...]:
        """Return the topics with one message in the current step, in the order of a bag."""
        return self._family.main[1:] if self._step else (*self._family.once, *self._family.main[1:])

    def missing_agents(self) -> tuple[int, ...]:
        """Return the robots whose state is missing in the current step."""
        if self.finished:
            return ()
        slot = self._slots.get(self._step, _Slot())
        return tuple(i for i in self._membership.publishing(self._step) if i not in slot.agents)

    def _complete(self) -> list[RecordedStep]:
        steps = []
        while not self.finished and (slot := self._slots.get(self._step)) is not None:
            expected = self._membership.publishing(self._step)
            if len(slot.main) < self._each + (0 if self._step else len(self._family.once)):
                break
            if any(i not in slot.agents for i in expected):
                break
            if self._orders is not None and not self._announced(slot, self._orders):
                break
            steps.append(
                RecordedStep(
                    self._step,
                    (
                        *(slot.main[topic] for topic in self._family.once if not self._step),
                        *(slot.agents[i] for i in expected),
                        *(slot.main[topic] for topic in self._family.main[1:]),
                        *(r for _, r in sorted(slot.events.items()) if not self._is_void(r.message)),
                    ),
                )
            )
            self._slots.pop(self._step - self._memory, None)
            self._step += 1
        return steps

    def _announced(self, slot: _Slot, orders: Orders) -> bool:
        """Return whether the request of the current step is known, and announced by the nodes that it concerns."""
        if self._step > orders.known:
            return False
        events = [record.message for record in slot.events.values()]
        told = {(e.agent_id, e.kind) for e in events if isinstance(e, SwarmEvent)}
        if not all((agent_id, kind) in told for agent_id, kind, _ in self._membership.changes(self._step)):
            return False
        setting = self._settings.get(self._step)
        return setting is None or any(
            isinstance(e, SwarmEvent) and e.kind == EventKind.STEERING and e.detail == setting for e in events
        )

    def _is_void(self, event: Message) -> bool:
        """Return whether an event comes from a robot that does not know that it no longer takes part."""
        if self._orders is None:
            return False
        publisher = publisher_of(event)
        return publisher.kind is NodeKind.AGENT and not self._membership.publishes(publisher.agent_id, event.step)

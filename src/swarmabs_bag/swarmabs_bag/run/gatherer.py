"""Collection of a run from its messages, in whatever order they arrive.

A run is complete when every message of the five main topics of its family is present exactly once. Identical repeats
are dropped; different ones are errors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmabs_bag.run.arrivals import Arrivals
from swarmabs_bag.run.recording import RecordedStep
from swarmabs_config.graph import KEPT_STEPS
from swarmabs_core.behaviours.base import ConflictError, NegativeTimeError, UnknownAgentError, refuse_other_system
from swarmabs_core.behaviours.steering import Orders
from swarmabs_core.cdr import decode, split
from swarmabs_core.errors import ProtocolError
from swarmabs_core.membership import Membership
from swarmabs_core.messages import (
    EVENTS,
    PLANE_FAMILY,
    ROBOT_STATES,
    STANDING,
    SWARM_STATES,
    Action,
    AnyRobotState,
    EventKind,
    Family,
    Message,
    Status,
    Steering,
    SwarmEvent,
    SwarmStates,
    Topic,
    said,
)
from swarmabs_core.publishers import NodeKind, publisher_of
from swarmabs_core.record import Record
from swarmabs_core.steering import DISTURBANCE, REFERENCE, STEERER, change_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from swarmabs_bag.run.blocks import Block
    from swarmabs_core.membership import Change


MEMORY = 250
"""Number of past steps for which repeats are compared with the recorded messages, unless given otherwise."""


class UnplannedChangeError(ProtocolError):
    """An event about a robot that nothing in this run ends, or lets join, at its step."""

    def __init__(self, event: SwarmEvent) -> None:
        kind = said(EventKind(event.kind))
        super().__init__(
            f"{EVENTS.name}: robot {event.agent_id} is reported as {kind!r} from step {event.step} on, which nothing "
            "in this run causes; is a second swarm in this namespace?"
        )


class _Slot:
    """The received messages of a step."""

    __slots__ = ("agents", "events", "main")

    def __init__(self) -> None:
        self.main: dict[Topic, Record] = {}
        self.agents: dict[int, Record] = {}
        self.events: dict[bytes, Record] = {}


class RunCollector:
    """Orders the messages of a run, which may arrive at any time and repeatedly.

    They are added one by one, or in batches of a topic. Of each step the messages are held in one place: as arrays, if
    all came in batches and are ordinary, or else as records.

    Parameters
    ----------
    memory : int
        Number of past steps for which repeats are compared with the recorded messages.
    steered : bool
        Whether the run is steerable. Then a step is complete only when its request is known and the events that
        announce it have arrived, so that everything recorded can be repeated.
    drops : bool
        Whether robots may end that neither the schedule nor a request ends. Otherwise an event that says so is not one
        of this swarm.
    division : int
        For how many steps from a change on the observer tells how the abstract state divides.
    family : Family
        The topics of the run.
    system : int, optional
        Hash of the parent system, if it is not the plane.
    """

    def __init__(
        self,
        members: Iterable[int],
        schedule: Iterable[Change],
        last_step: int,
        *,
        memory: int = MEMORY,
        steered: bool = False,
        drops: bool = True,
        division: int = 0,
        family: Family = PLANE_FAMILY,
        system: int | None = None,
    ) -> None:
        self._family = family
        self._system = system
        ids = sorted(members)
        changes = tuple(schedule)
        self._membership = Membership(ids, changes)
        self._division = division
        self._planned = None if drops else Membership(ids, changes)
        self._arrivals = Arrivals(family, self._membership, ids, memory, system)
        self._last_step = last_step
        self._memory = memory
        self._orders = Orders() if steered else None
        self._settings: dict[int, str] = {}
        self._step = 0
        self._newest = -1
        self._slots: dict[int, _Slot] = {}

    @property
    def step(self) -> int:
        """The first step that is not complete."""
        return self._step

    @property
    def newest(self) -> int:
        """The newest step of which a message has arrived, -1 before the first."""
        return max(self._newest, self._arrivals.newest)

    @property
    def finished(self) -> bool:
        """Whether all steps are complete."""
        return self._step > self._last_step

    def add(self, record: Record) -> list[RecordedStep]:
        """Add the record of a message; return the steps held as records that are complete then.

        Raises
        ------
        OtherSystemError
            If it is one of another parent system.
        ConflictError
            If it differs from the message already in its place.
        UnknownAgentError
            If it comes from a robot that is not a member.
        NegativeTimeError
            If its time, which determines the order in the bag, is before the beginning of the run.
        """
        topic, message = record.topic, record.message
        if self._system is not None:
            refuse_other_system(message, self._system)
        step = message.step
        if step > self._last_step or step < self._step - self._memory:
            return []
        if message.stamp < 0 and not getattr(message, "agent_id", 0):  # a robot's clock may be wrong
            raise NegativeTimeError(topic.name, step, message.stamp)
        self._newest = max(self._newest, step)
        slot = self._slots.get(step) or self._apart(step)
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

    def add_all(self, topic: Topic, payloads: Sequence[bytes]) -> Iterator[RecordedStep | Block]:
        """Add serialized messages of a topic, in order of arrival; yield the steps that are complete then.

        Errors as for `add`, and `MalformedMessageError`. The robots' states may also come as `SwarmStates`.
        """
        joined = topic is SWARM_STATES
        if joined:
            topic, payloads = self._family.robot, [_states_in(data) for data in payloads]
        apart = self._arrange(topic, payloads, joined=joined)
        if apart is None:
            apart = [each for data in payloads for each in split(topic.message, data)] if joined else payloads
        yield from self.ready()
        for payload in apart:
            yield from self.add(Record.heard(topic, payload))
            yield from self.ready()

    def _arrange(self, topic: Topic, payloads: Sequence[bytes], *, joined: bool) -> Sequence[bytes] | None:
        """Take ordinary messages; return those of steps that are held as records, None if all must be added singly."""
        messages = self._arrivals.read(topic, payloads, joined=joined) if topic in self._family.main else None
        if messages is None:
            return None
        steps = messages["step"].astype(np.int64)
        wanted = (steps >= max(0, self._step - self._memory)) & (steps <= self._last_step)
        taken = wanted & (steps < self._step + KEPT_STEPS)
        if self._slots:
            taken &= ~np.isin(steps, list(self._slots))
        if taken.all():
            return [] if self._arrivals.add(topic, messages) else None
        added = self._arrivals.add(topic, messages[taken])
        return [message.tobytes() for message in messages[wanted & ~taken]] if added else None

    def ready(self) -> Iterator[RecordedStep | Block]:
        """Yield the steps that are complete and that no other method has returned."""
        while (block := self._block()) is not None:
            yield block
            yield from self._complete()

    def _block(self) -> Block | None:
        """Return the complete steps held as arrays, as far as the robots and what was ordered stay the same."""
        step, membership = self._step, self._membership
        count = self._arrivals.complete(step)
        if not count or (not step and self._family.once):
            return None
        until = membership.undivided_until(step, self._division)
        if self._orders is not None:
            until = min(until, self._orders.known + 1, *(at for at in self._settings if at >= step))
        count = min(count, until - step)
        if count <= 0:
            return None
        block = self._arrivals.block(step, count)
        self._advance(count)
        return block

    def _advance(self, count: int) -> None:
        for step in range(self._step, self._step + count):
            self._slots.pop(step - self._memory, None)
        self._arrivals.forget(self._step + KEPT_STEPS, count)
        self._step += count

    def _apart(self, step: int) -> _Slot:
        """Hold the messages of a step as records."""
        slot = self._slots[step] = self._slot(step)
        if step < self._step + KEPT_STEPS:
            self._arrivals.forget(step)
        return slot

    def _slot(self, step: int) -> _Slot:
        """Return the messages of a step as records, however they are held."""
        slot = self._slots.get(step)
        if slot is None:
            slot = _Slot()
            for topic, payload in self._arrivals.messages(step) if step < self._step + KEPT_STEPS else ():
                record = Record.heard(topic, payload)
                if record.agent_id:
                    slot.agents[record.agent_id] = record
                else:
                    slot.main[topic] = record
        return slot

    def steer(self, order: Steering) -> tuple[list[Steering], list[RecordedStep]]:
        """Add the request of a step; return the requests known up to now, and steps as `add` does."""
        assert self._orders is not None  # noqa: S101 - only steerable runs receive requests
        found = self._orders.add(order)
        for known in found:
            if (change := change_of(known)) is not None:
                for membership in filter(None, (self._membership, self._planned)):
                    membership.plan(change)
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
            self._refuse_unplanned(event)
            return [RecordedStep(event.step, (record,), slot.main[self._family.parent].message.stamp)]
        return self._complete()

    def _refuse_unplanned(self, event: Message) -> None:
        """Accept an event unless it tells a change of the membership that no node of this swarm can have announced.

        Raises
        ------
        ConflictError
            If it does.
        """
        if self._planned is None or not isinstance(event, SwarmEvent) or event.agent_id not in self._planned:
            return
        span = self._planned.span(event.agent_id)
        at = {
            EventKind.JOINED: span.first,
            EventKind.LEFT: None if span.last is None or span.stays else span.last + 1,
            EventKind.DEAD: None if span.last is None or not span.stays else span.last + 1,
        }
        if event.kind in at and event.step != at[EventKind(event.kind)]:
            raise UnplannedChangeError(event)

    def missing(self) -> tuple[str, ...]:
        """Return human-readable names of what is missing for the current step."""
        if self.finished:
            return ()
        slot = self._slot(self._step)
        topics = [topic.name for topic in self._coordinated() if topic not in slot.main]
        ordered = self._orders is None or self._step <= self._orders.known
        return (*(() if ordered else (STEERER,)), *(f"agent {i}" for i in self.missing_agents()), *topics)

    def _coordinated(self) -> tuple[Topic, ...]:
        """Return the topics with one message in the current step, in the order of a bag after the robots' states."""
        family, step = self._family, self._step
        divided = self._membership.divides(step, self._division)
        return (*(() if step else family.once), *family.main[1:-1], *((STANDING,) if divided else ()), family.desired)

    def missing_agents(self) -> tuple[int, ...]:
        """Return the robots whose state is missing in the current step."""
        if self.finished:
            return ()
        slot = self._slot(self._step)
        return tuple(i for i in self._membership.publishing(self._step) if i not in slot.agents)

    def _complete(self) -> list[RecordedStep]:
        steps = []
        while not self.finished and (slot := self._slots.get(self._step)) is not None:
            expected = self._membership.publishing(self._step)
            coordinated = self._coordinated()
            if not all(topic in slot.main for topic in coordinated):
                break
            if any(i not in slot.agents for i in expected):
                break
            if self._orders is not None and not self._announced(slot, self._orders):
                break
            for record in slot.events.values():
                self._refuse_unplanned(record.message)
            steps.append(
                RecordedStep(
                    self._step,
                    (
                        *(slot.main[topic] for topic in coordinated if topic in self._family.once),
                        *(slot.agents[i] for i in expected),
                        *(slot.main[topic] for topic in coordinated if topic not in self._family.once),
                        *(r for _, r in sorted(slot.events.items()) if not self._is_void(r.message)),
                    ),
                )
            )
            self._advance(1)
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


def _states_in(data: bytes) -> bytes:
    """Return the joined payloads of the robots' states that one serialized message contains."""
    message = decode(SwarmStates, data)
    assert isinstance(message, SwarmStates)  # noqa: S101 - `decode` returns this type
    return message.states

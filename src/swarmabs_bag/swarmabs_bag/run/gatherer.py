"""Collection of a run from its messages, in whatever order they arrive.

A run is complete when every message of the topics of its family is present exactly once. Identical repeats are dropped;
different ones are errors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmabs_bag.run.arrivals import Arrivals
from swarmabs_bag.run.step import Step, rows_of
from swarmabs_config.graph import KEPT_STEPS
from swarmabs_config.publishers import publisher_of
from swarmabs_core.behaviours.base import ConflictError, NegativeTimeError, UnknownAgentError, refuse_other_system
from swarmabs_core.behaviours.steering import Orders
from swarmabs_core.cdr import decode, split
from swarmabs_core.errors import MalformedMessageError, ProtocolError
from swarmabs_core.events import EventCode, code_of
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
    Relay,
    Status,
    Steering,
    SwarmEvent,
    SwarmStates,
    Topic,
    relay_topic,
    said,
)
from swarmabs_core.nodes import NodeKind
from swarmabs_core.record import Record
from swarmabs_core.relays import Content, StepRelays
from swarmabs_core.steering import STEERER, change_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from swarmabs_core.membership import Change


_SET_BY = {Action.REFERENCE: EventCode.REFERENCE, Action.DISTURBANCE: EventCode.DISTURBANCE}
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


class RunCollector:
    """Orders the messages of a run, which may arrive at any time and repeatedly.

    They are added one by one, or in batches of a topic. Messages on topics that have some in every step are held as
    arrays, the few others of a step as bytes.

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
    relayed : bool
        Whether robots pass on to each other what they know. Then a step is complete only with all their relays, but for
        those of robots that are dropped, and those that depend on time (`StepRelays.voted`).
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
        relayed: bool = False,
    ) -> None:
        self._relays: dict[int, StepRelays[tuple[Topic, bytes]]] | None = {} if relayed else None
        ids = sorted(members)
        self._content = Content(ids, family)
        self._family, self._stepwise = family, family.stepwise
        self._system = system
        changes = tuple(schedule)
        self._membership = Membership(ids, changes)
        self._division = division
        self._planned = None if drops else Membership(ids, changes)
        self._arrivals = Arrivals(family, self._membership, ids, memory, system)
        self._last_step = last_step
        self._memory = memory
        self._orders = Orders() if steered else None
        self._settings: dict[int, EventCode] = {}
        self._step = 0
        self._newest = -1
        self._others: dict[int, dict[Topic, bytes]] = {}
        self._events: dict[int, dict[bytes, SwarmEvent]] = {}
        self._early: dict[int, list[Record]] = {}

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

    def add(self, record: Record) -> list[Step]:
        """Add the record of a message; return the steps that are complete then.

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
        MalformedMessageError
            If its lists are not as long as those of the messages before it.
        """
        return [*self._add(record), *self.ready()]

    def _add(self, record: Record) -> list[Step]:
        """Hold a message; return it as a step of its own if it is an event of a step that was complete before."""
        topic, message = record.topic, record.message
        refuse_other_system(message, self._system)
        step = message.step
        if step > self._last_step or step < self._step - self._memory:
            return []
        if message.stamp < 0 and not getattr(message, "agent_id", 0):  # a robot's clock may be wrong
            raise NegativeTimeError(topic.name, step, message.stamp)
        self._newest = max(self._newest, step)
        if isinstance(message, SwarmEvent):
            return self._add_event(record.payload, message)
        if step < self._step + KEPT_STEPS:
            self._hold(record)
        else:
            self._early.setdefault(step, []).append(record)
        return []

    def add_all(self, topic: Topic, payloads: Sequence[bytes]) -> Iterator[Step]:
        """Add serialized messages of a topic, in order of arrival; yield the steps that are complete then.

        Errors as for `add`. The robots' states may also come as `SwarmStates`.
        """
        joined = topic is SWARM_STATES
        if joined:
            topic, payloads = self._family.robot, [_states_in(data) for data in payloads]
        apart = self._arrange(topic, payloads, joined=joined)
        if apart is None:
            apart = [state for data in payloads for state in split(topic.message, data)] if joined else payloads
        try:
            for payload in apart:
                if topic in self._stepwise or topic is EVENTS:  # what is complete before this message has come
                    yield from self.ready()
                yield from self._add(Record.heard(topic, payload))
        except (ProtocolError, MalformedMessageError):
            yield from self.ready()
            raise
        yield from self.ready()

    def _arrange(self, topic: Topic, payloads: Sequence[bytes], *, joined: bool) -> Sequence[bytes] | None:
        """Hold ordinary messages; return those of steps far ahead, None if all must be added singly."""
        if topic not in self._stepwise or not payloads:
            return None
        messages = self._arrivals.read(topic, payloads, joined=joined)
        if messages is None:
            return None
        steps = messages["step"].astype(np.int64)
        wanted = (steps >= max(0, self._step - self._memory)) & (steps <= self._last_step)
        near = wanted & (steps < self._step + KEPT_STEPS)
        if not self._arrivals.add(topic, messages if near.all() else messages[near]):
            return None
        return [message.tobytes() for message in messages[wanted & ~near]]

    def _hold(self, record: Record) -> None:
        """Hold a message of a step that is not far ahead."""
        topic, message = record.topic, record.message
        if isinstance(message, ROBOT_STATES):
            self._hold_state(record, message)
        elif isinstance(message, Relay):
            self._hold_relay(record, message)
        elif topic in self._stepwise:
            if not self._arrivals.put(topic, 0, message.step, record.payload):
                raise ConflictError(topic.name, message.step)
        elif self._others.setdefault(message.step, {}).setdefault(topic, record.payload) != record.payload:
            raise ConflictError(topic.name, message.step)

    def _hold_state(self, record: Record, state: AnyRobotState) -> None:
        """Hold the state of a robot, unless it does not take part in this step."""
        topic, agent_id, step = record.topic, state.agent_id, state.step
        there = self._arrivals.get(topic, agent_id, step)
        if there is None and not self._membership.publishes(agent_id, step):
            if agent_id not in self._membership:
                raise UnknownAgentError(agent_id)
            return
        if not self._arrivals.put(topic, agent_id, step, record.payload):
            raise ConflictError(f"{topic.name} of agent {agent_id}", step)
        if there is None and state.status == Status.LEFT:
            self._membership.end(agent_id, step, stays=False, reason="left")

    def _hold_relay(self, record: Record, relay: Relay) -> None:
        """Hold a relay; those of complete steps are forgotten, because they are many."""
        if relay.agent_id not in self._membership:
            raise UnknownAgentError(relay.agent_id)
        if self._relays is None or relay.step < self._step:
            return
        form = (relay_topic(relay.agent_id), record.payload)
        if self._relays.setdefault(relay.step, StepRelays(self._content)).put(relay, form) != form:
            raise ConflictError(f"{form[0].name} in round {relay.round}", relay.step)

    def _add_event(self, payload: bytes, event: SwarmEvent) -> list[Step]:
        """Add an event; return it as a step of its own if its step is already complete."""
        events = self._events.setdefault(event.step, {})
        if payload in events:
            return []
        events[payload] = event
        self._membership.apply(event.kind, event.agent_id, event.step, event.detail)
        if event.step >= self._step or self._is_void(event):
            return []
        self._refuse_unplanned(event)
        parent = self._arrivals.get(self._family.parent, 0, event.step)
        time = None if parent is None else decode(self._family.parent.message, parent).stamp
        return [Step(event.step, {}, (payload,), time)]

    def ready(self) -> Iterator[Step]:
        """Yield the steps that are complete and that no other method has returned."""
        self._admit()
        while count := self._complete():
            for event in self._events.get(self._step + count - 1, {}).values():
                self._refuse_unplanned(event)
            yield self._take(count)
            self._admit()

    def _complete(self) -> int:
        """Return the number of complete steps, as far as they are alike and only the last one has events."""
        step, orders = self._step, self._orders
        count = 0 if self.finished else self._arrivals.complete(step)
        if not count or not self._others_there(step) or not (orders is None or self._announced(step, orders)):
            return 0
        if self._silent(step):
            return 0
        end = min(step + count, self._last_step + 1, self._membership.constant_until(step))
        end = min(end, *(at + 1 for at, events in self._events.items() if at >= step and events), end)
        if self._relays is not None:
            end = step + 1
        if orders is not None:
            end = min(end, orders.known + 1, *(at for at in self._settings if at > step), end)
        if not step and self._family.once:
            return 1
        if not self._membership.divides(step, self._division):
            return min(end, self._membership.undivided_until(step + 1, self._division)) - step
        size = len(self._others[step][STANDING])
        divided = step + 1
        while divided < end and self._membership.divides(divided, self._division):
            if len(self._others.get(divided, {}).get(STANDING, b"")) != size:
                break
            divided += 1
        return divided - step

    def _silent(self, step: int) -> list[int]:
        """Return the robots of which a step lacks relays."""
        if self._relays is None:
            return []
        awaited = [robot for robot in self._membership.lasting(step) if not self._membership.is_dropped(robot)]
        return self._relays.get(step, StepRelays(self._content)).lacking(awaited)

    def _others_there(self, step: int) -> bool:
        """Return whether the messages of a step on topics that have none in other steps have arrived."""
        others = self._others.get(step, {})
        return all(topic in others for topic in self._coordinated(step) if topic not in self._stepwise)

    def _take(self, count: int) -> Step:
        """Return so many complete steps, and go on to the next one."""
        step = self._step
        tables = self._arrivals.tables(step, count)
        for topic in self._coordinated(step):
            if topic not in self._stepwise:
                payloads = [self._others[number][topic] for number in range(step, step + count)]
                tables[topic] = rows_of(topic, payloads)
        relays = [] if self._relays is None else self._relays.pop(step, StepRelays(self._content)).ordered()
        events = self._events.get(step + count - 1, {})
        told = tuple(payload for payload, event in sorted(events.items()) if not self._is_void(event))
        self._step += count
        self._arrivals.forget(step + KEPT_STEPS, count)
        for number in range(step - self._memory, step - self._memory + count):
            self._others.pop(number, None)
            self._events.pop(number, None)
        return Step(step, tables, told, relays=relays)

    def _admit(self) -> None:
        """Hold the messages that were far ahead when they arrived and no longer are."""
        for step in sorted(step for step in self._early if step < self._step + KEPT_STEPS):
            for record in self._early.pop(step):
                self._hold(record)

    def steer(self, order: Steering) -> tuple[list[Steering], list[Step]]:
        """Add the request of a step; return the requests known up to now, and steps as `add` does."""
        assert self._orders is not None  # noqa: S101 - only steerable runs receive requests
        requests = self._orders.add(order)
        for request in requests:
            if (change := change_of(request)) is not None:
                for membership in filter(None, (self._membership, self._planned)):
                    membership.plan(change)
            elif request.action != Action.NONE:
                self._settings[request.step] = _SET_BY[Action(request.action)]
        return requests, list(self.ready())

    def _refuse_unplanned(self, event: SwarmEvent) -> None:
        """Accept an event unless it tells a change of the membership that no node of this swarm can have announced.

        Raises
        ------
        ConflictError
            If it does.
        """
        if self._planned is None or event.agent_id not in self._planned:
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
        step, others = self._step, self._others.get(self._step, {})
        topics = [
            topic.name
            for topic in self._coordinated(step)
            if topic not in others and self._arrivals.get(topic, 0, step) is None
        ]
        ordered = self._orders is None or step <= self._orders.known
        robots = {*self.missing_agents(), *self._silent(step)}
        return (*(() if ordered else (STEERER,)), *(f"agent {i}" for i in sorted(robots)), *topics)

    def _coordinated(self, step: int) -> tuple[Topic, ...]:
        """Return the topics with one message in a step, in the order of a bag after the robots' states."""
        family = self._family
        absent = {family.robot, *(family.once if step else ())}
        if not self._membership.divides(step, self._division):
            absent.add(STANDING)
        return tuple(topic for topic in family.recorded if topic not in absent)

    def missing_agents(self) -> tuple[int, ...]:
        """Return the robots whose state is missing in the current step."""
        if self.finished:
            return ()
        step, robot = self._step, self._family.robot
        return tuple(i for i in self._membership.publishing(step) if self._arrivals.get(robot, i, step) is None)

    def _announced(self, step: int, orders: Orders) -> bool:
        """Return whether the request of a step is known, and announced by the nodes that it concerns."""
        if step > orders.known:
            return False
        events = self._events.get(step, {}).values()
        told = {(event.agent_id, event.kind) for event in events}
        if not all((agent_id, kind) in told for agent_id, kind, _ in self._membership.changes(step)):
            return False
        setting = self._settings.get(step)
        return setting is None or any(code_of(event) is setting for event in events)

    def _is_void(self, event: SwarmEvent) -> bool:
        """Return whether an event comes from a robot that does not know that it no longer takes part."""
        if self._orders is None:
            return False
        publisher = publisher_of(event)
        if publisher is None or publisher.kind is not NodeKind.AGENT:
            return False
        return not self._membership.publishes(publisher.agent_id, event.step)


def _states_in(data: bytes) -> bytes:
    """Return the joined payloads of the robots' states that one serialized message contains."""
    message = decode(SwarmStates, data)
    assert isinstance(message, SwarmStates)  # noqa: S101 - `decode` returns this type
    return message.states

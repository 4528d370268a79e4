"""Observer and parent of packed runs: the states of all robots in a step are one message and one table.

What is not ordinary - repeated, outdated or malformed states, robots that leave, dead robots on the plane - they leave
to the state machines that take one message after the other. Bits and refusals are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, cast, overload

import numpy as np

from swarmabs_core.arrays import canonical_table
from swarmabs_core.behaviours.base import Gathering
from swarmabs_core.behaviours.observer import Observer
from swarmabs_core.behaviours.parent import Parent
from swarmabs_core.cdr import decode, encode, split
from swarmabs_core.messages import (
    EVENTS,
    OBSERVER_NODE,
    SWARM_STATES,
    AnyRobotState,
    Status,
    SwarmStates,
)
from swarmabs_core.model import TableMotion, TableObservation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from swarmabs_core.messages import AnyParentState, Message, Messages, SwarmEvent, Topic
    from swarmabs_core.model import Observed, ObserverConfig, ParentConfig


FEW = 24
"""Number of robots below which single messages are faster than a table."""


class TableStates(Sequence[AnyRobotState]):
    """States of robots as rows of a table, decoded only where single ones are needed.

    Parameters
    ----------
    topic : Topic
        The topic of the states.
    table : ndarray, (N,)
        Their canonical CDR, by ascending id.
    """

    def __init__(self, topic: Topic, table: NDArray[np.void]) -> None:
        self._topic = topic
        self.table = table

    @cached_property
    def _states(self) -> list[AnyRobotState]:
        kind = self._topic.message
        return [cast("AnyRobotState", decode(kind, payload)) for payload in split(kind, self.table.tobytes())]

    @overload
    def __getitem__(self, place: int) -> AnyRobotState: ...
    @overload
    def __getitem__(self, place: slice) -> list[AnyRobotState]: ...
    def __getitem__(self, place: int | slice) -> AnyRobotState | list[AnyRobotState]:
        """Return a state, or several, as messages."""
        return self._states[place]

    def __len__(self) -> int:
        """Return the number of robots."""
        return len(self.table)


class TableGathering(Gathering):
    """Collects the states of a step one by one, or takes those of all members at once."""

    _all: TableStates | None = None

    def add_all(self, robot: Topic, data: bytes, system: int | None) -> bool:
        """Take joined payloads of the states of all members; return False, and take nothing, in any other case.

        They must be the first ones of the step, canonical, one of every member, none of a robot that leaves, and those
        of this parent system. States of few robots are not taken either.
        """
        members = self._membership.publishing(self._step)
        if len(members) < FEW or self._states or self._all is not None:
            return False
        table = canonical_table(robot, data)
        if table is None or (system is not None and (table["system"] != system).any()):
            return False
        table = table[np.argsort(table["agent_id"])]
        ordinary = (table["step"] == self._step).all() and (table["status"] != Status.LEFT).all()
        if not ordinary or table["agent_id"].tolist() != [*members]:
            return False
        self._all = TableStates(robot, table)
        return True

    def outstanding(self) -> int:
        """Return how many messages it takes at least until something can happen."""
        return 1 if self._all is not None else len(self._membership.publishing(self._step)) - len(self._states)

    def add(self, state: AnyRobotState) -> None:
        """Take a state, as the base class does."""
        if self._all is not None:
            self._states, self._all = {state.agent_id: state for state in self._all}, None
        super().add(state)

    def complete(self) -> bool:
        """Return whether the states of all members have arrived."""
        return self._all is not None or super().complete()

    def missing(self) -> tuple[int, ...]:
        """Return the ids of the members whose state is missing."""
        return () if self._all is not None else super().missing()

    def states(self) -> Sequence[AnyRobotState]:
        """Return the states of the complete step by ascending id."""
        return super().states() if self._all is None else self._all

    def take(self) -> Sequence[AnyRobotState]:
        """Return the states of the complete step by ascending id, and advance to the next step."""
        states = super().take()
        self._all = None
        return states


class PackedObserver(Observer):
    """An observer that also publishes the states of a step as one message.

    Serialized states are kept unread until all that are missing may be there.
    """

    _gathering: TableGathering

    def __init__(self, config: ObserverConfig) -> None:
        super().__init__(config)
        self._robot: Topic = config.family.robot
        self._unread: list[bytes] = []
        self._tables = self._observation if isinstance(self._observation, TableObservation) else None

    def _gather(self) -> TableGathering:
        return TableGathering(self._membership)

    def hear_all(self, topic: Topic, payloads: Sequence[bytes]) -> Messages:
        """Take serialized messages; return what `handle` does."""
        if topic is not self._robot:
            return tuple(answer for data in payloads for answer in self.handle(decode(topic.message, data)))
        self._unread += payloads
        return () if len(self._unread) < self._gathering.outstanding() else self._read()

    def _read(self) -> Messages:
        """Take what is unread; what it does not complete returns nothing."""
        unread, self._unread = self._unread, []
        alike = len(set(map(len, unread))) == 1
        if alike and self._gathering.add_all(self._robot, b"".join(unread), self._system):
            return self._proceed()
        return tuple(answer for data in unread for answer in self.handle(decode(self._robot.message, data)))

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step, and the missing robots, or else the plane."""
        self._read()
        return super().missing()

    def missing_agents(self) -> tuple[int, ...]:
        """Return the ids of the robots whose states of the current step are missing."""
        self._read()
        return super().missing_agents()

    def silent_agents(self) -> tuple[int, ...]:
        """Return the ids of the robots whose states are missing in a step in which others have arrived."""
        self._read()
        return super().silent_agents()

    def _announce(self) -> Messages:
        step, states = self._gathering.step, self._gathering.states()
        data = states.table.tobytes() if isinstance(states, TableStates) else b"".join(map(encode, states))
        return (*super()._announce(), SwarmStates(step * self._config.period_ns, step, data))

    def _observed(
        self, stamp: int, step: int, states: Sequence[AnyRobotState], watched: AnyParentState | None
    ) -> Observed:
        if isinstance(states, TableStates) and self._tables is not None:
            still = np.frombuffer(b"".join(map(encode, self.standing)), states.table.dtype)
            with np.errstate(all="ignore"):
                return self._tables.observed_all(stamp, step, np.append(states.table, still), watched)
        return super()._observed(stamp, step, states, watched)


class PackedParent(Parent):
    """A simulated parent to which the observer sends the robots' states of a step as one message."""

    _gathering: TableGathering

    def __init__(self, config: ParentConfig) -> None:
        super().__init__(config)
        self._robot: Topic = config.family.robot
        self._before: TableStates | None = None  # the same as `_robots`, if they all move
        self._tables = self._motion if isinstance(self._motion, TableMotion) else None

    def _gather(self) -> TableGathering:
        return TableGathering(self._membership)

    def handle(self, message: Message) -> Messages:
        """Take the states of robots or an event; return the parent's state when a step is complete."""
        if not isinstance(message, SwarmStates):
            return super().handle(message)
        if not self._gathering.add_all(self._robot, message.states, self._system):
            for payload in split(self._robot.message, message.states):
                self._take(decode(self._robot.message, payload))
        return self._proceed()

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the states of the robots, and for events about robots that will not send one."""
        return (SWARM_STATES, EVENTS) if super().awaits() else ()

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the node that sends the states."""
        return self._gathering.step, (OBSERVER_NODE,)

    def _move(self, step: int, stamp: int, states: Sequence[AnyRobotState]) -> list[SwarmEvent]:
        before, plain = self._before, None
        if isinstance(states, TableStates) and self._tables is not None and not self._config.falsifications:
            plain = states
        if self._tables and plain and before and before.table["agent_id"].tolist() == plain.table["agent_id"].tolist():
            self._before = plain
            with np.errstate(all="ignore"):
                disturbance = self._disturbances.at(step - 1)
                moved = self._tables.advance_all(step, before.table, plain.table, disturbance)
                if self._ranges.quiet(float(np.abs(plain.table["position"]).max())):
                    return moved
                return [*moved, *self._watch(plain, step, stamp)]
        if before:
            self._robots = {state.agent_id: state for state in before}
        events = super()._move(step, stamp, states)
        self._before = plain if plain and len(self._robots) == len(plain) else None
        return events

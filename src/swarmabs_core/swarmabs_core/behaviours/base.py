"""Common parts of the nodes' behaviours: settings of the run, errors, gathering of the robots' states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, cast

from swarmabs_core.cdr import encode
from swarmabs_core.errors import ProtocolError
from swarmabs_core.messages import (
    AnyRobotState,
    Message,
    Messages,
    RobotState,
    Status,
    Topic,
    coordinates_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from swarmabs_core.membership import Membership
    from swarmabs_core.messages import AnyBroadcast, Family


class Behaviour(Protocol):
    """A node as a state machine. Its driver publishes the returned messages in order."""

    def start(self) -> Messages:
        """Return the messages to publish before anything is received."""
        ...

    def handle(self, message: Message) -> Messages:
        """Take a message and return the messages to publish; a repeated or outdated message changes nothing.

        Raises
        ------
        ProtocolError
            If no correct peer would send this message now.
        """
        ...

    def awaits(self) -> tuple[Topic, ...]:
        """Return the topics on which messages are currently awaited; empty if this node has finished."""
        ...

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the awaited step and, in readable form, what is missing for it."""
        ...


class StepAheadError(ProtocolError):
    """A message of a step that cannot have started yet."""

    def __init__(self, source: str, *, got: int, expected: int) -> None:
        super().__init__(f"{source}: step {expected} expected, {got} received; is a second swarm in this namespace?")


class UnknownAgentError(ProtocolError):
    """A state from a robot that does not belong to this swarm."""

    def __init__(self, agent_id: int) -> None:
        super().__init__(f"robot {agent_id} is not a member of this swarm; is a second swarm in this namespace?")


class ConflictError(ProtocolError):
    """Two different messages where there can be only one."""

    def __init__(self, source: str, step: int) -> None:
        super().__init__(f"{source}: two different messages of step {step}; is a second swarm in this namespace?")


class NegativeTimeError(ProtocolError):
    """A message from before the start of the run."""

    def __init__(self, source: str, step: int, stamp: int) -> None:
        super().__init__(f"{source}: the message of step {step} has a time stamp of {stamp} ns; no run starts before 0")


class UnexpectedMessageError(ProtocolError):
    """A message on a topic to which this node does not subscribe."""

    def __init__(self, node: str, message: Message) -> None:
        super().__init__(f"{node}: received {type(message).__name__}, which this node does not use")


class OtherSystemError(ProtocolError):
    """A message of a swarm on another parent system, or on one with other settings."""

    def __init__(self, message: Message) -> None:
        robot = getattr(message, "agent_id", 0)
        source = f"robot {robot}" if robot else type(message).__name__
        super().__init__(f"{source}: refused in step {message.step}, because its parent system has another description")


def refuse_other_system(message: Message, system: int | None) -> None:
    """Accept a message of a parent system with this hash; there is none on the plane.

    Raises
    ------
    OtherSystemError
        If it is one of another parent system.
    """
    if system is not None and getattr(getattr(message, "abstract", message), "system", system) != system:
        raise OtherSystemError(message)


def packed_broadcasts(family: Family, heard: Callable[[Topic], Message]) -> AnyBroadcast:
    """Return the three broadcasts of a step, by their topics, as one message."""
    packed = cast("Callable[[int, int, Message, Message, Message], AnyBroadcast]", family.packed.message)
    desired = heard(family.desired)
    return packed(desired.stamp, desired.step, heard(family.abstract), heard(family.auxiliary), desired)


def at_rest(state: AnyRobotState) -> AnyRobotState:
    """Return the state of a robot that stands where it was."""
    if isinstance(state, RobotState):
        return state._replace(velocities=(0.0,) * len(state.velocities), status=Status.SAFE_STOP)
    return state._replace(velocity=0.0, status=Status.SAFE_STOP)


def place_of(state: AnyRobotState) -> float:
    """Return the position of a robot, its first coordinate."""
    return coordinates_of(state)[0]


def refuse_conflict(earlier: Message, message: Message, source: str) -> None:
    """Accept a message that repeats an earlier one.

    Raises
    ------
    ConflictError
        If it differs. Bytes are compared, because NaN does not equal itself.
    """
    if earlier is not message and earlier != message and encode(earlier) != encode(message):
        raise ConflictError(source, message.step)


def is_new(message: Message, earlier: Message | None, expected: int, source: str) -> bool:
    """Return whether a message is the first one of the expected step; an earlier or repeated one is not.

    Raises
    ------
    StepAheadError, ConflictError
        If its step cannot have started yet, or it differs from the earlier one.
    """
    if message.step > expected:
        raise StepAheadError(source, got=message.step, expected=expected)
    if message.step < expected:
        return False
    if earlier is not None:
        refuse_conflict(earlier, message, source)
    return earlier is None


class Gathering:
    """Collects the robots' states of one step until those of all members have arrived.

    The membership determines whose states are awaited; it is updated when a robot announces that it leaves.
    """

    def __init__(self, membership: Membership) -> None:
        self._membership = membership
        self._step = 0
        self._states: dict[int, AnyRobotState] = {}

    @property
    def step(self) -> int:
        """The step being gathered."""
        return self._step

    def add(self, state: AnyRobotState) -> None:
        """Take a state; a late or repeated one changes nothing.

        Raises
        ------
        UnknownAgentError, StepAheadError, ConflictError
            If the robot is not a member, its step cannot have started yet, or a different state of it is known.
        """
        agent_id, step = state.agent_id, state.step
        if not self._membership.publishes(agent_id, step):
            if agent_id not in self._membership:
                raise UnknownAgentError(agent_id)
            return
        if not is_new(state, self._states.get(agent_id), self._step, f"agent {agent_id}"):
            return
        self._states[agent_id] = state
        if state.status == Status.LEFT:
            self._membership.end(agent_id, step, stays=False, reason="left")

    def complete(self) -> bool:
        """Return whether the states of all members have arrived."""
        members = self._membership.publishing(self._step)
        states = self._states
        return len(states) >= len(members) and all(agent_id in states for agent_id in members)

    def states(self) -> Sequence[AnyRobotState]:
        """Return the states of the complete step by ascending id."""
        return [self._states[i] for i in self._membership.publishing(self._step)]

    def missing(self) -> tuple[int, ...]:
        """Return the ids of the members whose state is missing."""
        return tuple(i for i in self._membership.publishing(self._step) if i not in self._states)

    def resume(self, step: int) -> None:
        """Continue with a step of which nothing has arrived."""
        self._step, self._states = step, {}

    def take(self) -> Sequence[AnyRobotState]:
        """Return the states of the complete step by ascending id, and advance to the next step."""
        states = self.states()
        self._step += 1
        self._states = {}
        return states

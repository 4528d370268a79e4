"""What the nodes' behaviours have in common: settings of the run, errors, gathering of the robots' states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from swarmabs_core.cdr import encode
from swarmabs_core.declaration import setting
from swarmabs_core.errors import ProtocolError
from swarmabs_core.membership import Change
from swarmabs_core.messages import Message, Messages, Status, Topic

if TYPE_CHECKING:
    from swarmabs_core.membership import Membership
    from swarmabs_core.messages import AgentState


@dataclass(frozen=True, slots=True)
class Run:
    """What nodes must know of the run in which they take part; each declares of it what it needs."""

    period_ns: int = setting(10_000_000, "control period, ns", minimum=1)
    last_step: int | None = setting(None, "step with which the run ends", unset=-1)
    members: tuple[int, ...] = setting((1, 2, 3, 4), "ids of all robots that ever take part", minimum=1, maximum=65535)
    schedule: tuple[Change, ...] = setting(
        (), "scheduled changes of the membership, each 'KIND AGENT STEP', such as 'kill 3 500'", make=Change.parse
    )
    seed: int = setting(1, "seed of the losses and the noise drawn during the run", minimum=0, below=2**63)
    actuator_lag: float = setting(
        0.0, "time constant with which velocity or force follows the command, s; 0: at once", minimum=0.0
    )


@dataclass(frozen=True, slots=True)
class Lockstep:
    """What happens when a robot does not answer."""

    on_stall: str = setting(
        "fail",
        "fail: the run fails; drop: the robot is taken out as if it had been killed",
        choices=("fail", "drop"),
    )
    stall_timeout: float = setting(5.0, "wall time without an answer that is a stall, s", above=0.0)


class Behaviour(Protocol):
    """A node as a state machine. Its driver publishes its answers, in that order."""

    def start(self) -> Messages:
        """Return what is to be published before anything was received."""
        ...

    def handle(self, message: Message) -> Messages:
        """Take a message; a repeated or outdated one changes nothing.

        Raises
        ------
        ProtocolError
            If no correct peer would send this message now.
        """
        ...

    def awaits(self) -> tuple[Topic, ...]:
        """Return the topics on which a message is awaited now; empty if this node has finished."""
        ...

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the step that is waited for and what is missing for it, for people."""
        ...


class StepAheadError(ProtocolError):
    """A message of a step that cannot have begun yet."""

    def __init__(self, source: str, *, got: int, expected: int) -> None:
        super().__init__(f"{source}: step {expected} expected, {got} received; is a second swarm in this namespace?")


class UnknownAgentError(ProtocolError):
    """A state from a robot that does not belong to this swarm."""

    def __init__(self, agent_id: int) -> None:
        super().__init__(f"robot {agent_id} is not a member of this swarm; is a second swarm in this namespace?")


class ConflictError(ProtocolError):
    """Two different messages where there can be one only."""

    def __init__(self, source: str, step: int) -> None:
        super().__init__(f"{source}: two different messages of step {step}; is a second swarm in this namespace?")


class NegativeTimeError(ProtocolError):
    """A message from before the beginning of the run."""

    def __init__(self, source: str, step: int, stamp: int) -> None:
        super().__init__(f"{source}: the message of step {step} has a time stamp of {stamp} ns; no run begins before 0")


class UnexpectedMessageError(ProtocolError):
    """A message on a topic to which this node does not listen."""

    def __init__(self, node: str, message: Message) -> None:
        super().__init__(f"{node}: a {type(message).__name__} was delivered, which this node does not use")


def refuse_conflict(known: Message, message: Message, source: str) -> None:
    """Accept a message that repeats the known one.

    Raises
    ------
    ConflictError
        If it differs. Bytes decide, since a repeated NaN is the same although it equals nothing.
    """
    if known is not message and known != message and encode(known) != encode(message):
        raise ConflictError(source, message.step)


def is_new(message: Message, known: Message | None, expected: int, source: str) -> bool:
    """Tell whether a message is the first of the step that is expected; an earlier or a repeated one is not.

    Raises
    ------
    StepAheadError, ConflictError
        If its step cannot have begun yet, or it differs from the one that is known.
    """
    if message.step > expected:
        raise StepAheadError(source, got=message.step, expected=expected)
    if message.step < expected:
        return False
    if known is not None:
        refuse_conflict(known, message, source)
    return known is None


class Gathering:
    """Collects the robots' states of one step until every member's is there.

    The membership says whose state is waited for; it learns of robots that say that they leave.
    """

    def __init__(self, membership: Membership) -> None:
        self._membership = membership
        self._step = 0
        self._states: dict[int, AgentState] = {}

    @property
    def step(self) -> int:
        """The step that is gathered."""
        return self._step

    def add(self, state: AgentState) -> None:
        """Take a state; late and repeated ones change nothing.

        Raises
        ------
        UnknownAgentError, StepAheadError, ConflictError
            If the robot is not a member, its step cannot have begun yet, or another state of it is there.
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
        """Tell whether every member's state is there."""
        members = self._membership.publishing(self._step)
        states = self._states
        return len(states) >= len(members) and all(agent_id in states for agent_id in members)

    def missing(self) -> tuple[int, ...]:
        """Return the ids of the members whose state is missing."""
        return tuple(i for i in self._membership.publishing(self._step) if i not in self._states)

    def take(self) -> list[AgentState]:
        """Return the states of the complete step by ascending id, and turn to the next step."""
        states = [self._states[i] for i in self._membership.publishing(self._step)]
        self._step += 1
        self._states = {}
        return states

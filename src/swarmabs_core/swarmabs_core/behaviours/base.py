"""What every node behaviour has in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from swarmabs_core.cdr import encode
from swarmabs_core.declaration import setting
from swarmabs_core.errors import ProtocolError
from swarmabs_core.membership import Change
from swarmabs_core.messages import Message, Messages, Topic


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
    """A node as a state machine. Whoever drives it publishes what it answers, in that order."""

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


def refuse_conflict(known: Message, message: Message, source: str) -> None:
    """Accept a message that repeats the known one.

    Raises
    ------
    ConflictError
        If it differs. Bytes decide, since a repeated NaN is the same although it equals nothing.
    """
    if known is not message and known != message and encode(known) != encode(message):
        raise ConflictError(source, message.step)


class UnexpectedMessageError(ProtocolError):
    """A message on a topic to which this node does not listen."""

    def __init__(self, node: str, message: Message) -> None:
        super().__init__(f"{node}: a {type(message).__name__} was delivered, which this node does not use")

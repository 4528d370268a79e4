"""What a parent system with its swarm is to the nodes: how it is observed, controlled, moved, and what its robots do.

The state machines in `swarmabs_core.behaviours` are the same for every parent system. A node's configuration holds the
settings of its run and makes the part of the model that this node needs. `swarmabs_core.models` contains both models:
the plane, and any system of an installed package.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, runtime_checkable

from swarmabs_core.declaration import part, same, setting
from swarmabs_core.faults import Falsification, InjectedFault
from swarmabs_core.membership import Change
from swarmabs_core.settings import LifeSpan, Run
from swarmabs_core.steering import StepChange

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import TypeAlias

    import numpy as np
    from numpy.typing import NDArray

    from swarmabs_core.messages import (
        AbstractState,
        AnyBroadcast,
        AnyParentState,
        AnyRobotState,
        AuxiliaryState,
        DesiredAbstractState,
        Family,
        Messages,
        StandingState,
        SwarmAbstract,
        SwarmAuxiliary,
        SwarmDesired,
        SwarmEvent,
        Topic,
    )
    from swarmabs_core.systems.interface import Quantity

    Observed: TypeAlias = tuple[AbstractState | SwarmAbstract, AuxiliaryState | SwarmAuxiliary]
    """Abstract and auxiliary state of a step."""


class Observation(Protocol):
    """How a swarm is observed."""

    @property
    def watched(self) -> Topic | None:
        """The parent's state, if it is needed."""
        ...

    def observed(
        self,
        stamp: int,
        step: int,
        moving: Sequence[AnyRobotState],
        standing: Sequence[AnyRobotState],
        watched: AnyParentState | None,
    ) -> Observed:
        """Return abstract and auxiliary state at a step, with a time stamp (ns)."""
        ...

    def divided(self, stamp: int, step: int, robots: Sequence[AnyRobotState]) -> StandingState:
        """Return how the abstract state divides at a step, with a time stamp (ns)."""
        ...


@runtime_checkable
class TableObservation(Protocol):
    """An observation of which the states of all robots may be the rows of a table."""

    def observed_all(self, stamp: int, step: int, robots: NDArray[np.void], watched: AnyParentState | None) -> Observed:
        """Do what `Observation.observed` does; robots that stand have their status."""
        ...


class DesiredStates(Protocol):
    """What generates the desired abstract state, once per period."""

    @property
    def no_offset(self) -> str:
        """Why the reference cannot be offset; empty if it can."""
        ...

    def divide(self, divided: StandingState) -> None:
        """Complete the desired state of the next step around the robots that stand."""
        ...

    def advance(
        self, time_ns: int, parent: AnyParentState, *, offset: float = 0.0
    ) -> tuple[Messages, DesiredAbstractState | SwarmDesired]:
        """Return events, and the desired state for a state of the parent; `offset` is added to the reference."""
        ...


class Motion(Protocol):
    """The motion of a simulated parent system under the robots."""

    def described(self) -> Messages:
        """Return what describes the parent system, published once."""
        ...

    def advance(
        self, step: int, robots: Iterable[tuple[AnyRobotState, AnyRobotState | None]], disturbance: float
    ) -> list[SwarmEvent]:
        """Move through the period before a step and return events.

        Robots are given by their states at both ends, None for one that stands.
        """
        ...

    def coasted(self, state: AnyRobotState) -> AnyRobotState:
        """Return the state of a robot one period later, without a command."""
        ...

    def state(self, step: int) -> AnyParentState:
        """Return the measured state at a step."""
        ...

    def resume(self, state: AnyParentState) -> None:
        """Continue from a state that is measured by perfect sensors."""
        ...


@runtime_checkable
class TableMotion(Protocol):
    """A motion for which the states of all robots may be the rows of tables."""

    def advance_all(
        self, step: int, before: NDArray[np.void], after: NDArray[np.void], disturbance: float
    ) -> list[SwarmEvent]:
        """Do what `Motion.advance` does, for robots that all move."""
        ...


class Outcome(NamedTuple):
    """The outcome of a robot's decision: why it does not follow the broadcasts, and what it wanted beyond a limit.

    A robot that is `held` is ready to follow, but the broadcasts do not allow for any robot yet.
    """

    problem: str = ""
    beyond: float | None = None
    held: bool = False


FOLLOWS = Outcome()
"""The outcome of a robot that follows the broadcasts."""


class Body(Protocol):
    """A robot: its state, with the decision and the motion that change it."""

    @property
    def watched(self) -> Topic | None:
        """The parent's state, if it acts on the robot."""
        ...

    def state(self, step: int, broadcast_step: int, status: int) -> AnyRobotState:
        """Return the state at a step, with the step of the broadcasts that led to it."""
        ...

    def resume(self, state: AnyRobotState) -> None:
        """Continue from a state that it would have published, with perfect sensors and without lag."""
        ...

    def wait(self) -> None:
        """Set the command for a period in which no broadcasts are known."""
        ...

    def decide(self, heard: AnyBroadcast, asked_to: str, step: int) -> Outcome:
        """Set the command of a step from the broadcasts; brake if asked to stop or reset."""
        ...

    def move(self, watched: AnyParentState | None) -> None:
        """Move for a period under the command."""
        ...


@dataclass(frozen=True)
class NodeConfig:
    """What the configurations of all nodes have; `family` are the topics of the swarm."""

    period_ns: int = same(Run, "period_ns")
    last_step: int | None = same(Run, "last_step")

    family: ClassVar[Family]

    @property
    def system_hash(self) -> int | None:
        """Hash of the description of the parent system, which the messages carry; None on the plane."""
        return None


@dataclass(frozen=True)
class CoordinatorConfig(NodeConfig):
    """What the configurations of the nodes have that know the robots."""

    members: tuple[int, ...] = same(Run, "members")
    schedule: tuple[Change, ...] = same(Run, "schedule")


@dataclass(frozen=True)
class ObserverConfig(CoordinatorConfig):
    """Configuration of an observer."""

    division: int = same(Run, "division")

    def observation(self) -> Observation:
        """Return how it observes the swarm."""
        raise NotImplementedError


@dataclass(frozen=True)
class ControllerConfig(CoordinatorConfig):
    """Configuration of a parent controller's node."""

    division: int = same(Run, "division")
    recording_window: int = setting(
        0, "number of steps that the run may be ahead of the recorder; 0: not recorded", minimum=0
    )
    offsets: tuple[StepChange, ...] = setting(
        (),
        "offsets of the law's reference, {unit}, each 'STEP VALUE' from a step on, such as '500 0.1'",
        unit="rad",
        make=StepChange.parse,
    )

    def desired_states(self) -> DesiredStates:
        """Return what generates the desired abstract state."""
        raise NotImplementedError


@dataclass(frozen=True)
class ParentConfig(CoordinatorConfig):
    """Configuration of a simulated parent system."""

    seed: int = same(Run, "seed")
    falsifications: tuple[Falsification, ...] = setting(
        (),
        "falsified states of robots, each 'AGENT lie FIRST END OFFSET FACTOR FACTOR'",
        name="lies",
        make=Falsification.parse,
    )
    torques: tuple[StepChange, ...] = setting(
        (),
        "constant torques that disturb the plane, {unit}, each 'STEP VALUE' from a step on, such as '500 0.1'",
        unit="N m",
        make=StepChange.parse,
    )
    confirmed: bool = setting(
        False, "whether robots send their states of a step again once one of them is announced to have ended before it"
    )

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        """The coordinates of a robot, with their ends."""
        raise NotImplementedError

    def motion(self) -> Motion:
        """Return the parent at its initial state."""
        raise NotImplementedError


@dataclass(frozen=True)
class AgentConfig(NodeConfig):
    """Configuration of a robot in lockstep."""

    agent_id: int = setting(1, "id of the robot, 1 to 65535", minimum=1, maximum=65535)
    life: LifeSpan = part(LifeSpan, name="")
    faults: tuple[InjectedFault, ...] = setting(
        (), "injected faults, each 'KIND FIRST END VALUE...', such as 'loss 0 -1 0.2'", make=InjectedFault.parse
    )
    seed: int = same(Run, "seed")

    def refuse_contradictions(self) -> None:
        """Raise `InputError` if settings contradict each other that no other check compares."""

    def body(self) -> Body:
        """Return the robot at its initial state."""
        raise NotImplementedError

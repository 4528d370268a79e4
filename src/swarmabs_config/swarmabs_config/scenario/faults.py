"""Faults and membership changes that a scenario injects at fixed steps."""

from typing import Annotated, Literal, TypeAlias

from pydantic import Field, field_validator, model_validator

from .agents import AgentId
from .controllers import Angle
from .fields import AsTuple, Model, Number, Positive, WithoutNegativeZero, problem
from .timing import LONGEST, to_nanoseconds

LARGEST_OFFSET = 1e6
"""Largest offset of a clock, s: nanoseconds of it are exact in a float."""
SMALLEST_FACTOR, LARGEST_FACTOR = 1e-3, 1e3
"""Factors of a lie between which it can be undone without harm."""

At: TypeAlias = Annotated[float, Field(ge=0, le=LONGEST), WithoutNegativeZero]
Probability: TypeAlias = Annotated[float, Field(ge=0, le=1), WithoutNegativeZero]
Factor: TypeAlias = Annotated[float, Field(ge=-LARGEST_FACTOR, le=LARGEST_FACTOR)]


_AT = "time in s; the fault step is the nearest step, round(at/step)"


class AgentFault(Model):
    """Base of the faults that hit one robot at one step."""

    kind: str = Field(description="what happens")
    at: At | None = Field(description=_AT)
    agent: AgentId = Field(description="id of the robot, one of swarm.agents")


class KillFault(AgentFault):
    """The robot's process dies; the robot stands still where it is, its weight stays on the plane."""

    kind: Literal["kill"] = Field(default="kill", description="the process dies, the robot stands still")
    at: At = Field(description=_AT)


class FreezeFault(AgentFault):
    """The robot's process is stopped (SIGSTOP); the robot stands still where it is."""

    kind: Literal["freeze"] = Field(default="freeze", description="the process is stopped, the robot stands still")
    at: At = Field(description=_AT)


class LeaveFault(AgentFault):
    """The robot says that it leaves; from the next step its weight is gone."""

    kind: Literal["leave"] = Field(default="leave", description="the robot leaves the plane")
    at: At = Field(description=_AT)


class RemoveFault(AgentFault):
    """The robot is taken off the plane without being asked; from the next step its weight is gone."""

    kind: Literal["remove"] = Field(default="remove", description="the robot is taken off the plane")
    at: At = Field(description=_AT)


class JoinFault(AgentFault):
    """The robot, listed under ``swarm.agents``, is not there before the fault step."""

    kind: Literal["join"] = Field(default="join", description="the robot appears on the plane at its initial position")
    at: At | None = Field(description=f"{_AT}; null: only when it is added to a run that is steered")


class SettingFault(Model):
    """Base of what is set for the whole run at a step, until it is set again."""

    kind: str = Field(description="what is set")
    at: At = Field(description="time in s from which on it holds; the nearest step counts")
    until: At | None = Field(
        default=None, description="time in s from which on it is 0 again; null: when it is set again, or never"
    )

    @model_validator(mode="after")
    def _check_order(self) -> "SettingFault":
        if self.until is not None and self.until <= self.at:
            raise problem(f"it ends at {self.until!r} s, before it begins", f"use an 'until' after {self.at!r} s")
        return self

    @property
    def value(self) -> float:
        """What is set."""
        raise NotImplementedError


class ReferenceFault(SettingFault):
    """The angle wanted is above the parent controller's reference by an offset."""

    kind: Literal["reference"] = Field(default="reference", description="the angle wanted is offset")
    offset: Angle = Field(description="what is added to the parent controller's reference, rad")

    @property
    def value(self) -> float:
        """The offset."""
        return self.offset


class DisturbanceFault(SettingFault):
    """A constant torque disturbs the plane, besides ``plane.disturbance`` and with its sign."""

    kind: Literal["disturbance"] = Field(default="disturbance", description="a constant torque disturbs the plane")
    torque: Number = Field(description="torque, N m; a positive one turns the plane to smaller angles")

    @property
    def value(self) -> float:
        """The torque."""
        return self.torque


class RobotFault(Model):
    """Base of the faults of robots and their messages, which act for a while."""

    kind: str = Field(description="what happens")
    begin: At = Field(default=0.0, alias="from", description="time in s from which on it acts; the nearest step counts")
    to: At | None = Field(default=None, description="time in s from which on it acts no more; null: to the end")

    @model_validator(mode="after")
    def _check_order(self) -> "RobotFault":
        if self.to is not None and self.to <= self.begin:
            raise problem(f"the fault ends at {self.to!r} s, before it begins", f"use a 'to' after {self.begin!r} s")
        return self

    def hits(self, agent_id: int) -> bool:
        """Tell whether it is injected into a robot."""
        raise NotImplementedError

    @property
    def values(self) -> tuple[float, ...]:
        """The numbers that say how it acts, in the order of `swarmabs_core.faults.FaultKind`."""
        raise NotImplementedError


class MessageFault(RobotFault):
    """Base of the faults of what robots hear and say."""

    agents: Annotated[tuple[AgentId, ...], AsTuple] | None = Field(
        default=None, description="ids of the robots that it hits; null: all"
    )

    @field_validator("agents")
    @classmethod
    def _check_agents(cls, agents: tuple[int, ...] | None) -> tuple[int, ...] | None:
        if agents is not None and not agents:
            raise problem("no robots are named", "name some, or leave out 'agents' for all")
        if agents is not None and len(set(agents)) < len(agents):
            twice = next(agent for agent in agents if agents.count(agent) > 1)
            raise problem(f"robot {twice} is named twice", "name each robot once")
        return agents

    def hits(self, agent_id: int) -> bool:
        """Tell whether it is injected into a robot."""
        return self.agents is None or agent_id in self.agents


class LossFault(MessageFault):
    """Robots miss broadcasts at random and keep their previous command."""

    kind: Literal["loss"] = Field(default="loss", description="robots keep their previous command at random")
    probability: Probability = Field(description="probability of a loss, for each robot and step")

    @property
    def values(self) -> tuple[float, ...]:
        """The probability."""
        return (self.probability,)


class DelayFault(MessageFault):
    """Robots compute with broadcasts that are some steps old; their command is 0 until there are any."""

    kind: Literal["delay"] = Field(default="delay", description="robots use earlier broadcasts")
    steps: int = Field(ge=0, lt=2**31, description="age of the broadcasts, steps")

    @property
    def values(self) -> tuple[float, ...]:
        """The age."""
        return (float(self.steps),)


class DuplicationFault(MessageFault):
    """Robots hear broadcasts twice and say their state twice, at random."""

    kind: Literal["duplication"] = Field(default="duplication", description="messages come twice at random")
    probability: Probability = Field(
        description="probability that a robot hears the broadcasts of a step twice, and that it says its state twice"
    )

    @property
    def values(self) -> tuple[float, ...]:
        """The probability."""
        return (self.probability,)


class ReorderingFault(MessageFault):
    """Broadcasts reach robots after later ones, at random; a robot acts on the newest that it has."""

    kind: Literal["reordering"] = Field(default="reordering", description="broadcasts come after later ones at random")
    probability: Probability = Field(description="probability that broadcasts come late, for each robot and step")
    steps: int = Field(default=1, ge=1, lt=2**31, description="most steps by which they come late")

    @property
    def values(self) -> tuple[float, ...]:
        """The probability, and by how many steps at most."""
        return self.probability, float(self.steps)


class SingleRobotFault(RobotFault):
    """Base of the faults of one robot that act for a while."""

    agent: AgentId = Field(description="id of the robot, one of swarm.agents")

    def hits(self, agent_id: int) -> bool:
        """Tell whether it is injected into a robot."""
        return self.agent == agent_id


class ClockOffsetFault(SingleRobotFault):
    """The clock of a robot is wrong: the stamps of its states and events are off."""

    kind: Literal["clock_offset"] = Field(default="clock_offset", description="the robot's stamps are off")
    offset: Annotated[float, Field(ge=-LARGEST_OFFSET, le=LARGEST_OFFSET), WithoutNegativeZero] = Field(
        description="by how much its clock is ahead, s"
    )

    @field_validator("offset")
    @classmethod
    def _check_offset(cls, offset: float) -> float:
        try:
            to_nanoseconds(offset)
        except ValueError as exc:
            raise problem(str(exc), "give at most nine decimals, e.g. 0.05") from None
        return offset

    @property
    def values(self) -> tuple[float, ...]:
        """The offset."""
        return (self.offset,)


class LieFault(SingleRobotFault):
    """A robot says a false position or mass; the plane feels the true ones."""

    kind: Literal["lie"] = Field(default="lie", description="the robot says a false position or mass")
    position_offset: Number = Field(default=0.0, description="what it adds to its position, m")
    position_factor: Factor = Field(default=1.0, description="by what it multiplies its position before; not 0")
    mass_factor: Annotated[Positive, Field(le=LARGEST_FACTOR)] = Field(
        default=1.0, description="by what it multiplies its mass"
    )

    @field_validator("position_factor")
    @classmethod
    def _check_factor(cls, factor: float) -> float:
        if abs(factor) < SMALLEST_FACTOR:
            raise problem(f"{factor!r} cannot be undone", f"give a number of at least {SMALLEST_FACTOR!r} in magnitude")
        return factor

    @model_validator(mode="after")
    def _check_false(self) -> "LieFault":
        if self.values == (0.0, 1.0, 1.0):
            raise problem("this robot tells the truth", "give 'position_offset', 'position_factor' or 'mass_factor'")
        return self

    @property
    def values(self) -> tuple[float, ...]:
        """Offset and factor of the position, factor of the mass."""
        return self.position_offset, self.position_factor, self.mass_factor


Fault: TypeAlias = (
    KillFault
    | FreezeFault
    | LeaveFault
    | RemoveFault
    | JoinFault
    | ReferenceFault
    | DisturbanceFault
    | LossFault
    | DelayFault
    | DuplicationFault
    | ReorderingFault
    | ClockOffsetFault
    | LieFault
)

FAULT_KINDS: dict[str, type[Model]] = {
    "kill": KillFault,
    "leave": LeaveFault,
    "remove": RemoveFault,
    "join": JoinFault,
    "freeze": FreezeFault,
    "reference": ReferenceFault,
    "disturbance": DisturbanceFault,
    "loss": LossFault,
    "delay": DelayFault,
    "duplication": DuplicationFault,
    "reordering": ReorderingFault,
    "clock_offset": ClockOffsetFault,
    "lie": LieFault,
}
"""The model of each ``kind`` of fault."""

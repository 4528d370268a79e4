"""Faults and membership changes that a scenario injects at fixed steps."""

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from .agents import AgentId
from .fields import Model, WithoutNegativeZero
from .timing import LONGEST

At: TypeAlias = Annotated[float, Field(ge=0, le=LONGEST), WithoutNegativeZero]


class AgentFault(Model):
    """Base of the faults that hit one robot at one step."""

    kind: str = Field(description="what happens")
    at: At = Field(description="time in s; the fault step is the nearest step, round(at/step)")
    agent: AgentId = Field(description="id of the robot, one of swarm.agents")


class KillFault(AgentFault):
    """The robot's process dies; the robot stands still where it is, its weight stays on the plane."""

    kind: Literal["kill"] = Field(default="kill", description="the process dies, the robot stands still")


class FreezeFault(AgentFault):
    """The robot's process is stopped (SIGSTOP); the robot stands still where it is."""

    kind: Literal["freeze"] = Field(default="freeze", description="the process is stopped, the robot stands still")


class LeaveFault(AgentFault):
    """The robot says that it leaves; from the next step its weight is gone."""

    kind: Literal["leave"] = Field(default="leave", description="the robot leaves the plane")


class JoinFault(AgentFault):
    """The robot, listed under ``swarm.agents``, is not there before the fault step."""

    kind: Literal["join"] = Field(default="join", description="the robot appears on the plane at its initial position")


class LossFault(Model):
    """Robots miss broadcasts at random and keep their previous command."""

    kind: Literal["loss"] = Field(default="loss", description="robots keep their previous command at random")
    probability: Annotated[float, Field(ge=0, le=1), WithoutNegativeZero] = Field(
        description="probability of a loss, for each robot and step"
    )


class DelayFault(Model):
    """Robots compute with broadcasts that are some steps old; their command is 0 until there are any."""

    kind: Literal["delay"] = Field(default="delay", description="robots use earlier broadcasts")
    steps: int = Field(ge=0, lt=2**31, description="age of the broadcasts, steps")


Fault: TypeAlias = KillFault | FreezeFault | LeaveFault | JoinFault | LossFault | DelayFault

FAULT_KINDS: dict[str, type[Model]] = {
    "kill": KillFault,
    "leave": LeaveFault,
    "join": JoinFault,
    "freeze": FreezeFault,
    "loss": LossFault,
    "delay": DelayFault,
}
"""The model of each ``kind`` of fault."""

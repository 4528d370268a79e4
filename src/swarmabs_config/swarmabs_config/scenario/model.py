"""The scenario: everything a run depends on, checked once and then immutable."""

from functools import cached_property
from typing import Annotated, Literal

from pydantic import BeforeValidator, ConfigDict, Field, field_validator, model_validator

from swarmabs_core.membership import UNPLANNED

from . import checks
from .agents import AGENT_KINDS, Agent, Generate
from .controllers import DEFAULT_CONTROLLER, STEEPEST, Angle, ControllerConfig, PdConfig
from .errors import describe
from .faults import FAULT_KINDS, AgentFault, Fault, JoinFault, RobotFault, SettingFault
from .fields import (
    AsPair,
    AsSix,
    AsTuple,
    Model,
    NonNegative,
    Number,
    Positive,
    Tagged,
    problem,
    raise_findings,
)
from .observers import DEFAULT_OBSERVER, OBSERVER_CONFIGS, ObserverConfig, SumObserver
from .plugins import ALL_CONTROLLER_CONFIGS, ALL_LAW_CONFIGS, DEFAULT_LAW, LawConfig, PaperLaw
from .timing import NANOSECONDS, Duration, nearest_step, to_nanoseconds
from .versions import known_version

LONGEST_NAME = 60


class Disturbance(Model):
    """The torque on the plane that nobody measures, tau_d = amplitude sin(angular_frequency t)."""

    amplitude: Number = Field(default=0.0, description="amplitude of the disturbance torque, N m")
    angular_frequency: Number = Field(default=0.5, description="angular frequency of the disturbance, rad/s")


class PlaneSensor(Model):
    """What is published of the plane's angle and angular velocity: rounded, after noise is added."""

    noise: Annotated[tuple[NonNegative, NonNegative], AsPair] = Field(
        default=(0.0, 0.0), description="standard deviations of white noise on angle, rad, and angular velocity, rad/s"
    )
    resolution: Annotated[tuple[NonNegative, NonNegative], AsPair] = Field(
        default=(0.0, 0.0), description="steps to which angle, rad, and angular velocity, rad/s, are rounded; 0: none"
    )


class RobotSensor(Model):
    """What a robot knows of its own position and velocity: rounded, after noise is added."""

    noise: Annotated[tuple[NonNegative, NonNegative], AsPair] = Field(
        default=(0.0, 0.0), description="standard deviations of white noise on its own position, m, and velocity, m/s"
    )
    resolution: Annotated[tuple[NonNegative, NonNegative], AsPair] = Field(
        default=(0.0, 0.0), description="steps to which its own position, m, and velocity, m/s, are rounded; 0: none"
    )


class Plane(Model):
    """The tilting plane."""

    inertia: Positive = Field(default=0.5, description="moment of inertia J without robots, kg m^2")
    length: Positive = Field(default=1.0, description="length L; robots stay within L/2 of the axis, m")
    gravity: Positive = Field(default=9.81, description="acceleration g of gravity, m/s^2")
    friction: Annotated[tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative], AsSix] = (
        Field(
            default=(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0),
            description="[g1, ..., g6] of g1 (tanh(g2 w) - tanh(g3 w)) + g4 tanh(g5 w) + g6 w: "
            "g1, g4 in N m, g2, g3, g5 in s/rad, g6 in N m s/rad",
        )
    )
    substep: Duration = Field(default=0.001, description="longest step of the plane's integrator, s")
    angle: Angle = Field(default=0.1, description="initial angle, rad")
    angular_velocity: Number = Field(default=0.0, description="initial angular velocity, rad/s")
    disturbance: Disturbance = Field(default=Disturbance(), description="disturbance torque on the plane")
    robot_gravity: bool = Field(
        default=False,
        description="whether the plane's motion acts on the double integrators, force -m g sin(th) + m p w^2",
    )
    end_stop: Annotated[Positive, Field(lt=STEEPEST)] | None = Field(
        default=None, description="angle of inelastic end stops on both sides, below 1.5 rad; null: none"
    )
    sensor: PlaneSensor = Field(default=PlaneSensor(), description="what is published of the plane's motion")


class Manifold(Model):
    """The curve in the abstract space on which the swarm is held, Js = curvature tau^2 + offset."""

    curvature: NonNegative = Field(default=0.0125, description="A of Js = A tau^2 + B, kg m^2/(N m)^2")
    offset: Positive = Field(default=0.025, description="B of Js = A tau^2 + B, kg m^2")
    torque_max: Positive = Field(default=5.0, description="bound of the torque asked of the swarm, N m")


class SwarmGains(Model):
    """Gains of the robots' control laws, one for the torque and one for the inertia."""

    k: Annotated[tuple[Positive, Positive], AsPair] = Field(
        default=(10.0, 10.0), description="K of single integrators, 1/s"
    )
    kp: Annotated[tuple[Positive, Positive], AsPair] = Field(
        default=(10.0, 10.0), description="Kp of double integrators, 1/s^2"
    )
    kd: Annotated[tuple[Positive, Positive], AsPair] = Field(
        default=(5.0, 5.0), description="Kd of double integrators, 1/s"
    )
    ksd: NonNegative = Field(default=1.0, description="damping k_sd added to double integrators, N s/m")


class Swarm(Model):
    """The robots and their gains: exactly one of `agents` and `generate` is given."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["agents"]}, {"required": ["generate"]}]})

    law: Annotated[LawConfig, Tagged("type", ALL_LAW_CONFIGS, DEFAULT_LAW)] = Field(
        default=PaperLaw(), description="the robots' control law"
    )
    gains: SwarmGains = Field(default=SwarmGains(), description="gains of the robots' control laws")
    agents: Annotated[tuple[Annotated[Agent, Tagged("kind", AGENT_KINDS)], ...], AsTuple] | None = Field(
        default=None, description="the robots, one by one"
    )
    generate: Generate | None = Field(default=None, description="a swarm drawn at random instead")
    sensor: RobotSensor = Field(default=RobotSensor(), description="what a robot knows of its own motion")
    actuator_lag: NonNegative = Field(
        default=0.0, description="time constant with which velocity or force follows the command, s; 0: at once"
    )

    @model_validator(mode="after")
    def _check_one_source(self) -> "Swarm":
        if self.agents is not None and self.generate is not None:
            raise problem(
                "both 'agents' and 'generate' are given",
                "keep one of them; '--set swarm.agents=null' removes one",
            )
        if self.agents is None and self.generate is None:
            raise problem("no robots: neither 'agents' nor 'generate' is given", "list 'agents', or use 'generate'")
        return self

    @cached_property
    def members(self) -> tuple[Agent, ...]:
        """The robots in order of their ids, whether they are listed or generated."""
        if self.generate is not None:
            return self.generate.agents()
        return tuple(sorted(self.agents or (), key=lambda agent: agent.id))


class Limits(Model):
    """What a robot's drive can do; null means no limit."""

    velocity: Positive | None = Field(default=None, description="largest speed of a robot, m/s")
    force: Positive | None = Field(default=None, description="largest force of a double integrator, N")


class Lockstep(Model):
    """What happens when a robot does not answer."""

    on_stall: Literal["fail", "drop"] = Field(
        default="fail",
        description="fail: the run fails; drop: the robot is taken out as if it had been killed",
    )
    stall_timeout: Positive = Field(default=5.0, description="wall time without an answer that is a stall, s")


class Realtime(Model):
    """What holds where the clock and not the last message makes the steps: on robots, and with `run --realtime`."""

    broadcast_age_limit: Positive = Field(
        default=0.1, description="age of the newest complete broadcasts from which on a robot stops, s"
    )
    state_age_limit: Positive = Field(
        default=0.1, description="age of a robot's state from which on it is taken to stand still, s"
    )
    plane_age_limit: Positive = Field(
        default=0.1, description="age of the plane's state from which on the parent controller asks for nothing, s"
    )
    clock_tolerance: NonNegative = Field(
        default=0.02, description="how far a message may come from the future by the receiver's clock, s"
    )
    lane_margin: NonNegative = Field(
        default=0.02, description="distance from the plane's ends at which a robot must have come to rest, m"
    )
    start: Literal["wait", "quorum", "proceed"] = Field(
        default="wait",
        description="wait: all robots must have been heard before the swarm moves; quorum: as many as `quorum` says; "
        "proceed: two",
    )
    quorum: Annotated[int, Field(ge=2, le=65535)] | None = Field(
        default=None, description="robots that must have been heard with start: quorum"
    )

    @model_validator(mode="after")
    def _check_quorum(self) -> "Realtime":
        if (self.quorum is None) == (self.start == "quorum"):
            if self.quorum is None:
                raise problem("start is 'quorum' and there is no number 'quorum'", "say how many robots must be there")
            raise problem(f"'quorum' has no meaning with start: {self.start}", "remove it, or use start: quorum")
        return self


class Scenario(Model):
    """A run, completely described.

    Instances are valid and immutable. Build them with `load_scenario` or `parse_scenario`, which name file
    and line of an error, or directly; then an invalid value raises `pydantic.ValidationError`.
    """

    schema_version: Annotated[Literal[1], BeforeValidator(known_version)] = Field(
        alias="schema", description="version of this file format: 1"
    )
    name: str = Field(
        default="scenario",
        description="name of the scenario, by default the file's stem",
        json_schema_extra={"minLength": 1, "maxLength": LONGEST_NAME},
    )
    duration: Duration = Field(default=30.0, description="simulated time, a multiple of step, s")
    step: Duration = Field(default=0.01, description="control period, s")
    seed: int = Field(default=1, ge=0, lt=2**63, description="seed of the losses and the noise drawn during the run")
    plane: Plane = Field(default=Plane(), description="the tilting plane")
    manifold: Manifold = Field(default=Manifold(), description="the curve Js(tau) on which the swarm is held")
    controller: Annotated[ControllerConfig, Tagged("type", ALL_CONTROLLER_CONFIGS, DEFAULT_CONTROLLER)] = Field(
        default=PdConfig(), description="the parent controller"
    )
    swarm: Swarm = Field(description="the robots and their gains")
    observer: Annotated[ObserverConfig, Tagged("type", OBSERVER_CONFIGS, DEFAULT_OBSERVER)] = Field(
        default=SumObserver(), description="where the robots' abstract state comes from"
    )
    limits: Limits = Field(default=Limits(), description="limits of the robots' drives")
    lockstep: Lockstep = Field(default=Lockstep(), description="what happens when a robot does not answer")
    realtime: Realtime = Field(default=Realtime(), description="what holds where the clock makes the steps")
    faults: Annotated[tuple[Annotated[Fault, Tagged("kind", FAULT_KINDS)], ...], AsTuple] = Field(
        default=(), description="faults and membership changes"
    )

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        if not is_name(name):
            raise problem(
                f"{describe(name)} cannot name a folder",
                f"use 1 to {LONGEST_NAME} printable characters, no / or \\, first a letter, a digit or _",
            )
        return name

    @model_validator(mode="after")
    def _check_together(self) -> "Scenario":
        raise_findings("Scenario", checks.findings(self))
        return self

    @cached_property
    def step_ns(self) -> int:
        """The control period in ns."""
        return to_nanoseconds(self.step)

    @cached_property
    def duration_ns(self) -> int:
        """The simulated time in ns."""
        return to_nanoseconds(self.duration)

    @property
    def steps(self) -> int:
        """The number n of control steps; steps 0 to n are recorded."""
        return self.duration_ns // self.step_ns

    @property
    def period(self) -> float:
        """The control period in s, as everything computes with it."""
        return self.step_ns / NANOSECONDS

    @property
    def agents(self) -> tuple[Agent, ...]:
        """The robots in order of their ids, whether they are listed or generated."""
        return self.swarm.members

    @property
    def initial_agents(self) -> tuple[Agent, ...]:
        """The robots that are there at step 0: all but those that join later."""
        later = {fault.agent for fault in self.faults if isinstance(fault, JoinFault) and self.fault_step(fault.at) > 0}
        return tuple(agent for agent in self.agents if agent.id not in later)

    @property
    def membership_faults(self) -> tuple[AgentFault, ...]:
        """The faults that end a robot or let it join."""
        return tuple(fault for fault in self.faults if isinstance(fault, AgentFault))

    @property
    def robot_faults(self) -> tuple[RobotFault, ...]:
        """The faults of robots and their messages that act for a while."""
        return tuple(fault for fault in self.faults if isinstance(fault, RobotFault))

    @property
    def setting_faults(self) -> tuple[SettingFault, ...]:
        """What is set for the whole run at a step: offsets of the reference, torques on the plane."""
        return tuple(fault for fault in self.faults if isinstance(fault, SettingFault))

    def fault_steps(self, fault: RobotFault) -> tuple[int, int | None]:
        """Return the first step in which a fault acts, and the first after it, None if it acts to the end."""
        return self.fault_step(fault.begin), None if fault.to is None else self.fault_step(fault.to)

    def fault_step(self, at: float | None) -> int:
        """Return the step of a fault at time `at` (s): round(at/step) of the exact decimals, ties to even.

        What has no time is not planned: `swarmabs_core.membership.UNPLANNED`.
        """
        return UNPLANNED if at is None else nearest_step(at, self.step_ns)

    def resolved(self) -> "Scenario":
        """Return the same scenario with every robot listed, in order of ids, and nothing left to generate."""
        swarm = self.swarm.model_copy(update={"agents": self.agents, "generate": None})
        return self.model_copy(update={"swarm": swarm})

    def warnings(self) -> tuple[str, ...]:
        """Return what is legal but likely to go wrong, one line each."""
        return checks.warnings(self)


def is_name(text: str) -> bool:
    """Say whether `text` can name a scenario and, with a number, the folder of a run."""
    return (
        0 < len(text) <= LONGEST_NAME
        and text.isprintable()
        and not set(text) & {"/", "\\"}
        and (text[0].isalnum() or text[0] == "_")
        and not text.endswith(" ")
    )

"""The nodes on any parent system: their configurations, the motion of the parent, and the robot."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import inf, isfinite
from typing import TYPE_CHECKING, ClassVar, cast

from swarmabs_core import model
from swarmabs_core.declaration import choice, part, same, setting
from swarmabs_core.events import EventCode
from swarmabs_core.messages import (
    SYSTEM_FAMILY,
    Family,
    Kind,
    Messages,
    ParentState,
    RobotState,
    StandingState,
    Status,
    SwarmEvent,
    SystemDescription,
    word,
)
from swarmabs_core.model import Outcome
from swarmabs_core.parameters import Settings
from swarmabs_core.robot_controller import BRAKING_TIME, NOT_FINITE
from swarmabs_core.sensing import ParentSensor
from swarmabs_core.steering import StepChange
from swarmabs_core.summation import exact_sum
from swarmabs_core.systems.desired import Requests, SystemDesiredState
from swarmabs_core.systems.interface import SYSTEMS, NamedSystem
from swarmabs_core.systems.law import RobotLaw, SystemGains
from swarmabs_core.systems.motion import ParentMotion, standing
from swarmabs_core.systems.swarm import divided, observed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from swarmabs_core.messages import (
        AnyBroadcast,
        AnyParentState,
        AnyRobotState,
        SwarmAbstract,
        SwarmAuxiliary,
        SwarmBroadcast,
        Topic,
    )
    from swarmabs_core.systems.interface import Quantity, Vector
    from swarmabs_core.systems.swarm import Add

HELD = EventCode.NO_FOLLOWER.text.format(why=" (the Gram matrix vanishes)")
"""`SwarmEvent.detail` where a robot brakes because the law is not defined."""


@dataclass(frozen=True)
class OfSystem(model.NodeConfig):
    """What every node on a parent system knows about it."""

    system: str = choice(SYSTEMS.find, SYSTEMS.built_in, "", "parent system, provided by an installed package")
    system_settings: Settings = field(default_factory=dict, hash=False)

    family: ClassVar[Family] = SYSTEM_FAMILY

    @cached_property
    def named(self) -> NamedSystem:
        """The parent system."""
        return NamedSystem(self.system, self.system_settings)

    @property
    def system_hash(self) -> int:
        """Hash of its description."""
        return self.named.hash


@dataclass(frozen=True)
class SystemObserverConfig(OfSystem, model.ObserverConfig):
    """Configuration of the observer on any parent system."""

    curvature: bool = setting(default=False, description="whether robots need the curvature of the abstract state")

    def observation(self) -> SystemObservation:
        """Return how it observes the swarm."""
        return SystemObservation(self)


@dataclass(frozen=True)
class SystemControllerConfig(OfSystem, model.ControllerConfig):
    """Configuration of the node of a parent system's controller."""

    gains: SystemGains = part(SystemGains)
    requests: Requests = part(Requests)

    def desired_states(self) -> SystemDesiredState:
        """Return what generates the desired abstract state."""
        return SystemDesiredState(self.period_ns, self.named, self.gains, requests=self.requests)


@dataclass(frozen=True)
class SystemParentConfig(OfSystem, model.ParentConfig):
    """Configuration of a simulated parent system."""

    sensor: ParentSensor = part(ParentSensor)
    torques: tuple[StepChange, ...] = same(model.ParentConfig, "torques", name="disturbances")

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        """The coordinates of a robot, with their ends."""
        return self.named.instance.robot

    def motion(self, system: NamedSystem | None = None, add: Add = exact_sum) -> SystemMotion:
        """Return the parent at its initial state, by default for robots one by one, whose terms are added."""
        return SystemMotion(self, system or self.named, add)


class SystemObservation:
    """The sums over the robots on any parent system."""

    watched: ClassVar[Topic | None] = None

    def __init__(self, config: SystemObserverConfig) -> None:
        self._system, self._curvature = config.named, config.curvature

    def observed(
        self,
        stamp: int,
        step: int,
        moving: Sequence[AnyRobotState],
        standing: Sequence[AnyRobotState],
        watched: AnyParentState | None = None,  # noqa: ARG002 - nothing of it is needed
    ) -> tuple[SwarmAbstract, SwarmAuxiliary]:
        """Return abstract and auxiliary state at a step, with a time stamp (ns)."""
        robots = cast("Sequence[RobotState]", (*moving, *standing))
        return observed(self._system, stamp, step, robots, curvature=self._curvature)

    def divided(self, stamp: int, step: int, robots: Sequence[AnyRobotState]) -> StandingState:
        """Return how the abstract state divides at a step, with a time stamp (ns)."""
        return divided(self._system, stamp, step, cast("Sequence[RobotState]", robots))


class SystemMotion:
    """The motion of any parent system under the robots."""

    def __init__(self, config: SystemParentConfig, system: NamedSystem, add: Add) -> None:
        self._config = config
        self._motion = ParentMotion(system, config.period_ns / 1e9, add)
        self._state: Vector = tuple(map(float, config.named.instance.initial))

    def advance(
        self, step: int, robots: Iterable[tuple[AnyRobotState, AnyRobotState | None]], disturbance: float
    ) -> list[SwarmEvent]:
        """Move through the period before a step; robots are given by their states at both ends, None if one stands."""
        time = (step - 1) * self._config.period_ns / 1e9
        states = cast("Iterable[tuple[RobotState, RobotState | None]]", robots)
        pairs = [(before, after or standing(before)) for before, after in states]
        self._state = self._motion.advance(time, self._state, pairs, disturbance)
        return []

    def resume(self, state: AnyParentState) -> None:
        """Continue from a state that is measured by perfect sensors."""
        self._state = cast("ParentState", state).state

    def described(self) -> Messages:
        """Return the description of the system, which is published once."""
        return (SystemDescription(0, 0, self._config.system_hash, self._config.named.description),)

    def coasted(self, state: AnyRobotState) -> RobotState:
        """Return the state of a robot one period later, without a command."""
        state = cast("RobotState", state)
        period, none = self._config.period_ns / 1e9, (0.0,) * len(state.coordinates)
        law = RobotLaw(self._config.named, Kind(state.kind), state.constants, SystemGains(), period)
        q, velocity = law.advance(state.coordinates, state.velocities, none)
        return state._replace(coordinates=q, velocities=velocity, command=none)

    def state(self, step: int) -> ParentState:
        """Return the measured state at a step."""
        config, measured = self._config, self._state
        if not config.sensor.perfect:
            names = [row.name for row in config.named.instance.parent]
            measured = config.sensor.measure_all(measured, f"{config.seed}:{step}:parent", names)
        return ParentState(step * config.period_ns, step, config.system_hash, measured)


@dataclass(frozen=True)
class SystemAgentConfig(OfSystem, model.AgentConfig):
    """Configuration of a robot on any parent system."""

    kind: Kind = setting(
        Kind.SINGLE_INTEGRATOR,
        "dynamics of the robot",
        choices=tuple(map(word, Kind)),
        make=Kind.of,
        say=word,
    )
    coordinates: tuple[float, ...] = setting((0.0,), "initial coordinates")
    velocities: tuple[float, ...] = setting((), "initial velocities; none: at rest", item=0.0)
    constants: tuple[float, ...] = setting((), "constants in the order of the system", item=0.0)
    gains: SystemGains = part(SystemGains)
    force_law: str = setting(
        "second_order",
        "law of double integrators: of second order, or the velocity law with the velocity at the end of the step",
        choices=("second_order", "velocity"),
    )
    effort: float = setting(
        inf,
        "bound of the root of sum W |q' - xi|^2 over the swarm; under second_order of accelerations, not velocities",
        above=0.0,
        unset=0.0,
    )

    def law(self) -> RobotLaw:
        """Return the law of the robot."""
        return RobotLaw(
            self.named,
            self.kind,
            self.constants,
            self.gains,
            self.period_ns / 1e9,
            second_order=self.force_law == "second_order",
            effort=self.effort,
        )

    def body(self) -> SystemRobot:
        """Return the robot at its initial state."""
        return SystemRobot(self)


class SystemRobot:
    """A robot on any parent system."""

    watched: ClassVar[Topic | None] = None

    def __init__(self, config: SystemAgentConfig) -> None:
        self._config = config
        self._period = config.period_ns / 1e9
        self._law = config.law()
        self._q = config.coordinates
        self._velocity = config.velocities or (0.0,) * len(self._q)
        self._command: Vector = (0.0,) * len(self._q)
        self._limited = False

    def state(self, step: int, broadcast_step: int, status: int) -> RobotState:
        """Return the state at a step, with the step of the broadcasts that led to it."""
        config, velocity = self._config, self._velocity
        if self._limited and status == Status.ACTIVE:
            status, velocity = Status.LIMITED, self._law.held_rate(self._q, self._command)
        return RobotState(
            step * config.period_ns,
            step,
            config.system_hash,
            broadcast_step,
            config.agent_id,
            config.kind,
            status,
            self._q,
            velocity,
            self._command,
            config.constants,
        )

    def resume(self, state: AnyRobotState) -> None:
        """Continue from a state that it would have published as a robot without a limited command."""
        state = cast("RobotState", state)
        self._q, self._velocity, self._command = state.coordinates, state.velocities, state.command
        self._limited = False

    def wait(self) -> None:
        """Set the command for a period in which no broadcasts are known."""
        self._brake()

    def _brake(self) -> None:
        self._limited = False
        self._command = self._law.brake(self._q, self._velocity, max(BRAKING_TIME, self._period))

    def decide(self, heard: AnyBroadcast, asked_to: str, step: int) -> Outcome:  # noqa: ARG002 - nothing is drawn
        """Set the command of a step from the broadcasts; brake if asked to stop or reset."""
        heard = cast("SwarmBroadcast", heard)
        held = self._law.held_rate(self._q, self._command) if self._limited else None
        rate = None if asked_to else self._law.rate(self._q, self._velocity, heard, held)
        if rate is None or not all(map(isfinite, rate)):
            self._brake()
            return Outcome(asked_to or (HELD if rate is None else NOT_FINITE), held=rate is None and not asked_to)
        wanted = self._law.command(self._q, self._velocity, rate)
        self._command = self._law.limited(wanted)
        if self._command == wanted:
            self._limited = False
            return Outcome()
        # A double integrator stays in the Gram matrix: its velocity is not limited. So does a robot that the others
        # need to control all rows: what it cannot do is then missing in all of these, and not only in the last.
        inside = not self._limited
        self._limited = not self._config.kind.by_force and self._law.dispensable(
            self._q, heard.auxiliary.gram, inside=inside
        )
        return Outcome(beyond=next(u for u, held in zip(wanted, self._command, strict=True) if u != held))

    def move(self, watched: AnyParentState | None = None) -> None:  # noqa: ARG002 - it does not act on robots
        """Move for a period under the command."""
        self._q, self._velocity = self._law.advance(self._q, self._velocity, self._command)

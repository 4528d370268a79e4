"""A robot on the plane: its configuration, and its state with the decision and the motion that change it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, cast

from swarmabs_core import model
from swarmabs_core.declaration import choice, part, same, setting
from swarmabs_core.drive import Lag
from swarmabs_core.elementary import sin
from swarmabs_core.errors import InputError
from swarmabs_core.messages import (
    PLANE_FAMILY,
    PLANE_KINDS,
    PLANE_STATE,
    AgentState,
    Family,
    Kind,
    Topic,
    word,
)
from swarmabs_core.model import FOLLOWS, Outcome
from swarmabs_core.parameters import Settings
from swarmabs_core.plant import Plane
from swarmabs_core.robot_controller import Decision, Limits, RobotController
from swarmabs_core.sensing import RobotSensor
from swarmabs_core.settings import Run
from swarmabs_core.swarm_law import LAWS, PAPER, Robot, SwarmGains

if TYPE_CHECKING:
    from swarmabs_core.drive import Drive
    from swarmabs_core.messages import AnyBroadcast, AnyParentState, AnyRobotState, Broadcast, PlaneState


@dataclass(frozen=True, slots=True)
class RobotConfig:
    """Configuration of a robot in lockstep and in real time."""

    agent_id: int = same(model.AgentConfig, "agent_id")
    kind: Kind = setting(
        PLANE_KINDS[0],
        "dynamics of the robot",
        choices=tuple(map(word, PLANE_KINDS)),
        make=Kind.of,
        say=word,
    )
    mass: float = setting(0.5, "mass", unit="kg", above=0.0)
    damping: float = setting(0.0, "viscous damping c of its motion, {unit}; may be 0", unit="N s/m", minimum=0.0)
    position: float = setting(0.0, "initial position on the plane, 0 at the axis", unit="m")
    velocity: float = setting(0.0, "initial velocity", unit="m/s")
    gravity: float = same(Plane, "gravity")
    plane_length: float = same(Plane, "length")
    gains: SwarmGains = part(SwarmGains)
    limits: Limits = part(Limits)
    law: str = choice(LAWS.find, LAWS.built_in, PAPER.name, "control law of the robots")
    law_settings: Settings = field(default_factory=dict, hash=False)

    @property
    def constants(self) -> tuple[float, float]:
        """Mass (kg) and damping (N s/m)."""
        return self.mass, self.damping

    def refuse_contradictions(self) -> None:
        """Reject settings that do not apply to the robot's kind, unless an external drive moves its body.

        Raises
        ------
        InputError
            If a single integrator has damping or an initial velocity.
        """
        if not self.kind.by_force:
            for name, value in (("damping", self.damping), ("velocity", self.velocity)):
                if value:
                    raise InputError(f"parameter {name}: not applicable to a single integrator", "omit it")


@dataclass(frozen=True)
class AgentConfig(RobotConfig, model.AgentConfig):
    """Configuration of a robot in lockstep."""

    feels_gravity: bool = same(Plane, "robot_gravity")
    sensor: RobotSensor = part(RobotSensor)
    actuator_lag: float = same(Run, "actuator_lag")

    family: ClassVar[Family] = PLANE_FAMILY

    def body(self, drive: Drive | None = None) -> PlaneRobot:
        """Return the robot at its initial state, by default with the ideal drive of its kind."""
        return PlaneRobot(self, drive)


class PlaneRobot:
    """A robot on the plane.

    Attributes
    ----------
    watched : Topic or None
        The plane's state, if its motion acts on the robot.

    Raises
    ------
    InputError
        If there is no such law, or its settings are invalid.
    """

    def __init__(self, config: AgentConfig, drive: Drive | None) -> None:
        self._config = config
        period = config.period_ns / 1e9
        robot = Robot(config.kind, config.mass, config.damping, config.gains, config.gravity, period)
        length = config.plane_length
        self._controller = RobotController(robot, config.law, config.law_settings, config.limits, length)
        self._drive = drive or self._controller.ideal
        self._position, self._velocity = config.position, config.velocity
        self._command = 0.0
        self._sensor = None if config.sensor.perfect else config.sensor
        self._lag = Lag.of(config.kind, config.actuator_lag, period, config.mass, config.damping)
        self._actual = 0.0  # output of a drive with lag
        self.watched: Topic | None = None
        if config.feels_gravity and config.kind.by_force:
            self.watched = PLANE_STATE

    def state(self, step: int, broadcast_step: int, status: int) -> AgentState:
        """Return the state at a step, with the step of the broadcasts that led to it."""
        config = self._config
        return AgentState(
            step * config.period_ns,
            step,
            broadcast_step,
            config.agent_id,
            config.kind,
            status,
            config.mass,
            config.damping,
            self._position,
            self._velocity,
            self._command,
        )

    def resume(self, state: AnyRobotState) -> None:
        """Continue from a state that it would have published, with perfect sensors and without lag."""
        state = cast("AgentState", state)
        self._position, self._velocity, self._command = state.position, state.velocity, state.command

    def wait(self) -> None:
        """Set the command for a period in which no broadcasts are known."""
        self._command = 0.0

    def decide(self, heard: AnyBroadcast, asked_to: str, step: int) -> Outcome:
        """Set the command of a step from the broadcasts; brake if asked to stop or reset."""
        heard = cast("Broadcast", heard)
        position, velocity = self._sensed(step)
        if asked_to:
            decision = Decision(self._controller.brake(velocity), 0.0, asked_to)
        else:
            decision = self._controller.decide(position, velocity, heard)
        self._command = decision.command
        if decision.problem:
            return Outcome(decision.problem, held=decision.held)
        return FOLLOWS if decision.command == decision.wanted else Outcome(beyond=decision.wanted)

    def move(self, watched: AnyParentState | None) -> None:
        """Move for a period under the command and, if configured, gravity."""
        force = self._command
        if watched is not None:
            force += self._weight(cast("PlaneState", watched))
        self._position, self._velocity = self._drive.advance(self._position, self._velocity, force)
        if self._lag is not None:
            gap = self._actual - self._command
            self._position += self._lag.gap_to_position * gap
            self._velocity += self._lag.gap_to_velocity * gap
            self._actual = self._command + self._lag.decay * gap

    def _sensed(self, step: int) -> tuple[float, float]:
        """Return the position (m) and velocity (m/s) that the robot measures."""
        if self._sensor is None:
            return self._position, self._velocity
        draw = f"{self._config.seed}:{step}:{self._config.agent_id}"
        return self._sensor.measure(self._position, self._velocity, draw)

    def _weight(self, plane: PlaneState) -> float:
        """Return the force of gravity and rotation along the plane (N), held over the period."""
        config, w = self._config, plane.angular_velocity
        return config.mass * (self._position * w * w - config.gravity * sin(plane.angle))

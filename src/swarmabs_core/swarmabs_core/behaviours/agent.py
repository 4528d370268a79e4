"""A robot: its own state and the three broadcasts in, its own command and next state out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import sin
from typing import TYPE_CHECKING

from swarmabs_core.behaviours.base import Run, UnexpectedMessageError, refuse_conflict
from swarmabs_core.behaviours.reception import Reception, Transmission
from swarmabs_core.declaration import choice, part, same, setting
from swarmabs_core.drive import Lag
from swarmabs_core.errors import InputError
from swarmabs_core.faults import InjectedFault, RobotFaults
from swarmabs_core.membership import UNPLANNED, ChangeKind
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AUXILIARY_STATE,
    BROADCAST,
    DESIRED_ABSTRACT_STATE,
    NEVER,
    PLANE_STATE,
    STEERING,
    TOPIC_OF,
    AbstractState,
    Action,
    AgentState,
    AuxiliaryState,
    Broadcast,
    DesiredAbstractState,
    EventKind,
    Kind,
    Message,
    Messages,
    Mode,
    PlaneState,
    Status,
    Steering,
    SwarmEvent,
    Topic,
)
from swarmabs_core.parameters import Settings
from swarmabs_core.plant import Plane
from swarmabs_core.robot_controller import COMMAND_LIMITED, RESET, STOPPED, Decision, Limits, RobotController
from swarmabs_core.sensing import RobotSensor
from swarmabs_core.swarm_law import LAWS, PAPER, Robot, SwarmGains

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_core.drive import Drive


@dataclass(frozen=True, slots=True)
class LifeSpan:
    """The steps in which a robot takes part, and its planned end, if any."""

    first_step: int = setting(0, "step at which the robot joins", minimum=0)
    end: ChangeKind | None = setting(
        None,
        "planned end of the robot",
        choices=("none", *(kind.value for kind in ChangeKind if kind is not ChangeKind.JOIN)),
        unset="none",
        make=ChangeKind,
        say=lambda kind: kind.value,
    )
    end_step: int | None = setting(None, "step of the planned end", unset=-1)


@dataclass(frozen=True, slots=True)
class RobotConfig:
    """Configuration of a robot in lockstep and in real time."""

    agent_id: int = setting(1, "id of the robot, 1 to 65535", minimum=1, maximum=65535)
    kind: Kind = setting(
        Kind.SINGLE_INTEGRATOR,
        "dynamics of the robot",
        choices=tuple(kind.name.lower() for kind in Kind),
        make=lambda name: Kind[name.upper()],
        say=lambda kind: kind.name.lower(),
    )
    mass: float = setting(0.5, "mass, kg", above=0.0)
    damping: float = setting(0.0, "viscous damping c of its motion, N s/m; may be 0", minimum=0.0)
    position: float = setting(0.0, "initial position on the plane, 0 at the axis, m")
    velocity: float = setting(0.0, "initial velocity, m/s")
    gravity: float = same(Plane, "gravity")
    plane_length: float = same(Plane, "length")
    gains: SwarmGains = part(SwarmGains)
    limits: Limits = part(Limits)
    law: str = choice(LAWS.find, LAWS.built_in, PAPER.name, "control law of the robots")
    law_settings: Settings = field(default_factory=dict, hash=False)

    def refuse_contradictions(self) -> None:
        """Reject settings that do not apply to the robot's kind, unless an external drive moves its body.

        Raises
        ------
        InputError
            If a single integrator has damping or an initial velocity.
        """
        if self.kind is Kind.SINGLE_INTEGRATOR:
            for name, value in (("damping", self.damping), ("velocity", self.velocity)):
                if value:
                    raise InputError(f"parameter {name}: not applicable to a single integrator; omit it")


@dataclass(frozen=True, slots=True)
class AgentConfig(RobotConfig):
    """Configuration of a robot in lockstep."""

    period_ns: int = same(Run, "period_ns")
    life: LifeSpan = part(LifeSpan, name="")
    faults: tuple[InjectedFault, ...] = setting(
        (), "injected faults, each 'KIND FIRST END VALUE...', such as 'loss 0 -1 0.2'", make=InjectedFault.parse
    )
    seed: int = same(Run, "seed")
    feels_gravity: bool = same(Plane, "robot_gravity")
    last_step: int | None = same(Run, "last_step")
    sensor: RobotSensor = part(RobotSensor)
    actuator_lag: float = same(Run, "actuator_lag")


class Agent:
    """One robot of the swarm. It has no knowledge of other robots.

    Parameters
    ----------
    drive : Drive, optional
        Drive of the robot; the default is the ideal drive of its kind.
    packed : bool
        Whether it receives the three broadcasts of a step as one message, which wakes it less often.
    steered : bool
        Whether the run is steered; if so, a robot without a planned join waits for the order that adds it.

    Attributes
    ----------
    needs : tuple of Topic
        The topics to which the robot subscribes.

    Raises
    ------
    InputError
        If there is no such law, or its settings are invalid.
    """

    def __init__(
        self, config: AgentConfig, drive: Drive | None = None, *, packed: bool = False, steered: bool = False
    ) -> None:
        self._config = config
        period = config.period_ns / 1e9
        robot = Robot(config.kind, config.mass, config.damping, config.gains, config.gravity, period)
        length = config.plane_length
        self._controller = RobotController(robot, config.law, config.law_settings, config.limits, length)
        self._drive = drive or self._controller.ideal
        # The message expected last is awaited first; the others have usually arrived by then.
        apart = (DESIRED_ABSTRACT_STATE, ABSTRACT_STATE, AUXILIARY_STATE)
        self._topics: tuple[Topic, ...] = (BROADCAST,) if packed else apart
        if config.feels_gravity and config.kind is Kind.DOUBLE_INTEGRATOR:
            self._topics = (*self._topics, PLANE_STATE)
        self._absent = steered and config.life.first_step == UNPLANNED
        self.needs = (STEERING, *self._topics) if self._absent else self._topics
        self._begin(config.life.first_step)
        self._heard: dict[Topic, Message] = {}
        self._faults = RobotFaults(config.faults, config.seed, config.agent_id) if config.faults else None
        self._reception, self._transmission = Reception(self._faults), Transmission(self._faults)
        self._ended = False
        self._position, self._velocity = config.position, config.velocity
        self._command = 0.0
        self._sensor = None if config.sensor.perfect else config.sensor
        self._lag = Lag.of(config.kind, config.actuator_lag, period, config.mass, config.damping)
        self._actual = 0.0  # output of a drive with lag
        self._broadcast_step = NEVER
        self._status = Status.ACTIVE
        self._limited = False

    def _begin(self, first_step: int) -> None:
        self._joined = first_step == 0
        self._step = (
            first_step if self._joined else first_step - 1
        )  # a robot that joins waits for the step before its first

    def start(self) -> Messages:
        """Publish the initial state, unless the robot joins later."""
        return self._transmission.published((self._state(),)) if self._joined else ()

    def handle(self, message: Message) -> Messages:
        """Take a broadcast; return the robot's next state when the broadcasts of the step are complete."""
        topic = TOPIC_OF[type(message)]
        if topic not in self.needs:
            raise UnexpectedMessageError(f"agent {self._config.agent_id}", message)
        if isinstance(message, Steering):
            self._steer(message)
            return ()
        answers = self._hear(topic, message)
        if self._faults is not None and self._faults.double(message.step, "heard"):
            answers = (*answers, *self._hear(topic, message))
        return answers

    def _steer(self, order: Steering) -> None:
        """Join if the order adds this robot."""
        if self._absent and order.action == Action.ADD and order.agent_id == self._config.agent_id:
            self._absent = False
            self._config = replace(self._config, life=LifeSpan(order.step))
            self._begin(order.step)

    def _hear(self, topic: Topic, message: Message) -> Messages:
        if self._absent or self._ended or message.step != self._step:
            return ()
        refuse_conflict(self._heard.setdefault(topic, message), message, topic.name)
        return self._transmission.published(self._advance()) if len(self._heard) == len(self._topics) else ()

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the missing broadcast that is expected last, or for orders while the robot is absent."""
        if self._absent:
            return (STEERING,)
        if self._ended:
            return ()
        return next(((topic,) for topic in self._topics if topic not in self._heard), ())

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the missing topics; none while the robot is absent."""
        if self._absent:
            return UNPLANNED, ()
        return self._step, tuple(topic.name for topic in self._topics if topic not in self._heard)

    def _state(self) -> AgentState:
        config = self._config
        leaves = config.life.end is ChangeKind.LEAVE and config.life.end_step == self._step
        return AgentState(
            self._step * config.period_ns,
            self._step,
            self._broadcast_step,
            config.agent_id,
            config.kind,
            Status.LEFT if leaves else self._status,
            config.mass,
            config.damping,
            self._position,
            self._velocity,
            self._command,
        )

    def _advance(self) -> Messages:
        """Compute the command of the step, move for a period and return the state at its end."""
        config, heard = self._config, self._heard
        if self._step == config.last_step or (self._joined and self._step == config.life.end_step):
            self._ended = True
            return ()
        self._heard = {}
        if not self._joined:
            self._joined = True
            self._step += 1
            return (self._state(),)
        events = self._decide() if self._reception.send(self._step, self._broadcast(heard)) else ()
        self._move(heard.get(PLANE_STATE))
        self._step += 1
        return (*events, self._state())

    def _broadcast(self, heard: dict[Topic, Message]) -> Broadcast:
        """Return the three broadcasts of the current step."""
        if packed := heard.get(BROADCAST):
            assert isinstance(packed, Broadcast)  # noqa: S101 - kept by topic
            return packed
        abstract, sums, desired = heard[ABSTRACT_STATE], heard[AUXILIARY_STATE], heard[DESIRED_ABSTRACT_STATE]
        assert isinstance(abstract, AbstractState)  # noqa: S101 - the three are kept by topic
        assert isinstance(sums, AuxiliaryState)  # noqa: S101
        assert isinstance(desired, DesiredAbstractState)  # noqa: S101
        return Broadcast(desired.stamp, self._step, abstract, sums, desired)

    def _move(self, plane: Message | None) -> None:
        """Move for a period under the command and, if configured, gravity."""
        force = self._command
        if plane is not None:
            force += self._weight(plane)
        self._position, self._velocity = self._drive.advance(self._position, self._velocity, force)
        if self._lag is not None:
            gap = self._actual - self._command
            self._position += self._lag.gap_to_position * gap
            self._velocity += self._lag.gap_to_velocity * gap
            self._actual = self._command + self._lag.decay * gap

    def _sensed(self) -> tuple[float, float]:
        """Return the position (m) and velocity (m/s) that the robot measures."""
        if self._sensor is None:
            return self._position, self._velocity
        draw = f"{self._config.seed}:{self._step}:{self._config.agent_id}"
        return self._sensor.measure(self._position, self._velocity, draw)

    def _weight(self, plane: Message) -> float:
        """Return the force of gravity and rotation along the plane (N), held over the period."""
        assert isinstance(plane, PlaneState)  # noqa: S101 - kept by topic
        config, w = self._config, plane.angular_velocity
        return config.mass * (self._position * w * w - config.gravity * sin(plane.angle))

    def _decide(self) -> Messages:
        """Update command, broadcast step and status; return the events."""
        heard = self._reception.newest
        if heard is None:
            self._command, self._broadcast_step = 0.0, NEVER
            return ()
        position, velocity = self._sensed()
        asked_to = STOPPED if self._reception.stopped else RESET if heard.desired.mode != Mode.RUN else ""
        if asked_to:
            decision = Decision(self._controller.brake(velocity), 0.0, asked_to)
        else:
            decision = self._controller.decide(position, velocity, heard)
        self._command = decision.command
        if decision.problem:
            self._broadcast_step = NEVER
            return self._set_status(Status.SAFE_STOP, EventKind.SAFE_STOP, decision.problem)
        self._broadcast_step = heard.step
        events = self._set_status(Status.ACTIVE, EventKind.RECOVERED, "")
        before, self._limited = self._limited, decision.command != decision.wanted
        if self._limited and not before:
            events = (*events, self._event(EventKind.LIMIT_HIT, decision.wanted, COMMAND_LIMITED))
        return events

    def _set_status(self, status: Status, kind: EventKind, detail: str) -> Messages:
        if status is self._status:
            return ()
        self._status = status
        return (self._event(kind, 0.0, detail),)

    def _event(self, kind: EventKind, value: float, detail: str) -> SwarmEvent:
        """Return an event that holds from the next published state on."""
        step = self._step + 1
        return SwarmEvent(step * self._config.period_ns, step, self._config.agent_id, kind, value, detail)


class AgentGroup:
    """Several robots in one process, for swarms with too many robots for one process each.

    They share only their subscriptions: each is a separate state machine that receives nothing but the broadcasts.

    Attributes
    ----------
    needs : tuple of Topic
        The topics to which the robots subscribe.
    """

    def __init__(self, configs: Sequence[AgentConfig], *, packed: bool = False, steered: bool = False) -> None:
        self._agents = [Agent(config, packed=packed, steered=steered) for config in configs]
        self.needs = tuple(dict.fromkeys(topic for agent in self._agents for topic in agent.needs))
        self._listeners = {topic: [a for a in self._agents if topic in a.needs] for topic in self.needs}

    def start(self) -> Messages:
        """Publish the initial states of the robots that take part from the start."""
        return tuple(message for agent in self._agents for message in agent.start())

    def handle(self, message: Message) -> Messages:
        """Pass a broadcast to every robot; return their next states when the broadcasts of the step are complete."""
        listeners = self._listeners[TOPIC_OF[type(message)]]
        return tuple(answer for agent in listeners for answer in agent.handle(message))

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for all topics that any robot waits for; empty when all have finished."""
        return tuple(dict.fromkeys(topic for agent in self._agents for topic in agent.awaits()))

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the earliest step in which a robot waits, and what it waits for."""
        return min((agent.missing() for agent in self._agents if agent.awaits()), default=self._agents[0].missing())

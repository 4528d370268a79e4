"""A robot: its own state and the three broadcasts in, its own command and next state out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, cast

from swarmabs_core.behaviours.base import (
    Behaviour,
    UnexpectedMessageError,
    packed_broadcasts,
    refuse_conflict,
    refuse_other_system,
)
from swarmabs_core.behaviours.reception import Reception, Transmission
from swarmabs_core.errors import InStep
from swarmabs_core.events import EventCode
from swarmabs_core.faults import RobotFaults
from swarmabs_core.membership import UNPLANNED, ChangeKind
from swarmabs_core.messages import (
    NEVER,
    STEERING,
    TOPIC_OF,
    Action,
    AnyBroadcast,
    AnyParentState,
    AnyRobotState,
    Message,
    Messages,
    Mode,
    Status,
    Steering,
    SwarmEvent,
    Topic,
    topic_of,
)
from swarmabs_core.robot_controller import RESET, STOPPED
from swarmabs_core.settings import LifeSpan

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_core.model import AgentConfig, Body


class Robot(Behaviour, Protocol):
    """A robot as a state machine, with the topics to which it subscribes."""

    @property
    def needs(self) -> tuple[Topic, ...]:
        """The topics."""
        ...


UNLIMITED_NS = 500_000_000
"""Time without a limited command, ns, after which limits are reported as over: one event each, however it dithers."""


class Agent:
    """One robot of the swarm. It has no knowledge of other robots.

    Parameters
    ----------
    config : AgentConfig
        Configuration, which determines the parent system.
    body : Body, optional
        The robot itself; by default the configured one.
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
        self,
        config: AgentConfig,
        body: Body | None = None,
        *,
        packed: bool = False,
        steered: bool = False,
    ) -> None:
        self._config = config
        self._life = config.life
        self._system = config.system_hash
        self._body: Body = body or config.body()
        family = config.family
        # The message expected last is awaited first; the others have usually arrived by then.
        apart = (family.desired, family.abstract, family.auxiliary)
        self._topics: tuple[Topic, ...] = (family.packed,) if packed else apart
        if (watched := self._body.watched) is not None:
            self._topics = (*self._topics, watched)
        self._absent = steered and config.life.first_step == UNPLANNED
        self.needs = (STEERING, *self._topics) if self._absent else self._topics
        self._begin(config.life.first_step)
        self._heard: dict[Topic, Message] = {}
        self._faults = RobotFaults(config.faults, config.seed, config.agent_id) if config.faults else None
        self._reception: Reception = Reception(self._faults)
        self._transmission = Transmission(self._faults)
        self._ended = False
        self._broadcast_step = NEVER
        self._status = Status.ACTIVE
        self._held = False
        self._limited_at: int | None = None

    def _begin(self, first_step: int) -> None:
        self._joined = first_step == 0
        self._step = (
            first_step if self._joined else first_step - 1
        )  # a robot that joins waits for the step before its first

    def start(self) -> Messages:
        """Publish the initial state, unless the robot joins later."""
        return self._transmission.published((self._state(),)) if self._joined else ()

    def resume(self, state: AnyRobotState) -> None:
        """Continue on the plane from a state that it would have published, without faults, as an active robot."""
        self._heard = {}
        self._step, self._broadcast_step = state.step, state.broadcast_step
        self._status, self._held, self._limited_at = Status.ACTIVE, False, None
        self._body.resume(state)

    def handle(self, message: Message) -> Messages:
        """Take a broadcast; return the robot's next state when the broadcasts of the step are complete."""
        topic = TOPIC_OF[type(message)]
        if topic not in self.needs:
            raise UnexpectedMessageError(f"agent {self._config.agent_id}", message)
        refuse_other_system(message, self._system)
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
            self._life = LifeSpan(order.step)
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
        for topic in self._topics:
            if topic not in self._heard:
                return (topic,)
        return ()

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the missing topics; none while the robot is absent."""
        if self._absent:
            return UNPLANNED, ()
        return self._step, tuple(topic.name for topic in self._topics if topic not in self._heard)

    def _state(self) -> AnyRobotState:
        life = self._life
        leaves = life.end is ChangeKind.LEAVE and life.end_step == self._step
        status = Status.LEFT if leaves else self._status
        return self._body.state(self._step, self._broadcast_step, status)

    def _advance(self) -> Messages:
        """Compute the command of the step, move for a period and return the state at its end."""
        config, heard = self._config, self._heard
        if self._step == config.last_step or (self._joined and self._step == self._life.end_step):
            self._ended = True
            return ()
        self._heard = {}
        if not self._joined:
            self._joined = True
            self._step += 1
            return (self._state(),)
        with InStep(self._step):
            events = self._decide() if self._reception.send(self._step, self._broadcast(heard)) else ()
            if self._faults is None or not any(fault.sticks() for fault in self._faults.acting(self._step)):
                self._body.move(self._watched(heard))
        self._step += 1
        return (*events, self._state())

    def _broadcast(self, heard: dict[Topic, Message]) -> AnyBroadcast:
        """Return the three broadcasts of the current step."""
        family = self._config.family
        return cast("AnyBroadcast", heard.get(family.packed) or packed_broadcasts(family, heard.__getitem__))

    def _watched(self, heard: dict[Topic, Message]) -> AnyParentState | None:
        """Return the state of the parent, if it acts on the robot."""
        topic = self._body.watched
        return None if topic is None else cast("AnyParentState", heard[topic])

    def _decide(self) -> Messages:
        """Update command, broadcast step and status; return the events."""
        heard = self._reception.newest
        if heard is None:
            self._body.wait()
            self._broadcast_step = NEVER
            return ()
        asked_to = STOPPED if self._reception.stopped else RESET if heard.desired.mode != Mode.RUN else ""
        outcome = self._body.decide(heard, asked_to, self._step)
        if outcome.held:  # it stays active, so that the sums of the next step allow for it
            self._broadcast_step, self._status = NEVER, Status.ACTIVE
            events = () if self._held else (self._event(EventCode.HELD, detail=outcome.problem),)
            self._held = True
            return events
        if outcome.problem:
            self._broadcast_step = NEVER
            before, self._status, self._held = self._status, Status.SAFE_STOP, False
            changed = before is not Status.SAFE_STOP
            return (self._event(EventCode.SAFE_STOP, detail=outcome.problem),) if changed else ()
        self._broadcast_step = heard.step
        recovered = self._held or self._status is not Status.ACTIVE
        self._status, self._held = Status.ACTIVE, False
        events = (self._event(EventCode.RECOVERED),) if recovered else ()
        return (*events, *self._note_limit(outcome.beyond))

    def _note_limit(self, beyond: float | None) -> Messages:
        """Report that a limit begins to act on the command, and that it has not acted for a while."""
        if beyond is not None:
            before, self._limited_at = self._limited_at, self._step
            return () if before is not None else (self._event(EventCode.COMMAND_LIMITED, beyond),)
        if self._limited_at is None or (self._step - self._limited_at) * self._config.period_ns < UNLIMITED_NS:
            return ()
        self._limited_at = None
        return (self._event(EventCode.WITHIN_LIMITS),)

    def _event(self, code: EventCode, value: float = 0.0, detail: str = "") -> SwarmEvent:
        """Return an event that holds from the next published state on."""
        step = self._step + 1
        return code.event(step * self._config.period_ns, step, value, robot=self._config.agent_id, detail=detail)


class AgentGroup:
    """Several robots in one process, for swarms with too many robots for one process each.

    They share only their subscriptions: each is a separate state machine that receives nothing but what it needs.

    Attributes
    ----------
    needs : tuple of Topic
        The topics to which the robots subscribe.
    """

    def __init__(self, robots: Sequence[Robot]) -> None:
        self._agents = robots
        self.needs = tuple(dict.fromkeys(topic for agent in self._agents for topic in agent.needs))
        self._listeners = {topic: [a for a in self._agents if topic in a.needs] for topic in self.needs}

    def start(self) -> Messages:
        """Publish the initial states of the robots that take part from the start."""
        return tuple(message for agent in self._agents for message in agent.start())

    def handle(self, message: Message) -> Messages:
        """Pass a broadcast to every robot; return their next states when the broadcasts of the step are complete."""
        listeners = self._listeners[topic_of(message)]
        return tuple(answer for agent in listeners for answer in agent.handle(message))

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for all topics that any robot waits for; empty when all have finished."""
        return tuple(dict.fromkeys(topic for agent in self._agents for topic in agent.awaits()))

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the earliest step in which a robot waits, and what it waits for."""
        return min((agent.missing() for agent in self._agents if agent.awaits()), default=self._agents[0].missing())

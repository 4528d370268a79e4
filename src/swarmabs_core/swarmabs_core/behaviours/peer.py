"""A robot that sums up and controls the swarm by itself, from what its neighbours pass on: no observer, no controller.

It hosts the state machines of observer, parent controller and robot, and passes messages between them. Robots exchange
what they know of a step in rounds. A robot sends the message of a round once it has those of the round before from all
neighbours, so rounds are the clock of the network: a lost message costs its content, not its round. In a step it stops
once it knows all, and all its neighbours do; only then it goes on to the next step. Which messages it sends therefore
depends on nothing but the links, and every robot's messages of a step end with one that says so.

A step opens at a robot that hears the parent with the parent's state, which exists once all robots have moved on to the
step; at other robots with the first message of the step that a neighbour sends.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.behaviours.agent import Agent, AgentGroup
from swarmabs_core.behaviours.base import UnexpectedMessageError, refuse_conflict, refuse_other_system
from swarmabs_core.behaviours.controller import Controller
from swarmabs_core.behaviours.observer import Observer
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    PARENT_STATES,
    RECORDER_NODE,
    RECORDING_PROGRESS,
    ROBOT_STATES,
    STANDING,
    STEERING,
    TOPIC_OF,
    AnyParentState,
    AnyRobotState,
    Message,
    Messages,
    RecordingProgress,
    Relay,
    Steering,
    Topic,
    relay_topic,
)
from swarmabs_core.relays import Content, reduced

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_core.links import Links
    from swarmabs_core.model import AgentConfig, ControllerConfig, ObserverConfig

_COPIES = 16
"""Neighbours from which a robot hears a state in a round, if it has so many: fewer lose more of it, more cost more."""


class Peer:
    """A robot with observer and parent controller of its own.

    Parameters
    ----------
    observer, controller, agent : ObserverConfig, ControllerConfig, AgentConfig
        Configurations of what it hosts.
    links : Links
        Who hears whom.
    steered : bool
        As for `Agent`.

    Attributes
    ----------
    agent_id : int
        Its id.
    neighbours : tuple of int
        The robots that it hears.
    needs : tuple of Topic
        The topics to which it subscribes.
    """

    def __init__(
        self,
        observer: ObserverConfig,
        controller: ControllerConfig,
        agent: AgentConfig,
        links: Links,
        *,
        steered: bool = False,
    ) -> None:
        self.agent_id, self._system = agent.agent_id, agent.system_hash
        self._period_ns, self._last_step, self._family = agent.period_ns, agent.last_step, agent.family
        self._observer, self._controller = Observer(observer), Controller(controller)
        self._agent = Agent(agent, steered=steered)
        self._watching = self._observer.awaits()[1:]
        self._links, self._senses = links, links.senses(self.agent_id)
        self._content = Content(observer.members, self._family)
        self.neighbours = links.of(self.agent_id)
        parent = (self._family.parent,) if self._senses else ()
        self.needs = (*parent, *map(relay_topic, self.neighbours), RECORDING_PROGRESS)
        self._parents: dict[int, AnyParentState] = {}
        self._inbox: dict[tuple[int, int], dict[int, Relay]] = {}
        self._own: AnyRobotState | None = None
        self._states: dict[int, AnyRobotState] = {}
        self._step = -1
        self._over = False
        self._begin(0)

    def _begin(self, step: int) -> None:
        """Forget the step before but for its states, whose constants still hold."""
        self._before, self._states = self._states, {}
        self._step, self._round, self._sent = step, 0, False
        self._open = False
        self._known = 0
        self._parent: AnyParentState | None = None
        spans = self._observer.membership
        self._near = tuple(robot for robot in self.neighbours if spans.lasts(robot, step))
        self._theirs = dict.fromkeys(self._near, 0)
        self._complete_near: set[int] = set()
        self._ended_near: set[int] = set()
        self._silent = False
        if spans.changes(step + 1):
            self._refuse_gaps(step + 1, [robot for robot in spans if spans.lasts(robot, step + 1)])

    def _refuse_gaps(self, step: int, relaying: list[int]) -> None:
        """Raise `RunError` if the robots that are left in a step do not all hear each other and the parent."""
        if apart := self._links.apart(relaying):
            raise RunError(
                f"step {step}: robot {apart[0]} is cut off from robot {relaying[0]} by the end of other robots; "
                "use more links"
            )
        if not any(self._links.senses(robot) for robot in relaying):
            raise RunError(f"step {step}: no robot is left that hears the parent; see links.sensing")

    def start(self) -> Messages:
        """Publish the initial state of the robot."""
        return self._act(self._agent.start())

    def handle(self, message: Message) -> Messages:
        """Take a relay of a neighbour, the parent's state, or the recorder's progress; return what is published.

        The first of the robots that publish a state in a step and in the next one also publishes the broadcasts.
        """
        refuse_other_system(message, self._system)
        if isinstance(message, RecordingProgress):
            return (*self._share(self._controller.handle(message)), *self._proceed())
        if isinstance(message, PARENT_STATES):
            if message.step >= self._step:
                refuse_conflict(self._parents.setdefault(message.step, message), message, self._family.parent.name)
        elif isinstance(message, Relay):
            if (message.step, message.round) >= (self._step, self._round):
                turn = self._inbox.setdefault((message.step, message.round), {})
                refuse_conflict(turn.setdefault(message.agent_id, message), message, f"robot {message.agent_id}")
        else:
            raise UnexpectedMessageError(f"robot {self.agent_id}", message)
        return self._proceed()

    def steer(self, order: Steering) -> None:
        """Apply an order in all that it hosts."""
        self._observer.steer(order)
        self._controller.steer(order)
        if STEERING in self._agent.needs:
            self._agent.handle(order)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for neighbours and, if it hears it, the parent; and for the recorder if it is too far behind."""
        return () if self._over else self.needs

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the nodes from which a message is missing."""
        if self._held_back:
            return self._step, (RECORDER_NODE,)
        if waiting := self._waiting():
            return self._step, tuple(f"agent {robot}" for robot in waiting)
        return self._step, (self._family.node,)

    @property
    def _held_back(self) -> bool:
        """Whether it knows all of the step, but its controller waits for the recorder."""
        return self._complete and self._controller.awaits() == (RECORDING_PROGRESS,)

    @property
    def _complete(self) -> bool:
        """Whether it knows all states of the step."""
        return self._parent is not None and len(self._states) == len(self._observer.membership.publishing(self._step))

    def _waiting(self) -> tuple[int, ...]:
        """Return the neighbours whose messages of the round are missing."""
        if not self._open or not self._sent or self._silent:
            return ()
        come = self._inbox.get((self._step, self._round), {})
        return tuple(robot for robot in self._near if robot not in come and robot not in self._ended_near)

    def _opens(self, step: int) -> bool:
        """Return whether a step has begun for this robot."""
        return step in self._parents if self._senses else any(begun == step for begun, _ in self._inbox)

    def _proceed(self) -> Messages:
        """Go on through rounds and steps as far as possible."""
        published: list[Message] = []
        while not self._over and (answers := self._advance()) is not None:
            published += answers
        return tuple(published)

    def _advance(self) -> Messages | None:
        """Do the next thing, and return what is published; None if a message is awaited."""
        if not self._open:
            return self._enter() if self._opens(self._step) else None
        if self._silent:
            if self._opens(self._step + 1):
                self._leave_behind()
                return ()
            self._over = self._step == self._last_step and not self._controller.awaits()
            return None
        if not self._sent:
            return (self._send(),)
        come = len(self._inbox.get((self._step, self._round), ()))
        return None if come < len(self._near) - len(self._ended_near) else self._hear()

    def _leave_behind(self) -> None:
        """Go on to the next step, if there is one for this robot."""
        if self._observer.membership.lasts(self.agent_id, self._step + 1):
            self._begin(self._step + 1)
        else:
            self._over = True
        self._parents = {step: state for step, state in self._parents.items() if step >= self._step}
        self._inbox = {turn: relays for turn, relays in self._inbox.items() if turn >= (self._step, 0)}

    def _enter(self) -> Messages:
        """Begin the rounds of a step with what this robot knows by itself."""
        self._open = True
        published: Messages = ()
        if self._own is not None and self._own.step == self._step:
            published = self._learn(self._own)
        if (parent := self._parents.get(self._step)) is not None:
            published = (*published, *self._measure(parent))
        return published

    def _send(self) -> Relay:
        """Return the message of the round: what neighbours are not known to have."""
        everywhere = -1
        for held in self._theirs.values():
            everywhere &= held
        wanted = self._known & ~everywhere
        states = [self._states[robot] for robot in self._shared(self._content.robots_in(wanted))]
        told = all(self._links.senses(robot) or robot in self._complete_near for robot in self._near)
        complete = self._complete
        self._silent = complete and self._complete_near.issuperset(self._near)
        self._sent = True
        content = self._content.written(self._known, states, None if told else self._parent, self._before)
        stamp = self._step * self._period_ns
        return Relay(stamp, self._step, self.agent_id, self._round, int(complete), int(self._silent), content)

    def _shared(self, robots: tuple[int, ...]) -> tuple[int, ...]:
        """Return those of the robots whose states it passes on in the round.

        Where many hear each other, a robot leaves most states to others, so that everybody still hears each of them
        from `_COPIES` neighbours; by turns it passes on all.
        """
        near = len(self._near)
        if near <= _COPIES:
            return robots
        if not self._round:
            return tuple(robot for robot in robots if robot == self.agent_id)
        return tuple(robot for robot in robots if (robot + self.agent_id + self._round) % near < _COPIES)

    def _hear(self) -> Messages:
        """Take what the neighbours have sent in the round."""
        published: list[Message] = []
        for robot, relay in sorted(self._inbox.pop((self._step, self._round), {}).items()):
            if robot not in self._theirs:
                continue
            if relay.complete:
                self._complete_near.add(robot)
            if relay.last:
                self._ended_near.add(robot)
            if self._links.loses(self._step, self._round, robot, self.agent_id):
                continue
            told = self._content.read(relay, self._before, self._known)
            self._theirs[robot] |= told.held
            for state in told.states:
                published += self._learn(state)
            if told.parent is not None:
                published += self._measure(told.parent)
        self._round, self._sent = self._round + 1, False
        return tuple(published)

    def _learn(self, state: AnyRobotState) -> Messages:
        """Take a robot's state of the step."""
        robot = state.agent_id
        if robot in self._states or not self._observer.membership.publishes(robot, self._step):
            return ()
        self._states[robot] = state
        self._known |= self._content.set_of((robot,))
        return self._host(state)

    def _measure(self, parent: AnyParentState) -> Messages:
        """Take the parent's state of the step."""
        if self._parent is not None:
            return ()
        self._parent = parent
        return self._host(parent)

    def _host(self, message: AnyRobotState | AnyParentState) -> Messages:
        """Give the hosted machines a state; return what is published."""
        topic = TOPIC_OF[type(message)]
        published: list[Message] = []
        if topic is self._family.robot or topic in self._watching:
            published += self._share(self._observer.handle(message))
        if topic is self._family.parent:
            published += self._share(self._controller.handle(message))
        if topic in self._agent.needs:
            published += self._act(self._agent.handle(message))
        return tuple(published)

    def _share(self, messages: Messages) -> Messages:
        """Pass on what observer and controller say; return what is published, if this robot speaks for all."""
        published = list(messages) if self._speaks() else []
        for message in messages:
            topic = TOPIC_OF[type(message)]
            if topic is STANDING:
                published += self._share(self._controller.handle(message))
            elif topic in self._agent.needs:
                published += self._act(self._agent.handle(message))
        return tuple(published)

    def _act(self, messages: Messages) -> Messages:
        """Keep the robot's own state for the others; return what the robot says."""
        for message in messages:
            if isinstance(message, ROBOT_STATES):
                self._own = reduced(message)
        return messages

    def _speaks(self) -> bool:
        """Return whether this robot publishes what all of them compute in the step."""
        membership, step = self._observer.membership, self._step
        publishing = membership.publishing(step)
        going_on = (robot for robot in publishing if membership.publishes(robot, step + 1))
        return self.agent_id == next(going_on, publishing[0])


class PeerGroup(AgentGroup):
    """Several of them in one process: they hear each other as they hear those in other processes."""

    def __init__(self, peers: Sequence[Peer]) -> None:
        super().__init__(peers)
        self._peers = peers

    def steer(self, order: Steering) -> None:
        """Apply an order in all of them."""
        for peer in self._peers:
            peer.steer(order)

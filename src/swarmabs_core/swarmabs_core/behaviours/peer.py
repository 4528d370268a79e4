"""A robot that sums up and controls the swarm by itself, from what its neighbours pass on: no observer, no controller.

It hosts the state machines of observer, parent controller and robot, and passes messages between them. Robots exchange
what they know of a step in rounds. A robot sends the message of a round once it has those of the round before from all
neighbours, so rounds are the clock of the network: a lost message costs its content, not its round. In a step it stops
once it knows all, and all its neighbours do; only then it goes on to the next step. Which messages it sends therefore
depends on nothing but the links, unless robots are silent, and its messages of a step end with one that says so.

A robot gives its state to the parent, and says what it has computed from the step before, only once it holds the states
of all. So whoever has the parent's state of a step, which exists once all robots have given theirs, knows that all hold
all of them. With the parent's state it computes the next state of its robot, and begins the next step. A robot that
does not hear the parent begins the next step with the first message of it, and gets the parent's state from neighbours.

Robots agree on going on without silent ones as `Agreement` says.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.agreement import Agreement
from swarmabs_core.behaviours.agent import Agent, AgentGroup
from swarmabs_core.behaviours.base import UnexpectedMessageError, refuse_conflict, refuse_other_system
from swarmabs_core.behaviours.controller import Controller
from swarmabs_core.behaviours.observer import Observer
from swarmabs_core.errors import RunError
from swarmabs_core.links import COPIES
from swarmabs_core.membership import SILENT
from swarmabs_core.messages import (
    NEVER,
    PARENT_STATES,
    RECORDER_NODE,
    RECORDING_PROGRESS,
    ROBOT_STATES,
    STANDING,
    STEERING,
    TOPIC_OF,
    AnyParentState,
    AnyRobotState,
    EventKind,
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
    from collections.abc import Iterable, Sequence

    from swarmabs_core.links import Links
    from swarmabs_core.model import AgentConfig, ControllerConfig, ObserverConfig

_KEPT_UNRECORDED = 8
"""Steps of which a robot keeps what it has said, if no recorder tells how far it is."""


class Turn(NamedTuple):
    """What a robot waits for.

    Attributes
    ----------
    step : int
        The current step.
    given : bool
        Whether it has given its state of it to the parent, and knows all others that count in it.
    out : int
        The robots that it leaves out, as bits by rank. Who reaches it gives its state once it knows all their votes.
    """

    step: int
    given: bool
    out: int


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
        self._graph = [self._content.set_of(links.of(robot)) for robot in sorted(observer.members)]
        self.neighbours = links.of(self.agent_id)
        parent = (self._family.parent,) if self._senses else ()
        self.needs = (*parent, *map(relay_topic, self.neighbours), RECORDING_PROGRESS)
        self._parents: dict[int, AnyParentState] = {}
        self._inbox: dict[tuple[int, int], dict[int, Relay]] = {}
        self._own: AnyRobotState | None = None
        self._states: dict[int, AnyRobotState] = {}
        self._said: list[Message] = []
        self._shared: list[Message] = []
        self._kept: deque[tuple[int, Messages]] = deque()
        self._recorded, self._written = bool(controller.recording_window), -1
        self._heard: set[int] = set()
        self._newest: dict[int, tuple[int, int]] = {}
        self._over = False
        self._never_join = 0
        """Robots, as bits by rank, that were dropped in the current step before they were to join."""
        self._begin(0)

    def _begin(self, step: int) -> None:
        """Begin a step, and forget the one before but for its states."""
        self._before, self._states = self._states, {}
        self._set_before = self._content.set_of(self._before) | self._never_join
        self._never_join = 0
        self._step, self._round, self._sent = step, 0, False
        self._known = 0
        self._parent: AnyParentState | None = None
        self._given = False
        self._own_again: Messages = ()
        self._theirs = dict.fromkeys(self.neighbours, 0)
        self._resting = False
        self._complete_near: dict[int, int] = {}
        self._ended_near: set[int] = set()
        self._alike_near: set[int] = set()
        self._agreement = self._first_meeting()
        self._meet()
        if self._observer.membership.changes(step + 1):
            self._refuse_gaps(step + 1)
        self._parents = {at: state for at, state in self._parents.items() if at >= step - 1}
        self._inbox = {turn: relays for turn, relays in self._inbox.items() if turn >= (step, 0)}

    def _meet(self) -> None:
        """Find out which neighbours pass on messages in the step."""
        membership = self._observer.membership
        self._near = tuple(robot for robot in self.neighbours if membership.lasts(robot, self._step))

    def _due(self) -> tuple[int, ...]:
        """Return the robots whose states belong to the step; there are none after the last one."""
        over = self._last_step is not None and self._step > self._last_step
        return () if over else self._observer.membership.publishing(self._step)

    def _first_meeting(self) -> Agreement:
        """Return an agreement of the step without votes."""
        membership, content = self._observer.membership, self._content
        present = content.set_of(membership.lasting(self._step))
        agreement = Agreement(content.rank(self.agent_id), self._graph, present, content.set_of(self._due()))
        if self._step in self._parents:
            agreement.answer()
        return agreement

    def _refuse_gaps(self, step: int) -> None:
        """Raise `RunError` if the robots that are left in a step do not all hear each other and the parent."""
        relaying = self._observer.membership.lasting(step)
        if apart := self._links.apart(relaying):
            raise RunError(
                f"step {step}: robot {apart[0]} is cut off from robot {relaying[0]} by the end of other robots; "
                "use more links"
            )
        if not any(map(self._links.senses, relaying)):
            raise self._no_parent(step)

    @staticmethod
    def _no_parent(step: int) -> RunError:
        return RunError(f"step {step}: no robot is left that hears the parent; see links.sensing")

    def start(self) -> Messages:
        """Pass on the initial state of the robot."""
        self._take_own(self._agent.start())
        return self._proceed()

    def handle(self, message: Message) -> Messages:
        """Take a relay of a neighbour, the parent's state, or the recorder's progress; return what is published.

        The first of the robots that publish a state in a step and in the next one also publishes the broadcasts.

        Raises
        ------
        RunError
            If the others have gone on without this robot, or too few of them are left.
        """
        refuse_other_system(message, self._system)
        if isinstance(message, RecordingProgress):
            if message.written_step != NEVER:
                self._written = max(self._written, message.written_step)
            self._share(self._controller.handle(message))
        elif isinstance(message, PARENT_STATES):
            if message.step >= self._step:
                refuse_conflict(self._parents.setdefault(message.step, message), message, self._family.parent.name)
            if message.step == self._step:
                self._agreement.answer()
        elif isinstance(message, Relay):
            self._take(message)
        else:
            raise UnexpectedMessageError(f"robot {self.agent_id}", message)
        return self._proceed()

    def _take(self, relay: Relay) -> None:
        """Keep a message of a neighbour until its round; take its votes at once."""
        robot, turn = relay.agent_id, (relay.step, relay.round)
        if relay.step == self._step and self._content.before(relay) != self._set_before:
            self._refuse_dropped(relay)
            return  # it is about to find out that the others have gone on without it
        self._heard.add(robot)
        newest = self._newest[robot] = max(turn, self._newest.get(robot, turn))
        if self._over or robot not in self._near or self._is_out(robot):
            return
        if relay.step > self._step:
            self._compare_ahead(relay)
        elif relay.step == self._step:
            votes = None if self._links.loses(*turn, robot, self.agent_id) else self._content.votes(relay)
            if votes and self._agreement.take(votes, self._known):
                self._note_votes()
            if not relay.complete and relay.round > self._complete_near.get(robot, relay.round):
                self._wake(robot)
        if turn >= (self._step, self._round):
            refuse_conflict(self._inbox.setdefault(turn, {}).setdefault(robot, relay), relay, f"robot {robot}")
        elif turn == newest and relay.step == self._step and self._agreement.votes:
            self._note(relay)  # it may say no more, and this robot has not waited for it

    def _is_out(self, robot: int) -> bool:
        """Return whether this robot has voted to leave out another one; it does not listen to it any more."""
        return bool(self._agreement.out >> self._content.rank(robot) & 1)

    def _compare_ahead(self, relay: Relay) -> None:
        """Take from a message of a later step how a neighbour has completed this one.

        Raises
        ------
        RunError
            If it has done so without this robot.
        """
        self._refuse_dropped(relay)
        if relay.step == self._step + 1 and self._agreement.out:
            self._agreement.follow(self._left_out(self._content.before(relay)))

    def _refuse_dropped(self, relay: Relay) -> None:
        """Raise `RunError` if a neighbour has completed a step without this robot, which takes part, or is to join."""
        membership, before = self._observer.membership, relay.step - 1
        if not membership.lasts(self.agent_id, before):
            return
        told = bool(self._content.before(relay) & self._content.set_of((self.agent_id,)))
        if relay.step > self._step + 1 or told != membership.publishes(self.agent_id, before):
            raise RunError(
                f"step {self._step}: the others have dropped robot {self.agent_id}, because it did not answer "
                f"(lockstep.on_stall); robot {relay.agent_id} is at step {relay.step}"
            )

    def _left_out(self, before: int) -> int:
        """Return whom others have dropped in this step, as they tell of it in the next one (`Knowledge.before`)."""
        present = self._content.set_of(self._observer.membership.lasting(self._step))
        return present & (before ^ self._content.set_of(self._due()))

    @property
    def turn(self) -> Turn:
        """What this robot waits for."""
        return Turn(self._step, self._given and self._complete, self._agreement.out)

    def take_heard(self) -> set[int]:
        """Return the neighbours of which anything has been heard since the last call."""
        heard, self._heard = self._heard, set()
        return heard

    def stalled(self, silent: Iterable[int], *, waited: bool) -> Messages:
        """Tell the others which neighbours are silent, or that this robot has waited in vain for the parent.

        Raises
        ------
        RunError
            If too few robots are left with this one.
        """
        if self._over or self._held_back:
            return ()
        agreement, linked = self._agreement, self._linked()
        missed = self._content.set_of(robot for robot in silent if robot in linked)
        # A vote of one that misses nobody lets it go on without messages whose senders have: these may not repeat them.
        passed = any(map(self._has_gone_on, self._waiting()))
        if not missed and not agreement.votes and not passed:
            return ()
        news = agreement.tell(missed, self._known)
        if waited and agreement.out and (self._deaf or (self._given and self._complete)):
            news |= agreement.wait()
        if not news:
            return ()
        self._note_votes()
        return self._proceed()

    def _has_gone_on(self, robot: int) -> bool:
        """Return whether a neighbour is at a later step, or, as it ends with this one, need not stay any more."""
        if self._observer.membership.lasts(robot, self._step + 1):
            return self._newest.get(robot, (-1, 0))[0] > self._step
        return self._goes_on()

    def settle(
        self, step: int, states: Iterable[AnyRobotState], parent: AnyParentState | None, dropped: Iterable[int]
    ) -> Messages:
        """Complete a step, the current one or the next, as a recorded run has done; return what is published.

        Parameters
        ----------
        states : iterable of AgentState or RobotState
            The states of the step, as robots get to know them.
        parent : PlaneState, ParentState or None
            The parent's state in the step before, None in step 0.
        dropped : iterable of int
            The robots that are dropped in the step.

        Raises
        ------
        RunError
            If the robots that are left do not all hear each other and the parent.
        """
        if self._step < step:
            self._leave_behind()
        if self._over:
            return ()
        if parent is not None:
            self._measure(parent)
        for state in states:
            self._learn(state)
        self._agreement.follow(self._content.set_of(dropped))
        self._resting = True
        return self._proceed()

    def _note_votes(self) -> None:
        """Pass on new votes, and learn whether all neighbours know them.

        Raises
        ------
        RunError
            If too few robots are left with this one.
        """
        agreement, content = self._agreement, self._content
        if agreement.outnumbered:
            inside, out = (", ".join(map(str, content.robots_in(bits))) for bits in (agreement.inside, agreement.out))
            raise RunError(
                f"step {self._step}: robot {self.agent_id} does not reach robots {out} any more; those left ({inside}) "
                "are no majority and stop, because the others may have gone on (lockstep.on_stall)"
            )
        self._go_on_relaying()
        self._complete_near.clear()
        self._ended_near.clear()
        self._alike_near.clear()

    def _wake(self, robot: int) -> None:
        """Take note that a neighbour that knew all has new votes; it goes on until it has read them here."""
        if self._resting:
            self._go_on_relaying()
        self._complete_near.pop(robot, None)
        self._ended_near.discard(robot)

    def _go_on_relaying(self) -> None:
        """Go on to the next round without waiting for neighbours, which may have stopped."""
        self._resting = False
        if self._sent:
            self._hear()

    def _drop(self) -> Messages:
        """Drop the robots on which all have agreed; return what is published.

        Raises
        ------
        RunError
            If the robots that are left do not all hear each other and the parent.
        """
        membership, content = self._observer.membership, self._content
        if self._agreement.waited and self._deaf:
            raise self._no_parent(self._step)
        dropped = [robot for robot in content.robots_in(self._agreement.dropped) if membership.lasts(robot, self._step)]
        if not dropped or not self._committed:
            return ()
        bits = content.set_of(dropped)
        self._never_join |= bits & ~content.set_of(self._due())
        self._known &= ~bits
        for robot in dropped:
            self._states.pop(robot, None)
        self._observer.drop(dropped, SILENT)
        self._meet()
        self._refuse_gaps(self._step)
        again = self._own_again  # the parent counts only what comes after the events
        if not self._speaks(self._step):
            return again
        # Whoever spoke before may have ended before the recorder had it. After the last step nobody is missed.
        # Who is to join in this step may still be dropped.
        changes = [event for event in self._observer.changes() if event.kind != EventKind.JOINED] if self._due() else ()
        return (*(message for _, messages in self._kept for message in messages), *changes, *again)

    def steer(self, order: Steering) -> None:
        """Apply an order in all that it hosts."""
        self._observer.steer(order)
        self._controller.steer(order)
        if STEERING in self._agent.needs:
            self._agent.handle(order)
            if self._committed and self._own is None:  # it joins with the broadcasts of the step before
                for message in self._shared:
                    if TOPIC_OF[type(message)] in self._agent.needs:
                        self._take_own(self._agent.handle(message))
        if not self._agreement.votes:
            self._agreement = self._first_meeting()
        self._meet()

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
    def _committed(self) -> bool:
        """Whether it has computed what follows from the step before."""
        return self._step == 0 or self._parent is not None

    @property
    def _deaf(self) -> bool:
        """Whether neither it nor any that it reaches can get the parent's state of the step before any more."""
        inside = self._content.robots_in(self._agreement.inside)
        return not self._committed and not any(map(self._links.senses, inside))

    @property
    def _held_back(self) -> bool:
        """Whether its controller waits for the recorder."""
        return self._controller.awaits() == (RECORDING_PROGRESS,)

    @property
    def _complete(self) -> bool:
        """Whether it knows all of the step: all states, and the votes of all that it reaches."""
        known = self._committed and not self._held_back and self._agreement.alike
        return known and len(self._states) == len(self._due())

    def _linked(self) -> tuple[int, ...]:
        """Return the neighbours whose messages it awaits."""
        unheard = self._agreement.unheard(self._content.rank(self.agent_id))
        return tuple(robot for robot in self._near if not unheard >> self._content.rank(robot) & 1)

    def _waiting(self) -> tuple[int, ...]:
        """Return the neighbours whose messages of the round are missing."""
        if not self._sent or self._resting:
            return ()
        come = self._inbox.get((self._step, self._round), {})
        return tuple(robot for robot in self._linked() if robot not in come and robot not in self._ended_near)

    def _goes_on(self) -> bool:
        """Return whether the next step has begun for this robot."""
        if not self._given or not self._agreement.settled:
            return False
        if self._senses:
            return self._step in self._parents
        return any(step > self._step for step, _ in self._inbox)

    def _proceed(self) -> Messages:
        """Go on through rounds and steps as far as possible."""
        published: list[Message] = []
        while not self._over and (answers := self._advance()) is not None:
            published += answers
        return tuple(published)

    def _advance(self) -> Messages | None:
        """Do the next thing, and return what is published; None if a message is awaited."""
        if answers := self._drop():
            return answers
        if self._complete and not self._given:
            return self._give()
        if self._complete and (self._resting or (self._sent and self._agreement.votes)) and self._goes_on():
            self._leave_behind()
            return ()
        if self._resting:
            self._over = not self._due() and not self._controller.awaits()
            return None
        if not self._sent:
            return (self._send(),) if self._speaking else None
        if self._waiting():
            return None
        self._hear()
        return ()

    @property
    def _speaking(self) -> bool:
        """Whether it has something to say in the round, or neighbours that may tell more."""
        if self._held_back or (self._committed and self.agent_id in self._due() and self.agent_id not in self._states):
            return False  # its own state will follow
        return self._complete or not self._ended_near.issuperset(self._linked())

    def _leave_behind(self) -> None:
        """Go on to the next step, if there is one for this robot."""
        step = self._step
        if not self._observer.membership.lasts(self.agent_id, step + 1):
            self._over = True
            return
        self._begin(step + 1)
        if self._senses:
            self._measure(self._parents[step])

    def _give(self) -> Messages:
        """Say what this robot and, if it speaks for all, observer and controller have computed from the step before."""
        self._given = True
        said, self._said = self._said, []
        self._own_again = tuple(message for message in said if isinstance(message, ROBOT_STATES))
        step, kept = self._step - 1, self._kept
        if step < 0:
            return tuple(said)
        kept.append((step, tuple(self._shared)))
        while kept and (kept[0][0] <= self._written or (len(kept) > _KEPT_UNRECORDED and not self._recorded)):
            kept.popleft()
        return (*(self._shared if self._speaks(step) else ()), *said)

    def _send(self) -> Relay:
        """Return the message of the round: what neighbours are not known to have."""
        linked = self._linked()
        everywhere = -1
        for robot in linked:
            everywhere &= self._theirs[robot]
        wanted = self._known & ~everywhere
        states = [self._states[robot] for robot in self._passed_on(self._content.robots_in(wanted))]
        told = all(self._links.senses(robot) or robot in self._complete_near for robot in linked)
        complete = self._complete and (not self._agreement.votes or self._alike_near.issuperset(linked))
        self._resting = complete and self._complete_near.keys() >= {*linked}
        self._sent = True
        parent = None if told else self._parent
        votes = self._agreement.votes
        content = self._content.written(self._set_before, self._known, states, parent, self._before, votes)
        stamp = self._step * self._period_ns
        return Relay(stamp, self._step, self.agent_id, self._round, int(complete), int(self._resting), content)

    def _passed_on(self, robots: tuple[int, ...]) -> tuple[int, ...]:
        """Return those of the robots whose states it passes on in the round.

        Where many hear each other, a robot leaves most states to others, so that everybody still hears each of them
        from `COPIES` neighbours; by turns it passes on all.
        """
        near = len(self._near)
        if near <= COPIES:
            return robots
        if not self._round:
            return tuple(robot for robot in robots if robot == self.agent_id)
        return tuple(robot for robot in robots if (robot + self.agent_id + self._round) % near < COPIES)

    def _hear(self) -> None:
        """Take what the neighbours have sent in the round."""
        for robot, relay in sorted(self._inbox.pop((self._step, self._round), {}).items()):
            if robot in self._near and not self._is_out(robot):
                self._note(relay)
        self._round, self._sent = self._round + 1, False

    def _note(self, relay: Relay) -> None:
        """Take what a neighbour has sent in a round of this step."""
        robot = relay.agent_id
        if relay.complete:
            self._complete_near[robot] = relay.round
        if not self._links.loses(relay.step, relay.round, robot, self.agent_id):
            self._read(relay)
        if relay.last and (not self._agreement.votes or robot in self._alike_near):
            self._ended_near.add(robot)

    def _read(self, relay: Relay) -> None:
        """Take what a neighbour passes on."""
        robot, told = relay.agent_id, self._content.read(relay, self._before, self._known)
        if told.votes == self._agreement.votes:
            self._alike_near.add(robot)
        self._theirs[robot] |= told.held
        for state in told.states:
            self._learn(state)
        if told.parent is not None:
            self._measure(told.parent)

    def _learn(self, state: AnyRobotState) -> None:
        """Take a robot's state of the step."""
        robot = state.agent_id
        if robot not in self._states and robot in self._due():
            self._states[robot] = state
            self._known |= self._content.set_of((robot,))

    def _measure(self, parent: AnyParentState) -> None:
        """Take the parent's state of the step before, and compute what follows from it and the robots' states."""
        if self._committed:
            return
        self._parent = parent
        self._shared = []
        for _, state in sorted(self._before.items()):
            self._host(state)
        self._host(parent)

    def _host(self, message: AnyRobotState | AnyParentState) -> None:
        """Give the hosted machines a state."""
        topic = TOPIC_OF[type(message)]
        if topic is self._family.robot or topic in self._watching:
            self._share(self._observer.handle(message))
        if topic is self._family.parent:
            self._share(self._controller.handle(message))
        if topic in self._agent.needs:
            self._take_own(self._agent.handle(message))

    def _share(self, messages: Messages) -> None:
        """Pass on what observer and controller say."""
        self._shared += messages
        for message in messages:
            topic = TOPIC_OF[type(message)]
            if topic is STANDING:
                self._share(self._controller.handle(message))
            elif topic in self._agent.needs:
                self._take_own(self._agent.handle(message))

    def _take_own(self, messages: Messages) -> None:
        """Keep what the robot says until the step is complete, and its state for the others."""
        self._said += messages
        for message in messages:
            if isinstance(message, ROBOT_STATES):
                self._own = reduced(message)
                self._learn(self._own)

    def _speaks(self, step: int) -> bool:
        """Return whether this robot publishes what all of them compute in a step."""
        membership = self._observer.membership
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

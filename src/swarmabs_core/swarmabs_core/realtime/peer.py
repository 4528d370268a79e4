"""A robot in real time that sums up and controls the swarm by itself: no observer, no parent controller.

It hosts the state machines of observer, parent controller and robot, and passes messages between them. Once per period
it tells its neighbours what they may lack: the newest state of each robot and of the plane, STOP and RESET as operators
ordered them anywhere, and how far its instance of the law is (docs/explanation/decentralised_realtime.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_core.declaration import part, same, setting
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.hearing import Hearing
from swarmabs_core.links import COPIES, LinkSettings, lost
from swarmabs_core.messages import (
    PARENT,
    RELAY,
    AbstractState,
    AgentState,
    Basis,
    DesiredAbstractState,
    Message,
    Messages,
    Mode,
    PlaneState,
    Relay,
    StandingState,
    Status,
    SwarmEvent,
)
from swarmabs_core.rank_sets import ranks, set_of
from swarmabs_core.realtime.base import (
    OBSERVER_PHASE,
    UNKNOWN,
    Health,
    Level,
    Realtime,
    Schedule,
    Sender,
    StepCounter,
)
from swarmabs_core.realtime.electorate import SETTLED, Electorate
from swarmabs_core.realtime.observer import Role
from swarmabs_core.realtime.relayed import (
    BUDGET,
    Told,
    answers_of,
    constants_of,
    motion_of,
    passed_on,
    read,
    read_plane,
    room,
    written,
)
from swarmabs_core.realtime.seals import Seals, Signatures, author_name
from swarmabs_core.realtime.validation import FROM_FUTURE, Origin, Problem, Refusals, Writers
from swarmabs_core.settings import Run

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from swarmabs_core.realtime.agent import RealtimeAgent
    from swarmabs_core.realtime.controller import LawView, RealtimeController
    from swarmabs_core.realtime.modes import Orders
    from swarmabs_core.realtime.observer import RealtimeObserver
    from swarmabs_core.realtime.relayed import Constants, Motion

_THERE = (Role.ACTIVE, Role.STOPPED)
_LACKED = (Role.UNHEARD, Role.SILENT)
_PROGRESS_PERIODS = 10
"""Periods after which a relay tells again from which desired state its sender continues."""
SWARM, LAW = "swarm: ", "law: "
"""What the values in a health status begin with that are those of the hosted observer and controller."""
_UNREADABLE = "a relay that cannot be read"


@dataclass(frozen=True, slots=True)
class RealtimePeerConfig:
    """What a robot that sums up the swarm by itself needs to know beyond what it hosts."""

    members: tuple[int, ...] = same(Run, "members")
    schedule: Schedule = part(Schedule, name="")
    agent_id: int = setting(1, "id of the robot", minimum=1, maximum=65535)
    neighbours: tuple[int, ...] = setting((), "ids of the robots that it hears", item=0, minimum=1, maximum=65535)
    senses: bool = setting(default=True, description="whether it hears the plane")
    loss: float = same(LinkSettings, "loss", name="links.loss")
    link_seed: int = same(LinkSettings, "seed", name="links.seed")
    state_age_limit: float = same(Realtime, "state_age_limit")
    clock_tolerance: float = same(Realtime, "clock_tolerance")


class RealtimePeer:
    """A robot with observer and parent controller of its own.

    It follows what these say while it hears a majority of the robots; the others of a partition stop. For recorders and
    viewers only, the robot with the lowest id of those that it hears publishes what all of them compute.

    Parameters
    ----------
    config : RealtimePeerConfig
        Its place in the swarm.
    observer, controller, agent : RealtimeObserver, RealtimeController, RealtimeAgent
        What it hosts.
    seals : Seals, optional
        Keys, if the states of the swarm are signed.
    """

    def __init__(
        self,
        config: RealtimePeerConfig,
        observer: RealtimeObserver,
        controller: RealtimeController,
        agent: RealtimeAgent,
        seals: Seals | None = None,
    ) -> None:
        self._config, self._schedule = config, config.schedule
        self._observer, self._controller, self._agent = observer, controller, agent
        self._ids = tuple(sorted(config.members))
        self._rank = {agent_id: rank for rank, agent_id in enumerate(self._ids)}
        self._age = config.schedule.steps(config.state_age_limit)
        self._ahead = config.schedule.ahead(config.clock_tolerance)
        self._counter = StepCounter(config.schedule)
        self._writers = Writers(self._age)
        self._refusals = Refusals(config.agent_id)
        self._signatures = Signatures(seals, config.schedule)
        self._constants: dict[int, Constants] = {}
        self._changed: set[int] = set()
        self._told: dict[int, tuple[int, Told]] = {}
        self._views: list[tuple[int, LawView]] = []  # with the newest RESET that their senders knew
        self._plane: PlaneState | None = None
        self._summed = -1
        self._begun = False
        self._bases: list[Basis] = []
        self._relayed = (-1, 0)
        self._electorate = Electorate(self._ids, config.schedule.steps(SETTLED))
        self._majority = True

    def hear(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Messages:
        """Take a neighbour's relay, a state of the plane, or what an operator or other robots tell the observer."""
        if isinstance(message, Relay):
            hear = self._hear_plane if message.agent_id == PARENT else self._hear_relay
            return hear(message, now, sender)
        if isinstance(message, PlaneState):
            return self._measure(message, now, sender)
        return self._observer.hear(message, now, sender)

    def tick(self, now: int) -> Messages:
        """Move the robot, and tell the neighbours what they may lack."""
        step = self._counter.next(now)
        if step is None:
            if self._counter.last is None and self._summed >= 0:
                self._forget()
            return self._agent.tick(now)
        self._writers.advance(step)
        published: list[Message] = []
        for answer in self._agent.tick(now):
            published.append(answer)
            if isinstance(answer, AgentState):
                published += self._learn(answer, now, UNKNOWN, self._signatures.sign(answer))
        if step - self._summed > self._age:  # otherwise states of the plane decide when it sums up
            published += self._sum_up(step)
        reset = self._controller.orders.reset
        self._controller.agree([law for known, law in self._views if known == reset])
        self._views = []
        published += self._share(self._controller.tick(now), now)
        return (*published, *self._relay(step, now))

    @property
    def orders(self) -> Orders:
        """STOP and RESET as far as this robot knows."""
        return self._controller.orders

    @property
    def law(self) -> LawView:
        """How far its instance of the law is."""
        return self._controller.view

    def stop(self, now: int) -> Messages:
        """Stop the swarm until `reset`."""
        return self._ordered(self._controller.stop(now), now)

    def reset(self, now: int) -> Messages:
        """Resume after `stop`; law and reference restart."""
        return self._ordered(self._controller.reset(now), now)

    def leave(self, now: int) -> Messages:
        """Leave the plane, as `RealtimeAgent.leave`; the robot goes on to pass on what it hears."""
        return self._agent.leave(now)

    def join(self, now: int) -> Messages:
        """Take part again after `leave`."""
        return self._agent.join(now)

    def halt(self) -> None:
        """Bring the robot to a safe state, because ticks are suspended."""
        self._agent.halt()
        self._controller.halt()
        self._forget()

    def health(self, now: int) -> Health:
        """Return the health of the robot, with what it knows of the swarm."""
        robot, swarm, law = (part.health(now) for part in (self._agent, self._observer, self._controller))
        step = self._schedule.step(now)
        roles, states = self._observer.roles, sorted(self._observer.states.items())
        hearing = Hearing(
            tuple(robot_id for robot_id, (heard, _) in sorted(self._told.items()) if step - heard <= self._age),
            len(self._config.neighbours),
            {i: max(0, step - state.step) for i, state in states if state.step and roles[i] is not Role.LEFT},
            tuple(i for i, role in sorted(roles.items()) if role in _LACKED),
            self._majority,
        )
        values = (
            *robot.values,
            *hearing.values(),
            ("counted robots", " ".join(map(str, sorted(self._electorate.counted)))),
            *((f"{SWARM}{name}", text) for name, text in swarm.values),
            *((f"{LAW}{name}", text) for name, text in law.values),
            *self._refusals.values(),
        )
        level, text = robot.level, robot.text
        if not self._majority:
            level, text = (
                max(level, Level.ERROR),
                f"{text}; hears a minority of the robots: the others go on without it",
            )
        elif robot.level is not Level.OK and not self._begun:
            text = f"{text}; {swarm.text}"
        return self._writers.warned(Health(level, text, values))

    def _ordered(self, said: Messages, now: int) -> Messages:
        """Pass on an order at once; who hears of it tells others in its next period."""
        events = () if self._speaks else tuple(message for message in said if isinstance(message, SwarmEvent))
        step = self._schedule.step(now)
        relayed = self._relay(step, now) if step >= 0 else ()  # before the first step there is none that could tell it
        return (*events, *self._share(said, now), *relayed)

    def _hear_relay(self, relay: Relay, now: int, sender: Sender) -> Messages:
        step, config = self._schedule.step(now), self._config
        origin = Origin(RELAY.name, relay.agent_id)
        if lost(config.link_seed, config.loss, relay.step, relay.round, relay.agent_id, config.agent_id):
            return ()
        if relay.step > step + self._ahead:
            return self._refusals.add(Problem(f"a relay {FROM_FUTURE}").of(origin), step, now)
        if relay.agent_id not in config.neighbours:
            return self._refusals.add(Problem("a relay of a robot that is not a neighbour").of(origin), step, now)
        try:
            told = read(relay, len(self._ids), answers=False)
        except MalformedMessageError as error:
            return self._refusals.add(Problem(_UNREADABLE, str(error)).of(origin), step, now)
        if told.sealed != self._signatures.sealed:
            other = "a relay without signatures" if self._signatures.sealed else "a relay with signatures"
            return self._refusals.add(Problem(other).of(origin), step, now)
        if problem := self._writers.second(origin, sender.writer, step):
            return self._refusals.add(problem.of(origin), step, now)
        before = self._told.get(relay.agent_id)
        if before is None or before[0] < relay.step:
            self._told[relay.agent_id] = relay.step, told
        published = [*self._obey(told, now)]
        since, counted = told.electing
        if since <= step + self._ahead:
            self._electorate.learn(since, map(self._ids.__getitem__, ranks(counted)))
        states = self._observer.states
        for motion in told.motions:
            known = states.get(self._ids[motion.rank])
            if known is None or relay.step - motion.age > known.step:
                constants = told.constants.get(motion.rank, self._constants.get(motion.rank))
                published += self._hear_motion(motion, constants, relay, now, sender)
            elif motion.rank in told.constants:  # there is nothing newer to wait for
                self._changed.discard(motion.rank)
        newest = step - self._age - 1 if self._plane is None else self._plane.step
        if told.plane is not None and told.plane.step > newest:
            if self._signatures.holds(told.plane, told.plane_signature):
                published += self._measure(told.plane, now, UNKNOWN, told.plane_signature)
            else:
                published += self._refusals.add(_forged(relay, PARENT), step, now)
        return tuple(published)

    def _hear_plane(self, relay: Relay, now: int, sender: Sender) -> Messages:
        """Take a state of the plane, with its signature, from the plane's node."""
        try:
            plane, signature = read_plane(relay)
        except MalformedMessageError as error:
            step = self._schedule.step(now)
            return self._refusals.add(Problem(_UNREADABLE, str(error)).of("the plane"), step, now)
        return self._measure(plane, now, sender, signature, checked=False)

    def _obey(self, told: Told, now: int) -> Messages:
        """Take over orders that are not from the future, and note how far the neighbour's law is."""
        latest = self._schedule.step(now) + self._ahead + self._controller.guard + 1
        if max(told.orders) > latest:
            return ()
        self._views.append((told.orders.reset, told.law))
        return self._share(self._controller.obey(told.orders, now), now)

    def _hear_motion(
        self, motion: Motion, constants: Constants | None, relay: Relay, now: int, sender: Sender
    ) -> Messages:
        """Take another robot's state that is newer than the known one, unless its constants are not known."""
        agent_id = self._ids[motion.rank]
        if agent_id == self._config.agent_id:
            return ()
        if constants is None or constants.tag != motion.tag:
            self._changed.add(motion.rank)
            return ()
        state = motion.state(agent_id, constants, relay.step - motion.age, self._schedule)
        if agent_id == relay.agent_id:
            return self._learn(state, now, sender, motion.signature, checked=False)
        if not self._signatures.holds(state, motion.signature):
            return self._refusals.add(_forged(relay, agent_id), self._schedule.step(now), now)
        return self._learn(state, now, UNKNOWN, motion.signature)

    def _learn(
        self, state: AgentState, now: int, sender: Sender, signature: bytes, *, checked: bool = True
    ) -> Messages:
        """Give the observer the state of a robot, and keep its signature if it is the newest."""
        known = passed_on(state, self._schedule)
        answers = self._observer.hear(known, now, sender)
        if self._observer.states.get(state.agent_id) is known:
            rank = self._rank[state.agent_id]
            self._constants[rank] = constants_of(state)
            self._changed.discard(rank)
            self._signatures.keep(known, signature, checked=checked)
        return answers

    def _measure(
        self, plane: PlaneState, now: int, sender: Sender, signature: bytes = b"", *, checked: bool = True
    ) -> Messages:
        """Take a state of the plane: sum up the swarm for its step, and ask the law for the desired abstract state.

        One that is not credible for the law is not passed on either.
        """
        taken, answers = self._controller.take(plane, now, sender)
        if not taken:
            return self._share(answers, now)
        self._plane = plane
        self._signatures.keep(plane, signature, checked=checked)
        published = self._sum_up(plane.step) if plane.step > self._summed else ()
        return (*published, *self._share(self._controller.answer(plane, now), now))

    def _sum_up(self, step: int) -> Messages:
        """Sum up the swarm as of a step."""
        self._summed, now = step, self._schedule.begin(step, OBSERVER_PHASE)
        answers = self._observer.tick(now)
        heard = [i for i, state in self._observer.states.items() if self._is_heard(state, step)]
        if not self._begun and any(isinstance(answer, AbstractState) for answer in answers):
            self._begun = True
            self._electorate.begin(heard)
        self._majority = not self._begun or self._electorate.hears_majority(heard, step)
        return self._share(answers, now)

    def _is_heard(self, state: AgentState, step: int) -> bool:
        """Return whether a robot counts as heard: losses alone must not make a minority, so for twice the age limit."""
        return state.status != Status.LEFT and bool(state.step) and step - state.step <= 2 * self._age

    def _share(self, messages: Messages, now: int) -> Messages:
        """Pass on what observer and controller say; return what is published, if this robot speaks for all."""
        published: list[Message] = []
        if self._speaks:
            published += [message for message in messages if not isinstance(message, Basis)]
        for message in messages:
            if isinstance(message, (AbstractState, StandingState)):
                published += self._controller.hear(message, now)
            if isinstance(message, Basis):
                self._bases.append(message)
            still = isinstance(message, DesiredAbstractState) and message.mode != Mode.RUN
            if still or (self._majority and not isinstance(message, (StandingState, Basis, SwarmEvent))):
                published += self._agent.hear(message, now)
        return tuple(published)

    @property
    def _speaks(self) -> bool:
        """Whether this robot publishes what all of them compute."""
        there = (agent_id for agent_id, role in self._observer.roles.items() if role in _THERE)
        return next(there, None) == self._config.agent_id

    def _forget(self) -> None:
        """Discard what the steps of an old clock tell."""
        self._observer.halt()
        self._told.clear()
        self._views = []
        self._plane, self._summed = None, -1

    # What is passed on

    def _relay(self, step: int, now: int) -> Messages:
        """Return what the neighbours may lack, and events for states that cannot be passed on."""
        states, signatures = self._observer.states, self._signatures
        known = self._constants.keys() - self._changed
        # After a halt, states are of step 0: how old they are is not known, so they are not passed on.
        dated = [states[i].step if i in states and rank in known else 0 for i, rank in self._rank.items()]
        held = np.array([state_step or -1 for state_step in dated])
        near = [(heard, told) for _, (heard, told) in self._told.items() if step - heard <= self._age]
        plane = self._plane
        if plane is not None and all(told.plane_step >= min(plane.step, heard - 1) for heard, told in near):
            plane = None
        seal = None if plane is None else signatures.of(plane)
        if seal is None:
            plane = None
        law = self._controller.view
        counted = set_of(map(self._rank.__getitem__, self._electorate.counted))
        answers, self._bases = answers_of(self._bases, self._rank, self._age), []
        progress = self._controller.progress
        tells = not progress or (step + self._rank[self._config.agent_id]) % _PROGRESS_PERIODS == 0
        plane_step = -1 if self._plane is None else self._plane.step
        orders, electing, sealed = self._controller.orders, (self._electorate.since, counted), signatures.sealed
        told = Told(
            orders,
            law,
            electing,
            plane_step,
            plane,
            held,
            answers,
            progress if tells else None,
            sealed=sealed,
            plane_signature=seal or b"",
        )
        budget = BUDGET - len(written(step, told, len(self._ids)))
        constants: dict[int, Constants] = {}
        motions: list[Motion] = []
        for rank in self._wanted(held, near, step):
            state = states[self._ids[rank]]
            new = constants | ({rank: constants_of(state)} if self._introduces(rank, near) else {})
            if not room(budget, len(new), len(motions) + 1, sealed=sealed):
                break
            signature = signatures.of(state)
            if signature is not None:
                constants = new
                motions.append(motion_of(rank, state, step, signature))
        content = written(step, replace(told, constants=constants, motions=motions), len(self._ids))
        self._relayed = step, self._relayed[1] + 1 if self._relayed[0] == step else 0
        problems = [f"{author_name(author)} has not signed its state" for author in signatures.refuted()]
        events = [event for problem in problems for event in self._refusals.add(Problem(problem), step, now)]
        return (*events, Relay(now, step, self._config.agent_id, self._relayed[1], 0, 0, content))

    def _wanted(self, held: NDArray[np.int64], near: list[tuple[int, Told]], step: int) -> Iterator[int]:
        """Yield the ranks of the robots of which some neighbour may lack the newest state, its own first.

        A neighbour has told what it held a period ago. What it will have heard from the robot itself by then is not
        passed on.
        """
        own, robots = self._rank[self._config.agent_id], len(self._ids)
        lacks = np.full(robots, -step if len(self._told) < len(self._config.neighbours) else 0)
        for heard, told in near:
            lacks = np.minimum(lacks, told.held - np.minimum(held, heard - 1))
        lacks[held < 0] = 0
        lacks[own] = 0
        if held[own] >= 0:
            yield own
        turns = (np.arange(robots) + own + step) % robots
        if len(near) > COPIES:  # in other periods it is the turn of other robots
            lacks[turns * len(near) >= COPIES * robots] = 0
        for rank in np.lexsort((turns, lacks)).tolist():
            if lacks[rank] >= 0:
                return
            yield rank

    def _introduces(self, rank: int, near: list[tuple[int, Told]]) -> bool:
        """Return whether some neighbour may not know the constants of a robot."""
        return len(near) < len(self._config.neighbours) or any(told.held[rank] < 0 for _, told in near)


def _forged(relay: Relay, author: int) -> Problem:
    """Return the problem of a state in a relay whose signature is not that of its author."""
    name = author_name(author)
    return Problem(f"robot {relay.agent_id} passed on a state of {name} that {name} has not signed")

"""Recomputation in real time of what robots compute by themselves, without observer and parent controller.

A relay names the states from which its sender has summed up the swarm, and the step from which its law continued. From
these and the recorded states follow the sums and the desired abstract state of each robot, and from them the command
that its next state carries and what is published for recorders. States that are passed on are compared with those that
their authors have published.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeVar

from swarmabs_analysis.difference import Difference, in_hex, judge, surplus
from swarmabs_analysis.verification.history import AMBIGUOUS, NO_STATES, History, UnconfirmedError, wrong_stamp
from swarmabs_analysis.verification.realtime_nodes import NO_ANSWER_BEFORE, NO_PLANE, RobotCheck
from swarmabs_config import realtime
from swarmabs_core.errors import MalformedMessageError, RunError
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BROADCASTS,
    DESIRED_ABSTRACT_STATE,
    NEVER,
    REMOVALS,
    STANDING,
    AgentState,
    DesiredAbstractState,
    Mode,
    PlaneState,
    Relay,
    StandingState,
    Status,
    relay_topic,
)
from swarmabs_core.realtime.base import OBSERVER_PHASE
from swarmabs_core.realtime.modes import ModeLatch
from swarmabs_core.realtime.observer import RealtimeSums
from swarmabs_core.realtime.relayed import MOST_ANSWERS, Constants, motion_of, passed_on, read
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from swarmabs_analysis.difference import Value
    from swarmabs_analysis.verification.base import Finding
    from swarmabs_analysis.verification.realtime_nodes import Followed
    from swarmabs_config.scenario import PlaneScenario
    from swarmabs_core.desired_state import DesiredStateGenerator
    from swarmabs_core.messages import Broadcast, Message, Topic
    from swarmabs_core.realtime.base import Schedule
    from swarmabs_core.realtime.modes import Orders
    from swarmabs_core.realtime.relayed import Answer, Motion, Told

NO_RELAY = "the relays that tell of it are not in the bag"
NO_AUTHOR = "a state that is passed on is not in the bag as its robot published it"
NOT_TOLD = "a relay does not tell from which states its sender has summed up: they are too many"
_SHARED = (ABSTRACT_STATE, AUXILIARY_STATE, STANDING, DESIRED_ABSTRACT_STATE)
"""What one of the robots publishes for recorders."""
_GENERATION = 64

T = TypeVar("T")


class _Recent(Generic[T]):
    """Values by robot and step, which are forgotten some steps after they were last needed."""

    def __init__(self) -> None:
        self._new: dict[tuple[int, int], T] = {}
        self._old: dict[tuple[int, int], T] = {}
        self._begun = 0

    def get(self, place: tuple[int, int]) -> T | None:
        """Return a value."""
        value = self._new.get(place)
        if value is None and (value := self._old.get(place)) is not None:
            self._new[place] = value
        return value

    def put(self, place: tuple[int, int], value: T) -> None:
        """Keep a value."""
        self._new[place] = value

    def advance(self, step: int) -> None:
        """Forget what has not been needed for long."""
        if abs(step - self._begun) > _GENERATION:
            self._begun, self._old, self._new = step, self._new, {}


@dataclass(slots=True)
class _Own:
    """What a robot has computed for a step; in place of what cannot be recomputed stands a `problem`."""

    messages: dict[Topic, Message] = field(default_factory=dict)
    speaks: bool = False
    problem: Finding = None


@dataclass(slots=True)
class _Peer:
    """What is known of a robot: its answers by step; and by the step of its relays, its orders and whether all came."""

    own: dict[int, _Own] = field(default_factory=dict)
    orders: dict[int, Orders] = field(default_factory=dict)
    told: dict[int, bool] = field(default_factory=dict)
    last: tuple[int, int] = (-1, 0)
    generator: DesiredStateGenerator | None = None
    law_step: int = -1
    begun: int = -1
    division: StandingState | None = None
    asked: DesiredAbstractState | None = None

    def lose(self) -> None:
        """Note that it is not known from where its law continues."""
        self.generator = self.division = None

    def forget(self, before: int) -> None:
        """Forget the steps before one, but for the desired state that was asked for last."""
        for step in [step for step in self.own if step < before]:
            desired = self.own.pop(step).messages.get(DESIRED_ABSTRACT_STATE)
            if isinstance(desired, DesiredAbstractState):
                self.asked = desired
        for steps in (self.orders, self.told):
            for step in [step for step in steps if step < before]:
                del steps[step]


class PeerHistory(History):
    """The messages of another history, with what a robot has computed by itself in place of broadcasts."""

    def __init__(self, of: History, peer: _Peer, agent_id: int) -> None:
        super().__init__()
        self._of, self._peer, self.agent_id = of, peer, agent_id

    def on(self, topic: Topic, step: int) -> Mapping[int, Record]:
        """Return the messages of a topic and step by key."""
        if topic not in BROADCASTS:
            return self._of.on(topic, step)
        own = self._peer.own.get(step)
        message = None if own is None or own.problem else own.messages.get(topic)
        if message is None:
            return {}
        key = message.mode if isinstance(message, DesiredAbstractState) else 0
        return {key: Record(topic, 0, message, b"")}

    def is_ambiguous(self, topic: Topic, step: int, agent_id: int = 0) -> bool:
        """Return whether different messages were received, of which the bag contains only the first."""
        return topic not in BROADCASTS and self._of.is_ambiguous(topic, step, agent_id)

    def problem(self, step: int, tick: int, ahead: int) -> Finding:
        """Return why a robot that decided in a step cannot be checked, or cannot have had broadcasts of a step."""
        own = self._peer.own.get(step)
        if own is not None:
            return own.problem or (None if len(own.messages) == len(_SHARED) else "")
        return "" if all(self._peer.told.get(k) for k in range(step - ahead, tick + 1)) else NO_RELAY

    def orders(self, tick: int) -> Orders | None:
        """Return STOP and RESET as the robot knew them before it decided in a step, None if that is not in the bag."""
        return self._peer.orders.get(tick - 1)


class PeerRobotCheck(RobotCheck):
    """Checks the states of a robot that follows what it has computed by itself."""

    own: PeerHistory
    guard: int

    def _followed(self, step: int) -> list[Followed]:  # noqa: ARG002 - the same in every step
        return [(self.own, self.own)]

    def _broadcasts(self, state: AgentState, before: AgentState, followed: Followed) -> Broadcast:
        orders, step = self.own.orders(before.step), state.broadcast_step
        if orders is not None and orders.stops(self.guard):
            reason = f"it knew of the STOP of step {orders.stop}, and does not obey"
            raise UnconfirmedError(Difference.of(state, "broadcast_step", step, NEVER, reason))
        problem = self.own.problem(step, before.step, self._ahead)
        if problem == "":
            reason = "by its relays it has not computed what it follows"
            raise UnconfirmedError(Difference.of(state, "broadcast_step", step, NEVER, reason))
        if problem:
            raise UnconfirmedError(NO_RELAY if isinstance(problem, Difference) else problem)
        return super()._broadcasts(state, before, followed)


class PeerChecks:
    """Checks relays and the broadcasts that are published for recorders.

    Attributes
    ----------
    robots : dict
        The checks of the robots' states, by id.
    """

    def __init__(
        self,
        scenario: PlaneScenario,
        schedule: Schedule,
        history: History,
        robots: dict[int, PeerRobotCheck],
        tolerance: float,
    ) -> None:
        self._schedule, self._history, self._tolerance = schedule, history, tolerance
        observer = realtime.observer_config(scenario, schedule)
        self._law = realtime.controller_config(scenario, schedule)
        self._sums = RealtimeSums(observer)
        self._ids = tuple(sorted(observer.members))
        self._rank = {agent_id: rank for rank, agent_id in enumerate(self._ids)}
        self._constants = {
            config.agent_id: Constants(config.kind, config.mass, config.damping)
            for config in realtime.agent_configs(scenario, schedule)
        }
        self._age = schedule.steps(observer.state_age_limit)
        self._ahead = schedule.ahead(observer.clock_tolerance)
        self._lag = self._age + self._ahead + 1
        self._peers = {agent_id: _Peer() for agent_id in self._ids}
        self._states: _Recent[Record] = _Recent()
        self._motions: _Recent[Motion] = _Recent()
        self._removed: set[int] = set()
        self._not_told: list[float] = []
        self._read = -1
        self.robots = robots
        guard = ModeLatch(schedule, self._law.plane_age_limit, self._law.clock_tolerance).guard
        for agent_id, check in robots.items():
            check.own, check.guard = PeerHistory(history, self._peers[agent_id], agent_id), guard

    # Relays

    def read(self, step: int) -> Iterator[Finding]:
        """Yield the findings on the relays up to as many steps after one as may tell of it: causes before effects."""
        end = step + self._lag
        for peer in self._peers.values():
            peer.forget(step - 2 * self._lag)
        begin, self._read = self._read + 1, max(self._read, end)
        few = end - begin <= len(self._history.steps)
        for one in range(begin, end + 1) if few else sorted(s for s in self._history.steps if begin <= s <= end):
            self._states.advance(one)
            self._motions.advance(one)
            self._removed |= {stored.agent_id for stored in self._history.on(REMOVALS, one).values()}
            relays = [
                (key, agent_id, stored)
                for agent_id in self._ids
                for key, stored in sorted(self._history.on(relay_topic(agent_id), one).items())
            ]
            relays.sort(key=lambda relay: relay[:2])
            for _, agent_id, stored in relays:
                self._note(agent_id, stored)
            for _, agent_id, stored in relays:
                yield self._relay(agent_id, stored)

    def spoken(self, step: int) -> Iterator[Finding]:
        """Yield the findings on the broadcasts of a step that were published for recorders."""
        for topic in _SHARED:
            for _, stored in sorted(self._history.on(topic, step).items()):
                yield AMBIGUOUS if self._history.is_ambiguous(topic, step) else self._spoken(topic, stored)

    def _note(self, agent_id: int, stored: Record) -> None:
        """Note a robot's own state in its relay, so that others can be compared with it."""
        relay = stored.message
        assert isinstance(relay, Relay)  # noqa: S101 - by topic
        try:
            told = read(relay, len(self._ids))
        except MalformedMessageError:
            return
        for motion in told.motions:
            if motion.rank == self._rank[agent_id] and not motion.age:
                self._motions.put((agent_id, relay.step), motion._replace(signature=b""))

    def _relay(self, agent_id: int, stored: Record) -> Finding:
        """Return the finding on a relay, and note what its sender has computed."""
        relay, peer = stored.message, self._peers[agent_id]
        assert isinstance(relay, Relay)  # noqa: S101 - by topic
        last, peer.last = peer.last, (relay.step, relay.round)
        if peer.last not in {(last[0], last[1] + 1), (last[0] + 1, 0)}:
            peer.lose()
        if self._history.is_ambiguous(stored.topic, relay.step, agent_id):
            peer.lose()
            peer.told[relay.step] = False
            return AMBIGUOUS
        wrong = wrong_stamp(relay, self._schedule) or judge(stored, relay._replace(complete=0, last=0), 0.0)
        if wrong:
            return wrong
        try:
            told = read(relay, len(self._ids))
        except MalformedMessageError as error:
            return Difference.of(relay, "content", in_hex(relay.content), None, str(error))
        if relay.step != last[0] and last[0] in peer.told and told.orders != peer.orders.get(last[0]):
            peer.told[last[0]] = False  # an operator may have told it that, and it told its neighbours at once
        whole = not relay.round or last == (relay.step, relay.round - 1)
        peer.told[relay.step] = peer.told.get(relay.step, True) and whole and len(told.answers) < MOST_ANSWERS
        peer.orders[relay.step] = told.orders
        findings = [self._passed_on(relay, motion) for motion in told.motions]
        findings += [self._introduced(relay, rank, constants) for rank, constants in told.constants.items()]
        findings.append(self._of_plane(relay, told.plane))
        for answer in told.answers:
            findings.append(self._answer(relay, peer, answer))
        findings.append(self._continued(relay, peer, told))
        differences = (finding for finding in findings if isinstance(finding, Difference))
        return next(differences, None) or next((finding for finding in findings if finding), None)

    def _passed_on(self, relay: Relay, motion: Motion) -> Finding:
        """Compare a state that is passed on with the one that its author has published; signatures are not checked."""
        motion = motion._replace(signature=b"")
        author, step = self._ids[motion.rank], relay.step - motion.age
        if step > relay.step + self._ahead:
            return Difference.of(relay, f"robot_{author}.step", step, None, "from the future")
        stored = self._history.on(AGENT_STATE, step).get(author)
        told = self._motions.get((author, step))
        if stored is not None and self._history.is_ambiguous(AGENT_STATE, step, author):
            return AMBIGUOUS
        if stored is not None:
            published = motion_of(motion.rank, self._known(stored), relay.step)
        elif told is not None:
            published = told._replace(age=motion.age)
        else:
            return NO_AUTHOR
        if motion == published:
            return None
        if motion.status == Status.LEFT and author in self._removed:
            published = published._replace(status=motion.status)
            if motion == published:
                return None
        name = next(name for name, a, b in zip(motion._fields, motion, published, strict=True) if a != b)
        whose = "it" if author == relay.agent_id else f"robot {author}"
        of = self._similar(author, step, motion)
        reason = f"{whose} never published that" if of is None else f"that is the state of step {of}"
        values: tuple[Value, Value] = getattr(motion, name), getattr(published, name)
        return Difference.of(relay, f"robot_{author}.{name}", *values, f"its state of step {step}: {reason}")

    def _similar(self, author: int, step: int, motion: Motion) -> int | None:
        """Return the step of a robot's state with this position and velocity near another step."""
        for near in range(step - 3 * self._lag, step + 3 * self._lag + 1):
            state = self._history.get(AgentState, near, author)
            if state is not None and (state.position, state.velocity) == (motion.position, motion.velocity):
                return near
        return None

    def _known(self, stored: Record) -> AgentState:
        assert isinstance(stored.message, AgentState)  # noqa: S101 - by topic
        return passed_on(stored.message, self._schedule)

    def _introduced(self, relay: Relay, rank: int, constants: Constants) -> Finding:
        agent_id = self._ids[rank]
        own = self._constants[agent_id]
        name = next((name for name, a, b in zip(own._fields, constants, own, strict=True) if a != b), None)
        if name is None:
            return None
        return Difference.of(relay, f"robot_{agent_id}.{name}", getattr(constants, name), getattr(own, name))

    def _of_plane(self, relay: Relay, plane: PlaneState | None) -> Finding:
        if plane is None:
            return None
        try:
            published = self._history.sure(PlaneState, plane.step, NO_PLANE)
        except UnconfirmedError as error:
            return error.finding
        name = next((name for name, a, b in zip(plane._fields, plane, published, strict=True) if a != b), None)
        if name is None:
            return None
        values = getattr(plane, name), getattr(published, name)
        return Difference.of(relay, f"plane.{name}", *values, f"the plane never published that in step {plane.step}")

    # What a robot has computed

    def _answer(self, relay: Relay, peer: _Peer, answer: Answer) -> Finding:
        """Recompute what a robot has computed for a step; return what is wrong with what it says of that."""
        own = peer.own.setdefault(answer.step, _Own())
        try:
            if answer.since is not None:
                peer.division = None
            if answer.summed:
                self._sum_up(relay, answer, own)
            if answer.since is not None:
                own.messages[DESIRED_ABSTRACT_STATE] = self._asked(relay, peer, answer)
        except UnconfirmedError as error:
            own.problem = error.finding
            if answer.since is not None:
                peer.generator = None
            return error.finding
        return None

    def _sum_up(self, relay: Relay, answer: Answer, own: _Own) -> None:
        if answer.states is None:
            raise UnconfirmedError(NOT_TOLD)
        newest = max((step for rank, step in answer.states.items() if rank not in answer.resting), default=0)
        if newest > relay.step + self._ahead:
            raise UnconfirmedError(Difference.of(relay, "state_steps", newest, None, "from the future"))
        states = {self._ids[rank]: self._state(self._ids[rank], step) for rank, step in answer.states.items()}
        ages = {self._ids[rank]: answer.step - step for rank, step in answer.states.items()}
        standing = {i for i, age in ages.items() if age > self._age or self._rank[i] in answer.resting}
        swarm = states, standing, answer.step, self._schedule.begin(answer.step, OBSERVER_PHASE)
        sums = (*self._sums.sum_up(*swarm), self._sums.divide(*swarm))
        own.messages |= zip((ABSTRACT_STATE, AUXILIARY_STATE, STANDING), sums, strict=True)
        own.speaks = min((i for i in states if i not in standing), default=0) == relay.agent_id

    def _state(self, agent_id: int, step: int) -> AgentState:
        """Return a state that a robot has summed up; raise `UnconfirmedError` if it is not known."""
        place = agent_id, step
        stored = self._history.on(AGENT_STATE, step).get(agent_id) or self._states.get(place)
        if stored is None:
            motion = self._motions.get(place)
            if motion is None:
                raise UnconfirmedError(NO_STATES)
            return motion.state(agent_id, self._constants[agent_id], step, self._schedule)
        if self._history.is_ambiguous(AGENT_STATE, step, agent_id):
            raise UnconfirmedError(AMBIGUOUS)
        self._states.put(place, stored)
        return self._known(stored)

    def _asked(self, relay: Relay, peer: _Peer, answer: Answer) -> DesiredAbstractState:
        """Return the desired state with which a robot has answered a state of the plane."""
        step, since = answer.step, answer.since
        divided = peer.division = self._division(relay, peer, answer)
        plane = self._history.sure(PlaneState, step, NO_PLANE)
        if since == NEVER:
            peer.generator, peer.law_step, peer.begun = self._law.generator(self._law.make_law()), step - 1, step
        elif since != peer.law_step:
            peer.generator = None
        generator = peer.generator
        if generator is None:
            raise UnconfirmedError(NO_ANSWER_BEFORE)
        desired = None
        try:
            while peer.law_step < step:
                peer.law_step += 1
                if divided is not None:
                    generator.divide(divided)
                _, desired = generator.advance((peer.law_step - peer.begun) * self._schedule.period_ns, plane)
        except RunError as error:
            raise UnconfirmedError(Difference.of(relay, "mode", Mode.RUN, Mode.STOP, str(error))) from error
        if desired is None:
            raise UnconfirmedError(Difference.of(relay, "since", since, None, f"it answers step {step}"))
        return desired

    def _division(self, relay: Relay, peer: _Peer, answer: Answer) -> StandingState | None:
        of = answer.division
        if of is None:
            return None
        if abs(of - answer.step) > self._age:
            raise UnconfirmedError(Difference.of(relay, "division", of, answer.step, "not a recent step"))
        own = peer.own.get(of)
        divided = None if own is None else own.messages.get(STANDING)
        if not isinstance(divided, StandingState):
            raise UnconfirmedError(NO_RELAY if own is None or own.problem is None else NO_STATES)
        return divided

    def _continued(self, relay: Relay, peer: _Peer, told: Told) -> Finding:
        """Continue from what a robot says of its law, which other robots have pulled; compare what they have not."""
        law, progress, generator = told.law, told.progress, peer.generator
        if progress == ():
            generator = self._law.generator(self._law.make_law()) if law.begun >= 0 else None
        elif generator is not None and law.step != peer.law_step:
            generator = None
        elif progress is not None:
            if generator is not None:
                pairs = zip(progress, generator.progress, strict=True)
                if wrong := next((pair for pair in pairs if self._differ(*pair)), None):
                    return Difference.of(relay, "progress", *wrong, "the desired state from which it continues")
            elif peer.division is not None and peer.division.moving_count:
                generator = self._law.generator(self._law.make_law())
                generator.restore(progress, peer.division)
        peer.generator, peer.law_step, peer.begun = generator, law.step, law.begun
        if generator is not None:
            try:
                generator.recall(law.memory)
            except (ValueError, IndexError):
                return Difference.of(relay, "memory", str(law.memory), None, "not of this law")
        return None

    def _differ(self, recorded: float, expected: float) -> bool:
        return recorded != expected and not abs(recorded - expected) <= self._tolerance * (1.0 + abs(expected))

    # What is published for recorders

    def _spoken(self, topic: Topic, stored: Record) -> Finding:
        """Compare a broadcast with what the robot computed that speaks for all; while views differ, with several."""
        message = stored.message
        if isinstance(message, DesiredAbstractState):
            if message.mode != Mode.RUN:
                return self._still(stored, message)
            self._not_told.clear()
        step = message.step
        computed = [own for peer in self._peers.values() if (own := peer.own.get(step)) is not None]
        possible = [own.messages[topic] for own in computed if own.speaks and topic in own.messages]
        if topic is DESIRED_ABSTRACT_STATE:  # it is stamped with the time at which a state of the plane has come
            possible = [one._replace(stamp=message.stamp) for one in possible]
        differences = [judge(stored, one, self._tolerance) for one in possible]
        if None in differences:
            return None
        if problem := next((own.problem for own in computed if own.problem), None):
            return problem if isinstance(problem, str) else NO_STATES
        if not self._tells_all(step):
            return NO_RELAY
        reason = "no robot that speaks for all has computed that"
        return (
            differences[0]._replace(reason=reason) if differences and differences[0] else surplus(stored, step, reason)
        )

    def _tells_all(self, step: int) -> bool:
        """Return whether the bag tells what each robot has computed for a step that is in the bag around it."""
        near = range(step - self._lag, step + self._lag + 1)
        needed = range(step - self._ahead, step + self._lag)
        there = [
            peer
            for agent_id, peer in self._peers.items()
            if any(k in peer.told or agent_id in self._history.on(AGENT_STATE, k) for k in near)
        ]
        return bool(there) and all(step in peer.own or all(peer.told.get(k) for k in needed) for peer in there)

    def _still(self, stored: Record, asked: DesiredAbstractState) -> Finding:
        """Compare what is published while the swarm holds still: the last answer of its author, with zero rates.

        That one is on the curve if no robots stand. It may not be in the bag, but each robot has only one.
        """
        known = [self._law.manifold.inertia(asked.torque), *self._not_told]
        for peer in self._peers.values():
            answers = (own.messages.get(DESIRED_ABSTRACT_STATE) for step, own in peer.own.items() if step <= asked.step)
            answered = (one for one in (peer.asked, *answers) if isinstance(one, DesiredAbstractState))
            known += [one.inertia for one in answered if one.torque == asked.torque]
        still = DesiredAbstractState(asked.stamp, asked.step, asked.mode, asked.torque, asked.inertia)
        differences = [judge(stored, still._replace(inertia=inertia), self._tolerance) for inertia in known]
        if None in differences:
            return None
        if judge(stored, still, self._tolerance) is None and len(self._not_told) < len(self._ids):
            self._not_told.append(asked.inertia)
            return NO_ANSWER_BEFORE
        return differences[0]

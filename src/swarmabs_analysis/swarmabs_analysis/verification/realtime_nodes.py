"""Recomputation of the messages of each node in real time, from the inputs that they name."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, ClassVar, Generic, TypeAlias, TypeVar

from swarmabs_analysis.difference import Difference, judge
from swarmabs_analysis.verification.history import AMBIGUOUS, NO_STATES, UnconfirmedError, refuse_if, wrong_stamp
from swarmabs_core.abstraction import is_degenerate
from swarmabs_core.controllers import StateFeedback
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BROADCASTS,
    DESIRED_ABSTRACT_STATE,
    NEVER,
    PLANE_STATE,
    STANDING,
    AbstractState,
    AgentState,
    AuxiliaryState,
    Broadcast,
    DesiredAbstractState,
    Mode,
    PlaneState,
    Source,
    StandingState,
    Status,
)
from swarmabs_core.realtime import controller
from swarmabs_core.realtime.agent import RealtimeAgentConfig, RealtimeLaw
from swarmabs_core.realtime.controller import RealtimeControllerConfig
from swarmabs_core.realtime.drives import moved
from swarmabs_core.realtime.observer import RealtimeObserverConfig, RealtimeSums, Role
from swarmabs_core.realtime.plane import PlaneMotion, RealtimePlaneConfig

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from swarmabs_analysis.verification.base import Finding
    from swarmabs_analysis.verification.history import History
    from swarmabs_core.controllers import ParentController
    from swarmabs_core.desired_state import DesiredStateGenerator
    from swarmabs_core.messages import Basis, Message, Topic
    from swarmabs_core.record import Record

Config = TypeVar("Config", RealtimeAgentConfig, RealtimeObserverConfig, RealtimePlaneConfig, RealtimeControllerConfig)

NO_STATE_BEFORE = "the robot's state of the previous step is not in the bag"
OWN_LIMITS = "the robot has its own limits"
NO_BROADCASTS = "the broadcasts that the robot followed are not in the bag"
NO_ANSWER_BEFORE = "the answer from which it continues is not in the bag"
NO_DIVISION = "what the observer told of standing robots is not in the bag"
NO_PLANE = "the plane's state that it answers is not in the bag"
_ROUNDING = 1e-12


Followed: TypeAlias = "tuple[History, History]"
"""The messages among which are those of the observer and of the parent controller that a robot followed."""


class _Check(Generic[Config]):
    """The common part of the checks: configuration of the node, recorded messages, and the tolerance of `judge`."""

    def __init__(self, config: Config, history: History, tolerance: float) -> None:
        self._config: Config = config
        self._history = history
        self._tolerance = tolerance

    def _judge(self, stored: Record, *possible: Message) -> Difference | None:
        """Return no difference if a message is one of those that are possible, otherwise that from the first."""
        differences = [judge(stored, expected, self._tolerance) for expected in possible]
        return None if None in differences else differences[0]

    def _besides(self, field: str, stored: Record, *possible: Message) -> Difference | None:
        """Return what is wrong besides a field, which may come from a message that is not in the bag."""
        own = {field: getattr(stored.message, field)}
        return self._judge(stored, *(one._replace(**own) for one in possible))


class RobotCheck(_Check[RealtimeAgentConfig]):
    """Checks the states of one robot: each command from the previous state and the broadcasts that it names.

    Where coordinators have standbys, the broadcasts must be those of one observer and one controller; `standby` has the
    messages of the standbys.

    `start` is the initial position (m) and velocity (m/s) of a simulated body; the motion of another body is not
    checked. The commands of a robot with its own limits, unlike those of the configuration, are not checked either.
    """

    def __init__(
        self,
        config: RealtimeAgentConfig,
        history: History,
        tolerance: float,
        start: tuple[float, float] | None,
        *,
        standby: History,
        own_limits: bool = False,
    ) -> None:
        super().__init__(config, history, tolerance)
        self._standby = standby
        self._start = start
        self._own_limits = own_limits
        self._law = RealtimeLaw(config)
        self._unmeasured = self._law.unmeasured()
        self._age = config.schedule.steps(config.broadcast_age_limit)
        self._ahead = config.schedule.ahead(config.clock_tolerance)
        self._before: AgentState | None = None

    def check(self, stored: Record) -> Finding:
        """Check the robot's next state."""
        state, before = stored.message, self._before
        assert isinstance(state, AgentState)  # noqa: S101 - by topic
        self._before = state
        if before is not None:
            self._unmeasured.note(before.step, before.stamp, before.command)
        as_configured = state._replace(kind=self._config.kind, mass=self._config.mass, damping=self._config.damping)
        # Only the state of a simulated body is measured at the beginning of its step.
        wrong_time = None if self._start is None else wrong_stamp(state, self._config.schedule)
        if wrong := self._judge(stored, as_configured) or wrong_time:
            return wrong
        if self._history.is_ambiguous(AGENT_STATE, state.step, state.agent_id):
            return AMBIGUOUS
        if self._own_limits:
            return OWN_LIMITS
        if before is None and self._begins(state):
            return None
        if before is None or self._history.is_ambiguous(AGENT_STATE, before.step, state.agent_id):
            return NO_STATE_BEFORE
        finding = self._explain(stored, state, before)
        if isinstance(finding, Difference) and (state.step > before.step + 1 or self._unmeasured.gap):
            return NO_STATE_BEFORE  # the command may follow from a state in between
        return finding

    def _explain(self, stored: Record, state: AgentState, before: AgentState) -> Finding:
        """Return whether the broadcasts of any observer and controller explain a state: no finding if some do."""
        findings: list[Finding] = []
        for followed in self._followed(before.step):
            finding: Finding
            try:
                finding = self._judge(stored, self._move(self._follow(state, before, followed), before))
            except UnconfirmedError as error:
                finding = error.finding
            if finding is None:
                return None
            findings.append(finding)
        return next((finding for finding in findings if isinstance(finding, str)), findings[0])

    def _followed(self, step: int) -> list[Followed]:
        """Return all whom the robot may have followed in a step: those who have sent anything around it."""
        either = (self._history, self._standby)
        if self._history.paired:
            near = range(step - self._age, step + self._ahead + 1)
            observers, controllers = (
                [of for of in either if any(of.on(topic, s) for s in near)]
                for topic in (ABSTRACT_STATE, DESIRED_ABSTRACT_STATE)
            )
            if observers and controllers:
                return [*product(observers, controllers)]
        return [(self._history, self._history)]

    def _begins(self, state: AgentState) -> bool:
        """Return whether a state is the first one of a robot with a simulated body."""
        at_rest = (state.status, state.broadcast_step, state.command) == (Status.SAFE_STOP, NEVER, 0.0)
        return at_rest and (state.position, state.velocity) == self._start

    def _follow(self, state: AgentState, before: AgentState, followed: Followed) -> AgentState:
        """Return the state with the command, broadcasts and status that follow from the previous one."""
        brake = self._law.brake(before.velocity)
        still = (0.0, brake) if str(state.command) == str(0.0) else (brake, 0.0)
        at_rest = state._replace(command=still[0], broadcast_step=NEVER)
        if state.broadcast_step == NEVER:
            if state.status == Status.ACTIVE:
                self._check_hold(state, before, followed[0])
            return at_rest
        heard = self._broadcasts(state, before, followed)
        decision, _ = self._law.decide(before.position, before.velocity, heard, self._unmeasured.distance)
        if decision.problem:
            return at_rest
        measured = self._start is not None or state.status == Status.LEFT
        return state._replace(command=decision.command, status=Status.ACTIVE if measured else state.status)

    def _check_hold(self, state: AgentState, before: AgentState, observer: History) -> None:
        """Raise an error for an active robot that follows nothing, unless the swarm may have been degenerate."""
        complete = True
        for step in range(before.step - self._age, before.step + self._ahead + 1):
            sums = observer.get(AuxiliaryState, step)
            if sums is None:
                complete = complete and step > before.step
            elif is_degenerate(sums.s0, sums.s3, self._config.bounds.plane_length):
                return
        if not complete:
            raise UnconfirmedError(NO_BROADCASTS)
        reason = "it follows no broadcasts"
        raise UnconfirmedError(Difference.of(state, "status", Status.ACTIVE, Status.SAFE_STOP, reason))

    def _broadcasts(self, state: AgentState, before: AgentState, followed: Followed) -> Broadcast:
        """Return the broadcasts that the robot names, if it was allowed to follow them."""
        step, (observer, controller) = state.broadcast_step, followed
        recent = before.step - self._age <= step <= before.step + self._ahead
        _refuse_to_follow(not recent, state, f"they were {before.step - step} steps old when it decided")
        senders = (observer, observer, controller)
        if any(of.is_ambiguous(topic, step) for of, topic in zip(senders, BROADCASTS, strict=True)):
            raise UnconfirmedError(AMBIGUOUS)
        abstract, sums = observer.get(AbstractState, step), observer.get(AuxiliaryState, step)
        asked = next(iter(controller.desired(step)), None)
        if abstract is None or sums is None or asked is None:
            raise UnconfirmedError(NO_BROADCASTS)
        still = asked.mode != Mode.RUN
        if still and controller.changes_within(step):
            raise UnconfirmedError(NO_BROADCASTS)
        mode = Mode(asked.mode).name if asked.mode in set(Mode) else f"mode {asked.mode}"
        _refuse_to_follow(still, state, f"the parent controller requested {mode}")
        for message in (abstract, sums, asked):
            problem = self._config.bounds.problem(message)
            _refuse_to_follow(problem, state, f"they had to be rejected: {problem}")
        return Broadcast(asked.stamp, step, abstract, sums, asked)

    def _move(self, state: AgentState, before: AgentState) -> AgentState:
        """Return the state with the position and velocity of a simulated body."""
        if self._start is None:
            return state
        passed = state.step - before.step
        places = [self._moved((before.position, before.velocity), passed, state.command)]
        if state.broadcast_step == NEVER and state.command == 0.0:
            # Stopped at once, or its process was restarted.
            places += [self._moved((before.position, 0.0), passed, 0.0), self._start]
        there = next((p for p in places if p == (state.position, state.velocity)), places[0])
        return state._replace(position=there[0], velocity=there[1])

    def _moved(self, place: tuple[float, float], periods: int, command: float) -> tuple[float, float]:
        return moved(self._law.controller.ideal, place, command, periods, self._config.schedule)


def _refuse_to_follow(wrong: object, state: AgentState, reason: str) -> None:
    """Raise `UnconfirmedError` if it is wrong that a robot followed the broadcasts that it names."""
    refuse_if(wrong, state, "broadcast_step", state.broadcast_step, NEVER, reason)


class _CoordinatorCheck(_Check[Config]):
    """Checks what a coordinator said in each step, from the inputs that its provenance names.

    Attributes
    ----------
    source : Source
        The coordinator.
    topics : tuple of Topic
        The topics of its answers.
    """

    source: ClassVar[Source]
    topics: ClassVar[tuple[Topic, ...]]

    def check(self, step: int) -> Iterator[Finding]:
        """Yield the findings of a step."""
        expected: Mapping[Topic, Sequence[Message]] = {}
        problem: Finding = None
        try:
            expected = self._recomputed(self._history.provenance(self.source, step))
        except UnconfirmedError as error:
            problem = error.finding
        for topic in self.topics:
            for _, stored in sorted(self._history.on(topic, step).items()):
                if self._history.is_ambiguous(topic, step):
                    yield AMBIGUOUS
                else:
                    yield self._compare(stored, problem, expected.get(topic, ()))

    def _recomputed(self, provenance: Basis) -> Mapping[Topic, Sequence[Message]]:
        """Return the possible answers of a step by topic; raise `UnconfirmedError` if they cannot be recomputed."""
        raise NotImplementedError

    def _compare(self, stored: Record, problem: Finding, possible: Sequence[Message]) -> Finding:
        """Return the finding on an answer; with a `problem` those of its step could not be recomputed."""
        return problem or self._judge(stored, *possible)

    def _refuse_wrong_stamp(self, provenance: Basis) -> None:
        """Raise `UnconfirmedError` for an answer made in another step than its own."""
        if wrong := wrong_stamp(provenance, self._config.schedule):
            raise UnconfirmedError(wrong)


class ObserverCheck(_CoordinatorCheck[RealtimeObserverConfig]):
    """Checks abstract and auxiliary states, and how the former divide, against the states that the observer names."""

    source = Source.OBSERVER
    topics = (ABSTRACT_STATE, AUXILIARY_STATE, STANDING)

    def __init__(self, config: RealtimeObserverConfig, history: History, tolerance: float) -> None:
        super().__init__(config, history, tolerance)
        self._sums = RealtimeSums(config)
        self._ahead = config.schedule.ahead(config.clock_tolerance)

    def _recomputed(self, provenance: Basis) -> Mapping[Topic, Sequence[Message]]:
        states, problem = self._history.states(self.source, provenance)
        if problem:
            raise UnconfirmedError(problem)
        self._refuse_wrong_stamp(provenance)
        self._refuse_wrong_robots(provenance)
        standing = {i for i, mark in zip(provenance.agent_ids, provenance.standing, strict=True) if mark}
        for agent_id in set(states) - standing:
            silent = self._sums.role(states[agent_id], provenance.step) is Role.SILENT
            refuse_if(silent, provenance, "standing", 0, 1, f"robot {agent_id} was silent")
        swarm = states, standing, provenance.step, provenance.stamp
        abstract, auxiliary = self._sums.sum_up(*swarm)
        return dict(zip(self.topics, ([abstract], [auxiliary], [self._sums.divide(*swarm)]), strict=True))

    def _refuse_wrong_robots(self, provenance: Basis) -> None:
        ids, begins = provenance.agent_ids, (provenance.since, provenance.begun)
        refuse_if(begins != (NEVER, NEVER), provenance, "since", provenance.since, NEVER, "of the observer")
        in_order = list(ids) == sorted(set(ids) & set(self._config.members))
        refuse_if(not in_order, provenance, "agent_ids", str(ids), None, "not members in order")
        newest = max(provenance.state_steps, default=0)
        from_future = newest > provenance.step + self._ahead
        refuse_if(from_future, provenance, "state_steps", newest, None, "from the future")


class PlaneCheck(_CoordinatorCheck[RealtimePlaneConfig]):
    """Checks the simulated plane's states, each against the previous one and the robots' states that the plane names.

    With an imperfect sensor the true state is not recorded: it is tracked from the beginning, or not at all.
    """

    source = Source.PLANE
    topics = (PLANE_STATE,)

    def __init__(self, config: RealtimePlaneConfig, history: History, tolerance: float) -> None:
        super().__init__(config, history, tolerance)
        self._motion = PlaneMotion(config)
        self._true_state: tuple[int, float, float] | None = None
        self._spoke = False

    def _recomputed(self, provenance: Basis) -> Mapping[Topic, Sequence[Message]]:
        last, self._true_state = self._true_state, None
        places = self._places(provenance, last)
        states = [self._state(provenance, place) for place in places]
        stored, place = self._history.on(PLANE_STATE, provenance.step).get(0), places[0]
        if len(places) > 1 and stored is not None:
            fitting = (p for p, state in zip(places, states, strict=True) if not self._judge(stored, state))
            place = next(fitting, place)
        self._true_state = (provenance.step, *place)
        return {PLANE_STATE: states}

    def _places(self, provenance: Basis, last: tuple[int, float, float] | None) -> list[tuple[float, float]]:
        """Return the possible true states of the plane: one, unless the plane was restarted."""
        step, since, begun = provenance.step, provenance.since, provenance.begun
        self._refuse_wrong_stamp(provenance)
        marks = provenance.standing
        refuse_if(any(marks), provenance, "standing", str(marks), None, "of the plane")
        if since == NEVER:
            self._history.states(self.source, provenance)
            begin = (self._config.plane.angle, self._config.plane.angular_velocity)
            return [begin] if last is None else [begin, last[1:], (last[1], begin[1])]
        try:
            before = self._history.provenance(self.source, since, NO_ANSWER_BEFORE)
            start = self._start(since, last, held=before.begun == NEVER)
            released = before.begun == NEVER and since <= begun <= step
            refuse_if(begun != before.begun and not released, provenance, "begun", begun, before.begun, "of the plane")
            earlier, lost = self._history.states(self.source, before)
        finally:
            robots, missed = self._history.states(self.source, provenance)  # last, so that these states are kept
        if begun == NEVER:
            return [start]
        if lost or missed:
            raise UnconfirmedError(NO_STATES)
        return [self._motion.advance(start, earlier, robots, step - since, since - begun)]

    def _compare(self, stored: Record, problem: Finding, possible: Sequence[Message]) -> Finding:
        """Return the finding; where a plane that has spoken was held, its last state may not be in the bag."""
        finding, spoke = super()._compare(stored, problem, possible), self._spoke
        self._spoke = True
        if problem or not isinstance(finding, Difference) or not spoke:
            return finding
        if self._history.provenance(self.source, stored.message.step).since != NEVER:
            return finding
        return self._besides("angle", stored, *possible) or NO_ANSWER_BEFORE

    def _start(self, since: int, last: tuple[int, float, float] | None, *, held: bool) -> tuple[float, float]:
        """Return the true state from which the plane continued; while held, it keeps its initial state."""
        if self._config.plane.sensor.perfect:
            state = self._history.sure(PlaneState, since, NO_ANSWER_BEFORE)
            return state.angle, self._config.plane.angular_velocity if held else state.angular_velocity
        if last is None or last[0] != since:
            raise UnconfirmedError(NO_ANSWER_BEFORE)
        return last[1:]

    def _state(self, provenance: Basis, place: tuple[float, float]) -> PlaneState:
        """Return the state that the plane publishes; while held, it is at rest."""
        rate = 0.0 if provenance.begun == NEVER else place[1]
        return PlaneState(provenance.stamp, provenance.step, *self._motion.measured(place[0], rate, provenance.step))


class ControllerCheck(_CoordinatorCheck[RealtimeControllerConfig]):
    """Checks desired states against the plane's state and earlier ones; `make_law` creates the control law.

    The `observers` have the messages of the observer and of its standby.
    """

    source = Source.CONTROLLER
    topics = (DESIRED_ABSTRACT_STATE,)

    def __init__(
        self,
        config: RealtimeControllerConfig,
        history: History,
        tolerance: float,
        make_law: Callable[[], ParentController],
        observers: tuple[History, History],
    ) -> None:
        super().__init__(config, history, tolerance)
        self._observers = observers
        self._make_law = make_law
        self._generator: DesiredStateGenerator | None = None
        self._last: DesiredAbstractState | None = None  # in mode RUN
        self._still: DesiredAbstractState | None = None  # in another mode, since then
        self._law_step = self._begun = -1

    def _recomputed(self, provenance: Basis) -> Mapping[Topic, Sequence[Message]]:
        step, since = provenance.step, provenance.since
        begins = since == NEVER and provenance.begun == step
        missed = step - since
        follows = since == self._law_step and provenance.begun == self._begun and 0 < missed <= controller.MOST_STEPS
        generator, self._generator = self._generator, None
        lost = generator is not None and not (begins or follows or self._law_step < since < step)
        refuse_if(lost, provenance, "since", since, self._law_step, f"its law began at {provenance.begun}")
        plane = self._history.sure(PlaneState, step, NO_PLANE)
        divided = self._division(provenance)
        if begins:
            self._law_step, self._begun, generator = step - 1, step, self._config.generator(self._make_law())
        elif not follows or generator is None:
            generator = self._resumed(provenance, divided)
        desired = self._advanced(generator, plane, divided)
        self._generator = generator
        return {DESIRED_ABSTRACT_STATE: [desired._replace(stamp=provenance.stamp)]}

    def _advanced(
        self, generator: DesiredStateGenerator, plane: PlaneState, divided: StandingState | None
    ) -> DesiredAbstractState:
        """Return the desired state that answers a state of the plane, which also answers missed steps before it."""
        try:
            while True:
                self._law_step += 1
                time = (self._law_step - self._begun) * self._config.schedule.period_ns
                if divided is not None:
                    generator.divide(divided)
                _, desired = generator.advance(time, plane)
                if self._law_step == plane.step:
                    return desired
        except RunError as error:
            topic = DESIRED_ABSTRACT_STATE.name
            difference = Difference(topic, plane.step, None, "mode", Mode.RUN, Mode.STOP, str(error))
            raise UnconfirmedError(difference) from error

    def _compare(self, stored: Record, problem: Finding, possible: Sequence[Message]) -> Finding:
        asked = stored.message
        assert isinstance(asked, DesiredAbstractState)  # noqa: S101 - by topic
        if asked.mode != Mode.RUN:
            finding = self._compare_still(stored, asked)
            self._still = asked
            return finding
        self._last, self._still = asked, None
        return super()._compare(stored, problem, possible)

    def _compare_still(self, stored: Record, asked: DesiredAbstractState) -> Finding:
        """Compare what is published while the swarm holds still: the last desired state in mode RUN with zero rates.

        That one is on the curve if no robots stand. It may not be in the bag (a standby's never is), but the next
        ones of the mode repeat it.
        """
        before, age = self._still, self._config.schedule.steps(self._config.plane_age_limit)
        repeats = before is not None and before.mode == asked.mode and asked.step - before.step <= age
        last = before if repeats else self._last
        inertia = self._config.manifold.inertia(asked.torque)
        if last is not None and last.torque == asked.torque:
            inertia = last.inertia
        elif abs(asked.inertia - inertia) <= _ROUNDING * inertia:
            inertia = asked.inertia  # computed around robots that stand, for a message that was not recorded
        still = DesiredAbstractState(asked.stamp, asked.step, asked.mode, asked.torque, inertia)
        wrong = self._judge(stored, still)
        answered = self._last is not None and self._last.step >= asked.step
        sure = repeats or answered or self._besides("inertia", stored, still)
        return wrong if wrong is None or sure else NO_ANSWER_BEFORE

    def _division(self, provenance: Basis) -> StandingState | None:
        """Return how the abstract state divides, by the observer or standby that the controller names, if any."""
        steps, ids, marks = provenance.state_steps, provenance.agent_ids, provenance.standing
        if not (steps or ids or marks):
            return None
        age = self._config.schedule.steps(self._config.plane_age_limit)
        refuse_if(ids != (0,), provenance, "agent_ids", str(ids), "(0,)", "of the controller")
        refuse_if(marks not in {(0,), (1,)}, provenance, "standing", str(marks), None, "not one observer")
        outdated = abs(steps[0] - provenance.step) > age
        refuse_if(outdated, provenance, "state_steps", steps[0], None, "not a recent step")
        return self._observers[marks[0]].sure(StandingState, steps[0], NO_DIVISION)

    def _resumed(self, provenance: Basis, divided: StandingState | None) -> DesiredStateGenerator:
        """Return the generator as it was before an answer, which is possible only for a law without memory.

        It is not possible either while the desired state is on its way to another curve.
        """
        law = self._make_law()
        asked = self._history.get(DesiredAbstractState, provenance.step, Mode.RUN)
        if asked is None or not isinstance(law, StateFeedback):
            raise UnconfirmedError(NO_ANSWER_BEFORE)
        generator = self._config.generator(law)
        if divided is not None:
            generator.divide(divided)
        generator.resume(asked)
        if not generator.on_curve:
            raise UnconfirmedError(NO_ANSWER_BEFORE)
        self._law_step, self._begun = provenance.step - 1, provenance.begun
        return generator

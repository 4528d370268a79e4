"""What the coordinators have published in real time, each answer from what its basis names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar

from swarmabs_analysis.difference import Difference, judge
from swarmabs_analysis.verification.history import AMBIGUOUS, NO_STATES
from swarmabs_core.controllers import StateFeedback
from swarmabs_core.desired_state import DesiredStateGenerator
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AUXILIARY_STATE,
    BASIS,
    DESIRED_ABSTRACT_STATE,
    NEVER,
    PLANE_STATE,
    DesiredAbstractState,
    Mode,
    PlaneState,
    Source,
)
from swarmabs_core.realtime.controller import MOST_STEPS
from swarmabs_core.realtime.observer import RealtimeSums, Role
from swarmabs_core.realtime.plane import PlaneMotion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from swarmabs_analysis.verification.history import History
    from swarmabs_core.controllers import ParentController
    from swarmabs_core.messages import AgentState, Basis, Message
    from swarmabs_core.realtime.controller import RealtimeControllerConfig
    from swarmabs_core.realtime.observer import RealtimeObserverConfig
    from swarmabs_core.realtime.plane import RealtimePlaneConfig
    from swarmabs_core.record import Record

Config = TypeVar("Config")
Finding: TypeAlias = "Difference | str | None"
"""None if a message is right, else what is wrong, or why it cannot be checked."""

NO_BASIS = "what it was computed from is not in the bag"
NO_ANSWER_BEFORE = "the answer from which it goes on is not in the bag"
NO_PLANE = "the plane's state that it answers is not in the bag"


class _Check(Generic[Config]):
    """What the checks have in common.

    Parameters
    ----------
    config
        How the coordinator was configured.
    history : History
        What the bag holds.
    tolerance : float
        As of `judge`.
    """

    def __init__(self, config: Config, history: History, tolerance: float) -> None:
        self._config = config
        self._history = history
        self._tolerance = tolerance

    def _judge(self, stored: Record, expected: Message) -> Difference | None:
        return judge(stored, expected, None, self._tolerance)


class ObserverCheck(_Check["RealtimeObserverConfig"]):
    """Abstract and auxiliary states, from the robots' states that the observer names."""

    def __init__(self, config: RealtimeObserverConfig, history: History, tolerance: float) -> None:
        super().__init__(config, history, tolerance)
        self._sums = RealtimeSums(config)
        self._ahead = config.schedule.ahead(config.clock_tolerance)

    def check(self, step: int) -> Iterator[Finding]:
        """Check what there is of a step."""
        answers = [s for t in (ABSTRACT_STATE, AUXILIARY_STATE) if (s := self._history.get(t, step)) is not None]
        basis = self._history.basis(Source.OBSERVER, step)
        if basis is None:
            yield from (NO_BASIS for _ in answers)
            return
        states = self._history.states(Source.OBSERVER, basis)
        if isinstance(states, str):
            yield from (states for _ in answers)
            return
        wrong = wrong_time(basis, self._config.schedule.step(basis.stamp)) or self._wrong_basis(basis)
        wrong = wrong or self._wrong_standing(basis, states)
        abstract, sums = self._sums.sum_up(states, _standing(basis), step, basis.stamp)
        for stored in answers:
            expected = abstract if stored.topic is ABSTRACT_STATE else sums
            found = AMBIGUOUS if self._history.is_ambiguous(stored.topic, step) else wrong
            yield found or self._judge(stored, expected)

    def _wrong_standing(self, basis: Basis, states: Mapping[int, AgentState]) -> Difference | None:
        """Return that a robot of which nothing new was known was not taken to stand."""
        for agent_id in set(states) - _standing(basis):
            if self._sums.role(states[agent_id], basis.step) is Role.SILENT:
                reason = f"robot {agent_id} was silent"
                return Difference(BASIS.name, basis.step, None, "standing", 0, 1, reason)
        return None

    def _wrong_basis(self, basis: Basis) -> Difference | None:
        ids = basis.agent_ids
        if (basis.since, basis.begun) != (NEVER, NEVER):
            return Difference(BASIS.name, basis.step, None, "since", basis.since, NEVER, "of the observer")
        if list(ids) != sorted(set(ids)) or not set(ids) <= set(self._config.members):
            return Difference(BASIS.name, basis.step, None, "agent_ids", str(ids), None, "not members in order")
        newest = max(basis.state_steps, default=0)
        if newest > basis.step + self._ahead:
            return Difference(BASIS.name, basis.step, None, "state_steps", newest, None, "from the future")
        return None


class PlaneCheck(_Check["RealtimePlaneConfig"]):
    """The simulated plane's states, each from the one before and the robots' states that the plane names.

    With a sensor that is not perfect the true state is not recorded: it is followed from the beginning, or not at all.
    """

    def __init__(self, config: RealtimePlaneConfig, history: History, tolerance: float) -> None:
        super().__init__(config, history, tolerance)
        self._motion = PlaneMotion(config)
        self._truth: tuple[int, float, float] | None = None

    def check(self, step: int) -> Iterator[Finding]:
        """Check what there is of a step."""
        stored = self._history.get(PLANE_STATE, step)
        basis = self._history.basis(Source.PLANE, step)
        if basis is None:
            if stored is not None:
                yield NO_BASIS
            return
        last, self._truth = self._truth, None
        places = self._places(basis, last)
        if not isinstance(places, list):
            if stored is not None:
                yield places
            return
        self._truth = (step, *places[0])
        if stored is None:
            return
        if self._history.is_ambiguous(PLANE_STATE, step):
            yield AMBIGUOUS
            return
        wrong = [self._judge(stored, self._state(basis, place)) for place in places]
        if None in wrong:
            self._truth = (step, *places[wrong.index(None)])
        yield None if None in wrong else wrong[0]

    def _places(
        self, basis: Basis, last: tuple[int, float, float] | None
    ) -> list[tuple[float, float]] | Difference | str:
        """Return the true states in which the plane may be: one, but for a plane that has begun anew."""
        step, since = basis.step, basis.since
        wrong = wrong_time(basis, self._config.schedule.step(basis.stamp))
        if wrong is not None:
            return wrong
        if since == NEVER:
            self._history.states(Source.PLANE, basis)
            begin = (self._config.plane.angle, self._config.plane.angular_velocity)
            return [begin] if last is None else [begin, last[1:], (last[1], begin[1])]
        before = self._history.basis(Source.PLANE, since)
        start = None if before is None else self._start(since, last, held=before.begun == NEVER)
        if start is None or before is None:
            self._history.states(Source.PLANE, basis)
            return NO_ANSWER_BEFORE
        if basis.begun != before.begun and not (before.begun == NEVER and since <= basis.begun <= step):
            return Difference(BASIS.name, step, None, "begun", basis.begun, before.begun, "of the plane")
        earlier = self._history.states(Source.PLANE, before)
        robots = self._history.states(Source.PLANE, basis)  # last, so that these are kept
        if basis.begun == NEVER:
            return [start]
        if isinstance(robots, str) or isinstance(earlier, str):
            return NO_STATES
        return [self._motion.advance(start, earlier, robots, step - since, since - basis.begun)]

    def _start(self, since: int, last: tuple[int, float, float] | None, *, held: bool) -> tuple[float, float] | None:
        """Return the true state from which the plane went on; while it is held, it keeps what it begins with."""
        if self._config.plane.sensor.perfect:
            stored = self._history.get(PLANE_STATE, since)
            if stored is None or self._history.is_ambiguous(PLANE_STATE, since):
                return None
            state = stored.message
            assert isinstance(state, PlaneState)  # noqa: S101 - kept by topic
            return state.angle, self._config.plane.angular_velocity if held else state.angular_velocity
        return last[1:] if last is not None and last[0] == since else None

    def _state(self, basis: Basis, place: tuple[float, float]) -> PlaneState:
        """Return what the plane says of where it is; while it is held, that it is at rest."""
        measured = self._motion.measured(place[0], 0.0 if basis.begun == NEVER else place[1], basis.step)
        return PlaneState(basis.stamp, basis.step, *measured)


class ControllerCheck(_Check["RealtimeControllerConfig"]):
    """Desired states, each from the plane's state and those before.

    Parameters
    ----------
    config, history, tolerance
        As of the other checks.
    make_law : callable
        Makes the control law.
    """

    def __init__(
        self,
        config: RealtimeControllerConfig,
        history: History,
        make_law: Callable[[], ParentController],
        tolerance: float,
    ) -> None:
        super().__init__(config, history, tolerance)
        self._make_law = make_law
        self._generator: DesiredStateGenerator | None = None
        self._law_step = self._begun = -1

    def check(self, step: int) -> Iterator[Finding]:
        """Check what there is of a step."""
        answers = self._history.desired(step)
        asked = next(
            (m for s in answers if isinstance(m := s.message, DesiredAbstractState) and m.mode == Mode.RUN), None
        )
        basis = self._history.basis(Source.CONTROLLER, step)
        expected = NO_BASIS if basis is None else self._expected(basis, asked)
        for stored in answers:
            message = stored.message
            assert isinstance(message, DesiredAbstractState)  # noqa: S101 - kept by topic
            if self._history.is_ambiguous(DESIRED_ABSTRACT_STATE, step):
                yield AMBIGUOUS
            elif message.mode != Mode.RUN:
                yield self._still(stored, message)
            elif isinstance(expected, DesiredAbstractState):
                yield self._judge(stored, expected)
            else:
                yield expected

    def _expected(self, basis: Basis, asked: DesiredAbstractState | None) -> DesiredAbstractState | Difference | str:
        step, since = basis.step, basis.since
        stored = self._history.get(PLANE_STATE, step)
        begins = since == NEVER and basis.begun == step
        follows = since == self._law_step and basis.begun == self._begun and 0 < step - since <= MOST_STEPS
        generator, self._generator = self._generator, None
        known = generator is not None and not begins
        if known and not (follows or self._law_step < since < step):
            return Difference(BASIS.name, step, None, "since", since, self._law_step, f"its law began at {basis.begun}")
        if stored is None or self._history.is_ambiguous(PLANE_STATE, step):
            return NO_PLANE
        if begins:
            self._law_step, self._begun, generator = step - 1, step, self._new_generator()
        elif not follows or generator is None:
            generator = self._resumed(basis, asked)
        if generator is None:
            return NO_ANSWER_BEFORE
        plane = stored.message
        assert isinstance(plane, PlaneState)  # noqa: S101 - kept by topic
        try:
            while True:
                self._law_step += 1
                time = (self._law_step - self._begun) * self._config.schedule.period_ns
                _, desired = generator.advance(time, plane)
                if self._law_step == step:
                    break
        except RunError as error:
            return Difference(DESIRED_ABSTRACT_STATE.name, step, None, "mode", Mode.RUN, Mode.STOP, str(error))
        self._generator = generator
        return desired._replace(stamp=basis.stamp)

    def _resumed(self, basis: Basis, asked: DesiredAbstractState | None) -> DesiredStateGenerator | None:
        """Return the generator as it was before an answer, if a law without memory makes that known."""
        law = self._make_law()
        if asked is None or not isinstance(law, StateFeedback):
            return None
        generator = DesiredStateGenerator(self._config.schedule.period_ns, self._config.manifold, law)
        generator.resume(asked.torque, asked.torque_rate)
        self._law_step, self._begun = basis.step - 1, basis.begun
        return generator

    def _new_generator(self) -> DesiredStateGenerator:
        return DesiredStateGenerator(self._config.schedule.period_ns, self._config.manifold, self._make_law())

    def _still(self, stored: Record, asked: DesiredAbstractState) -> Difference | None:
        """Check what is published while the swarm keeps still: some point of the manifold, without any rate."""
        torque, inertia = asked.torque, self._config.manifold.inertia(asked.torque)
        still = DesiredAbstractState(asked.stamp, asked.step, asked.mode, torque, inertia, *(0.0,) * 6)
        return self._judge(stored, still)


def _standing(basis: Basis) -> set[int]:
    return {agent_id for agent_id, mark in zip(basis.agent_ids, basis.standing, strict=True) if mark}


def wrong_time(basis: Basis, step: int) -> Difference | None:
    """Return that an answer was made in another step than its own."""
    if step == basis.step:
        return None
    return Difference(BASIS.name, basis.step, None, "stamp", basis.stamp, None, f"that is in step {step}")

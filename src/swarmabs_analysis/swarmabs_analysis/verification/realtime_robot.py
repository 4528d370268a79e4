"""A robot's recorded states in real time: each command from the state before and the broadcasts that it names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_analysis.difference import Difference, judge
from swarmabs_analysis.verification.history import AMBIGUOUS
from swarmabs_core.abstraction import is_degenerate
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BROADCASTS,
    NEVER,
    AbstractState,
    AgentState,
    AuxiliaryState,
    Broadcast,
    DesiredAbstractState,
    Mode,
    Status,
)
from swarmabs_core.realtime.agent import RealtimeLaw
from swarmabs_core.realtime.drives import MOST_STEPS

if TYPE_CHECKING:
    from swarmabs_analysis.verification.history import History
    from swarmabs_core.realtime.agent import RealtimeAgentConfig
    from swarmabs_core.record import Record

NO_STATE_BEFORE = "the robot's state of the step before is not in the bag"
OWN_LIMITS = "the robot has limits of its own"
NO_BROADCASTS = "the broadcasts that the robot followed are not in the bag"


class RobotCheck:
    """Follows the states of one robot in the order of their steps.

    Parameters
    ----------
    config : RealtimeAgentConfig
        How the robot was configured.
    history : History
        What the bag holds.
    start : tuple of float, optional
        Position (m) and velocity (m/s) at which a simulated body begins; None if the body is not simulated, and its
        motion is not checked.
    tolerance : float
        As of `judge`.
    own_limits : bool
        Whether the robot's limits are not those of the configuration, so that its commands cannot be checked.
    """

    def __init__(
        self,
        config: RealtimeAgentConfig,
        history: History,
        start: tuple[float, float] | None,
        tolerance: float,
        *,
        own_limits: bool = False,
    ) -> None:
        self._config = config
        self._history = history
        self._start = start
        self._own_limits = own_limits
        self._tolerance = tolerance
        self._law = RealtimeLaw(config)
        self._age = config.schedule.steps(config.broadcast_age_limit)
        self._ahead = config.schedule.ahead(config.clock_tolerance)
        self._before: AgentState | None = None

    def check(self, stored: Record) -> Difference | str | None:
        """Check the next state: None if it is right, else what is wrong, or why it cannot be checked."""
        state, before = stored.message, self._before
        assert isinstance(state, AgentState)  # noqa: S101 - the history keeps them apart
        self._before = state
        known = state._replace(kind=self._config.kind, mass=self._config.mass, damping=self._config.damping)
        wrong = judge(stored, known, state.agent_id, self._tolerance) or self._wrong_time(state)
        if wrong is not None:
            return wrong
        if self._history.is_ambiguous(AGENT_STATE, state.step, state.agent_id):
            return AMBIGUOUS
        if self._own_limits:
            return OWN_LIMITS
        if before is None and self._begins(state):
            return None
        if before is None or self._history.is_ambiguous(AGENT_STATE, before.step, state.agent_id):
            return NO_STATE_BEFORE
        expected = self._follow(state, before)
        found = (
            judge(stored, self._move(expected, before), state.agent_id, self._tolerance)
            if isinstance(expected, AgentState)
            else expected
        )
        if isinstance(found, Difference) and state.step > before.step + 1:
            return NO_STATE_BEFORE  # the command may be of a state in between
        return found

    def _begins(self, state: AgentState) -> bool:
        """Tell whether a state is the first one of a robot with a simulated body."""
        at_rest = (state.status, state.broadcast_step, state.command) == (Status.SAFE_STOP, NEVER, 0.0)
        return at_rest and (state.position, state.velocity) == self._start

    def _wrong_time(self, state: AgentState) -> Difference | None:
        """Return that the state of a simulated body, which is measured when a step begins, is of another step."""
        step = self._config.schedule.step(state.stamp)
        if self._start is None or step == state.step:
            return None
        return self._difference(state, "stamp", state.stamp, None, f"that is in step {step}")

    def _follow(self, state: AgentState, before: AgentState) -> AgentState | Difference | str:
        """Return the state with the command, broadcasts and status that follow from the one before."""
        brake = self._law.brake(before.velocity)
        still = (0.0, brake) if str(state.command) == str(0.0) else (brake, 0.0)
        at_rest = state._replace(command=still[0], broadcast_step=NEVER)
        if state.broadcast_step == NEVER:
            return self._hold(at_rest, before) if state.status == Status.ACTIVE else at_rest
        heard = self._broadcasts(state, before)
        if not isinstance(heard, Broadcast):
            return heard
        decision, _ = self._law.decide(before.position, before.velocity, heard)
        if decision.problem:
            return at_rest
        measured = self._start is not None or state.status == Status.LEFT
        return state._replace(command=decision.command, status=Status.ACTIVE if measured else state.status)

    def _hold(self, expected: AgentState, before: AgentState) -> AgentState | Difference | str:
        """Accept that an active robot follows nothing if the swarm may have had no spread."""
        complete = True
        for step in range(before.step - self._age, before.step + self._ahead + 1):
            stored = self._history.get(AUXILIARY_STATE, step)
            if stored is None:
                complete = complete and step > before.step
                continue
            sums = stored.message
            assert isinstance(sums, AuxiliaryState)  # noqa: S101 - kept by topic
            if is_degenerate(sums.s0, sums.s3, self._config.bounds.plane_length):
                return expected
        if not complete:
            return NO_BROADCASTS
        return self._difference(expected, "status", Status.ACTIVE, Status.SAFE_STOP, "it follows nothing")

    def _broadcasts(self, state: AgentState, before: AgentState) -> Broadcast | Difference | str:
        """Return the broadcasts that the robot names, if it may have followed them."""
        step = state.broadcast_step
        if not before.step - self._age <= step <= before.step + self._ahead:
            age = before.step - step
            return self._difference(state, "broadcast_step", step, NEVER, f"they were {age} steps old when it decided")
        if self._history.any_ambiguous(BROADCASTS, step):
            return AMBIGUOUS
        parts = [self._history.get(ABSTRACT_STATE, step), self._history.get(AUXILIARY_STATE, step)]
        desired = self._history.desired(step)
        abstract, sums = (None if part is None else part.message for part in parts)
        asked = desired[0].message if desired else None
        if (
            not isinstance(abstract, AbstractState)
            or not isinstance(sums, AuxiliaryState)
            or not isinstance(asked, DesiredAbstractState)
        ):
            return NO_BROADCASTS
        if asked.mode != Mode.RUN:
            if self._history.changes_within(step):
                return NO_BROADCASTS
            reason = f"the parent controller asked for {Mode(asked.mode).name}"
            return self._difference(state, "broadcast_step", step, NEVER, reason)
        for message in (abstract, sums, asked):
            problem = self._config.bounds.problem(message)
            if problem:
                return self._difference(state, "broadcast_step", step, NEVER, f"they had to be refused: {problem}")
        return Broadcast(asked.stamp, step, abstract, sums, asked)

    def _move(self, state: AgentState, before: AgentState) -> AgentState:
        """Return the state with where a simulated body has come to."""
        if self._start is None:
            return state
        passed = min(state.step - before.step, MOST_STEPS)
        places = [self._moved((before.position, before.velocity), passed, state.command)]
        if state.broadcast_step == NEVER and state.command == 0.0:
            # Stopped at once, or in a process that has begun anew.
            places += [self._moved((before.position, 0.0), passed, 0.0), self._start]
        there = next((p for p in places if p == (state.position, state.velocity)), places[0])
        return state._replace(position=there[0], velocity=there[1])

    def _moved(self, place: tuple[float, float], periods: int, command: float) -> tuple[float, float]:
        for _ in range(periods):
            place = self._law.controller.ideal.advance(*place, command)
        return place

    def _difference(
        self, state: AgentState, field: str, recorded: float, recomputed: float | None, reason: str
    ) -> Difference:
        return Difference(AGENT_STATE.name, state.step, state.agent_id, field, recorded, recomputed, reason)

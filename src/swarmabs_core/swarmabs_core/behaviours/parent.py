"""The simulated parent: the robots' states in, its own state out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.behaviours.base import Gathering, StepAheadError, UnexpectedMessageError, refuse_other_system
from swarmabs_core.errors import InStep, RunError
from swarmabs_core.events import EventCode
from swarmabs_core.faults import failed_drives, true_state
from swarmabs_core.membership import Membership
from swarmabs_core.messages import (
    EVENTS,
    ROBOT_STATES,
    Action,
    AnyRobotState,
    Message,
    Messages,
    Steering,
    SwarmEvent,
    Topic,
    coordinates_of,
)
from swarmabs_core.ranges import RangeMonitor
from swarmabs_core.steering import StepSchedule, change_of

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence

    from swarmabs_core.messages import AnyParentState
    from swarmabs_core.model import Motion, ParentConfig


class Parent:
    """Moves the parent over a period once the robots' states at its end are known.

    Parameters
    ----------
    config : ParentConfig
        Configuration, which determines the parent system.
    ranges : RangeMonitor, optional
        What tells which robots leave the ranges of their coordinates; by default by the ends in the configuration.
    """

    def __init__(self, config: ParentConfig, ranges: RangeMonitor | None = None) -> None:
        self._config = config
        self._ranges = ranges or RangeMonitor(config.coordinates)
        self._system = config.system_hash
        self._motion: Motion = config.motion()
        self._disturbances = StepSchedule(config.torques)
        self._membership = Membership(config.members, config.schedule)
        self._gathering = self._gather()
        self._robots: dict[int, AnyRobotState] = {}

    def _gather(self) -> Gathering:
        return Gathering(self._membership)

    def start(self) -> Messages:
        """Describe the parent system, unless it is the plane; then the robots start."""
        return self._motion.described()

    def standing(self, moving: Container[int]) -> tuple[AnyRobotState, ...]:
        """Return the robots that act on the parent, without those that move, by id."""
        return tuple(state for agent_id, state in self._robots.items() if agent_id not in moving)

    def resume(self, states: Iterable[AnyRobotState], parent: AnyParentState) -> None:
        """Continue after a step of the plane, given by its messages, since whose predecessors no robot has changed.

        The states are true, and the plane is measured by perfect sensors.
        """
        self._robots.update((state.agent_id, state) for state in states)
        self._gathering.resume(parent.step + 1)
        self._motion.resume(parent)

    def handle(self, message: Message) -> Messages:
        """Take a robot's state or an event; return the parent's state when a step is complete."""
        self._take(message)
        return self._proceed()

    def _take(self, message: Message) -> None:
        refuse_other_system(message, self._system)
        if isinstance(message, ROBOT_STATES):
            self._gathering.add(message)
        elif isinstance(message, SwarmEvent):
            self._take_over(message)
        else:
            raise UnexpectedMessageError("parent", message)

    def _proceed(self) -> Messages:
        return self._finish() if self._gathering.complete() and not self._finished() else ()

    def _take_over(self, event: SwarmEvent) -> None:
        """Apply a membership change that the observer announced.

        Raises
        ------
        StepAheadError, RunError
            If it takes effect at a step that cannot have started yet, or that the plane has computed with the robot.
        """
        membership, robot, step, now = self._membership, event.agent_id, event.step, self._gathering.step
        was_in = membership.publishes(robot, step)
        membership.apply(event.kind, robot, step, event.detail)
        if not was_in or membership.publishes(robot, step):
            return
        if step > now:
            raise StepAheadError(f"end of robot {robot}", got=step, expected=now)
        if step < now:
            raise RunError(
                f"robot {robot} is reported to be out from step {step} on ({event.detail}), but the parent has already "
                "moved with its state of that step: either its last state reached it and not the observer, or a "
                "second swarm is in this namespace; run again"
            )
        if self._config.confirmed:
            self._gathering.resume(now)

    def steer(self, order: Steering) -> None:
        """Apply an ordered disturbance or membership change."""
        if order.action == Action.DISTURBANCE:
            self._disturbances.set(order.step, order.value)
        elif (change := change_of(order)) is not None:
            self._membership.plan(change)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for states of robots, and for events about robots that will not send one."""
        return () if self._finished() else (self._config.family.robot, EVENTS)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the robots whose states are missing."""
        return self._gathering.step, tuple(f"agent {i}" for i in self._gathering.missing())

    def _finished(self) -> bool:
        last = self._config.last_step
        return last is not None and self._gathering.step > last

    def _finish(self) -> Messages:
        config = self._config
        step = self._gathering.step
        stamp = step * config.period_ns
        states = self._gathering.take()
        events: Messages = ()
        if (disturbance := self._disturbances.changing(step)) is not None:
            events = (EventCode.DISTURBANCE.event(stamp, step, disturbance),)
        with InStep(step):
            moved = self._move(step, stamp, states)
        return (*events, *moved, self._motion.state(step))

    def _move(self, step: int, stamp: int, states: Sequence[AnyRobotState]) -> list[SwarmEvent]:
        """Move through the period before a step with the states at its end; return the events."""
        config = self._config
        events: list[SwarmEvent] = []
        if config.falsifications:
            states = [true_state(state, config.falsifications) for state in states]
        coasting = self._coasting(step - 1)
        states = [coasting.get(state.agent_id, state) for state in states]
        if step > 0:
            now = {state.agent_id: state for state in states} | coasting
            paths = [(before, now.get(agent_id)) for agent_id, before in self._robots.items()]
            events = self._motion.advance(step, paths, self._disturbances.at(step - 1))
        self._keep(states, coasting)
        return [*events, *self._watch(states, step, stamp)]

    def _watch(self, states: Sequence[AnyRobotState], step: int, stamp: int) -> list[SwarmEvent]:
        """Return events for the robots that have just crossed the ends of their ranges."""
        return self._ranges.watch([(state.agent_id, coordinates_of(state)) for state in states], step, stamp)

    def _coasting(self, step: int) -> dict[int, AnyRobotState]:
        """Return the true states, after a step, of the robots whose drives have failed."""
        failed = failed_drives(self._config.falsifications, step) & self._robots.keys()
        return {agent_id: self._motion.coasted(self._robots[agent_id]) for agent_id in failed}

    def _keep(self, states: Sequence[AnyRobotState], coasting: dict[int, AnyRobotState]) -> None:
        """Store the robots that act on the parent: with a state, or at rest or coasting after their end."""
        still = {
            agent_id: state
            for agent_id, state in self._robots.items()
            if not self._membership.publishes(agent_id, self._gathering.step - 1)
            and self._membership.span(agent_id).stays
        }
        self._robots = {state.agent_id: state for state in states} | still | coasting

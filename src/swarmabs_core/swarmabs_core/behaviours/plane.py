"""The simulated plane: the robots' states in, angle and angular velocity out."""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign
from typing import NamedTuple

from swarmabs_core import plant
from swarmabs_core.behaviours.base import Gathering, Run, StepAheadError, UnexpectedMessageError
from swarmabs_core.declaration import part, same, setting
from swarmabs_core.errors import RunError
from swarmabs_core.faults import Falsification, true_state
from swarmabs_core.membership import Change, Membership
from swarmabs_core.messages import (
    AGENT_STATE,
    EVENTS,
    Action,
    AgentState,
    EventKind,
    Kind,
    Message,
    Messages,
    PlaneState,
    Steering,
    SwarmEvent,
    Topic,
)
from swarmabs_core.plant import PlaneDynamics, RobotPath, hermite, standing, straight, swarm_load
from swarmabs_core.sensing import measured_plane
from swarmabs_core.steering import DISTURBANCE, StepChange, StepSchedule, change_of

CURVED_FROM = 0.25
"""Lag, in control periods, above which a cubic describes a single integrator's path better than a line."""


@dataclass(frozen=True, slots=True)
class PlaneConfig:
    """Configuration of the simulated plane."""

    members: tuple[int, ...] = same(Run, "members")
    period_ns: int = same(Run, "period_ns")
    plane: plant.Plane = part(plant.Plane, name="", without=("robot_gravity",))
    schedule: tuple[Change, ...] = same(Run, "schedule")
    last_step: int | None = same(Run, "last_step")
    seed: int = same(Run, "seed")
    actuator_lag: float = same(Run, "actuator_lag")
    falsifications: tuple[Falsification, ...] = setting(
        (),
        "falsified states of robots, each 'AGENT lie FIRST END OFFSET FACTOR FACTOR'",
        name="lies",
        make=Falsification.parse,
    )
    torques: tuple[StepChange, ...] = setting(
        (),
        "constant torques that disturb the plane, N m, each 'STEP VALUE' from a step on, such as '500 0.1'",
        make=StepChange.parse,
    )


class _Load(NamedTuple):
    """A robot on the plane in the last step."""

    kind: int
    mass: float
    position: float
    velocity: float


class Plane:
    """Integrates the plane over a period once the robots' states at its end are known."""

    def __init__(self, config: PlaneConfig) -> None:
        self._config = config
        self._period = config.period_ns / 1e9
        self._dynamics = PlaneDynamics(config.plane, self._period)
        lagging = config.actuator_lag > 0.0 and config.actuator_lag >= CURVED_FROM * self._period
        self._straight = 0 if lagging else int(Kind.SINGLE_INTEGRATOR)
        self._torques = StepSchedule(config.torques)
        self._membership = Membership(config.members, config.schedule)
        self._gathering = Gathering(self._membership)
        self._angle = config.plane.angle
        self._angular_velocity = config.plane.angular_velocity
        self._loads: dict[int, _Load] = {}
        self._outside: set[int] = set()

    def start(self) -> Messages:
        """Publish nothing: the robots start."""
        return ()

    def handle(self, message: Message) -> Messages:
        """Take a robot's state or an event; return the plane's state when a step is complete."""
        if isinstance(message, AgentState):
            self._gathering.add(message)
        elif isinstance(message, SwarmEvent):
            self._take_over(message)
        else:
            raise UnexpectedMessageError("plane", message)
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
                f"robot {robot} is reported to be out from step {step} on ({event.detail}), but the plane has already "
                "moved with its state of that step: either its last state reached the plane and not the observer, or a "
                "second swarm is in this namespace; run again"
            )

    def steer(self, order: Steering) -> None:
        """Apply an ordered torque or membership change."""
        if order.action == Action.DISTURBANCE:
            self._torques.set(order.step, order.value)
        elif (change := change_of(order)) is not None:
            self._membership.plan(change)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for states of robots, and for events about robots that will not send one."""
        return () if self._finished() else (AGENT_STATE, EVENTS)

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
        if config.falsifications:
            states = [true_state(state, config.falsifications) for state in states]
        events: list[SwarmEvent] = []
        if (torque := self._torques.changing(step)) is not None:
            events.append(SwarmEvent(stamp, step, 0, EventKind.STEERING, torque, DISTURBANCE))
        if step > 0:
            time = (step - 1) * config.period_ns / 1e9
            load = swarm_load(self._paths(states), config.plane.gravity)
            self._angle, self._angular_velocity = self._dynamics.advance(
                self._angle, self._angular_velocity, time, load, self._torques.at(step - 1)
            )
            if self._dynamics.impact is not None:
                events.append(self._hit(*self._dynamics.impact, step, stamp))
        self._keep(states)
        measured = measured_plane(config.plane.sensor, self._angle, self._angular_velocity, config.seed, step)
        return (*events, *self._limits(states, stamp), PlaneState(stamp, step, *measured))

    def _hit(self, time: float, rate: float, step: int, stamp: int) -> SwarmEvent:
        """Return the event of an impact on an end stop."""
        angle = copysign(self._config.plane.end_stop, rate)
        detail = f"end stop hit at {time:.6g} s with {rate:.4g} rad/s"
        return SwarmEvent(stamp, step, 0, EventKind.LIMIT_HIT, angle, detail)

    def _paths(self, states: list[AgentState]) -> list[RobotPath]:
        """Return the paths over the last period of all robots that were on the plane at its beginning."""
        now = {state.agent_id: state for state in states}
        paths = []
        for agent_id, load in self._loads.items():
            state = now.get(agent_id)
            if state is None:
                paths.append(standing(load.mass, load.position))
            elif load.kind == self._straight:
                paths.append(straight(load.mass, load.position, state.position))
            else:
                start, end = (load.position, load.velocity), (state.position, state.velocity)
                paths.append(hermite(load.mass, start, end, self._period))
        return paths

    def _keep(self, states: list[AgentState]) -> None:
        """Store the robots on the plane: those with a state, and those at rest after their end."""
        still = {
            agent_id: load
            for agent_id, load in self._loads.items()
            if not self._membership.publishes(agent_id, self._gathering.step - 1)
            and self._membership.span(agent_id).stays
        }
        self._loads = {s.agent_id: _Load(s.kind, s.mass, s.position, s.velocity) for s in states} | still

    def _limits(self, states: list[AgentState], stamp: int) -> list[SwarmEvent]:
        """Return events for the robots that have just crossed an end of the plane (eq. swarmStateConstraint)."""
        half = 0.5 * self._config.plane.length
        events = []
        for state in states:
            outside = abs(state.position) > half
            if outside and state.agent_id not in self._outside:
                self._outside.add(state.agent_id)
                events.append(
                    SwarmEvent(
                        stamp,
                        state.step,
                        state.agent_id,
                        EventKind.LIMIT_HIT,
                        state.position,
                        "off the plane's end",
                    )
                )
            elif not outside:
                self._outside.discard(state.agent_id)
        return events

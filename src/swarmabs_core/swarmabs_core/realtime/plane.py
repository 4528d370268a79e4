"""The simulated plane in real time: for demonstrations and tests; on hardware a sensor's driver takes its place."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import copysign
from typing import NamedTuple

from swarmabs_core.desired_state import STEEPEST
from swarmabs_core.friction import Friction
from swarmabs_core.messages import (
    NEVER,
    AgentState,
    EventKind,
    Kind,
    Message,
    Messages,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.plant import Disturbance, PlaneDynamics, RobotPath, hermite, standing, straight, swarm_load
from swarmabs_core.realtime.base import Health, Level, Schedule, StepCounter
from swarmabs_core.realtime.plausibility import Bounds
from swarmabs_core.realtime.refusals import Refusals
from swarmabs_core.sensing import Sensor

MOST_STEPS = 1000
"""Periods that the plane catches up after a pause of its process; beyond, it has been held."""


@dataclass(frozen=True, slots=True)
class RealtimePlaneConfig:
    """Configuration of the simulated plane.

    Parameters
    ----------
    members : tuple of int
        Ids of all robots that may ever take part.
    schedule : Schedule
        How time becomes steps.
    bounds : Bounds
        What is known of the swarm and its plane beforehand; of it, gravity.
    inertia : float
        Moment of inertia of the plane alone, kg m^2.
    friction : Friction
        Friction of the bearing.
    substep : float
        Largest integration step, s.
    angle, angular_velocity : float
        Initial state, rad and rad/s.
    disturbance : Disturbance
        Disturbance torque, whose time begins when the plane is let go.
    end_stop : float
        Angle of the end stops on both sides, rad.
    sensor : Sensor
        What is published of angle (rad) and angular velocity (rad/s).
    seed : int
        Seed of the sensor's noise.
    clock_tolerance : float
        How far a robot's state may be from the future, s.
    """

    members: tuple[int, ...]
    schedule: Schedule
    bounds: Bounds
    inertia: float
    friction: Friction
    substep: float
    angle: float
    angular_velocity: float
    disturbance: Disturbance
    end_stop: float = STEEPEST
    sensor: Sensor = field(default_factory=Sensor)
    seed: int = 1
    clock_tolerance: float = 0.02


class _Load(NamedTuple):
    """A robot on the plane: where it was at the last step, and the newest that is known of it."""

    position: float
    velocity: float
    newest: AgentState


class RealtimePlane:
    """Integrates the plane up to each tick, with the robots where they were heard last.

    It is held at its initial angle until a robot follows the broadcasts for the first time: nobody lets a plane go
    before the swarm is there to hold it.

    Parameters
    ----------
    config : RealtimePlaneConfig
        Configuration.
    """

    def __init__(self, config: RealtimePlaneConfig) -> None:
        self._config = config
        self._period = config.schedule.period_ns / 1e9
        self._dynamics = PlaneDynamics(
            inertia=config.inertia,
            friction=config.friction,
            disturbance=config.disturbance,
            period=self._period,
            substep=config.substep,
            end_stop=config.end_stop,
        )
        self._angle, self._angular_velocity = config.angle, config.angular_velocity
        self._loads: dict[int, _Load] = {}
        self._ahead = config.schedule.ahead(config.clock_tolerance)
        self._members = frozenset(config.members)
        self._released: int | None = None
        self._counter = StepCounter(config.schedule)
        self._last_step: int | None = None
        self._refusals = Refusals()

    def hear(self, message: Message, now: int) -> Messages:
        """Take a robot's state."""
        step = self._config.schedule.step(now)
        if not isinstance(message, AgentState) or message.agent_id not in self._members:
            return self._refusals.add("not a state of a robot of this swarm", step, now)
        problem = self._config.bounds.problem(message)
        if message.step > step + self._ahead:
            problem = "a state from the future; the clocks differ, or it is of another swarm"
        if problem:
            return self._refusals.add(f"robot {message.agent_id}: {problem}", step, now)
        known = self._loads.get(message.agent_id)
        if known is not None and message.step <= known.newest.step:
            return ()
        if message.status == Status.LEFT:
            self._loads.pop(message.agent_id, None)
            return ()
        start = (message.position, message.velocity) if known is None else known[:2]
        self._loads[message.agent_id] = _Load(*start, message)
        if self._released is None and message.broadcast_step != NEVER:
            self._released = step
        return ()

    def tick(self, now: int) -> Messages:
        """Move the plane up to this step and tell its state."""
        config = self._config
        step = self._counter.next(now)
        if step is None:
            if self._counter.last is None:
                self._last_step = None
            return ()
        events: Messages = ()
        if self._released is not None and self._last_step is not None:
            passed = min(step - self._last_step, MOST_STEPS)
            events = self._advance(passed, self._last_step - self._released, now, step)
        self._loads = {
            i: _Load(load.newest.position, load.newest.velocity, load.newest) for i, load in self._loads.items()
        }
        self._last_step = step
        angle, rate = self._angle, self._angular_velocity
        if self._released is None:
            rate = 0.0
        if not config.sensor.perfect:
            angle, rate = config.sensor.measure(angle, rate, f"{config.seed}:{step}:plane")
        return (*events, PlaneState(now, step, angle, rate))

    def halt(self) -> None:
        """Hold the plane where it is."""
        self._released = self._last_step = None

    def health(self, now: int) -> Health:  # noqa: ARG002 - a simulation knows no age
        """Return where the plane is."""
        values = (
            ("angle, rad", f"{self._angle:.4f}"),
            ("angular velocity, rad/s", f"{self._angular_velocity:.4f}"),
            ("robots on it", str(len(self._loads))),
            ("refused", str(self._refusals.total)),
            ("last refusal", self._refusals.latest),
        )
        if self._released is None:
            return Health(Level.WARN, "held until a robot follows the broadcasts", values)
        if abs(self._angle) >= self._config.end_stop:
            return Health(Level.ERROR, "rests at its end stop", values)
        return Health(Level.OK, "moves", values)

    def _advance(self, passed: int, since_release: int, now: int, step: int) -> Messages:
        """Integrate over the periods that have passed."""
        config = self._config
        hit: Messages = ()
        for index in range(passed):
            resting = abs(self._angle) == config.end_stop and not self._angular_velocity
            load = swarm_load(
                [self._path(load, index, passed) for _, load in sorted(self._loads.items())], config.bounds.gravity
            )
            time = max(0, since_release + index) * self._period
            self._angle, self._angular_velocity = self._dynamics.advance(
                self._angle, self._angular_velocity, time, load
            )
            if self._dynamics.impact is not None and not resting:
                speed = self._dynamics.impact[1]
                detail = f"end stop hit with {speed:.4g} rad/s"
                hit = (SwarmEvent(now, step, 0, EventKind.LIMIT_HIT, copysign(config.end_stop, speed), detail),)
        return hit

    def _path(self, load: _Load, index: int, passed: int) -> RobotPath:
        """Return a robot's path over one of the periods that have passed since it was last looked at."""
        newest = load.newest
        if load.position == newest.position:
            return standing(newest.mass, newest.position)
        if passed == 1 and newest.kind == Kind.DOUBLE_INTEGRATOR:
            start, end = (load.position, load.velocity), (newest.position, newest.velocity)
            return hermite(newest.mass, start, end, self._period)
        way = newest.position - load.position
        return straight(newest.mass, load.position + way * index / passed, load.position + way * (index + 1) / passed)

"""The simulated plane in real time, for demonstrations and tests; on hardware a sensor driver replaces it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import copysign
from typing import TYPE_CHECKING

from swarmabs_core.declaration import part, same
from swarmabs_core.events import EventCode
from swarmabs_core.heights import CenterHeights
from swarmabs_core.messages import (
    NEVER,
    AgentState,
    Basis,
    Kind,
    Message,
    Messages,
    PlaneState,
    Source,
    Status,
    coordinates_of,
)
from swarmabs_core.plant import (
    STEEPEST,
    Plane,
    PlaneDynamics,
    RobotPath,
    height_load,
    hermite,
    standing,
    straight,
    swarm_load,
)
from swarmabs_core.ranges import RangeMonitor, lane
from swarmabs_core.realtime.base import UNKNOWN, Health, Level, Realtime, Schedule, Sender, StepCounter
from swarmabs_core.realtime.validation import NO_MEMBER, Bounds, HeardStates, Problem, Refusals
from swarmabs_core.sensing import measured_plane
from swarmabs_core.settings import Run

if TYPE_CHECKING:
    from collections.abc import Mapping

MOST_STEPS = 1000
"""Largest number of periods that the plane makes up for after a pause of its process; in further ones it was held."""
DOUBT = 0.1
"""Time, s, for which states of a robot are compared, and for which contradictory states block new ones."""


@dataclass(frozen=True, slots=True)
class RealtimePlaneConfig:
    """Configuration of the simulated plane in real time; the time of its disturbance starts with its release."""

    members: tuple[int, ...] = same(Run, "members")
    schedule: Schedule = part(Schedule, name="")
    plane: Plane = part(Plane, name="", without=("robot_gravity",))
    robots: CenterHeights = part(CenterHeights, name="")
    seed: int = same(Run, "seed")
    clock_tolerance: float = same(Realtime, "clock_tolerance")

    def __post_init__(self) -> None:
        """Raise `SettingError` if there are heights, but not one for each member."""
        self.robots.refuse_another_number(self.members)

    @property
    def bounds(self) -> Bounds:
        """Known properties of the swarm and its plane, against which messages are validated."""
        return Bounds(self.plane.gravity, self.plane.length, period=self.schedule.period)

    @property
    def end_stop(self) -> float:
        """Angle of the end stops on both sides, rad; by default the angle at which a run in lockstep fails."""
        return min(self.plane.end_stop, STEEPEST)


class PlaneMotion:
    """Motion of the plane under the robots. Verification recomputes the same bits from the same input.

    Attributes
    ----------
    impact : float or None
        Angular velocity (rad/s) of the last impact on an end stop, unless the plane rested there before.
    """

    def __init__(self, config: RealtimePlaneConfig) -> None:
        self._config = config
        self._period = config.schedule.period
        self._dynamics = PlaneDynamics(replace(config.plane, end_stop=config.end_stop), self._period)
        self._heights = config.robots.above(config.plane, config.members)
        self.impact: float | None = None

    def advance(
        self,
        state: tuple[float, float],
        before: Mapping[int, AgentState],
        newest: Mapping[int, AgentState],
        passed: int,
        since_release: int,
    ) -> tuple[float, float]:
        """Return angle (rad) and angular velocity (rad/s) some periods later.

        Parameters
        ----------
        state : tuple of float
            Angle and angular velocity now.
        before, newest : mapping of int to AgentState
            The robots on the plane by id: their known states at the start and at the end. A robot without a known
            state at the start is assumed to have been in its position at the end.
        passed : int
            Number of periods; in those beyond `MOST_STEPS` the plane was held.
        since_release : int
            Number of periods since the plane was released.
        """
        config, (angle, rate) = self._config, state
        passed = min(passed, MOST_STEPS)
        self.impact = None
        robots = [(before.get(i, robot), robot) for i, robot in sorted(newest.items())]
        for index in range(passed):
            paths = [self._path(*ends, index, passed) for ends in robots]
            time = max(0, since_release + index) * self._period
            load = swarm_load(paths, config.plane.gravity)
            if self._heights is not None:
                heights = [self._heights[robot.agent_id] for _, robot in robots]
                jumps = [self._jump(*ends, index, passed) for ends in robots]
                load = replace(load, height=height_load(paths, heights, jumps, self._period))
            angle, rate = self._dynamics.advance(angle, rate, time, load)
            if self._dynamics.impact is not None:
                self.impact = self._dynamics.impact[1]
        return angle, rate

    def measured(self, angle: float, angular_velocity: float, step: int) -> tuple[float, float]:
        """Return the sensor's measurement of angle (rad) and angular velocity (rad/s) at a step."""
        return measured_plane(self._config.plane.sensor, angle, angular_velocity, self._config.seed, step)

    def _path(self, start: AgentState, end: AgentState, index: int, passed: int) -> RobotPath:
        """Return a robot's path over one of the periods that have passed since the last tick."""
        if start.position == end.position:
            return standing(end.mass, end.position)
        if self._is_cubic(start, end, passed):
            ends = (start.position, start.velocity), (end.position, end.velocity)
            return hermite(end.mass, *ends, self._period)
        way = end.position - start.position
        return straight(end.mass, start.position + way * index / passed, start.position + way * (index + 1) / passed)

    def _jump(self, start: AgentState, end: AgentState, index: int, passed: int) -> float:
        """Return by how much (m/s) a robot's velocity jumps at the start of one of the periods that have passed."""
        return 0.0 if index > 0 or self._is_cubic(start, end, passed) else end.velocity - start.velocity

    @staticmethod
    def _is_cubic(start: AgentState, end: AgentState, passed: int) -> bool:
        """Return whether a robot's velocity changes within the period, on a cubic."""
        return passed == 1 and end.kind == Kind.DOUBLE_INTEGRATOR and start.position != end.position


class RealtimePlane:
    """Integrates the plane up to each tick, with the robots at their last reported positions.

    The plane is held at its initial angle until a robot follows the broadcasts for the first time, that is, until the
    swarm can balance it.

    Parameters
    ----------
    config : RealtimePlaneConfig
        Configuration.
    """

    def __init__(self, config: RealtimePlaneConfig) -> None:
        self._config, self._bounds = config, config.bounds
        self._motion = PlaneMotion(config)
        self._angle, self._angular_velocity = config.plane.angle, config.plane.angular_velocity
        self._newest: dict[int, AgentState] = {}
        self._before: dict[int, AgentState] = {}
        ahead = config.schedule.ahead(config.clock_tolerance)
        self._heard = HeardStates(config.schedule.steps(DOUBT), ahead)
        self._members = frozenset(config.members)
        self._released: int | None = None
        self._counter = StepCounter(config.schedule)
        self._last_step: int | None = None
        self._refusals = Refusals()
        self._ranges = RangeMonitor(lane(config.plane.length))

    def hear(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Messages:
        """Take a robot's state."""
        step = self._config.schedule.step(now)
        if not isinstance(message, AgentState):
            return self._refusals.add(Problem("not a robot's state"), step, now)
        if message.agent_id not in self._members:
            return self._refusals.add(Problem(NO_MEMBER, f"robot {message.agent_id}"), step, now)
        problem = self._heard.problem(message, step, self._bounds.problem(message), sender.writer)
        if problem:
            return self._refusals.add(problem, step, now)
        if not self._heard.replaces(message, self._newest.get(message.agent_id), step):
            return ()
        self._newest[message.agent_id] = message
        if self._released is None and message.broadcast_step != NEVER:
            self._released = step
        return ()

    def tick(self, now: int) -> Messages:
        """Move the plane up to this step and return its state."""
        step = self._counter.next(now)
        if step is None:
            if self._counter.last is None:
                self._last_step = None
                self._heard.forget()
            return ()
        self._heard.writers.advance(step)
        since, robots = self._last_step, self._robots()
        events: Messages = ()
        if self._released is not None and since is not None:
            self._angle, self._angular_velocity = self._motion.advance(
                (self._angle, self._angular_velocity), self._before, robots, step - since, since - self._released
            )
            events = self._hit(step, now)
        places = [(robot, coordinates_of(state)) for robot, state in sorted(robots.items())]
        events = (*events, *self._ranges.watch(places, step, now))
        self._before, self._last_step = robots, step
        rate = 0.0 if self._released is None else self._angular_velocity
        state = PlaneState(now, step, *self._motion.measured(self._angle, rate, step))
        return (*events, self._provenance(step, now, since), state)

    def halt(self) -> None:
        """Hold the plane at its current angle."""
        self._released = self._last_step = None
        self._angular_velocity = self._config.plane.angular_velocity

    def health(self, now: int) -> Health:  # noqa: ARG002 - a simulation is never outdated
        """Return the motion of the plane, and the robots for which a second sender speaks."""
        return self._heard.writers.warned(self._health())

    def _health(self) -> Health:
        values = (
            ("angle, rad", f"{self._angle:.4f}"),
            ("angular velocity, rad/s", f"{self._angular_velocity:.4f}"),
            ("robots on it", str(len(self._robots()))),
            *self._refusals.values(),
        )
        if self._released is None:
            return Health(Level.WARN, "held until a robot follows the broadcasts", values)
        if abs(self._angle) >= self._config.end_stop:
            return Health(Level.ERROR, "at rest on its end stop", values)
        return Health(Level.OK, "moving", values)

    def _robots(self) -> dict[int, AgentState]:
        """Return the newest states of the robots on the plane."""
        return {i: state for i, state in self._newest.items() if state.status != Status.LEFT}

    def _provenance(self, step: int, now: int, since: int | None) -> Basis:
        """Return the provenance of the plane's state: the step from which it moved, and the states of the robots."""
        states = sorted(self._before.items())
        return Basis(
            now,
            step,
            NEVER if since is None else since,
            NEVER if self._released is None else self._released,
            Source.PLANE,
            tuple(state.step for _, state in states),
            tuple(agent_id for agent_id, _ in states),
            (0,) * len(states),
        )

    def _hit(self, step: int, now: int) -> Messages:
        speed = self._motion.impact
        if speed is None:
            return ()
        stop = copysign(self._config.end_stop, speed)
        return (EventCode.END_STOP_HIT.event(now, step, stop, how=f" with {speed:.4g} rad/s"),)

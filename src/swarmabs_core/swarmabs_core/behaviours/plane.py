"""The motion of the simulated plane under the robots."""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign
from typing import TYPE_CHECKING, Any, ClassVar

from swarmabs_core import plant
from swarmabs_core.behaviours.base import Run
from swarmabs_core.declaration import part, same, setting
from swarmabs_core.drive import ideal_drive
from swarmabs_core.events import EventCode
from swarmabs_core.faults import Falsification
from swarmabs_core.membership import Change
from swarmabs_core.messages import (
    PLANE_FAMILY,
    AgentState,
    Family,
    Kind,
    Messages,
    PlaneState,
    SwarmEvent,
)
from swarmabs_core.plant import (
    PlaneDynamics,
    RobotPath,
    SwarmLoad,
    column_load,
    hermite,
    standing,
    straight,
    swarm_load,
)
from swarmabs_core.ranges import lane
from swarmabs_core.sensing import measured_plane
from swarmabs_core.steering import StepChange

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_core.systems.interface import Quantity

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
        "constant torques that disturb the plane, {unit}, each 'STEP VALUE' from a step on, such as '500 0.1'",
        unit="N m",
        make=StepChange.parse,
    )

    family: ClassVar[Family] = PLANE_FAMILY
    system_hash: ClassVar[None] = None

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        """The coordinate of a robot, with the ends of the plane."""
        return lane(self.plane.length)

    def motion(self) -> PlaneMotion:
        """Return the plane at its initial state."""
        return PlaneMotion(self)

    def described(self) -> Messages:
        """Return nothing: everybody knows the plane."""
        return ()


class PlaneMotion:
    """The motion of the plane under the robots."""

    def __init__(self, config: PlaneConfig) -> None:
        self._config = config
        self._period = config.period_ns / 1e9
        self._dynamics = PlaneDynamics(config.plane, self._period)
        lagging = config.actuator_lag > 0.0 and config.actuator_lag >= CURVED_FROM * self._period
        self._straight = 0 if lagging else int(Kind.SINGLE_INTEGRATOR)
        self._angle = config.plane.angle
        self._angular_velocity = config.plane.angular_velocity

    def advance(
        self, step: int, robots: Iterable[tuple[AgentState, AgentState | None]], disturbance: float
    ) -> list[SwarmEvent]:
        """Move through the period before a step and return events.

        Robots are given by their states at both ends, None for one that stands; the disturbance is in N m.
        """
        paths = [self._path(before, after) for before, after in robots]
        return self._carry(step, swarm_load(paths, self._config.plane.gravity), disturbance)

    def advance_all(self, step: int, before: Any, after: Any, disturbance: float) -> list[SwarmEvent]:
        """Do what `advance` does for robots that are the rows of two tables, which hold the states at both ends."""
        start, end = ((table["position"], table["velocity"]) for table in (before, after))
        curved = before["kind"] != self._straight
        load = column_load(before["mass"], start, end, curved, (self._period, self._config.plane.gravity))
        return self._carry(step, load, disturbance)

    def _carry(self, step: int, load: SwarmLoad, disturbance: float) -> list[SwarmEvent]:
        """Move through the period before a step under a load and a disturbance (N m), and return events."""
        config = self._config
        time = (step - 1) * config.period_ns / 1e9
        self._angle, self._angular_velocity = self._dynamics.advance(
            self._angle, self._angular_velocity, time, load, disturbance
        )
        if self._dynamics.impact is None:
            return []
        return [self._hit(*self._dynamics.impact, step, step * config.period_ns)]

    def resume(self, state: PlaneState) -> None:
        """Continue from a state that is measured by perfect sensors."""
        self._angle, self._angular_velocity = state.angle, state.angular_velocity

    def coasted(self, state: AgentState) -> AgentState:
        """Return the state of a robot one period later, without a command."""
        drive = ideal_drive(Kind(state.kind), self._period, state.mass, state.damping)
        position, velocity = drive.advance(state.position, state.velocity, 0.0)
        return state._replace(position=position, velocity=velocity, command=0.0)

    def state(self, step: int) -> PlaneState:
        """Return the measured state at a step."""
        config = self._config
        measured = measured_plane(config.plane.sensor, self._angle, self._angular_velocity, config.seed, step)
        return PlaneState(step * config.period_ns, step, *measured)

    def _hit(self, time: float, rate: float, step: int, stamp: int) -> SwarmEvent:
        """Return the event of an impact on an end stop."""
        angle = copysign(self._config.plane.end_stop, rate)
        how = f" at {time:.6g} s with {rate:.4g} rad/s"
        return EventCode.END_STOP_HIT.event(stamp, step, angle, how=how)

    def _path(self, before: AgentState, after: AgentState | None) -> RobotPath:
        """Return the path of a robot over the last period."""
        if after is None:
            return standing(before.mass, before.position)
        if before.kind == self._straight:
            return straight(before.mass, before.position, after.position)
        start, end = (before.position, before.velocity), (after.position, after.velocity)
        return hermite(before.mass, start, end, self._period)

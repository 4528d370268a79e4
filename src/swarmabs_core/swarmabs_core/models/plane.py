"""The plane as a model: the configurations of its coordinators, how its swarm is observed, and its motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import copysign
from typing import TYPE_CHECKING, ClassVar, cast

from swarmabs_core import model
from swarmabs_core.abstraction import Weight, divided_load, observed, summed
from swarmabs_core.controllers import ParentLaw
from swarmabs_core.declaration import part, same, setting
from swarmabs_core.desired_state import DesiredStateGenerator, SwarmOnPlane
from swarmabs_core.events import EventCode
from swarmabs_core.heights import CenterHeights
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import (
    PLANE_FAMILY,
    PLANE_STATE,
    AgentState,
    Family,
    Kind,
    Messages,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.parent_response import ParentResponse, TorqueEstimator
from swarmabs_core.plant import (
    Friction,
    Plane,
    PlaneDynamics,
    RobotPath,
    SwarmLoad,
    column_load,
    height_load,
    hermite,
    standing,
    straight,
    swarm_load,
)
from swarmabs_core.ranges import lane
from swarmabs_core.sensing import measured_plane
from swarmabs_core.settings import Run
from swarmabs_core.summation import column_sums
from swarmabs_core.swarm_law import SwarmGains
from swarmabs_core.systems.kinds import KINDS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from swarmabs_core.controllers import ParentController
    from swarmabs_core.messages import (
        AbstractState,
        AnyParentState,
        AnyRobotState,
        AuxiliaryState,
        StandingState,
        Topic,
    )
    from swarmabs_core.systems.interface import Quantity

CURVED_FROM = 0.25
"""Lag, in control periods, above which a cubic describes a single integrator's path better than a line."""


@dataclass(frozen=True)
class ObserverConfig(model.ObserverConfig):
    """Configuration of the observer, including the properties of the plane that its torque estimate requires."""

    gravity: float = same(Plane, "gravity")
    ksd: float = same(SwarmGains, "ksd")
    type: str = setting(
        "sum",
        "source of the torque: the sum over the robots, or the plane's motion",
        choices=("sum", "parent_response"),
    )
    inertia: float = same(Plane, "inertia")
    friction: Friction = same(Plane, "friction")
    bandwidth: float = same(ParentResponse, "bandwidth")

    family: ClassVar[Family] = PLANE_FAMILY

    def observation(self) -> PlaneObservation:
        """Return how it observes the swarm."""
        return PlaneObservation(self)


@dataclass(frozen=True)
class ControllerConfig(model.ControllerConfig):
    """Configuration of the parent controller's node."""

    manifold: Manifold = part(Manifold)
    gravity: float = same(Plane, "gravity")
    gains: SwarmGains = part(SwarmGains)
    law: ParentLaw = part(ParentLaw, name="")

    family: ClassVar[Family] = PLANE_FAMILY

    def desired_states(self, law: ParentController | None = None) -> DesiredStateGenerator:
        """Return what generates the desired abstract state, by default with the configured law."""
        law = law or self.law.make(self.period_ns / 1e9, self.manifold)
        return DesiredStateGenerator(
            self.period_ns, self.manifold, law, SwarmOnPlane(self.gravity, self.gains, self.law.compensated)
        )


@dataclass(frozen=True)
class PlaneConfig(model.ParentConfig):
    """Configuration of the simulated plane."""

    plane: Plane = part(Plane, name="", without=("robot_gravity",))
    robots: CenterHeights = part(CenterHeights, name="")
    actuator_lag: float = same(Run, "actuator_lag")

    family: ClassVar[Family] = PLANE_FAMILY

    def __post_init__(self) -> None:
        """Raise `SettingError` if there are heights, but not one for each member."""
        self.robots.refuse_another_number(self.members)

    @property
    def heights(self) -> Mapping[int, float] | None:
        """Heights (m) of the robots' centres of mass by id; None if all masses, also the plane's, are at height 0."""
        return self.robots.above(self.plane, self.members)

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        """The coordinate of a robot, with the ends of the plane."""
        return lane(self.plane.length)

    def motion(self) -> PlaneMotion:
        """Return the plane at its initial state."""
        return PlaneMotion(self)


class PlaneObservation:
    """The sums over the robots on the plane; the torque may be estimated from the plane's motion instead."""

    def __init__(self, config: ObserverConfig) -> None:
        self._constants = config.gravity, config.ksd
        self._estimator = None
        if config.type == ParentResponse.type:
            period = config.period_ns / 1e9
            self._estimator = TorqueEstimator(config.inertia, config.friction, config.bandwidth, period)

    @property
    def watched(self) -> Topic | None:
        """The plane's state, if the torque is estimated from its motion."""
        return None if self._estimator is None else PLANE_STATE

    def observed(
        self,
        stamp: int,
        step: int,
        moving: Sequence[AnyRobotState],
        standing: Sequence[AnyRobotState],
        watched: AnyParentState | None,
    ) -> tuple[AbstractState, AuxiliaryState]:
        """Return abstract and auxiliary state at a step, with a time stamp (ns)."""
        robots = cast("Sequence[AgentState]", (*moving, *standing))
        weights = [Weight(state.mass, state.position, state.velocity) for state in robots]
        followers = [state for state in robots if state.status == Status.ACTIVE]
        return self._estimated(observed(stamp, step, weights, followers, *self._constants), watched)

    def observed_all(
        self, stamp: int, step: int, robots: NDArray[np.void], watched: AnyParentState | None
    ) -> tuple[AbstractState, AuxiliaryState]:
        """Do what `observed` does for robots that are the rows of a table."""
        active = robots[robots["status"] == Status.ACTIVE]
        forced = active[active["kind"] == Kind.DOUBLE_INTEGRATOR]
        columns = (
            (robots["mass"], robots["position"], robots["velocity"]),
            (active["mass"], active["position"]),
            (forced["mass"], forced["position"], forced["damping"]),
        )
        return self._estimated(summed(stamp, step, len(robots), columns, self._constants, column_sums), watched)

    def _estimated(
        self, sums: tuple[AbstractState, AuxiliaryState], watched: AnyParentState | None
    ) -> tuple[AbstractState, AuxiliaryState]:
        """Replace the torque by its estimate, if it is estimated."""
        if self._estimator is None or watched is None:
            return sums
        plane, (abstract, auxiliary) = cast("PlaneState", watched), sums
        torque, rate = self._estimator.update(plane.angle, plane.angular_velocity, abstract.inertia)
        return abstract._replace(torque=torque, torque_rate=rate), auxiliary

    def divided(self, stamp: int, step: int, robots: Sequence[AnyRobotState]) -> StandingState:
        """Return how the abstract state divides at a step, with a time stamp (ns)."""
        return divided_load(stamp, step, robots, self._constants[0])


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
        self._heights = config.heights
        self._standing: frozenset[int] = frozenset()  # the robots that stood in the last period

    def advance(
        self, step: int, robots: Iterable[tuple[AnyRobotState, AnyRobotState | None]], disturbance: float
    ) -> list[SwarmEvent]:
        """Move through the period before a step and return events.

        Robots are given by their states at both ends, None for one that stands; the disturbance is in N m.
        """
        states = cast("Sequence[tuple[AgentState, AgentState | None]]", list(robots))
        paths = [self._path(before, after) for before, after in states]
        load = swarm_load(paths, self._config.plane.gravity)
        if self._heights is not None:
            heights = [self._heights[before.agent_id] for before, _ in states]
            jumps = [self._jump(before, after) for before, after in states]
            load = replace(load, height=height_load(paths, heights, jumps, self._period))
            self._standing = frozenset(before.agent_id for before, after in states if after is None)
        return self._carry(step, load, disturbance)

    def advance_all(
        self, step: int, before: NDArray[np.void], after: NDArray[np.void], disturbance: float
    ) -> list[SwarmEvent]:
        """Do what `advance` does for robots that are the rows of two tables, which hold the states at both ends."""
        start, end = ((table["position"], table["velocity"]) for table in (before, after))
        curved = before["kind"] != self._straight
        heights = None
        if self._heights is not None:
            heights = before["mass"].copy()
            heights[:] = [self._heights[agent_id] for agent_id in before["agent_id"].tolist()]
            self._standing = frozenset()
        constants = self._period, self._config.plane.gravity
        load = column_load(before["mass"], start, end, curved, constants, heights=heights)
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

    def described(self) -> Messages:
        """Return nothing: everybody knows the plane."""
        return ()

    def resume(self, state: AnyParentState) -> None:
        """Continue from a state that is measured by perfect sensors."""
        state = cast("PlaneState", state)
        self._angle, self._angular_velocity = state.angle, state.angular_velocity

    def coasted(self, state: AnyRobotState) -> AgentState:
        """Return the state of a robot one period later, without a command."""
        state = cast("AgentState", state)
        drive = KINDS[state.kind].drive(self._period, state.mass, state.damping)
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

    def _jump(self, before: AgentState, after: AgentState | None) -> float:
        """Return by how much (m/s) a robot's velocity jumps at the start of the last period."""
        if after is None:
            return 0.0 if before.agent_id in self._standing else -before.velocity
        return after.velocity - before.velocity if before.kind == self._straight else 0.0

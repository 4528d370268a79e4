"""Input for the conditions of all theorems: configuration of the nodes, and initial state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import fsum, tan
from typing import TYPE_CHECKING, Literal

from swarmabs_core.abstraction import Abstraction, Weight, abstraction
from swarmabs_core.messages import Kind, PlaneState
from swarmabs_core.theory.constraint_sets import ConstraintSets

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from swarmabs_core.controllers import ParentController
    from swarmabs_core.manifold import Manifold
    from swarmabs_core.models import AgentConfig
    from swarmabs_core.plant import Plane
    from swarmabs_core.swarm_law import SwarmGains

SwarmKind = Literal["SI", "DI", "noHomo"]
"""Single integrators, double integrators or both, as in the labels of the theorems."""


@dataclass(frozen=True)
class Setting:
    """The properties of a scenario that the theory uses."""

    scenario: str
    controller: str
    make_law: Callable[[], ParentController]
    manifold: Manifold
    plane: Plane
    period: float  # control period, s
    robots: tuple[AgentConfig, ...]  # including those that join later, which are not in the initial state
    duration: float  # s
    delay: int  # of the broadcasts, in steps
    heights: Mapping[int, float]  # of the robots' centres of mass above the axis by id, m; 0 for others
    compensated: float  # first moment H whose weight the controller compensates, kg m
    faulty: bool
    angle_max: float  # theta_max, rad

    @cached_property
    def law(self) -> ParentController:
        """The parent controller."""
        return self.make_law()

    @property
    def swarm_law(self) -> str:
        """The name of the swarm's control law."""
        return self.robots[0].law

    @property
    def gains(self) -> SwarmGains:
        """The gains of the swarm."""
        return self.robots[0].gains

    @cached_property
    def initial_robots(self) -> tuple[AgentConfig, ...]:
        """The robots that take part from the start."""
        return tuple(robot for robot in self.robots if robot.life.first_step == 0)

    @cached_property
    def sets(self) -> ConstraintSets:
        """The constraint sets of the initial robots."""
        return ConstraintSets([robot.mass for robot in self.initial_robots], self.plane.length, self.plane.gravity)

    @cached_property
    def kind(self) -> SwarmKind:
        """The kind of the swarm, including robots that join later."""
        kinds = {robot.kind for robot in self.robots}
        if len(kinds) > 1:
            return "noHomo"
        return "SI" if Kind.SINGLE_INTEGRATOR in kinds else "DI"

    @property
    def has_single(self) -> bool:
        """Whether there are single integrators."""
        return self.kind != "DI"

    @property
    def has_double(self) -> bool:
        """Whether there are double integrators."""
        return self.kind != "SI"

    @cached_property
    def initial(self) -> Abstraction:
        """The initial abstract state."""
        robots = [Weight(robot.mass, robot.position, robot.velocity) for robot in self.initial_robots]
        return abstraction(robots, self.plane.gravity)

    @cached_property
    def desired_torque(self) -> float:
        """The limited torque (N m) that the controller requests at the start."""
        plane = PlaneState(0, 0, self.plane.angle, self.plane.angular_velocity)
        return self.requested(self.make_law(), plane)

    def requested(self, law: ParentController, plane: PlaneState) -> float:
        """Return the limited torque (N m) that a law in its initial state requests, with compensation of heights."""
        return self.manifold.clip(law.torque(0.0, plane) + self.compensated_weight * tan(plane.angle))

    @cached_property
    def moment(self) -> float:
        """First moment H (kg m) of the masses above the axis at the start."""
        return fsum([self.plane.moment, *(robot.mass * self._height(robot) for robot in self.initial_robots)])

    @property
    def raised(self) -> bool:
        """Whether masses are above or below the axis."""
        return bool(self.plane.moment) or any(map(self._height, self.robots))

    @property
    def compensated_weight(self) -> float:
        """The weight g H (N m) that the controller compensates."""
        return self.plane.gravity * self.compensated

    @property
    def weight(self) -> float:
        """The weight g H (N m) above the axis that the controller does not compensate; negative below it."""
        return self.plane.gravity * self.moment - self.compensated_weight

    @cached_property
    def body_inertia(self) -> float:
        """Moment of inertia (kg m^2) of plane and initial robots if these are at p = 0, J + sum m h^2."""
        return self.plane.inertia + fsum(robot.mass * self._height(robot) ** 2 for robot in self.initial_robots)

    @cached_property
    def reacting_height(self) -> float:
        """The height (m) at which the second derivative of the torque reacts on the plane, g sum m h v'/tau_s''.

        It is a mean of the heights with the weights m^2 (S2 - p S1)/S3 of the initial positions.
        """
        robots = self.initial_robots
        s0, s1, s2 = (fsum(robot.mass**2 * robot.position**n for robot in robots) for n in range(3))
        shares = (robot.mass**2 * (s2 - robot.position * s1) * self._height(robot) for robot in robots)
        return fsum(shares) / (s0 * s2 - s1 * s1)

    def _height(self, robot: AgentConfig) -> float:
        return self.heights.get(robot.agent_id, 0.0)

    @property
    def initial_error(self) -> tuple[float, float]:
        """The initial error e_a = a_d - a of torque (N m) and inertia (kg m^2); the filter starts at the command."""
        desired = self.manifold.inertia(self.desired_torque)
        return self.desired_torque - self.initial.torque, desired - self.initial.inertia

    @property
    def initial_error_rate(self) -> tuple[float, float]:
        """The initial rate of the error; that of the desired state is 0, because the filter starts at rest."""
        return -self.initial.torque_rate, -self.initial.inertia_rate

"""Input for the conditions of all theorems: configuration of the nodes, and initial state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

from swarmabs_core.abstraction import Abstraction, Weight, abstraction
from swarmabs_core.messages import Kind, PlaneState
from swarmabs_core.theory.constraint_sets import ConstraintSets

if TYPE_CHECKING:
    from collections.abc import Callable

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
        return self.manifold.clip(self.make_law().torque(0.0, plane))

    @property
    def initial_error(self) -> tuple[float, float]:
        """The initial error e_a = a_d - a of torque (N m) and inertia (kg m^2); the filter starts at the command."""
        desired = self.manifold.inertia(self.desired_torque)
        return self.desired_torque - self.initial.torque, desired - self.initial.inertia

    @property
    def initial_error_rate(self) -> tuple[float, float]:
        """The initial rate of the error; that of the desired state is 0, because the filter starts at rest."""
        return -self.initial.torque_rate, -self.initial.inertia_rate

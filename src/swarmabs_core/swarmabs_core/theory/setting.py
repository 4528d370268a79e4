"""What the conditions of all theorems are evaluated for: how the nodes are configured, and the initial state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos
from typing import TYPE_CHECKING, Literal

from swarmabs_core.abstraction import Abstraction, Weight, abstraction
from swarmabs_core.messages import Kind, PlaneState
from swarmabs_core.theory.constraint_sets import ConstraintSets
from swarmabs_core.theory.error_dynamics import (
    ErrorDynamics,
    epsilon_bound,
    first_order,
    first_order_energy,
    second_order,
    second_order_energy,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.behaviours import AgentConfig
    from swarmabs_core.controllers import ParentController
    from swarmabs_core.friction import Friction
    from swarmabs_core.manifold import Manifold
    from swarmabs_core.plant import Plane
    from swarmabs_core.swarm_law import SwarmGains

SwarmKind = Literal["SI", "DI", "noHomo"]
"""Single integrators, double integrators or both, as in the labels of the theorems."""

Pair = tuple[float, float]


@dataclass(frozen=True)
class Setting:
    """A scenario as the theory sees it.

    Parameters
    ----------
    scenario, controller : str
        Names of the scenario and of its parent controller.
    make_law : callable
        Makes the parent controller.
    manifold : Manifold
        Of the desired abstract state.
    plane : Plane
        The plane.
    period : float
        The control period, s.
    robots : tuple of AgentConfig
        The robots. Those that join later are not in the initial state.
    duration : float
        Of the run, s.
    delay : int
        Of the broadcasts, in steps.
    faulty : bool
        Whether there are faults.
    angle_max : float
        theta_max, rad.
    """

    scenario: str
    controller: str
    make_law: Callable[[], ParentController]
    manifold: Manifold
    plane: Plane
    period: float
    robots: tuple[AgentConfig, ...]
    duration: float
    delay: int
    faulty: bool
    angle_max: float

    @cached_property
    def law(self) -> ParentController:
        """The parent controller."""
        return self.make_law()

    @property
    def friction(self) -> Friction:
        """The friction of the bearing."""
        return self.plane.friction

    @property
    def gains(self) -> SwarmGains:
        """The gains of the swarm."""
        return self.robots[0].gains

    @cached_property
    def initial_robots(self) -> tuple[AgentConfig, ...]:
        """The robots that are there at the start."""
        return tuple(robot for robot in self.robots if robot.life.first_step == 0)

    @cached_property
    def sets(self) -> ConstraintSets:
        """Their constraint sets."""
        return ConstraintSets([robot.mass for robot in self.initial_robots], self.plane.length, self.plane.gravity)

    @cached_property
    def kind(self) -> SwarmKind:
        """The kind of the swarm, with the robots that join later."""
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
    def initial_error(self) -> Pair:
        """The initial error e_a = a_d - a of torque (N m) and inertia (kg m^2); the filter starts at the command."""
        return self.desired_torque - self.initial.torque, self.manifold.inertia(
            self.desired_torque
        ) - self.initial.inertia

    @cached_property
    def initial_error_rate(self) -> Pair:
        """The initial rate of the error; that of the desired state is 0, as the filter starts at rest."""
        return -self.initial.torque_rate, -self.initial.inertia_rate

    @cached_property
    def desired_torque(self) -> float:
        """The torque (N m) that a fresh controller asks for at the start, limited."""
        plane = PlaneState(0, 0, self.plane.angle, self.plane.angular_velocity)
        return self.manifold.clip(self.make_law().torque(0.0, plane))

    @cached_property
    def initial_acceleration(self) -> float:
        """The initial angular acceleration of the plane, rad/s^2; the disturbance begins at 0."""
        plane = self.plane
        opposing = (
            cos(plane.angle) * self.initial.torque
            + self.initial.inertia_rate * plane.angular_velocity
            + self.friction.torque(plane.angular_velocity)
        )
        return -opposing / (plane.inertia + self.initial.inertia)

    @cached_property
    def epsilon_bound(self) -> float:
        """The corrected bound of epsilon over both axes, 1/s."""
        gains = self.gains
        return min(epsilon_bound(kp, kd) for kp, kd in zip(gains.kp, gains.kd, strict=True))

    @property
    def epsilon(self) -> float:
        """The epsilon that is used, half of its bound, 1/s."""
        return self.epsilon_bound / 2.0

    @cached_property
    def errors(self) -> ErrorDynamics:
        """How the swarm follows its desired state; of a mixed swarm what holds for both parts."""
        gains = self.gains
        single, double = first_order(gains.k), second_order(gains.kp, gains.kd, self.epsilon)
        if self.kind == "noHomo":
            return single.with_other(double)
        return single if self.kind == "SI" else double

    @cached_property
    def error_energy(self) -> float:
        """V_a at the start, of a mixed swarm the sum of both parts' functions, each with the whole error."""
        total = 0.0
        if self.has_single:
            total += first_order_energy(self.initial_error)
        if self.has_double:
            total += second_order_energy(self.gains.kp, self.epsilon, self.initial_error, self.initial_error_rate)
        return total

    @cached_property
    def error_growth(self) -> float:
        """The largest g of V_a >= g abs(e_a)^2."""
        growths = [0.5] if self.has_single else []
        if self.has_double:
            growths.append((min(self.gains.kp) - self.epsilon**2) / 2.0)
        return min(growths)

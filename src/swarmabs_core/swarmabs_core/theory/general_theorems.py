r"""The sets S and S_c of the two general theorems, GeneralStability and GeneralConstrainedStability.

The latter uses the errors w_p of the parent system and w_a of the abstract state that satisfy the constraints in any
direction: D_pc and D_ac are the balls

.. math::

    |w_p| \le r_p = \theta_{max} - \max_t |\theta_d(t)| \qquad
    |w_a| \le r_a = \min_{a_d \in A_d} dist(a_d, complement\ of\ A_C)

where the norm combines N m and kg m^2 as in the paper. S is a set V_p + V_a <= c of the unconstrained theorem. S_c is
the largest such set inside S and both balls: V_p + V_a <= c_c, where c_c is the smallest value on the boundary of their
intersection. Inside S_c the errors converge to 0 without violating a constraint.

Taken literally, A_C contains only states that exist, so r_a also includes the distance to the lower bound of the
inertia, which the swarm cannot cross anyway. Both distances are therefore reported.
"""

from __future__ import annotations

from math import hypot, inf
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swarmabs_core.plant import STEEPEST
from swarmabs_core.theory.error_dynamics import deepest_swing
from swarmabs_core.theory.linear_algebra import minimum
from swarmabs_core.theory.report import Condition, Form

if TYPE_CHECKING:
    from swarmabs_core.theory.constraint_sets import ConstraintSets
    from swarmabs_core.theory.report import ParentCheck
    from swarmabs_core.theory.setting import Setting

GRID = 1000


class Clearance(NamedTuple):
    """Distances to the boundaries of A_A, in the norm that combines N m and kg m^2; negative beyond the boundary."""

    lower: float  # to J_min = T^2/M, below which there are no positions
    upper: float  # to J_A, above which some positions are off the plane

    @property
    def radius(self) -> float:
        """The largest radius of a ball inside A_A, as the theorem literally defines it; negative if there is none."""
        return min(self)


def clearance(sets: ConstraintSets, torque: float, inertia: float) -> Clearance:
    """Return the distances of an abstract state (N m, kg m^2) from the boundaries of A_A."""
    # J_A is c2 |tau|^2 + c1 |tau| + c0 up to the torque with all robots at one end.
    length, total = sets.length, sum(sets.masses)
    moment = sets.gravity * total
    across = 1 / (1 / min(sets.masses) - 1 / total)
    reach = abs(torque)
    least = sets.smallest_inertia(1.0)
    lower = _distance(reach, inertia, (least, 0.0, 0.0), (0.0, inf))
    coefficients = (least + across / moment**2, -across * length / moment, across * length * length / 4)
    upper = _distance(reach, inertia, coefficients, (0.0, moment * length / 2))
    inside_lower = inertia >= sets.smallest_inertia(torque)
    inside_upper = inertia <= sets.largest_admissible_inertia(torque)
    return Clearance(lower if inside_lower else -lower, upper if inside_upper else -upper)


def manifold_clearance(sets: ConstraintSets, curvature: float, offset: float, torque_max: float) -> Clearance:
    """Return the smallest distances of a manifold J = curvature tau^2 + offset, |tau| <= torque_max, within A_A.

    Its parameters are in kg m^2/(N m)^2, kg m^2 and N m.
    """

    def at(torque: float) -> Clearance:
        return clearance(sets, torque, curvature * torque * torque + offset)

    grid = np.linspace(0.0, torque_max, 201).tolist()
    states = [at(torque) for torque in grid]
    least = []
    for side in (0, 1):
        index = min(range(len(grid)), key=lambda i: states[i][side])
        bounds = (grid[max(index - 1, 0)], grid[min(index + 1, len(grid) - 1)])
        near = minimum(lambda torque: at(torque)[side], *bounds)  # noqa: B023
        least.append(min(states[index][side], near))
    return Clearance(*least)


def _distance(
    torque: float, inertia: float, coefficients: tuple[float, float, float], bounds: tuple[float, float]
) -> float:
    """Return the distance to the parabola J = c2 tau^2 + c1 tau + c0 with tau within bounds."""
    c2, c1, c0 = coefficients
    below = c0 - inertia
    # Stationary points of the squared distance; real parts of complex roots are merely further points of the curve. If
    # an end of the bounds is nearest, a stationary point lies beyond it.
    stationary = np.roots([2 * c2 * c2, 3 * c1 * c2, 1 + c1 * c1 + 2 * c2 * below, c1 * below - torque]).real.tolist()
    feet = [min(max(foot, bounds[0]), bounds[1]) for foot in stationary]
    return min(hypot(foot - torque, (c2 * foot + c1) * foot + below) for foot in feet)


class Ball(NamedTuple):
    """An error ball |w| <= radius, and the growth of the Lyapunov function in it: V >= growth |w|^2."""

    radius: float
    growth: float


def constrained_level(level: float, parent: Ball, abstract: Ball) -> float:
    """Return the level of S_c for the set S = {V_p + V_a <= level} and the balls D_pc and D_ac; -inf if it is empty.

    On the boundary of the intersection, V_p + V_a is at least the smallest of `level`, V_p on |w_p| = r_p, and V_a on
    |w_a| = r_a. With V >= growth |w|^2 this yields a safe level, which is exact where equality is attained. For a
    negative radius, S_c is empty.
    """
    if min(parent.radius, abstract.radius) < 0:
        return -inf
    return min(level, parent.growth * parent.radius**2, abstract.growth * abstract.radius**2)


class Constraints(NamedTuple):
    """Bounds on torque, positions and errors of a swarm within the robots' constraints."""

    torque: float  # largest desired torque that is assumed, N m
    position: float  # largest |p_i| of all positions with torques and inertias that can occur, m
    errors: tuple[float, float]  # largest errors of the swarm's torque (N m) and inertia (kg m^2) over time


def constraints(setting: Setting, torque: float) -> Constraints:
    """Return bounds of the swarm while the desired torque stays within +-`torque` (N m).

    The errors of torque and inertia decay independently of the plane, so each stays within its largest value; all
    positions with such a torque and inertia are considered.
    """
    errors = _largest_error(setting, 0), _largest_error(setting, 1)
    positions = []
    for index in range(GRID + 1):
        swarm = (torque + errors[0]) * index / GRID
        desired = min(torque, swarm + errors[0])
        positions.append(setting.sets.largest_position(swarm, setting.manifold.inertia(desired) + errors[1]))
    return Constraints(torque, max(positions), errors)


def _largest_error(setting: Setting, axis: int) -> float:
    gains = setting.gains
    error, rate = setting.initial_error[axis], setting.initial_error_rate[axis]
    if not setting.has_double:
        return abs(error)
    kp, kd = gains.kp[axis], gains.kd[axis]
    return max(-deepest_swing(kp, kd, error, rate), -deepest_swing(kp, kd, -error, -rate))


def constrained_conditions(setting: Setting, bounds: Constraints, parent: ParentCheck) -> tuple[Condition, ...]:
    """Return the conditions of thm. GeneralConstrainedStability, given the result of `constraints`."""
    half, manifold = setting.plane.length / 2.0, setting.manifold
    room = manifold_clearance(setting.sets, manifold.curvature, manifold.offset, manifold.torque_max)
    angle_room = STEEPEST - parent.largest_angle
    of_plane, of_swarm = parent.growths
    level = constrained_level(parent.level, Ball(angle_room, of_plane), Ball(room.radius, of_swarm))
    angle = Form("room of the angle, th limit - max |th_d| > 0", angle_room, 0.0)
    return (
        Condition("D_pc", angle, angle, {"angle_limit": STEEPEST, "largest_angle": parent.largest_angle}),
        Condition(
            "S_c",
            Form("V(z0) <= level of S_c, balls around |tau_sd| <= torque_max in A_A", parent.energy, level, "<="),
            Form("largest |p_i| that can occur <= L/2", bounds.position, half, "<="),
            {
                "desired_torque": bounds.torque,
                "largest_errors": bounds.errors,
                "clearance_lower": room.lower,
                "clearance_upper": room.upper,
                "initial_error_norm": hypot(*setting.initial_error),
                "level": level,
            },
            "the errors of the swarm decay independently of the plane, so no common level set is needed: all positions "
            "with a torque and an inertia that occur must be on the plane",
        ),
    )


def abstract_states(setting: Setting, bounds: Constraints) -> dict[str, object]:
    """Return the location of initial, desired and reached abstract states in the constraint sets."""
    manifold, initial, sets = setting.manifold, setting.initial, setting.sets
    half, torque_max = setting.plane.length / 2.0, manifold.torque_max

    def state(torque: float, inertia: float) -> dict[str, object]:
        return {
            "torque": torque,
            "inertia": inertia,
            "class": sets.classify(torque, inertia).value,
            "largest_position": sets.largest_position(torque, inertia),
        }

    reach = sets.manifold_reach(manifold.curvature, manifold.offset)
    reachable = reach.reachable.lower
    return {
        "initial": state(initial.torque, initial.inertia),
        "initial_desired": state(setting.desired_torque, manifold.inertia(setting.desired_torque)),
        "torque_max": torque_max,
        "manifold_end": state(torque_max, manifold.inertia(torque_max)),
        "manifold_reach": {"admissible": reach.admissible, "reachable": reachable, "nonempty": reach.nonempty},
        "manifold_in_A_A": reach.admissible >= torque_max,
        "manifold_in_A_A_or_A_P": reachable >= torque_max,
        "half_length": half,
        "lane_end_margin": half - max(abs(robot.position) for robot in setting.initial_robots),
        "assumed_torque": bounds.torque,
        "largest_position": bounds.position,
        "margin": half - bounds.position,
    }

r"""How much room the constraints leave around the desired state: D_pc, D_ac and S_c (thm. GeneralConstrainedStability).

The theorem takes the errors w_p of the parent system and w_a of the abstract state that keep within the constraints
whatever their direction: D_pc and D_ac are the balls

.. math::

    |w_p| \le r_p = \theta_{max} - \max_t |\theta_d(t)| \qquad
    |w_a| \le r_a = \min_{a_d \in A_d} dist(a_d, complement\ of\ A_C)

where the norm adds N m and kg m^2 as the paper does. S is a set V_p + V_a <= c of the unconstrained theorem. S_c is
the largest such set inside S and both balls: V_p + V_a <= c_c, where c_c is the smallest value on the boundary of their
intersection. Inside S_c the errors go to 0 and never touch a constraint.

Read by the letter, A_C lies within the states that exist, so r_a also counts the distance to the lower bound of the
inertia, below which there is nothing the swarm could do wrong. Both distances are therefore given.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from swarmabs_core.theory.constraint_sets import ConstraintSets


class Clearance(NamedTuple):
    """Distances to the boundaries of A_A, in the norm that adds N m and kg m^2; negative beyond the boundary."""

    lower: float
    """To J_min = T^2/M, below which there are no positions."""
    upper: float
    """To J_A, above which some positions are off the plane."""

    @property
    def radius(self) -> float:
        """The largest radius of a ball inside A_A, the theorem's by the letter; negative if there is none."""
        return min(self)


class Ball(NamedTuple):
    """An error ball |w| <= radius, and how fast the Lyapunov function grows in it: V >= growth |w|^2."""

    radius: float
    growth: float


@dataclass(frozen=True, slots=True)
class ConstrainedRegion:
    """S_c: the errors with V_p + V_a <= level, |w_p| <= parent_radius, |w_a| <= abstract_radius.

    Parameters
    ----------
    level : float
        -inf if the set is empty.
    parent_radius, abstract_radius : float
        r_p and r_a.
    """

    level: float
    parent_radius: float
    abstract_radius: float

    def contains(self, value: float, parent_error: float, abstract_error: float) -> bool:
        """Tell whether errors of these norms, at which V_p + V_a is `value`, lie in S_c."""
        return value <= self.level and parent_error <= self.parent_radius and abstract_error <= self.abstract_radius


def clearance(sets: ConstraintSets, torque: float, inertia: float) -> Clearance:
    """Return how far an abstract state is from the boundaries of A_A.

    Parameters
    ----------
    sets : ConstraintSets
        The robots on their plane.
    torque, inertia : float
        The abstract state, N m and kg m^2.
    """
    masses, length, gravity = sets.masses, sets.length, sets.gravity
    # J_A is c2 |tau|^2 + c1 |tau| + c0 up to the torque at which all robots stand at one end.
    total = sum(masses)
    end = gravity * total * length / 2
    across = 1 / (1 / min(masses) - 1 / total)
    reach = abs(torque)
    lower = _distance(reach, inertia, (sets.smallest_inertia(1.0), 0.0, 0.0), (0.0, inf))
    coefficients = (
        sets.smallest_inertia(1.0) + across / (gravity * total) ** 2,
        -across * length / (gravity * total),
        across * length * length / 4,
    )
    upper = _distance(reach, inertia, coefficients, (0.0, end))
    inside_lower = inertia >= sets.smallest_inertia(torque)
    inside_upper = inertia <= sets.largest_admissible_inertia(torque)
    return Clearance(lower if inside_lower else -lower, upper if inside_upper else -upper)


def manifold_clearance(sets: ConstraintSets, curvature: float, offset: float, torque_max: float) -> Clearance:
    """Return the smallest distances of a manifold J = curvature tau^2 + offset, |tau| <= torque_max, in A_A.

    Parameters
    ----------
    sets : ConstraintSets
        The robots on their plane.
    curvature, offset, torque_max : float
        kg m^2/(N m)^2, kg m^2, N m.
    """

    def at(torque: float) -> Clearance:
        return clearance(sets, torque, curvature * torque * torque + offset)

    grid = np.linspace(0.0, torque_max, 201).tolist()
    states = [at(torque) for torque in grid]
    least = []
    for side in (0, 1):
        index = min(range(len(grid)), key=lambda i: states[i][side])
        bounds = (grid[max(index - 1, 0)], grid[min(index + 1, len(grid) - 1)])
        near = minimize_scalar(lambda torque: at(torque)[side], bounds=bounds, method="bounded")  # noqa: B023
        least.append(min(states[index][side], float(near.fun)))
    return Clearance(*least)


def constrained_region(level: float, parent: Ball, abstract: Ball) -> ConstrainedRegion:
    """Return S_c for the set S = {V_p + V_a <= level} and the balls D_pc and D_ac.

    On the boundary of the intersection V_p + V_a is at least the smallest of `level`, V_p on |w_p| = r_p, and V_a on
    |w_a| = r_a. With V >= growth |w|^2 that gives a level which is safe, and exact where equality is attained.

    Parameters
    ----------
    level : float
        Of S.
    parent, abstract : Ball
        Radius and growth for the errors of the parent system and of the abstract state. Without room, radius < 0,
        S_c is empty.
    """
    balls = (parent, abstract)
    if min(ball.radius for ball in balls) < 0:
        return ConstrainedRegion(-inf, parent.radius, abstract.radius)
    least = min(level, *(ball.growth * ball.radius**2 for ball in balls))
    return ConstrainedRegion(least, parent.radius, abstract.radius)


def _distance(
    torque: float, inertia: float, coefficients: tuple[float, float, float], bounds: tuple[float, float]
) -> float:
    """Return the distance to the parabola J = c2 tau^2 + c1 tau + c0, tau within bounds."""
    c2, c1, c0 = coefficients
    below = c0 - inertia
    # Where the squared distance is stationary; real parts of complex roots are further points of the curve only. If an
    # end of the bounds is nearest, a stationary point lies beyond it.
    stationary = np.roots([2 * c2 * c2, 3 * c1 * c2, 1 + c1 * c1 + 2 * c2 * below, c1 * below - torque]).real.tolist()
    feet = [min(max(foot, bounds[0]), bounds[1]) for foot in stationary]
    return min(hypot(foot - torque, (c2 * foot + c1) * foot + below) for foot in feet)

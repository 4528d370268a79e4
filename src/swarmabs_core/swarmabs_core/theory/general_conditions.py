"""The sets S and S_c of the two general theorems, GeneralStability and GeneralConstrainedStability."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf
from typing import TYPE_CHECKING

from swarmabs_core.plant import STEEPEST
from swarmabs_core.theory.constrained_region import Ball, constrained_region, manifold_clearance
from swarmabs_core.theory.error_dynamics import deepest_swing
from swarmabs_core.theory.report import Condition, Form, finite

if TYPE_CHECKING:
    from swarmabs_core.theory.report import Document, ParentCheck
    from swarmabs_core.theory.setting import Setting

GRID = 1000


@dataclass(frozen=True, slots=True)
class Constraints:
    """What the constraints of the robots leave.

    Parameters
    ----------
    torque : float
        Largest desired torque that is assumed, N m.
    position : float
        Largest abs(p_i) of any positions with the torques and inertias that can occur, m.
    errors : tuple of float
        Largest errors of torque (N m) and inertia (kg m^2) of the swarm on its way.
    """

    torque: float
    position: float
    errors: tuple[float, float]


def constraints(setting: Setting, torque: float) -> Constraints:
    """Return what positions the swarm can take while the desired torque stays within +-`torque` (N m).

    The errors of torque and inertia decay on their own, whatever the plane does, so each stays within its largest
    value, and all positions with such a torque and inertia are looked at.
    """
    bounds = _largest_error(setting, 0), _largest_error(setting, 1)
    positions = []
    for index in range(GRID + 1):
        swarm = (torque + bounds[0]) * index / GRID
        desired = min(torque, swarm + bounds[0])
        positions.append(setting.sets.largest_position(swarm, setting.manifold.inertia(desired) + bounds[1]))
    return Constraints(torque, max(positions), bounds)


def _largest_error(setting: Setting, axis: int) -> float:
    gains = setting.gains
    error, rate = setting.initial_error[axis], setting.initial_error_rate[axis]
    if not setting.has_double:
        return abs(error)
    kp, kd = gains.kp[axis], gains.kd[axis]
    return max(-deepest_swing(kp, kd, error, rate), -deepest_swing(kp, kd, -error, -rate))


def constrained_conditions(setting: Setting, found: Constraints, parent: ParentCheck) -> tuple[Condition, ...]:
    """Return the conditions of thm. GeneralConstrainedStability, given what `constraints` has found."""
    plane, manifold = setting.plane, setting.manifold
    room = manifold_clearance(setting.sets, manifold.curvature, manifold.offset, manifold.torque_max)
    angle_room = STEEPEST - parent.largest_angle
    of_plane, of_swarm = parent.growths
    region = constrained_region(parent.level, Ball(angle_room, of_plane), Ball(room.radius, of_swarm))
    error = hypot(*setting.initial_error)
    return (
        Condition(
            "D_pc",
            Form("room of the angle, th limit - max |th_d| > 0", angle_room, 0.0),
            Form("room of the angle, th limit - max |th_d| > 0", angle_room, 0.0),
            {"angle_limit": STEEPEST, "largest_angle": parent.largest_angle},
        ),
        Condition(
            "S_c",
            Form(
                "V(z0) <= level of S_c, balls around |tau_sd| <= torque_max in A_A", parent.energy, region.level, "<="
            ),
            Form("largest |p_i| that can occur <= L/2", found.position, plane.length / 2.0, "<="),
            {
                "desired_torque": found.torque,
                "largest_errors": found.errors,
                "clearance_lower": room.lower,
                "clearance_upper": room.upper,
                "initial_error_norm": error,
                "level": region.level,
            },
            "the errors of the swarm decay on their own, so no common level set is needed: every position with a "
            "torque and an inertia that occur must be on the plane",
        ),
    )


def abstract_states(setting: Setting, found: Constraints) -> dict[str, Document]:
    """Return how initial, desired and reached abstract states lie in the constraint sets."""
    plane, manifold, initial, sets = setting.plane, setting.manifold, setting.initial, setting.sets
    desired = setting.desired_torque

    def state(torque: float, inertia: float) -> dict[str, Document]:
        return {
            "torque": torque,
            "inertia": inertia,
            "class": sets.classify(torque, inertia).value,
            "largest_position": finite(sets.largest_position(torque, inertia)),
        }

    reach = sets.manifold_reach(manifold.curvature, manifold.offset)
    torque_max = manifold.torque_max
    ends = {"admissible": reach.admissible, "reachable": reach.reachable.lower, "nonempty": reach.nonempty}
    return {
        "initial": state(initial.torque, initial.inertia),
        "initial_desired": state(desired, manifold.inertia(desired)),
        "torque_max": torque_max,
        "manifold_end": state(torque_max, manifold.inertia(torque_max)),
        "manifold_reach": {name: finite(value) for name, value in ends.items()},
        "manifold_in_A_A": reach.admissible >= torque_max,
        "manifold_in_A_A_or_A_P": reach.reachable.lower >= torque_max,
        "half_length": plane.length / 2.0,
        "lane_end_margin": plane.length / 2.0 - max(abs(robot.position) for robot in setting.initial_robots),
        "assumed_torque": found.torque,
        "largest_position": finite(found.position),
        "margin": finite(plane.length / 2.0 - found.position) if found.position < inf else None,
    }

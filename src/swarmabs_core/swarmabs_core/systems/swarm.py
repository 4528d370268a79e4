"""Abstract and auxiliary state of a swarm on any parent system: sums over robots that do not depend on their order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.messages import RobotStatus, SwarmAbstract, SwarmAuxiliary
from swarmabs_core.summation import exact_sum

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from swarmabs_core.messages import RobotState
    from swarmabs_core.systems.interface import Matrix, NamedSystem, ParentSystem, Vector

_SHORT = 1e-3
"""Time, s, over which the Jacobian is differentiated; exact where contributions have degree 2."""


def along(jacobian: Matrix, velocity: Sequence[float]) -> list[float]:
    """Return J v, (k,)."""
    return [sum(a * b for a, b in zip(row, velocity, strict=True)) for row in jacobian]


def total(rows: Iterable[Sequence[float]], size: int) -> Vector:
    """Return the sum of vectors (size,), correctly rounded in each component."""
    columns = list(zip(*rows, strict=True)) or [()] * size
    return tuple(exact_sum(column) for column in columns)


def observed(
    system: NamedSystem, stamp: int, step: int, robots: Sequence[RobotState], *, curvature: bool
) -> tuple[SwarmAbstract, SwarmAuxiliary]:
    """Return the messages that an observer publishes in a step.

    Parameters
    ----------
    stamp, step : int
        Time stamp (ns) and step of both messages.
    robots : sequence of RobotState
        All robots that contribute; those that stand have velocities of 0 and are not active.
    curvature : bool
        Whether robots need the curvature.
    """
    made = system.made
    size = len(made.abstract)
    values, rates, drifts, grams, bends = [], [], [], [], []
    for robot in robots:
        q, velocity, constants = robot.coordinates, robot.velocities, robot.constants
        jacobian = made.jacobian(q, constants)
        rate = along(jacobian, velocity)
        values.append(made.contribution(q, constants))
        rates.append(rate)
        if robot.status == RobotStatus.ACTIVE:
            weight = made.weight(constants)
            grams.append(
                [
                    sum(a * b for a, b in zip(jacobian[i], jacobian[j], strict=True)) / weight
                    for i in range(size)
                    for j in range(i + 1)
                ]
            )
            drifts.append(along(jacobian, made.own_motion(q, constants)))
        else:
            drifts.append(rate)
        if curvature:
            bends.append(_curvature(made, q, velocity, constants))
    return (
        SwarmAbstract(stamp, step, system.hash, len(robots), total(values, size), total(rates, size)),
        SwarmAuxiliary(
            stamp,
            step,
            system.hash,
            total(grams, size * (size + 1) // 2),
            total(drifts, size),
            total(bends, size) if curvature else (),
        ),
    )


def _curvature(made: ParentSystem, q: Vector, velocity: Vector, constants: Vector) -> list[float]:
    """Return the second derivative of a robot's contribution, (k,), while it moves at constant velocity."""
    ahead, behind = (
        along(
            made.jacobian(tuple(x + sign * _SHORT * v for x, v in zip(q, velocity, strict=True)), constants), velocity
        )
        for sign in (1.0, -1.0)
    )
    return [(a - b) / (2.0 * _SHORT) for a, b in zip(ahead, behind, strict=True)]

"""Abstract and auxiliary state of a swarm on any parent system: sums over robots that do not depend on their order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.messages import StandingState, Status, SwarmAbstract, SwarmAuxiliary
from swarmabs_core.summation import added, exact_sum
from swarmabs_core.systems.law import gram_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from typing import TypeAlias

    from swarmabs_core.messages import RobotState
    from swarmabs_core.systems.interface import Matrix, NamedSystem, ParentSystem, Vector

    Add: TypeAlias = Callable[[Iterable[float]], float]

_SHORT = 1e-3
"""Time, s, over which the Jacobian is differentiated; exact where contributions have degree 2."""


def along(jacobian: Matrix, velocity: Sequence[float]) -> list[float]:
    """Return J v, (k,)."""
    return [added(a * b for a, b in zip(row, velocity, strict=True)) for row in jacobian]


def total(rows: Iterable[Sequence[float]], size: int, add: Add = exact_sum) -> Vector:
    """Return the sum of vectors (size,), correctly rounded in each component."""
    columns = list(zip(*rows, strict=True)) or [()] * size
    return tuple(add(column) for column in columns)


def observed(
    system: NamedSystem,
    stamp: int,
    step: int,
    robots: Sequence[RobotState],
    *,
    curvature: bool,
    count: int | None = None,
    add: Add = exact_sum,
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
    count : int, optional
        Number of robots, by default that of the states; each state may be that of several robots as columns.
    add : callable
        What adds the terms of all states in one component.
    """
    instance = system.instance
    size = len(instance.abstract)
    values, rates, drifts, grams, bends = [], [], [], [], []
    for robot in robots:
        q, velocity, constants = robot.coordinates, robot.velocities, robot.constants
        jacobian = instance.jacobian(q, constants)
        rate = along(jacobian, velocity)
        values.append(instance.contribution(q, constants))
        rates.append(rate)
        if robot.status == Status.ACTIVE:
            grams.append(gram_of(jacobian, instance.weight(constants)))
            drifts.append(along(jacobian, instance.own_motion(q, constants)))
        else:
            drifts.append(rate)
        if curvature:
            bends.append(_curvature(instance, q, velocity, constants))

    def summed(rows: list[list[float]] | list[Vector], length: int = size) -> Vector:
        return total(rows, length, add)

    number = len(robots) if count is None else count
    return (
        SwarmAbstract(stamp, step, system.hash, number, summed(values), summed(rates)),
        SwarmAuxiliary(
            stamp,
            step,
            system.hash,
            summed(grams, size * (size + 1) // 2),
            summed(drifts),
            summed(bends) if curvature else (),
        ),
    )


def divided(system: NamedSystem, stamp: int, step: int, robots: Sequence[RobotState]) -> StandingState:
    """Return how the abstract state divides between robots that stand and those that follow the law or hold a limit."""
    instance = system.instance
    parts: tuple[list[RobotState], list[RobotState]] = [], []
    for robot in robots:
        parts[robot.status in (Status.ACTIVE, Status.LIMITED)].append(robot)
    size = len(instance.abstract)
    standing, moving = (
        total((instance.contribution(r.coordinates, r.constants) for r in part), size) for part in parts
    )
    still, active = (total((r.constants for r in part), len(instance.constants)) for part in parts)
    jacobians = [instance.jacobian(r.coordinates, r.constants) for r in parts[1]]
    with_jacobians = list(zip(jacobians, parts[1], strict=True))
    return StandingState(
        stamp,
        step,
        system.hash,
        len(parts[0]),
        len(parts[1]),
        standing,
        still,
        moving,
        total((along(jacobian, r.velocities) for jacobian, r in with_jacobians), size),
        total((_curvature(instance, r.coordinates, r.velocities, r.constants) for r in parts[1]), size),
        total(
            (gram_of(jacobian, instance.weight(r.constants)) for jacobian, r in with_jacobians),
            size * (size + 1) // 2,
        ),
        exact_sum(instance.weight(r.constants) for r in parts[1]),
        active,
    )


def _curvature(instance: ParentSystem, q: Vector, velocity: Vector, constants: Vector) -> list[float]:
    """Return the second derivative of a robot's contribution, (k,), while it moves at constant velocity."""
    ahead, behind = (
        along(
            instance.jacobian(tuple(x + sign * _SHORT * v for x, v in zip(q, velocity, strict=True)), constants),
            velocity,
        )
        for sign in (1.0, -1.0)
    )
    return [(a - b) / (2.0 * _SHORT) for a, b in zip(ahead, behind, strict=True)]

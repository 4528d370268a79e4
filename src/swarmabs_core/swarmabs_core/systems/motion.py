"""Motion of a parent system over one control period, along a cubic through the abstract state at both ends."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

from swarmabs_core.errors import RunError, one_line
from swarmabs_core.messages import Kind
from swarmabs_core.plant import bends, substeps
from swarmabs_core.summation import exact_sum
from swarmabs_core.systems.kinds import kind_of
from swarmabs_core.systems.swarm import along, total

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_core.messages import RobotState
    from swarmabs_core.systems.interface import NamedSystem, Vector
    from swarmabs_core.systems.swarm import Add


class ParentMotion:
    """Integrates a parent system by the classical Runge-Kutta method with equal substeps.

    The cubic has the values of the abstract state and its rate at both ends of the period (s). It is exact for single
    integrators with contributions of degree 2, and of fourth order otherwise. `add` adds the terms of robots.
    """

    def __init__(self, system: NamedSystem, period: float, add: Add = exact_sum) -> None:
        self._system, self._period, self._add = system.instance, period, add
        self._named = system
        self._count = substeps(period, self._system.substep)

    def advance(
        self, time: float, state: Vector, robots: Iterable[tuple[RobotState, RobotState]], disturbance: float = 0.0
    ) -> Vector:
        """Return the state (n,) one period after `time` (s), with the states of the robots at both ends of the period.

        Raises
        ------
        RunError
            If the motion is not finite, or the derivative has another size.
        """
        system, period, count = self._system, self._period, self._count
        cubic = self._cubic(robots)
        disturbed = getattr(system, "disturbed", None)

        def derivative(n: int, x: Vector) -> Vector:
            s = n / (2 * count)
            value = tuple(c0 + s * (c1 + s * (c2 + s * c3)) for c0, c1, c2, c3 in cubic)
            rate = tuple((c1 + s * (2.0 * c2 + s * 3.0 * c3)) / period for _, c1, c2, c3 in cubic)
            try:
                if disturbance and disturbed is not None:
                    slope = disturbed(time + s * period, x, value, rate, disturbance)
                else:
                    slope = system.derivative(time + s * period, x, value, rate)
            except Exception as error:
                if all(abs(number) < _FAR for number in x):
                    raise
                raise RunError(f"{_DIVERGED.format(time)} ({one_line(error)})") from error
            if not isinstance(slope, (tuple, list)) or len(slope) != len(x):
                wanted = f"it must return {len(x)} numbers"
                raise RunError(f"derivative() returned {slope!r} at {time + s * period:g} s; {wanted}")
            return tuple(slope)

        h = period / count
        x = state
        for n in range(0, 2 * count, 2):
            k1 = derivative(n, x)
            k2 = derivative(n + 1, _moved(x, 0.5 * h, k1))
            k3 = derivative(n + 1, _moved(x, 0.5 * h, k2))
            k4 = derivative(n + 2, _moved(x, h, k3))
            x = tuple(
                value + h / 6.0 * (a + 2.0 * (b + c) + d) for value, a, b, c, d in zip(x, k1, k2, k3, k4, strict=True)
            )
        if not all(map(isfinite, x)):
            raise RunError(_DIVERGED.format(time))
        return x

    def _cubic(self, robots: Iterable[tuple[RobotState, RobotState]]) -> list[tuple[float, float, float, float]]:
        """Return the coefficients of the abstract state by s in [0, 1], lowest power first, row by row."""
        instance, size, add = self._system, len(self._system.abstract), self._add
        pairs = tuple(robots)
        start = total((instance.contribution(a.coordinates, a.constants) for a, _ in pairs), size, add)
        end = total((instance.contribution(b.coordinates, b.constants) for _, b in pairs), size, add)
        slopes = [kind_of(b.kind).slopes(self._named, a, b, self._period) for a, b in pairs]
        moving = list(zip(pairs, slopes, strict=True))
        d0 = total((along(instance.jacobian(a.coordinates, a.constants), v) for (a, _), (v, _) in moving), size, add)
        d1 = total((along(instance.jacobian(b.coordinates, b.constants), v) for (_, b), (_, v) in moving), size, add)
        return [(a, u, *bends(u, v, b - a)) for a, b, u, v in zip(start, end, d0, d1, strict=True)]


def standing(state: RobotState) -> RobotState:
    """Return the state at the end of a period in which a robot does not move."""
    return state._replace(kind=Kind.SINGLE_INTEGRATOR)


def _moved(x: Vector, h: float, slope: Vector) -> Vector:
    return tuple(value + h * rate for value, rate in zip(x, slope, strict=True))


_FAR = 1e100
"""Magnitude of a state beyond which the motion has diverged, whatever the system raises there."""
_DIVERGED = "the parent's motion diverged in the period that begins at {} s; reduce the substep or the gains"

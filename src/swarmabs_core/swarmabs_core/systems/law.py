r"""The laws of robots on any parent system (eq. nodeControlLaw, nodeControlLaw_double in general form).

With :math:`e = a_d - a`, the Gram matrix :math:`S = \sum J_i W_i^{-1} J_i^T` of the active robots, the drift r (the
rate of a by motions that are not commanded) and the robot's own motion :math:`\xi_i`:

.. math::

    v &= K e + \dot a_d, \quad y = S^{-1} (v - r), \quad \dot q_i = \xi_i + W_i^{-1} J_i^T y

    w &= K_p e + K_d \dot e + \ddot a_d, \quad
    \ddot q_i = -\sigma \dot q_i + W_i^{-1} J_i^T S^{-1} (w + \sigma \dot a - h)

The first, for single integrators and lags, gives :math:`\dot a = v` exactly; the second, for double integrators,
:math:`\ddot a = w`, with the curvature :math:`h_l = \sum \dot q_i^T \phi_{l,i}'' \dot q_i`. Over a control period, the
commands give these rates in the mean. A robot needs its own coordinates and constants and the broadcasts of one step.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from math import inf, sqrt
from typing import TYPE_CHECKING

from swarmabs_core.abstraction import damped
from swarmabs_core.declaration import setting
from swarmabs_core.messages import Kind, word
from swarmabs_core.summation import added
from swarmabs_core.systems.kinds import KINDS, RobotDynamics

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from swarmabs_core.messages import SwarmAbstract, SwarmBroadcast, SwarmDesired
    from swarmabs_core.systems.interface import Matrix, NamedSystem, ParentSystem, Quantity, Vector

SINGULAR = 1e-12
"""Smallest pivot of a Gram matrix with which a run may start, in units of its largest diagonal entry, both scaled."""
LEAST_PIVOT = 1e-8
"""Pivot in the same units below which the row of the abstract state is no longer fully controlled."""


@dataclass(frozen=True, slots=True)
class SystemGains:
    """Gains of the robots' laws on any parent system: one number, or one for each row of the abstract state."""

    k: tuple[float, ...] = setting(
        (5.0,), "K of single integrators and lags, {unit}, one or by row", unit="1/s", above=0.0
    )
    kp: tuple[float, ...] = setting((16.0,), "Kp of double integrators, {unit}, one or by row", unit="1/s^2", above=0.0)
    kd: tuple[float, ...] = setting((8.0,), "Kd of double integrators, {unit}, one or by row", unit="1/s", above=0.0)
    sigma: float = setting(1.0, "damping of motion that the abstract state does not see", unit="1/s", above=0.0)


class Gram:
    """The Gram matrix S, factorised as scaled L D L^T in fixed order.

    A row whose pivot is small is damped: S + delta in its place of the diagonal is solved, where delta depends on the
    pivot. The motion then gives all other rows exactly, and the share p/(p + delta) of what this row lacks, which
    vanishes with the pivot p.

    Parameters
    ----------
    lower : sequence of float, (k (k + 1) / 2,)
        Its lower triangle by rows.
    rows : sequence of Quantity, (k,)
        The rows of the abstract state.

    Attributes
    ----------
    pivots : list of float
        The scaled pivots.
    uncontrolled : list of int
        The rows whose pivot is too small: the robots cannot control them independently of the rows before.
    empty : bool
        Whether no robot can move anything.
    """

    def __init__(self, lower: Sequence[float], rows: Sequence[Quantity]) -> None:
        self._scales = [row.scale for row in rows]
        size = len(rows)
        scaled = [
            [lower[i * (i + 1) // 2 + j] / (self._scales[i] * self._scales[j]) for j in range(i + 1)]
            for i in range(size)
        ]
        self._largest = max(scaled[i][i] for i in range(size))
        self.empty = self._largest == 0.0
        self._factors: list[list[float]] = []
        self._damped: list[float] = []
        self.pivots: list[float] = []
        edge = LEAST_PIVOT * self._largest
        for i in range(size):
            row: list[float] = []
            for j in range(i):
                explained = added(row[n] * self._damped[n] * self._factors[j][n] for n in range(j))
                row.append((scaled[i][j] - explained) / self._damped[j] if self._damped[j] else 0.0)
            pivot = scaled[i][i] - added(row[n] * row[n] * self._damped[n] for n in range(i))
            self.pivots.append(pivot)
            self._damped.append(pivot if pivot > edge else damped(pivot, edge) if edge else 0.0)
            self._factors.append(row)
        self.uncontrolled = [i for i, pivot in enumerate(self.pivots) if not pivot > SINGULAR * self._largest]

    @property
    def least(self) -> float:
        """The smallest scaled pivot in units of the largest diagonal entry."""
        return min(self.pivots) / self._largest if self._largest else 0.0

    def solve(self, right: Sequence[float]) -> list[float]:
        """Return y with S y = right, both (k,)."""
        size = len(self._damped)
        y = [value / scale for value, scale in zip(right, self._scales, strict=True)]
        for i in range(size):
            y[i] -= added(self._factors[i][n] * y[n] for n in range(i))
        y = [value / pivot for value, pivot in zip(y, self._damped, strict=True)]
        for i in reversed(range(size)):
            y[i] -= added(self._factors[n][i] * y[n] for n in range(i + 1, size))
        return [value / scale for value, scale in zip(y, self._scales, strict=True)]


class Remainder:
    """What some rows of the abstract state ask for beyond what the motion for the other rows gives them anyway.

    Parameters
    ----------
    lower : sequence of float, (k (k + 1) / 2,)
        Lower triangle of the Gram matrix by rows.
    rows : sequence of Quantity, (k,)
        The rows of the abstract state.
    free : sequence of int
        The rows that are satisfied after all others.
    """

    def __init__(self, lower: Sequence[float], rows: Sequence[Quantity], free: Sequence[int]) -> None:
        self._free, self._first = free, [row for row in range(len(rows)) if row not in free]

        def at(i: int, j: int) -> float:
            i, j = max(i, j), min(i, j)
            return lower[i * (i + 1) // 2 + j]

        def of(chosen: Sequence[int], entry: Callable[[int, int], float]) -> Gram:
            triangle = [entry(a, b) for n, a in enumerate(chosen) for b in chosen[: n + 1]]
            return Gram(triangle, [rows[row] for row in chosen])

        first = of(self._first, at) if self._first else None
        # What a unit of each free row has in common with the first rows, solved for these.
        self._common = {
            row: first.solve([at(row, one) for one in self._first]) if first is not None else [] for row in free
        }

        def left(i: int, j: int) -> float:
            return at(i, j) - added(c * at(j, one) for c, one in zip(self._common[i], self._first, strict=True))

        self._gram = of(free, left)

    def excess(self, asked: Sequence[float], most: float) -> list[float]:
        """Return by how much the free rows ask too much, if their share of the effort is to be at most `most`."""
        left = [
            asked[row] - added(c * asked[one] for c, one in zip(self._common[row], self._first, strict=True))
            for row in self._free
        ]
        if self._gram.empty:
            return left
        y = self._gram.solve(left)
        effort = sqrt(max(0.0, added(a * b for a, b in zip(left, y, strict=True))))
        return [value * (1.0 - most / effort) for value in left] if effort > most else [0.0] * len(left)


def by_row(gain: Sequence[float], size: int) -> tuple[float, ...]:
    """Return a gain for each row."""
    return tuple(gain) if len(gain) == size else (gain[0],) * size


class RobotLaw:
    """The law of one robot, its motion over a control period (s), and the effort bound of the swarm.

    `effort` limits the norm of the motion of the whole swarm, the square root of sum W |q' - xi|^2, without a message:
    every robot computes it from the broadcasts.

    Attributes
    ----------
    system : ParentSystem
        The system.
    dynamics : RobotDynamics
        The numbers of the robot.
    """

    def __init__(
        self,
        system: NamedSystem,
        kind: Kind,
        constants: Vector,
        gains: SystemGains,
        period: float,
        *,
        second_order: bool = True,
        effort: float = inf,
    ) -> None:
        self.system, self._kind, self._period = system.instance, kind, period
        size = len(self.system.abstract)
        self._k, self._kp, self._kd = (by_row(gain, size) for gain in (gains.k, gains.kp, gains.kd))
        self._sigma, self._second_order, self._effort = gains.sigma, second_order, effort
        self._model = KINDS[kind]
        self.dynamics = self._model.dynamics(system, constants, period)

    def on(self, system: ParentSystem, dynamics: RobotDynamics) -> RobotLaw:
        """Return the same law for another robot of the kind, given by its numbers, on an equal system."""
        law = copy(self)
        law.system, law.dynamics = system, dynamics
        return law

    def rate(self, q: Vector, velocity: Vector, heard: SwarmBroadcast, held: Vector | None = None) -> Vector | None:
        """Return what the law prescribes at coordinates and velocities, (d,) each; None if no robot follows it yet.

        It is the mean velocity over the period, (d,), and for double integrators the mean acceleration. A robot that
        holds a limit is in the sums with the rate (d,) that is `held`; it asks what the law would prescribe if it
        followed it.
        """
        abstract, auxiliary, desired = heard.abstract, heard.auxiliary, heard.desired
        lower, drift = auxiliary.gram, auxiliary.drift
        if held is not None:
            lower, drift = self._joined(q, held, lower, drift)
        gram = Gram(lower, self.system.abstract)
        if gram.empty:
            return None
        force = self._kind.by_force
        second_order = force and self._second_order
        if second_order:
            right = self._acceleration(abstract, desired, auxiliary.curvature)
        else:
            wanted = desired.end_rate if force else desired.mean_rate
            right = [
                gain * (goal - value) + rate - drift
                for gain, goal, value, rate, drift in zip(
                    self._k, desired.value, abstract.value, wanted, drift, strict=True
                )
            ]
        y = gram.solve(right)
        if self._effort < inf:
            effort = sqrt(max(0.0, added(a * b for a, b in zip(right, y, strict=True))))
            y = [value * min(1.0, self._effort / effort) for value in y] if effort else y
        moved = motion(self.system.jacobian(q, self.dynamics.constants), y, self.dynamics.weight, len(q))
        if second_order:
            return tuple(a - self._sigma * v for a, v in zip(moved, velocity, strict=True))
        target = [a + b for a, b in zip(self.system.own_motion(q, self.dynamics.constants), moved, strict=True)]
        if force:
            return tuple((goal - v) / self._period for goal, v in zip(target, velocity, strict=True))
        return tuple(target)

    def dispensable(self, q: Vector, lower: Vector, *, inside: bool) -> bool:
        """Return whether the others control all rows without this robot, which is `inside` a Gram matrix, or not."""
        if inside:
            own = gram_of(self.system.jacobian(q, self.dynamics.constants), self.dynamics.weight)
            lower = tuple(a - b for a, b in zip(lower, own, strict=True))
        return Gram(lower, self.system.abstract).least > LEAST_PIVOT

    def _joined(self, q: Vector, held: Vector, lower: Vector, drift: Vector) -> tuple[Vector, Vector]:
        """Return Gram matrix and drift with this robot among those that follow the law, instead of its held rate."""
        jacobian = self.system.jacobian(q, self.dynamics.constants)
        gap = [xi - v for xi, v in zip(self.system.own_motion(q, self.dynamics.constants), held, strict=True)]
        own = gram_of(jacobian, self.dynamics.weight)
        return (
            tuple(a + b for a, b in zip(lower, own, strict=True)),
            tuple(
                r + added(a * b for a, b in zip(row, gap, strict=True)) for r, row in zip(drift, jacobian, strict=True)
            ),
        )

    def _acceleration(self, abstract: SwarmAbstract, desired: SwarmDesired, curvature: Vector) -> list[float]:
        """Return w + sigma a' - h, (k,)."""
        return [
            kp * (goal - value) + kd * (goal_rate - rate) + goal_acceleration + self._sigma * rate - bend
            for kp, kd, goal, value, goal_rate, rate, goal_acceleration, bend in zip(
                self._kp,
                self._kd,
                desired.value,
                abstract.value,
                desired.rate,
                abstract.rate,
                desired.mean_acceleration,
                curvature,
                strict=True,
            )
        ]

    def command(self, q: Vector, velocity: Vector, rate: Vector) -> Vector:
        """Return the command (d,) that, held for a period, gives the rate of the law."""
        return self._model.command(self.dynamics, q, velocity, rate)

    def brake(self, q: Vector, velocity: Vector, time: float) -> Vector:
        """Return the command (d,) that brings the robot to rest, a double integrator with a time constant (s)."""
        return self._model.brake(self.dynamics, q, velocity, time)

    def limited(self, command: Vector) -> Vector:
        """Return a command (d,) within the limits of the robot, if the system declares limits."""
        limits = getattr(self.system, "limits", None)
        if limits is None:
            return command
        low, high = limits(self.dynamics.constants, word(self._kind))
        return tuple(min(max(u, a), b) for u, a, b in zip(command, low, high, strict=True))

    def advance(self, q: Vector, velocity: Vector, command: Vector) -> tuple[Vector, Vector]:
        """Return coordinates and velocities, (d,) each, one period later under a command (d,)."""
        return self._model.advance(self.dynamics, q, velocity, command, self._period)

    def held_rate(self, q: Vector, command: Vector) -> Vector:
        """Return the mean velocities (d,) of a single integrator or a lag in the next period under a command (d,)."""
        return tuple((b - a) / self._period for a, b in zip(q, self.advance(q, q, command)[0], strict=True))


def gram_of(jacobian: Matrix, weight: float) -> list[float]:
    """Return a robot's part of the Gram matrix, the lower triangle of J W^-1 J^T by rows, (k (k + 1) / 2,)."""
    return [
        added(a * b for a, b in zip(jacobian[i], jacobian[j], strict=True)) / weight
        for i in range(len(jacobian))
        for j in range(i + 1)
    ]


def motion(jacobian: Matrix, y: Sequence[float], weight: float, size: int) -> list[float]:
    """Return J^T y / W, (d,)."""
    return [added(row[j] * value for row, value in zip(jacobian, y, strict=True)) / weight for j in range(size)]

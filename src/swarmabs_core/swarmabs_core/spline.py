r"""The smooth curve through the rows of a table: a quintic spline at rest at both ends.

It is the interpolant with continuous derivatives up to the fourth that minimises :math:`\int (y''')^2`, with first and
second derivative 0 at both ends. Two rows give the quintic step. Unknown are first and second derivative at the inner
knots; that third and fourth derivative do not jump there is a symmetric, positive definite, block tridiagonal system,
which Gaussian elimination solves without pivoting, by arithmetic alone: the same bits on every machine.
"""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

Derivatives = tuple[float, float, float, float, float]
Pair = tuple[float, float]
Coefficients = tuple[float, float, float, float, float, float]

SHORTEST = 1e-3
"""Shortest time between two rows, s: its fifth power divides."""


class _Matrix(NamedTuple):
    """A matrix of two rows and two columns, row by row."""

    a: float
    b: float
    c: float
    d: float

    def times(self, x: Pair) -> Pair:
        return self.a * x[0] + self.b * x[1], self.c * x[0] + self.d * x[1]

    def product(self, other: _Matrix) -> _Matrix:
        a, c = self.times((other.a, other.c))
        b, d = self.times((other.b, other.d))
        return _Matrix(a, b, c, d)

    def inverse(self) -> _Matrix:
        det = self.a * self.d - self.b * self.c
        return _Matrix(self.d / det, -self.b / det, -self.c / det, self.a / det)

    def transposed(self) -> _Matrix:
        return _Matrix(self.a, self.c, self.b, self.d)


class QuinticSpline:
    """The curve y(t) through rows (t, y); before the first and after the last it stays where they are.

    Parameters
    ----------
    times : sequence of float
        Increasing by at least `SHORTEST`, s.
    values : sequence of float
        As many, at least two.

    Raises
    ------
    InputError
        If there are too few rows, or times that do not increase, or a number that is not finite.
    """

    def __init__(self, times: Sequence[float], values: Sequence[float]) -> None:
        if len(times) != len(values) or len(times) < 2:
            raise InputError(f"{len(times)} times and {len(values)} values make no curve; give two rows or more")
        for earlier, later in pairwise(times):
            if not later - earlier >= SHORTEST:
                raise InputError(f"time {later!r} s follows {earlier!r} s; let the times increase by {SHORTEST} s")
        if not all(isfinite(number) for number in (*times, *values)):
            raise InputError("a number that is not finite; give finite times and values")
        self._times = tuple(times)
        slopes = _slopes(times, values)
        self._pieces = [
            _piece(t1 - t0, (y0, *s0), (y1, *s1))
            for t0, t1, y0, y1, s0, s1 in zip(times, times[1:], values, values[1:], slopes, slopes[1:], strict=False)
        ]
        self._ends = values[0], values[-1]

    def derivatives(self, time: float) -> Derivatives:
        """Return y and its first four derivatives at a time in s."""
        index = bisect_right(self._times, time) - 1
        if index < 0 or index >= len(self._pieces):
            return self._ends[0 if index < 0 else 1], 0.0, 0.0, 0.0, 0.0
        x = time - self._times[index]
        c0, c1, c2, c3, c4, c5 = self._pieces[index]
        return (
            c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5)))),
            c1 + x * (2.0 * c2 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5))),
            2.0 * c2 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5)),
            6.0 * c3 + x * (24.0 * c4 + x * 60.0 * c5),
            24.0 * c4 + x * 120.0 * c5,
        )


def _piece(h: float, start: tuple[float, float, float], end: tuple[float, float, float]) -> Coefficients:
    """Return the quintic over an interval of length h with value and two derivatives given at both ends."""
    y0, v0, a0 = start
    rise = end[0] - y0 - h * (v0 + 0.5 * h * a0)
    slope = h * (end[1] - v0 - h * a0)
    bend = h * h * (end[2] - a0)
    cube = h * h * h
    return (
        y0,
        v0,
        0.5 * a0,
        (10.0 * rise - 4.0 * slope + 0.5 * bend) / cube,
        (-15.0 * rise + 7.0 * slope - bend) / (cube * h),
        (6.0 * rise - 3.0 * slope + 0.5 * bend) / (cube * h * h),
    )


def _slopes(times: Sequence[float], values: Sequence[float]) -> list[Pair]:
    """Return first and second derivative at every knot: block elimination, then substitution backwards."""
    inner = range(1, len(times) - 1)
    eliminated: list[tuple[_Matrix, Pair]] = []
    previous, known = _Matrix(0.0, 0.0, 0.0, 0.0), (0.0, 0.0)
    for i in inner:
        h, k = times[i] - times[i - 1], times[i + 1] - times[i]
        rise, next_rise = (values[i] - values[i - 1]) / h, (values[i + 1] - values[i]) / k
        h, k = 1.0 / h, 1.0 / k
        mixed = -36.0 * (h * h - k * k)
        diagonal = _Matrix(192.0 * (h * h * h + k * k * k), mixed, mixed, 9.0 * (h + k))
        right = (
            360.0 * (rise * h * h * h + next_rise * k * k * k),
            -60.0 * (rise * h * h - next_rise * k * k),
        )
        below = _coupling(h).transposed()
        taken, carried = below.product(previous), below.times(known)
        pivot = _Matrix(
            diagonal.a - taken.a, diagonal.b - taken.b, diagonal.c - taken.c, diagonal.d - taken.d
        ).inverse()
        known = pivot.times((right[0] - carried[0], right[1] - carried[1]))
        previous = pivot.product(_coupling(k))
        eliminated.append((previous, known))
    slopes: list[Pair] = [(0.0, 0.0)]
    for factor, constant in reversed(eliminated):
        shift = factor.times(slopes[-1])
        slopes.append((constant[0] - shift[0], constant[1] - shift[1]))
    return [(0.0, 0.0), *reversed(slopes)]


def _coupling(k: float) -> _Matrix:
    """Return how the derivatives at the end of an interval of length 1/k enter the equations of its beginning."""
    return _Matrix(168.0 * k * k * k, -24.0 * k * k, 24.0 * k * k, -3.0 * k)

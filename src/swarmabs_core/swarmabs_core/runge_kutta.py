r"""Motion :math:`\dot x = v, \dot v = a(s, x, v)` over a period by the pair of Dormand and Prince, of orders 5 and 4.

Coefficients: J. R. Dormand and P. J. Prince, "A family of embedded Runge-Kutta formulae", J. Comput. Appl. Math. 6
(1980). `s` is the share of the period that has passed. A step is accepted if its estimated error is small, else halved;
the last stage of a step is the first one of the next. A smooth period is one step of six evaluations, and one more for
its start. Nothing but additions, multiplications, divisions and comparisons decides on the steps, so they are the same
on every machine, and for many periods at once, given as arrays, the same as for each of them.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats: TypeAlias = NDArray[np.float64]

Acceleration: TypeAlias = Callable[[Any, Any, Any], Any]
"""Share of the period, x and v in, a out: numbers, or arrays (K,)."""

TOLERANCE = 1e-11
"""Largest estimated error of x, and of v times 1 s, in an accepted step, in their units."""
SHORTEST = 2.0**-20
"""Shortest step, in periods; it is accepted whatever its error is."""
_ORDER = 32.0
"""Factor by which the estimated error of a step grows with each doubling of its length."""
_MARGIN = 2.0
_DOUBLINGS = 3
"""Most doublings of the length from a step to the next one."""

_C2, _C3, _C4, _C5 = 1 / 5, 3 / 10, 4 / 5, 8 / 9
_A21 = 1 / 5
_A31, _A32 = 3 / 40, 9 / 40
_A41, _A42, _A43 = 44 / 45, -56 / 15, 32 / 9
_A51, _A52, _A53, _A54 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
_A61, _A62, _A63, _A64, _A65 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
_B1, _B3, _B4, _B5, _B6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
_E1, _E3, _E4, _E5, _E6, _E7 = 71 / 57600, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40


def step(acceleration: Acceleration, s: Any, h: Any, period: float, state: tuple[Any, Any, Any]) -> tuple[Any, ...]:
    """Return x, v and a at the end of a step of `h` periods (s) from `s` on, and the estimated errors of x and v.

    The state holds x, v and a at its start.
    """
    x, v, a1 = state
    d, end = h * period, s + h
    v2 = v + d * (_A21 * a1)
    a2 = acceleration(s + _C2 * h, x + d * (_A21 * v), v2)
    v3 = v + d * (_A31 * a1 + _A32 * a2)
    a3 = acceleration(s + _C3 * h, x + d * (_A31 * v + _A32 * v2), v3)
    v4 = v + d * (_A41 * a1 + _A42 * a2 + _A43 * a3)
    a4 = acceleration(s + _C4 * h, x + d * (_A41 * v + _A42 * v2 + _A43 * v3), v4)
    v5 = v + d * (_A51 * a1 + _A52 * a2 + _A53 * a3 + _A54 * a4)
    a5 = acceleration(s + _C5 * h, x + d * (_A51 * v + _A52 * v2 + _A53 * v3 + _A54 * v4), v5)
    v6 = v + d * (_A61 * a1 + _A62 * a2 + _A63 * a3 + _A64 * a4 + _A65 * a5)
    a6 = acceleration(end, x + d * (_A61 * v + _A62 * v2 + _A63 * v3 + _A64 * v4 + _A65 * v5), v6)
    x7 = x + d * (_B1 * v + _B3 * v3 + _B4 * v4 + _B5 * v5 + _B6 * v6)
    v7 = v + d * (_B1 * a1 + _B3 * a3 + _B4 * a4 + _B5 * a5 + _B6 * a6)
    a7 = acceleration(end, x7, v7)
    of_x = d * (_E1 * v + _E3 * v3 + _E4 * v4 + _E5 * v5 + _E6 * v6 + _E7 * v7)
    of_v = d * (_E1 * a1 + _E3 * a3 + _E4 * a4 + _E5 * a5 + _E6 * a6 + _E7 * a7)
    return x7, v7, a7, of_x, of_v


def advance(
    acceleration: Acceleration,
    period: float,
    state: tuple[float, float],
    longest: float,
    begin: float = 0.0,
    event: Callable[[float, float, tuple[float, float, float], tuple[float, float, float]], Any] | None = None,
) -> tuple[float, float, Any]:
    """Return x and v at the end of a period (s), and what ended the motion before, None if nothing did.

    Parameters
    ----------
    acceleration : callable
        The motion.
    period : float
        Length of the period, s.
    state : tuple of float
        x and v at the share `begin` of the period.
    longest : float
        Longest step, in periods.
    begin : float
        Share of the period at which the motion begins.
    event : callable, optional
        Takes share and length of each accepted step, and x, v and a at its start and its end. If it returns anything
        but None, the motion ends with it.
    """
    s = begin
    h = min(longest, 1.0 - s)
    x, v = state
    a = acceleration(s, x, v)
    while s < 1.0:
        x7, v7, a7, of_x, of_v = step(acceleration, s, h, period, (x, v, a))
        error = max(abs(of_x), abs(of_v))
        if not error <= TOLERANCE and h > SHORTEST:
            if not error < inf:
                return x7, v7, None
            while error > TOLERANCE and h > SHORTEST:
                h, error = 0.5 * h, error / _ORDER
            continue
        if event is not None and (ended := event(s, h, (x, v, a), (x7, v7, a7))) is not None:
            return x7, v7, ended
        x, v, a = x7, v7, a7
        s = s + h
        for _ in range(_DOUBLINGS):
            error = error * _ORDER
            if error > TOLERANCE / _MARGIN:
                break
            h = 2.0 * h
        h = min(h, longest, 1.0 - s)
    return x, v, None


def advance_each(
    acceleration: Callable[[Any], Acceleration], period: float, state: tuple[Floats, Floats], longest: float
) -> tuple[Floats, Floats]:
    """Return x and v (K,) at the ends of many periods (s): the same bits as `advance`.

    The acceleration is a function of the periods that still move, given by an index of arrays (K,).
    """
    end_x, end_v = state[0].copy(), state[1].copy()
    places = (end_x * 0.0 == 0.0).nonzero()[0]  # those that are not finite stay so
    motion = acceleration(places)
    x, v = end_x[places], end_v[places]
    s = 0.0 * x
    h = s + longest
    a = motion(s, x, v)
    while len(places):
        x7, v7, a7, of_x, of_v = step(motion, s, h, period, (x, v, a))
        error = abs(of_x)
        larger = ~(abs(of_v) <= error)
        error[larger] = abs(of_v)[larger]
        lost = ~(error < inf)
        taken = (error <= TOLERANCE) | (h <= SHORTEST) | lost
        for old, new in ((x, x7), (v, v7), (a, a7), (s, s + h)):
            old[taken] = new[taken]
        while (rejected := ~taken & (error > TOLERANCE) & (h > SHORTEST)).any():
            h[rejected] *= 0.5
            error[rejected] /= _ORDER
        growing = taken
        for _ in range(_DOUBLINGS):
            error = error * _ORDER
            growing = growing & (error <= TOLERANCE / _MARGIN)
            h[growing] *= 2.0
        h = h.clip(max=longest).clip(max=1.0 - s)
        done = (s >= 1.0) | lost
        if done.any():
            end_x[places[done]], end_v[places[done]] = x[done], v[done]
            left = ~done
            places, x, v, a, s, h = (array[left] for array in (places, x, v, a, s, h))
            motion = acceleration(places)
    return end_x, end_v

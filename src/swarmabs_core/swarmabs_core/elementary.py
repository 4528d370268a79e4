r"""Correctly rounded elementary functions: the same bits on every machine.

Every result is the double nearest to the true value, and the even one of two that are equally near. That is a
definition, so any implementation of it, such as MPFR, gives the same bits. Results follow from the operations of
IEEE 754 (``+ - * /``, comparison), which are the same everywhere, Python's integers, and `math.frexp`, which is exact.
The mathematical library of the machine only starts the iteration for a quantile, whose result does not depend on the
start. As in IEEE 754, functions return infinities and NaN instead of raising: ``exp(1000.0)`` is ``inf``,
``sin(inf)`` is ``nan``.

How a result is found:

1. *Near a node.* The argument is a multiple c of 2**-8 plus a rest h, exactly. The Taylor polynomial about c, with its
   two largest terms as exact products, gives a sum ``hi + lo`` of two doubles and a bound e of its error (`near`). If
   ``hi + (lo - e)`` and ``hi + (lo + e)`` round to the same double, that is the result (Ziv's test).
2. *Other ranges.* Large arguments are reduced by multiples of ln 2 or pi/2; near zeros a short series is used.
3. *In integers.* Where the test fails, for 1 to 24 in 10,000 arguments, and in rare ranges, the function is computed in
   integers with a bound of the error, and ever more bits until both bounds round to the same double (`_decided`). No
   value but those that are treated first lies halfway between two doubles: the others are transcendental numbers. (Of
   the quantile that is not proven; with such a value it would not end.)

Nodes are computed in integers when they are first needed, and kept: 1 to 35 us and half a kilobyte each.
`swarmabs_core.elementary_arrays` applies the functions to numpy arrays with the same nodes, formulas and bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache, lru_cache
from itertools import accumulate, count, repeat
from math import frexp, inf, isqrt, nan
from operator import mul
from statistics import NormalDist
from typing import Any, TypeAlias

Node: TypeAlias = tuple[float, ...]
"""Head and tail of the value, head and tail of the slope, the Taylor coefficients a2 to a6, and the bound e."""

_GRID = 1.5 * (1 << 44)
"""A double with neighbours 2**-8 away: adding and subtracting it rounds to a multiple of 2**-8."""
_HEAD = 1.5 * (1 << 22)
"""A double with neighbours 2**-30 away."""
_WHOLE = 1.5 * (1 << 52)
"""A double with neighbours 1 away."""
_UNKNOWN: Node = (nan,) * 10
"""The node of arguments without one: fails every test."""


# Integers: x stands for x / 2**p. Each function computes with _GUARD more bits than it returns.

_GUARD = 32
_ERROR = 64
"""Bound of the errors of `_exp`, `_sin_cos`, `_tanh`, `_log` and of values that follow from them, in units of 2**-p.

A sum of less than 2**11 terms, each truncated twice, is off by less than 2**12 units of 2**-(p + _GUARD); 8 doublings
multiply that by at most 4 each, to 2**28. What is left is the truncation to p bits, 1 unit, which the sums, products
and quotients that follow multiply by less than 64.
"""
_START = 192
"""Bits of the first attempt in integers: arguments above 2**-54 are multiples of 2**-_START."""
_QUANTILE_START = 120
"""Bits to which one step from a double suffices."""
_DOUBLINGS = 8
"""How often an argument is halved before its series is summed."""
_FEW, _MANY = 16, 1024
"""Bits before the point of usual arguments of sine and cosine, and of the largest double."""


def _nearest(value: int, p: int) -> float:
    """Return the double nearest to value / 2**p; Python rounds quotients of integers correctly."""
    try:
        return value / (1 << p) if p >= 0 else float(value << -p)
    except OverflowError:
        return inf if value > 0 else -inf


def _decided(approximation: Callable[[int], tuple[int, int]], p: int = _START) -> float:
    """Return the double nearest to a number.

    Parameters
    ----------
    approximation : callable
        Takes a number of bits p and returns v and q: the number is v / 2**q, v off by at most _ERROR.
    p : int, optional
        Bits of the first attempt.
    """
    while True:
        value, q = approximation(p)
        low = _nearest(value - _ERROR, q)
        if low == _nearest(value + _ERROR, q):
            return low
        p *= 2


def _rounded(hi: float, lo: float, e: float, approximation: Callable[[int], tuple[int, int]], p: int = _START) -> float:
    """Return the double nearest to a number: from hi + lo, which is off by at most e, if that is enough."""
    y = hi + (lo - e)
    return y if y == hi + (lo + e) else _decided(approximation, p)


def _fixed(x: float, p: int) -> int:
    """Return x * 2**p, rounded down: exact if x is a multiple of 2**-p."""
    numerator, denominator = x.as_integer_ratio()
    return (numerator << p) // denominator


def _power_series(y: int, q: int, divisors: Iterable[int]) -> int:
    """Return 1 + y/d1 (1 + y/d2 (1 + ...)), until the terms vanish."""
    total = term = 1 << q
    for divisor in divisors:
        term = (term * y >> q) // divisor
        if term in {0, -1}:
            break
        total += term
    return total


def _factors(first: int) -> Iterable[int]:
    """Return n (n + 1) for n = first, first + 2, ...: the quotients of every second factorial."""
    return (n * (n + 1) for n in count(first, 2))


def _odd_series(z: int, q: int, sign: int) -> int:
    """Return z + s z**3/3 + z**5/5 + s z**7/7 + ...: the arc tangent for s = -1, the area tangent for s = 1."""
    square = sign * (z * z >> q)
    total, n = z, 1
    while z not in {0, -1}:
        z = z * square >> q
        n += 2
        total += z // n
    return total


@cache
def _ln2(p: int) -> int:
    return 2 * _odd_series((1 << p + _GUARD) // 3, p + _GUARD, 1) >> _GUARD


@cache
def _half_pi(p: int) -> int:
    q = p + _GUARD
    return 2 * (4 * _odd_series((1 << q) // 5, q, -1) - _odd_series((1 << q) // 239, q, -1)) >> _GUARD


@cache
def _root_two_pi(p: int) -> int:
    return isqrt(_half_pi(2 * p + 2))


def _exp(x: int, p: int) -> tuple[int, int]:
    """Return v and q: exp(x / 2**(p + _GUARD)) is v / 2**q, where 2**p <= v < 2**(p + 1)."""
    q = p + _GUARD
    k, rest = divmod(x, _ln2(q))  # abs(k) < 2**12: the guard bits suffice
    value = _power_series(rest >> _DOUBLINGS, q, count(1))
    for _ in range(_DOUBLINGS):
        value = value * value >> q
    return value >> _GUARD, p - k


def _sin_cos(x: float, p: int) -> tuple[int, int]:
    """Return sine and cosine."""
    q = p + _GUARD
    # pi/2 has as many more bits as its multiple may have before the point.
    more = _FEW if abs(x) < 1 << _FEW else _MANY
    turns, rest = divmod(_fixed(x, q + more), _half_pi(q + more))
    y = rest >> more + _DOUBLINGS
    square = -(y * y >> q)
    s = y * _power_series(square, q, _factors(2)) >> q
    c = _power_series(square, q, _factors(1))
    for _ in range(_DOUBLINGS):
        s, c = s * c >> q - 1, (c * c >> q - 1) - (1 << q)
    s >>= _GUARD
    c >>= _GUARD
    return ((s, c), (c, -s), (-s, -c), (-c, s))[turns % 4]


def _tanh(x: float, p: int) -> int:
    """Return the hyperbolic tangent; abs(x) < 22, so that exp(2x) has less than 64 bits before or after the point."""
    value, q = _exp(_fixed(2.0 * x, p + _GUARD), p)
    one = 1 << q
    return (value - one << p) // (value + one)


def _log(x: float, p: int) -> int:
    """Return the logarithm of a positive number."""
    q = p + _GUARD
    fraction, exponent = frexp(x)
    numerator, denominator = fraction.as_integer_ratio()
    if 3 * denominator > 4 * numerator:  # between 1/2 and 3/4
        numerator, exponent = 2 * numerator, exponent - 1
    z = (numerator - denominator << q) // (numerator + denominator)
    return 2 * _odd_series(z, q, 1) + exponent * _ln2(q) >> _GUARD


# Nodes


class Nodes(dict[float, Node]):
    """The nodes of a function by their places c, abs(c) <= limit; each is computed when it is first needed."""

    def __init__(self, limit: float, compute: Callable[[float], Node]) -> None:
        super().__init__()
        self.limit = limit
        self._compute = compute

    def __missing__(self, c: float) -> Node:
        if not -self.limit <= c <= self.limit:
            return _UNKNOWN
        node = self[c] = self._compute(c)
        return node


_BITS = 128
"""Bits to which nodes are computed."""


def _node(value: int, slope: int, higher: Node, seventh: float, digits: int = 52) -> Node:
    """Return a node, given value and slope in units of 2**-_BITS and a2 to a6.

    The head of the value is a multiple of 2**-digits, that of the slope of 2**-(digits - 30).

    Parameters
    ----------
    seventh : float
        Bound of the seventh Taylor coefficient within 2**-9 of the node.
    """
    f0, f0l = _head_and_tail(value, digits)
    f1, f1l = _head_and_tail(slope, digits - 30)
    a2, a3, a4, a5, a6 = higher
    curvature = abs(a2) + 2.0**-9 * (abs(a3) + abs(a4) + abs(a5) + abs(a6))
    # The bound is derived in near.
    e = 24.0 * 2.0**-71 * curvature + 2.0**-74 * abs(f1) + 2.0**-79 + 1.01 * 2.0**-63 * seventh
    return f0, f0l, f1, f1l, a2, a3, a4, a5, a6, e


def _head_and_tail(number: int, digits: int) -> tuple[float, float]:
    """Return the nearest multiple of 2**-digits, and what is left of a number in units of 2**-_BITS."""
    dropped = _BITS - digits
    head = number + (1 << dropped - 1) >> dropped
    return head / (1 << digits), (number - (head << dropped)) / (1 << _BITS)


def near(nodes: Any, x: Any, t: Any) -> tuple[Any, Any, Any]:
    r"""Return hi, lo and e: the function at x + t is hi + lo, with an error of at most e - 2**-53 abs(lo).

    So e also covers the rounding of ``lo - e`` and ``lo + e``. Numbers or arrays; ``abs(t) <= 2**-53``, for x between
    -2**43 and 2**43.

    The bound. With H = 2**-9, u = 2**-53 and the node's values f0 + f0l, f1 + f1l, a2, ..., a6:

    - ``h = x - c`` is exact: both are multiples of the last place of x, or c is 0. The head is a multiple of 2**-30
      and f1 of 2**-22, so their product is exact, is a multiple of 2**-52 like f0, and so is ``hi``, which is below 2.
      (The quantile has other units.)
    - Let M = abs(a2) + H (abs(a3) + ... + abs(a6)). The coefficients are off by at most 12u each, the polynomial from
      a2 on by another 1.1u M; multiplying it by h, which for t != 0 is rounded, adding f1l and multiplying by h adds
      5u. So this part of lo, at most H**2 M, is off by 18.1u H**2 M; its sums with the others add 2u H**2 M, and
      ``lo +- e`` as much as one: less than 24u H**2 M = 24 M 2**-71.
    - Of the other terms, abs(f1 tail) <= 2**-31 abs(f1) is rounded 5 times, abs(f1l h) <= 2**-29 6 times, abs(f0l)
      <= 2**-50 twice: less than 2**-79 + 2**-81 abs(f1). A reduced argument is off by at most 2**-74.9, which with the
      former is less than 2**-74 abs(f1).
    - The remainder of the polynomial is at most `seventh` (1.01 H**7).
    """
    c = (x + _GRID) - _GRID
    f0, f0l, f1, f1l, a2, a3, a4, a5, a6, e = nodes[c]
    h = x - c
    head = (h + _HEAD) - _HEAD
    tail = (h - head) + t
    h = head + tail
    lo = f0l + (f1 * tail + h * (f1l + h * (a2 + h * (a3 + h * (a4 + h * (a5 + h * a6))))))
    return f0 + f1 * head, lo, e


# Reduction


def _period(value: int) -> tuple[float, float, float]:
    """Return 1 / period and, as two doubles with 42 bits after the point each, the period, in units of 2**-_BITS."""
    dropped = _BITS - 84
    head, tail = divmod(value + (1 << dropped - 1) >> dropped, 1 << 42)
    first = head / (1 << 42)
    return 1.0 / first, first, tail / (1 << 84)


_LN2 = _period(_ln2(_BITS))
_HALF_PI = _period(_half_pi(_BITS))


def _reduced(x: float, period: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return n, r and t: x is n periods + r + t, where abs(t) <= 2**-53 and r + t is off by at most 2**-74.9.

    For abs(n) <= 2**10: n times a part of the period is exact, and so is the first difference, a multiple of the last
    place of x not larger than x. Of the second difference, r and t are the rounded value and its error, exactly. The
    parts of the period are off by 2**-85.
    """
    rate, first, second = period
    n = (x * rate + _WHOLE) - _WHOLE
    rest = x - n * first
    fine = n * second
    r = rest - fine
    return n, r, (rest - r) - fine


# Exponential functions

_LOWEST = -1021
_POWERS = tuple(accumulate(repeat(2.0, 1023 - _LOWEST), mul, initial=1.0 / (1 << -_LOWEST)))
"""2**m for m = _LOWEST to 1023: factors that keep doubles between 1/2 and 2 normal."""
_FACTORIALS = (1.0, 1.0, 2.0, 6.0, 24.0, 120.0, 720.0, 5040.0)


def _exp_node(c: float, subtracted: int) -> Node:
    value, q = _exp(_fixed(c, _BITS + _GUARD), _BITS)
    value = value << _BITS - q if q < _BITS else value >> q - _BITS
    slope = value / (1 << _BITS)
    higher = tuple(slope / factorial for factorial in _FACTORIALS[2:7])
    return _node(value - (subtracted << _BITS), value, higher, 1.01 * slope / _FACTORIALS[7])


_EXP = Nodes(0.375, lambda c: _exp_node(c, 0))
_EXPM1 = Nodes(1.0, lambda c: _exp_node(c, 1))


def _scaled_exp(x: float) -> tuple[float, float, float, float]:
    """Return a power of two, and hi, lo and e of exp(x) divided by it, as `near` does, for x between -707 and 709."""
    m, r, t = _reduced(x, _LN2)
    return _POWERS[int(m) - _LOWEST], *near(_EXP, r, t)


def exp(x: float) -> float:
    """Return e**x, correctly rounded."""
    if -707.0 < x < 709.0:
        power, hi, lo, e = _scaled_exp(x)
        y: float = hi + (lo - e)
        if y == hi + (lo + e):
            return y * power
        if -(2.0**-54) <= x <= 2.0**-54:
            return 1.0
    elif not -746.0 < x < 710.0:
        return inf if x > 0.0 else 0.0 if x < 0.0 else nan
    return _decided(lambda p: _exp(_fixed(x, p + _GUARD), p))


def expm1(x: float) -> float:
    """Return e**x - 1, correctly rounded."""
    if -1.0 < x < 1.0:
        hi, lo, e = near(_EXPM1, x, 0.0)
        y: float = hi + (lo - e)
        if y == hi + (lo + e):
            return y
    return _expm1_elsewhere(x)


def _expm1_elsewhere(x: float) -> float:
    if -(2.0**-54) <= x <= 2.0**-54:
        return x  # the rest, x**2/2, is less than a quarter of the last place
    hi = lo = e = nan
    if -(2.0**-9) <= x <= 2.0**-9:
        # lo is off by less than 4 roundings, and at most 0.51 x**2; the next term is less than 2**-70 x**2
        square = x * x
        series = 1 / 6 + x * (1 / 24 + x * (1 / 120 + x * (1 / 720 + x * (1 / 5040 + x / 40320))))
        hi, lo, e = x, square * (0.5 + x * series), 2.0**-51 * square
    elif -50.0 < x < 709.0:
        power, hi, lo, e = _scaled_exp(x)
        # The sum of two doubles is a double and an exact error.
        larger = hi * power
        hi = larger - 1.0
        error = (larger - hi) - 1.0 if larger > 1.0 else larger - (hi + 1.0)
        # lo is below 2**-17 of the power and the error below 2**-53 of the result; their sum is rounded twice.
        lo, e = lo * power + error, (e + 2.0**-68) * power + 2.0**-104
    elif not -50.0 < x < 710.0:
        return -1.0 if x < 0.0 else inf if x > 0.0 else nan
    return _rounded(hi, lo, e, lambda p: _expm1(x, p))


def _expm1(x: float, p: int) -> tuple[int, int]:
    value, q = _exp(_fixed(x, p + _GUARD), p)
    return value - (1 << q) if q > 0 else value, q  # without a place after the point, 1 is at most a unit


@cache
def _exp_of(c: float) -> tuple[int, int]:
    return _exp(_fixed(c, _BITS + _GUARD), _BITS)


def _tanh_node(c: float) -> Node:
    if c < 0.0:
        f0, f0l, f1, f1l, a2, a3, a4, a5, a6, e = _TANH[-c]
        return -f0, -f0l, f1, f1l, -a2, a3, -a4, a5, -a6, e
    whole = (2.0 * c + _WHOLE) - _WHOLE
    (large, q), (small, r) = _exp_of(whole), _exp_of(2.0 * c - whole)
    power, one = large * small >> _BITS, 1 << q + r - _BITS
    value = (power - one << _BITS) // (power + one)
    slope = (1 << _BITS) - (value * value >> _BITS)
    # tanh' = 1 - tanh**2, so the coefficient of h**n in the square is -(n + 1) times the next one of tanh.
    a0, a1 = value / (1 << _BITS), slope / (1 << _BITS)
    a2 = -a0 * a1
    a3 = -(2.0 * a0 * a2 + a1 * a1) / 3.0
    a4 = -(a0 * a3 + a1 * a2) / 2.0
    a5 = -(2.0 * (a0 * a4 + a1 * a3) + a2 * a2) / 5.0
    a6 = -(a0 * a5 + a1 * a4 + a2 * a3) / 3.0
    return _node(value, slope, (a2, a3, a4, a5, a6), 17 / 315)  # the seventh coefficient is largest at 0


_TANH = Nodes(20.0, _tanh_node)


def tanh(x: float) -> float:
    """Return the hyperbolic tangent, correctly rounded."""
    if not -20.0 < x < 20.0:
        return 1.0 if x > 0.0 else -1.0 if x < 0.0 else nan
    hi, lo, e = near(_TANH, x, 0.0)
    y = hi + (lo - e)
    return y if y == hi + (lo + e) else _tanh_near_zero(x)


def _tanh_near_zero(x: float) -> float:
    if -(2.0**-27) <= x <= 2.0**-27:
        return x  # the rest, x**3/3, is less than a quarter of the last place
    hi = lo = e = nan
    if -(2.0**-9) <= x <= 2.0**-9:
        # lo is at most 2**-19.5 x, off by less than 5 roundings, and the next term less than 2**-77 x
        square = x * x
        lo = x * square * (-1 / 3 + square * (2 / 15 - square * (17 / 315)))
        hi, e = x, 2.0**-70 * abs(x)
    return _rounded(hi, lo, e, lambda p: (_tanh(x, p), p))


# Sine and cosine


@cache
def _sin_cos_of(c: float) -> tuple[int, int]:
    return _sin_cos(c, _BITS)


@lru_cache(maxsize=1)  # sine and cosine of an angle are often needed together
def _sin_cos_at(c: float) -> tuple[int, int]:
    """Return sine and cosine of a multiple of 2**-8, from those of a multiple of 2**-4 and of the rest."""
    coarse = ((16.0 * c + _WHOLE) - _WHOLE) / 16.0
    (s, k), (s1, k1) = _sin_cos_of(coarse), _sin_cos_of(c - coarse)
    return s * k1 + k * s1 >> _BITS, k * k1 - s * s1 >> _BITS


def _sine_node(c: float, quarter: int) -> Node:
    """Return a node of the sine, or of the cosine, which is a quarter turn ahead."""
    sine, cosine = _sin_cos_at(c)
    value, slope = (cosine, -sine) if quarter else (sine, cosine)
    f0, f1 = value / (1 << _BITS), slope / (1 << _BITS)
    return _node(value, slope, (-f0 / 2.0, -f1 / 6.0, f0 / 24.0, f1 / 120.0, -f0 / 720.0), 1 / 5040)


_SIN = Nodes(4.0, lambda c: _sine_node(c, 0))
_COS = Nodes(4.0, lambda c: _sine_node(c, 1))


def sin(x: float) -> float:
    """Return the sine of an angle, rad, correctly rounded."""
    if -4.0 < x < 4.0:
        hi, lo, e = near(_SIN, x, 0.0)
        y: float = hi + (lo - e)
        if y == hi + (lo + e):
            return y
    return _sine_elsewhere(x, 0)


def cos(x: float) -> float:
    """Return the cosine of an angle, rad, correctly rounded."""
    if -4.0 < x < 4.0:
        hi, lo, e = near(_COS, x, 0.0)
        y: float = hi + (lo - e)
        if y == hi + (lo + e):
            return y
    return _sine_elsewhere(x, 1)


@lru_cache(maxsize=1024)
def sin_cos(x: float) -> tuple[float, float]:
    """Return sine and cosine of an angle, rad, correctly rounded; those of recent angles are remembered."""
    return sin(x), cos(x)


def _sine_elsewhere(x: float, quarter: int) -> float:
    """Return the sine, or the cosine, which is a quarter turn ahead."""
    hi = lo = e = nan
    if -1024.0 < x < 1024.0 and (quarter or not -(2.0**-9) <= x <= 2.0**-9):
        n, r, t = _reduced(x, _HALF_PI)
        turn = int(n) + quarter & 3
        hi, lo, e = near(_COS if turn & 1 else _SIN, r, t)
        if turn & 2:
            hi, lo = -hi, -lo
        y: float = hi + (lo - e)
        if y == hi + (lo + e):
            return y
    if -(2.0**-27) <= x <= 2.0**-27:
        return 1.0 if quarter else x  # the rest is less than a quarter of the last place
    if not -inf < x < inf:
        return nan
    if not quarter and -(2.0**-9) <= x <= 2.0**-9:
        # lo is at most 2**-20.5 x, off by less than 5 roundings, and the next term less than 2**-90 x
        square = x * x
        lo = x * square * (-1 / 6 + square * (1 / 120 - square / 5040))
        hi, e = x, 2.0**-71 * abs(x)
    return _rounded(hi, lo, e, lambda p: (_sin_cos(x, p)[quarter], p))


# Logarithm


def _log_node(c: float) -> Node:
    numerator, denominator = c.as_integer_ratio()
    value, slope = _log(c, _BITS), (denominator << _BITS) // numerator
    _, a2, a3, a4, a5, a6, a7 = (1.0 / (n * power) for n, power in enumerate(accumulate(repeat(c, 7), mul), 1))
    return _node(value, slope, (-a2, a3, -a4, a5, -a6), 1.02 * a7)


_LOG = Nodes(1.5, _log_node)


def log(x: float) -> float:
    """Return the natural logarithm, correctly rounded; -inf of 0, NaN of negative numbers."""
    if not 0.0 < x < inf:
        return x if x == inf else -inf if x == 0.0 else nan
    m, k = frexp(x)
    if m < 0.75:
        m, k = 2.0 * m, k - 1
    rest = m - 1.0
    if k == 0 and -(2.0**-9) <= rest <= 2.0**-9:
        if rest == 0.0:
            return 0.0
        # lo is off by less than 4 roundings, and at most 0.51 rest**2; the next term is less than 2**-66 rest**2
        square = rest * rest
        series = 1 / 3 + rest * (-1 / 4 + rest * (1 / 5 + rest * (-1 / 6 + rest * (1 / 7 - rest / 8))))
        hi, lo, e = rest, square * (-0.5 + rest * series), 2.0**-51 * square
    else:
        hi, lo, e = near(_LOG, m, 0.0)
        if k:
            # The sum of two doubles, the larger one first, is a double and an exact error.
            _, first, second = _LN2
            larger, smaller = k * first, hi
            hi = larger + smaller
            lo += (larger - hi) + smaller + k * second
            # lo is at most 2**-17, and rounded 3 times; the parts of ln 2 are off by 2**-85.
            e = 2.0 * e + 2.0**-68
    return _rounded(hi, lo, e, lambda p: (_log(x, p), p))


NODES: dict[Callable[[float], float], Nodes] = {sin: _SIN, cos: _COS, tanh: _TANH, expm1: _EXPM1}
"""Functions that first look for a node near the argument itself."""


# Normal distribution


def _lower_tail(x: int, p: int) -> tuple[int, int]:
    """Return the normal distribution and its density at -x, in units of 2**-p; x >= 0 in units of 2**-(p + _GUARD)."""
    q = p + _GUARD
    square = x * x >> q
    value, scale = _exp(-square >> 1, p)
    density = (value << q) // _root_two_pi(q) >> scale - p
    # x + x**3/3 + x**5/15 + ...: half less the density times this is the tail.
    series = x * _power_series(square, q, count(3, 2)) >> q
    return (1 << p - 1) - (density * series >> q), density


def _quantile(probability: float, p: int) -> tuple[int, int]:
    """Return the quantile -x at a probability of at most 1/2, in units of 2**-p, and p.

    The start, whose last digits may differ between machines, does not matter: a step of third order with x, the density
    d and ``w = (tail - probability) / d``, x + w + x w**2 / 2, leaves less than (2 x**2 + 1) abs(w)**3, and is repeated
    until that is less than a unit. Tail and density are off by few units of 2**-work, where the tail is above 2**-zeros
    / 2 and the series it results from below 2**(zeros + 2), so w is off by less than 2**(2 zeros + 8 - work).
    """
    zeros = -frexp(probability)[1]
    work = p + 2 * zeros + 16
    q = work + _GUARD
    x = _fixed(-NormalDist().inv_cdf(probability), q)
    while True:
        tail, density = _lower_tail(x, work)
        w = (tail - _fixed(probability, work) << q) // density
        left = abs(w) ** 3 * (2 * x * x + (1 << 2 * q)) >> 4 * q
        x += w + (x * w * w >> 2 * q + 1)
        if left < 1 << q - p:
            return -x >> q - p, p


def _quantile_node(c: float, unit: float) -> Node:
    """Return a node of the quantile at c units of probability."""
    value, _ = _quantile(c * unit, _BITS)
    work = 2 * _BITS
    _, density = _lower_tail(-value << work + _GUARD - _BITS, work)
    slope = (_fixed(unit, work) << _BITS) // density
    # With the quantile z and its slope s, the nth derivative is P(z) s**n, where the next P is P' + n z P.
    z, s = value / (1 << _BITS), slope / (1 << _BITS)
    z2, s2 = z * z, s * s
    higher = (
        z * s2 / 2.0,
        (1.0 + 2.0 * z2) * s2 * s / 6.0,
        z * (7.0 + 6.0 * z2) * s2 * s2 / 24.0,
        (7.0 + z2 * (46.0 + 24.0 * z2)) * s2 * s2 * s / 120.0,
        z * (127.0 + z2 * (326.0 + 120.0 * z2)) * s2 * s2 * s2 / 720.0,
    )
    seventh = (127.0 + z2 * (1740.0 + z2 * (2556.0 + 720.0 * z2))) * s2 * s2 * s2 * s / 5040.0
    return _node(value, slope, higher, 1.1 * seventh, digits=49)


def _quantile_nodes(unit: float) -> Nodes:
    return Nodes(2.0, lambda c: _quantile_node(c, unit))


_UNITS = tuple(accumulate(repeat(0.5, 53), mul, initial=0.5))
_QUANTILE = tuple(_quantile_nodes(unit) for unit in _UNITS)


def normal_quantile(probability: float) -> float:
    """Return the quantile of the normal distribution with mean 0 and variance 1, correctly rounded.

    The number below which a variable of this distribution lies with a probability between 0 and 1; -inf for 0, inf for
    1, NaN outside.
    """
    if not 0.0 < probability < 0.5:
        if 0.5 < probability < 1.0:
            return -normal_quantile(1.0 - probability)  # the difference is exact
        return {0.0: -inf, 0.5: 0.0, 1.0: inf}.get(probability, nan)
    fraction, exponent = frexp(probability)
    hi = lo = e = nan
    if exponent > -len(_UNITS):
        hi, lo, e = near(_QUANTILE[-exponent], 2.0 * fraction, 0.0)
    return _rounded(hi, lo, e, lambda p: _quantile(probability, p), _QUANTILE_START)

"""Sums over robots, given as numbers or as arrays, that do not depend on the order of their terms.

A formula computes the terms of one robot by arithmetic only. Applied to columns of arrays instead of the numbers of one
robot, it computes the same bits for all robots at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from itertools import chain, starmap
from math import fsum, nan
from operator import add
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Columns: TypeAlias = "tuple[NDArray[np.float64], ...]"
"""Robots as arrays, one for each of their quantities."""
Terms: TypeAlias = Callable[..., tuple[Any, ...]]
"""The numbers of a robot in, its terms in several sums out; without numbers, zero terms."""
Reduction: TypeAlias = Callable[[Iterable[Sequence[float]]], list[float]]
"""The terms of all robots, for each sum, in; numbers that do not depend on the order of the robots out."""
Sums: TypeAlias = Callable[[Iterable[Any], Terms, Reduction], list[float]]
"""Robots, their terms and a reduction of these in, its numbers out: `robot_sums`, or `column_sums` for columns."""

PLACES = 1074
"""Bits after the point of the least double."""

_Term = TypeVar("_Term")


def exact_sum(terms: Iterable[float]) -> float:
    """Return the correctly rounded sum; NaN if it does not exist, as with infinite or overflowing terms."""
    try:
        return fsum(terms)
    except (OverflowError, ValueError):  # terms near the largest double, or +inf with -inf
        return nan


def exact_units(terms: Sequence[float]) -> int:
    """Return the sum of terms without rounding, in units of 2**-1074, of which every double is a multiple.

    Such sums of parts add up to that of the whole, in any grouping and order.

    Raises
    ------
    OverflowError, ValueError
        If a term or the sum is infinite or NaN.
    """
    rest, total = list(terms), 0
    while part := fsum(rest):
        numerator, denominator = part.as_integer_ratio()
        total += numerator << (PLACES + 1 - denominator.bit_length())
        rest.append(-part)
    return total


def rounded(units: int, places: int = PLACES) -> float:
    """Return the double nearest to a sum in units of 2**-places; NaN if it overflows."""
    try:
        return units / (1 << places)  # Python rounds quotients of integers correctly
    except OverflowError:
        return nan


def added(terms: Iterable[_Term]) -> _Term:
    """Return the sum of a few terms, numbers or columns, added one after the other; 0 without terms.

    The built-in `sum` of numbers rounds differently since Python 3.12.
    """
    total: Any = reduce(add, terms, 0.0)
    return total  # type: ignore[no-any-return]


def exact_total(*columns: Iterable[float]) -> float:
    """Return the `exact_sum` of all numbers in columns."""
    return exact_sum(chain.from_iterable(columns))


def term_columns(robots: Iterable[Iterable[float]], terms: Terms) -> Iterable[Sequence[float]]:
    """Return the terms of all robots, for each sum."""
    return zip(*(list(starmap(terms, robots)) or [terms()]), strict=True)


def each_sum(columns: Iterable[Iterable[float]]) -> list[float]:
    """Return the `exact_sum` of each column."""
    return [exact_sum(column) for column in columns]


def determinant(columns: Iterable[Sequence[float]]) -> list[float]:
    """Return the sums a, b, c of three columns and a c - b^2, at least 0, each rounded once; all NaN without sums."""
    try:
        a, b, c = map(exact_units, columns)
    except (OverflowError, ValueError):
        return [nan] * 4
    # Without the zeros at the ends of all three, the products are a tenth as long.
    bits = a | b | c | 1 << PLACES
    zeros = (bits & -bits).bit_length() - 1
    a, b, c, places = a >> zeros, b >> zeros, c >> zeros, PLACES - zeros
    return [*(rounded(units, places) for units in (a, b, c)), max(0.0, rounded(a * c - b * b, 2 * places))]


def robot_sums(robots: Iterable[Iterable[float]], terms: Terms, reduction: Reduction = each_sum) -> list[float]:
    """Return the sums over robots given as tuples of numbers."""
    return reduction(term_columns(robots, terms))


def column_sums(robots: Iterable[Any], terms: Terms, reduction: Reduction = each_sum) -> list[float]:
    """Return the sums over robots given as columns, which are numpy arrays."""
    return reduction([column.tolist() for column in terms(*robots)])


def column_total(*columns: NDArray[np.float64]) -> float:
    """Return the `exact_sum` of all numbers in columns, which are numpy arrays."""
    terms = columns[0].tolist()
    for column in columns[1:]:
        terms += column.tolist()
    return exact_sum(terms)

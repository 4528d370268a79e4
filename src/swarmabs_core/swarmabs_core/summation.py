"""Sums over robots, given as numbers or as arrays, that do not depend on the order of their terms.

A formula computes the terms of one robot by arithmetic only. Applied to columns of arrays instead of the numbers of one
robot, it computes the same bits for all robots at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import chain, starmap
from math import fsum, isfinite, nan
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Columns: TypeAlias = "tuple[NDArray[np.float64], ...]"
"""Robots as arrays, one for each of their quantities."""
Terms: TypeAlias = Callable[..., tuple[Any, ...]]
"""The numbers of a robot in, its terms in several sums out; without numbers, zero terms."""
Sums: TypeAlias = Callable[[Iterable[Any], Terms], list[float]]
"""Robots and their terms in, the sums out: `robot_sums`, or `column_sums` for robots as columns."""

_Term = TypeVar("_Term")


def exact_sum(terms: Iterable[float]) -> float:
    """Return the correctly rounded sum; NaN if it does not exist, as with infinite or overflowing terms."""
    try:
        return fsum(terms)
    except (OverflowError, ValueError):  # terms near the largest double, or +inf with -inf
        return nan


def added(terms: Iterable[_Term]) -> _Term:
    """Return the sum of numbers or columns, with the rounding errors of its additions added in the end.

    That is what the built-in `sum` does with numbers since Python 3.12; before, it gives other bits. A sum of numbers
    that overflows is infinite or NaN; no terms give 0.
    """
    total: Any = 0.0
    lost: Any = 0.0
    for term in terms:
        after = total + term
        part = after - total
        lost = lost + ((total - (after - part)) + (term - part))
        total = after
    if isinstance(total, float) and not isfinite(lost):
        return total  # type: ignore[return-value]
    return total + lost  # type: ignore[no-any-return]


def exact_total(*columns: Iterable[float]) -> float:
    """Return the `exact_sum` of all numbers in columns."""
    return exact_sum(columns[0] if len(columns) == 1 else chain.from_iterable(columns))


def term_columns(robots: Iterable[Iterable[float]], terms: Terms) -> Iterable[Sequence[float]]:
    """Return the terms of all robots, for each sum."""
    return zip(*(list(starmap(terms, robots)) or [terms()]), strict=True)


def robot_sums(robots: Iterable[Iterable[float]], terms: Terms) -> list[float]:
    """Return the sums over robots given as tuples of numbers."""
    return [exact_sum(column) for column in term_columns(robots, terms)]


def column_sums(robots: Iterable[Any], terms: Terms) -> list[float]:
    """Return the sums over robots given as columns, which are numpy arrays."""
    return [column_total(column) for column in terms(*robots)]


def column_total(*columns: NDArray[np.float64]) -> float:
    """Return the `exact_sum` of all numbers in columns, which are numpy arrays."""
    return exact_total(*(column.tolist() for column in columns))

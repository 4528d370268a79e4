"""Sums over robots that do not depend on the order of their terms, of numbers and of arrays alike.

A formula gives the terms of one robot by arithmetic alone. Handed columns of arrays instead of one robot's numbers, it
gives the same bits for all of them at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import starmap
from math import fsum, nan
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Columns: TypeAlias = "tuple[NDArray[np.float64], ...]"
"""Robots as arrays, one for each of their numbers."""
Terms: TypeAlias = Callable[..., tuple[Any, ...]]
"""The numbers of a robot in, its terms of several sums out; without any numbers, those of no robot."""
Sums: TypeAlias = Callable[[Iterable[Any], Terms], list[float]]
"""Robots and their terms in, the sums out: `robot_sums`, or `column_sums` where the robots are columns."""


def exact_sum(terms: Iterable[float]) -> float:
    """Return the correctly rounded sum; NaN where there is none, as of infinite or overflowing terms."""
    try:
        return fsum(terms)
    except (OverflowError, ValueError):  # of terms near the largest double, and of +inf with -inf
        return nan


def term_columns(robots: Iterable[Iterable[float]], terms: Terms) -> Iterable[Sequence[float]]:
    """Return for each sum the terms of all robots."""
    return zip(*(list(starmap(terms, robots)) or [terms()]), strict=True)


def robot_sums(robots: Iterable[Iterable[float]], terms: Terms) -> list[float]:
    """Return the sums over robots that are tuples of numbers."""
    return [exact_sum(column) for column in term_columns(robots, terms)]


def column_sums(robots: Iterable[Any], terms: Terms) -> list[float]:
    """Return the sums over robots whose numbers are columns, each an array of numpy."""
    return [exact_sum(column.tolist()) for column in terms(*robots)]

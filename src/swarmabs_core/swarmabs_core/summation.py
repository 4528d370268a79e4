"""Sums that do not depend on the order of their terms."""

from __future__ import annotations

from math import fsum, nan
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


def exact_sum(terms: Iterable[float]) -> float:
    """Return the correctly rounded sum; NaN where there is none, as of infinite or overflowing terms."""
    try:
        return fsum(terms)
    except (OverflowError, ValueError):  # of terms near the largest double, and of +inf with -inf
        return nan

"""Curves with no more points than a picture can show."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]


def column_points(column: Integers, values: Floats) -> Integers:
    """Return which points of a line stand for it, ascending.

    Parameters
    ----------
    column : ndarray of int, (n,)
        The column of the picture in which each point lies, ascending.
    values : ndarray, (n,)
        Their heights; NaN is a gap, whose borders are kept.
    """
    begins = np.flatnonzero(np.diff(column, prepend=column[0] - 1))
    ends = np.append(begins[1:], len(column))
    missing = np.isnan(values)
    gaps = np.flatnonzero(missing[1:] != missing[:-1])
    lowest = np.where(missing, np.inf, values)
    highest = np.where(missing, -np.inf, values)
    extremes = [
        found
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)
        for found in (begin + int(np.argmin(lowest[begin:end])), begin + int(np.argmax(highest[begin:end])))
    ]
    return np.unique(np.concatenate([begins, ends - 1, gaps, gaps + 1, np.array(extremes, dtype=np.int64)]))

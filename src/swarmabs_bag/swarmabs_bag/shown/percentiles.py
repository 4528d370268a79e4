"""Percentiles of the positions of many robots, for the bands of reports and of the page.

Robots that start on different sides of the axis move differently, so each side has percentiles of its own: a median of
both would lie where no robot is, or jump from one side to the other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

QUANTILES = {"lowest": 0.0, "5 %": 0.05, "25 %": 0.25, "median": 0.5, "75 %": 0.75, "95 %": 0.95, "highest": 1.0}
"""The part of the robots with positions up to each line, by its name."""
SIDES = {True: "> 0", False: "≤ 0"}
"""The sides of the axis on which a robot may start, by whether it starts above 0."""


def starts_above(start: float) -> bool:
    """Return whether a robot that starts at this position, or first coordinate, is on the upper side."""
    return start > 0.0


def percentiles(values: ArrayLike) -> NDArray[np.float64] | None:
    """Return the `QUANTILES` of the finite values, shape (7,), None if there are none."""
    finite = np.asarray(values, dtype=np.float64).ravel()
    finite = finite[np.isfinite(finite)]
    return np.quantile(finite, list(QUANTILES.values())) if len(finite) else None

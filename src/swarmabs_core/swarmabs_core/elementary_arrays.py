"""The functions of `swarmabs_core.elementary` over numpy arrays: same nodes, formulas and bits."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_core.elementary import NODES, Nodes, near

if TYPE_CHECKING:
    from swarmabs_core.arrays import Floats

_STEP = 2.0**-8
"""Distance of nodes."""


class _Columns:
    """The nodes of a function, looked up for arrays of places: one array for each number of a node."""

    def __init__(self, nodes: Nodes) -> None:
        self._nodes = nodes
        self._end = nodes.limit + _STEP  # a place without a node, as are all places outside and NaN
        size = int(2.0 * self._end / _STEP) + 1
        self._table = np.empty((10, size))
        self._known = np.zeros(size, dtype=bool)

    def __getitem__(self, places: Floats) -> Floats:
        inside = (places >= -self._end) & (places <= self._end)
        index = ((np.where(inside, places, self._end) + self._end) / _STEP).astype(np.intp)
        for n in set(index[~self._known[index]].tolist()):
            self._table[:, n] = self._nodes[n * _STEP - self._end]
            self._known[n] = True
        return self._table.take(index, axis=1)


@cache
def _columns(function: Callable[[float], float]) -> _Columns:
    return _Columns(NODES[function])


def elementwise(function: Callable[[float], float], values: Floats) -> Floats:
    """Return a function of each number of an array, with the bits of the function itself.

    Parameters
    ----------
    function : callable
        `sin`, `cos`, `tanh` or `expm1` of `swarmabs_core.elementary`.
    values : array
        Numbers, of any shape.
    """
    x = values.ravel()
    with np.errstate(over="ignore", invalid="ignore"):  # arguments without a node
        hi, lo, e = near(_columns(function), x, 0.0)
        result: Floats = hi + (lo - e)
        undecided = np.flatnonzero(result != hi + (lo + e))
    for n in undecided:
        result[n] = function(float(x[n]))
    return result.reshape(values.shape)

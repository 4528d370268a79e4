"""The functions of `swarmabs_core.elementary` over numpy arrays: same nodes, formulas and bits."""

from __future__ import annotations

from collections.abc import Callable
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

    def __getitem__(self, places: Floats) -> Floats:
        last = self._nodes.limit + _STEP  # a place without a node, as all places outside and NaN
        inside = (places >= -last) & (places <= last)
        index = ((np.where(inside, places, last) + last) / _STEP).astype(np.int64)
        used = np.zeros(int(2.0 * last / _STEP) + 1, dtype=bool)
        used[index] = True
        which = np.flatnonzero(used)
        table = np.empty((10, len(used)))
        table[:, which] = np.transpose([self._nodes[float(c)] for c in which * _STEP - last])
        return table[:, index]


def elementwise(function: Callable[[float], float], values: Floats) -> Floats:
    """Return a function of each number of an array, with the bits of the function itself.

    Parameters
    ----------
    function : callable
        `sin`, `cos`, `tanh` or `expm1` of `swarmabs_core.elementary`.
    values : array
        Numbers, of any shape, at least one.
    """
    x = values.ravel()
    with np.errstate(over="ignore", invalid="ignore"):  # arguments without a node
        hi, lo, e = near(_Columns(NODES[function]), x, 0.0)
        result: Floats = hi + (lo - e)
        undecided = np.flatnonzero(result != hi + (lo + e))
    for n in undecided:
        result[n] = function(float(x[n]))
    return result.reshape(values.shape)

"""Lines with no more points than a picture can show: of every column of it the first, lowest, highest and last."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmabs_bag.recorded_swarm import column_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

_CELL = 0.5
"""Width of a column, points."""
_FEW = 500
"""Points up to which a line is left alone."""
_MOST = 4000
"""Points of a line that is no function of x."""


def thin_lines(figure: Figure) -> None:
    """Thin all lines of a figure whose layout and limits are final; what it looks like stays the same."""
    scale = 72.0 / figure.dpi / _CELL
    for axes in figure.axes:
        axes.set_autoscale_on(False)
        for line in axes.lines:
            points = np.column_stack([np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)])
            if len(points) > _FEW and line.get_transform() == axes.transData:
                chosen = _chosen(axes, points, scale)
                line.set_data(points[chosen, 0], points[chosen, 1])


def _chosen(axes: Axes, points: Floats, scale: float) -> Integers:
    with np.errstate(all="ignore"):
        places = axes.transData.transform(points) * scale
    places[~np.isfinite(places)] = np.nan
    if not np.isnan(places[:, 0]).any() and (np.diff(points[:, 0]) >= 0).all():
        return column_points(np.floor(places[:, 0]).astype(np.int64), points[:, 1])
    # A path that fills an area: its points in coarser and coarser cells, at last in one.
    chosen = np.arange(len(points))
    cells = np.where(np.isnan(places), -1.0, places - np.nanmin(places, axis=0, initial=np.inf))
    while len(chosen) > _MOST and (cells > 0).any():
        moved = np.any(np.floor(cells[1:]) != np.floor(cells[:-1]), axis=1)
        chosen = np.concatenate([[0], np.flatnonzero(moved) + 1])
        cells = np.where(cells < 0, cells, np.where(cells < 1.0, 0.0, cells / 2.0))
    return chosen[:: -(-len(chosen) // _MOST)]

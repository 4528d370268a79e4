"""Many robots over time: percentile bands and mass density."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from swarmabs_analysis.figures.style import BLACK, DASHED, DOTTED, GREY, SOLID
from swarmabs_bag.shown.percentiles import SIDES, percentiles, starts_above
from swarmabs_core.systems.kinds import KINDS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from numpy.typing import NDArray

    from swarmabs_analysis.report.record import Recorded

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

COLUMNS, LINES = 240, 80


def draw_bands(axes: Axes, recorded: Recorded, values: Floats) -> list[Line2D | Patch]:
    """Draw bands that contain 50 and 90 % of the robots, the extremes, the median, and three named robots.

    Robots that start on different sides of the axis move differently and have separate bands. The values have shape
    (n+1, N), NaN where a robot has none; the time axis must be set. Returns the entries of the legend.
    """
    there = np.isfinite(values).any(axis=0)
    legend: list[Line2D | Patch] = []
    above = np.array([starts_above(start) for start in _start(recorded).tolist()])
    for (side, named_side), colour in zip(SIDES.items(), (BLACK, GREY), strict=True):
        chosen = np.flatnonzero(there & (above == side))
        if len(chosen):
            _draw_band(axes, recorded, values[:, chosen], colour)
            symbol = recorded.subject.term(recorded.tables.robot[0]).symbol
            legend.append(Patch(color=colour, alpha=0.5, label=f"initially {symbol} {named_side}"))
    named = _named(recorded, values, there).items() if there.any() else ()
    for (name, column), dashes in zip(named, (SOLID, DASHED, DOTTED), strict=False):
        colour = KINDS[int(recorded.arrays.agents.kind[:, column].max())].colour
        legend += axes.plot(
            recorded.arrays.time, values[:, column], color=colour, linestyle=dashes, linewidth=1.0, label=name
        )
    return legend


def _draw_band(axes: Axes, recorded: Recorded, values: Floats, colour: str) -> None:
    time: list[float] = []
    bands: list[Floats] = []
    for rows, _ in _columns(axes, recorded):
        lines = percentiles(values[rows])
        if lines is not None:
            time.append(float(recorded.arrays.time[rows].mean()))
            bands.append(lines)
    lowest, low, lower, middle, upper, high, highest = np.array(bands).T
    axes.fill_between(time, low, high, color=colour, alpha=0.2, linewidth=0.0)
    axes.fill_between(time, lower, upper, color=colour, alpha=0.35, linewidth=0.0)
    for edge in (lowest, highest):
        axes.plot(time, edge, color=colour, linestyle=DOTTED, linewidth=0.7)
    axes.plot(time, middle, color=colour, linewidth=1.1)


def _start(recorded: Recorded) -> Floats:
    """Return the first position of each robot, m, or its first coordinate."""
    agents = recorded.arrays.agents
    return np.asarray(recorded.coordinates[..., 0][(agents.kind > 0).argmax(axis=0), np.arange(len(agents.ids))])


def density(axes: Axes, recorded: Recorded) -> QuadMesh:
    """Draw the mass density over position and time, kg per mm; the time axis of the panel must be set."""
    agents, time = recorded.arrays.agents, recorded.arrays.time
    positions = agents.position[np.isfinite(agents.position)]
    low, high = (float(np.min(positions)), float(np.max(positions))) if len(positions) else (-0.5, 0.5)
    slack = 0.02 * (high - low) + 1e-6
    edges = np.linspace(low - slack, high + slack, LINES + 1)
    kept, masses = [], []
    for rows, end in _columns(axes, recorded):
        position, mass = agents.position[rows], agents.mass[rows]
        there = np.isfinite(position) & np.isfinite(mass)
        binned, _ = np.histogram(position[there], bins=edges, weights=mass[there])
        masses.append(binned / len(position) / (edges[1] - edges[0]) / 1e3)
        kept.append(end)
    fade = LinearSegmentedColormap.from_list("mass", [(*to_rgb(GREY), 0.0), (*to_rgb(GREY), 1.0)])
    mesh = axes.pcolormesh([float(time[0]), *kept], edges, np.array(masses).T, cmap=fade, rasterized=True)
    mesh.set_clim(0.0, float(np.quantile(np.array(masses), 0.998)) or 1.0)
    return mesh


def _columns(axes: Axes, recorded: Recorded) -> Iterator[tuple[Integers, float]]:
    """Yield the rows in each non-empty column of the picture, and the time at its right edge, s."""
    scale = axes.xaxis.get_transform()
    time = recorded.arrays.time
    first, last = scale.transform(np.array([time[0], time[-1]]))
    edges = np.asarray(scale.inverted().transform(np.linspace(first, last, COLUMNS + 1)))
    edges[-1] = np.inf
    places = np.searchsorted(edges, time, side="right")
    for place in np.unique(places).tolist():
        yield np.flatnonzero(places == place), float(min(edges[place], time[-1]))


def _named(recorded: Recorded, values: Floats, there: NDArray[np.bool_]) -> dict[str, int]:
    """Return the columns of the lightest and the heaviest robot, and of the one with the largest value, by name."""
    agents = recorded.arrays.agents
    columns = np.flatnonzero(there)
    farthest = np.nanmax(np.abs(values[:, columns]), axis=0)
    chosen = {"largest": columns[int(np.argmax(farthest))]}
    if "mass" in {constant.name for constant in recorded.tables.constants}:
        mass = np.nanmax(recorded.arrays["mass"][:, columns], axis=0)
        chosen |= {"heaviest": columns[int(np.argmax(mass))], "lightest": columns[int(np.argmin(mass))]}
    names: dict[int, list[str]] = defaultdict(list)
    for name, column in chosen.items():
        names[int(column)].append(name)
    return {f"{agents.ids[column]} ({', '.join(said)})": column for column, said in names.items()}

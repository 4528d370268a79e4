"""Responses of plane, robots and abstract state: fig. PD_res, ARISE_res and ARISE_lg_swarm, from recorded runs."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from swarmabs_analysis.figures.style import BLACK, BLUE, DASHED, DOTTED, GREY, LIGHT, PAGE, ROBOT_DASHES, VERMILION
from swarmabs_config import configure
from swarmabs_core.systems.kinds import KINDS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from swarmabs_analysis.figures.runs import RecordedRun
    from swarmabs_core.arrays import RunArrays

    Floats = NDArray[np.float64]
    Pair = tuple[Axes, Axes]

STRETCHED = 5.0
"""The first seconds of a run, where most changes occur, take half of the time axis."""
SWARMS = ("single integrators", "double integrators", "heterogeneous")
_POSITION = "position p, m"
_MILLI = 1e3
SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_MARGIN = 1.08


def draw_three_swarms(runs: Sequence[RecordedRun]) -> Figure:
    """Draw the runs of `SWARMS`, a row each: plane, positions of the robots, error of the abstract state."""
    figure = _figure(4.4)
    panels = figure.subplots(len(runs), 3, sharex=True, squeeze=False)
    left, middle, right = panels.T
    parents = [parent_state(axes, run) for axes, run in zip(left, runs, strict=True)]
    for axes, run in zip(middle, runs, strict=True):
        each_robot(axes, run.arrays, run.arrays.agents.position, "p")
        axes.set_ylabel(_POSITION, labelpad=2.0)
    errors = [abstract_error(axes, run) for axes, run in zip(right, runs, strict=True)]
    same_limits(parents)
    same_limits(errors)
    limits = np.array([axes.get_ylim() for axes in middle])
    for axes in middle:
        axes.set_ylim(limits[:, 0].min(), limits[:, 1].max())
    for axes, name in zip(left, SWARMS, strict=True):
        axes.annotate(name, (0, 0.5), (-44, 0), "axes fraction", "offset points", rotation=90, ha="right", va="center")
    above(left[0], "plane", _named(*parents[0]))
    names = zip(_named(middle[0]), cycle(ROBOT_DASHES), strict=False)
    robots = [Line2D([], [], color=BLACK, linestyle=dashes, label=line.get_label()) for line, dashes in names]
    above(middle[0], "robots", [*robots, *kinds(runs[-1])], columns=6)
    above(right[0], "error of the abstract state", _named(*errors[0]))
    end = max(float(run.arrays.time[-1]) for run in runs)
    for axes in panels.flat:
        time_axis(axes, end)
    for axes in panels[-1]:
        axes.set_xlabel("time, s")
    return figure


def draw_large_swarms(runs: Sequence[RecordedRun]) -> Figure:
    """Draw two runs side by side, the smaller swarm first: the plane (a, c) and the positions of the robots (b, d)."""
    figure = _figure(2.1)
    panels = figure.subplots(1, 2 * len(runs), squeeze=False)[0]
    parents = [parent_state(axes, run) for axes, run in zip(panels[::2], runs, strict=True)]
    same_limits(parents)
    for pair, axes, run, letters in zip(parents, panels[1::2], runs, ("ab", "cd"), strict=True):
        robots_by_kind(axes, run.arrays, run.arrays.agents.position)
        axes.set_ylabel(_POSITION, labelpad=2.0)
        count = len(run.arrays.agents.ids)
        above(pair[0], f"{letters[0]}) {count} robots", _named(*pair))
        above(axes, f"{letters[1]}) {count} robots", kinds(run))
        for one in (pair[0], axes):
            time_axis(one, float(run.arrays.time[-1]))
            one.set_xlabel("time, s")
    return figure


def parent_state(axes: Axes, run: RecordedRun) -> Pair:
    """Draw angle and angular velocity of the plane, and the reference unless it is 0; return both axes."""
    time, other = run.arrays.time, axes.twinx()
    reference = configure.reference(run.scenario)
    desired = [reference(t) for t in time.tolist()]
    axes.plot(time, run.arrays.angle, color=BLUE, label="θ")
    if any(desired):
        axes.plot(time, desired, color=BLACK, linestyle=DOTTED, linewidth=0.9, label="reference")
    other.plot(time, run.arrays.angular_velocity, color=VERMILION, linestyle=DASHED, label="ω")
    _label_pair(axes, other, "θ, rad", "ω, rad/s")
    return axes, other


def each_robot(axes: Axes, arrays: RunArrays, values: Floats, symbol: str) -> None:
    """Draw a quantity of a few robots, shape (n+1, N), in colours of kinds and dashes of robots, with their names."""
    lines = robots_by_kind(axes, arrays, values)
    for line, dashes, number in zip(lines, cycle(ROBOT_DASHES), arrays.agents.ids.tolist(), strict=False):
        line.set(linewidth=1.1, linestyle=dashes, label=f"{symbol}{str(number).translate(SUBSCRIPTS)}")


def robots_by_kind(axes: Axes, arrays: RunArrays, values: Floats) -> list[Line2D]:
    """Draw a quantity of many robots, shape (n+1, N), as thin lines coloured by kind, and return the lines."""
    agents = arrays.agents
    lines = []
    for column in range(len(agents.ids)):
        colour = KINDS[max(agents.kind[:, column].tolist())].colour
        lines += axes.plot(arrays.time, values[:, column], color=colour, linewidth=0.4)
    return lines


def abstract_error(axes: Axes, run: RecordedRun, colours: tuple[str, str] = (BLUE, VERMILION)) -> Pair:
    """Draw the errors of torque and inertia, desired minus actual, in these colours; return both axes."""
    desired, actual, other = run.arrays.desired, run.arrays.abstract, axes.twinx()
    axes.plot(run.arrays.time, desired.torque - actual.torque, color=colours[0], label="τ")
    inertia = _MILLI * (desired.inertia - actual.inertia)
    other.plot(run.arrays.time, inertia, color=colours[1], linestyle=DASHED, label="J")
    _label_pair(axes, other, "error of τ, N m", "error of J, 10⁻³ kg m²", colours)
    return axes, other


def same_limits(pairs: Sequence[Pair]) -> None:
    """Give all left axes common limits, likewise all right axes, with both zeros at the same height."""
    sides = [_extent(side) for side in zip(*pairs, strict=True)]
    height = float(np.clip(np.mean([-low / (high - low) for low, high in sides]), 0.1, 0.9))
    for side, (low, high) in zip(zip(*pairs, strict=True), sides, strict=True):
        span = _MARGIN * max(-low / height, high / (1.0 - height))
        for axes in side:
            axes.set_ylim(-height * span, (1.0 - height) * span)


def time_axis(axes: Axes, end: float) -> None:
    """Show a run up to its end (s); of long runs, stretch the first seconds to half of the axis and shade them."""
    axes.set_xlim(0.0, end)
    axes.grid(visible=True)
    if end < 2.0 * STRETCHED:
        return
    rest = end - STRETCHED

    def to_place(time: Floats) -> Floats:
        return np.where(time < STRETCHED, time / STRETCHED, 1.0 + (time - STRETCHED) / rest)

    def to_time(place: Floats) -> Floats:
        return np.where(place < 1.0, place * STRETCHED, STRETCHED + (place - 1.0) * rest)

    axes.set_xscale("function", functions=(to_place, to_time))
    spacing = next((size for size in (10.0, 20.0, 25.0, 50.0, 100.0) if end < 3.5 * size), end)
    axes.set_xticks([0.0, 2.0, 4.0, *np.arange(spacing, end + 1e-9, spacing)])
    axes.axvspan(0.0, STRETCHED, color=LIGHT, zorder=-2.0)
    axes.axvline(STRETCHED, color=GREY, linewidth=0.6, zorder=-1.0)


def above(axes: Axes, heading: str, lines: Sequence[Line2D], columns: int = 4) -> None:
    """Put a heading and the legend above a panel."""
    axes.set_title(heading, pad=15.0)
    legend = axes.legend(handles=lines, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, borderaxespad=0.2)
    legend.set_in_layout(False)


def _figure(height: float) -> Figure:
    engine = ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02, wspace=0.05, hspace=0.03)
    return Figure(figsize=(PAGE, height), layout=engine)


def _extent(side: Sequence[Axes]) -> tuple[float, float]:
    """Return the lowest and the highest value on these axes, with 0 between them."""
    values = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for axes in side for line in axes.lines])
    low, high = min(0.0, float(np.nanmin(values))), max(0.0, float(np.nanmax(values)))
    return (low, high) if low < high else (-1.0, 1.0)


def _named(*panel: Axes) -> list[Line2D]:
    """Return the labelled lines of a panel."""
    return [line for axes in panel for line in axes.lines if not str(line.get_label()).startswith("_")]


def kinds(run: RecordedRun) -> list[Line2D]:
    """Return legend entries for the kinds of robots in a run."""
    there = set(np.unique(run.arrays.agents.kind).tolist())
    return [Line2D([], [], color=kind.colour, label=kind.short) for kind in KINDS.values() if kind.kind in there]


def _label_pair(axes: Axes, other: Axes, left: str, right: str, colours: tuple[str, str] = (BLUE, VERMILION)) -> None:
    axes.set_ylabel(left, color=colours[0])
    other.set_ylabel(right, color=colours[1])
    for one in (axes, other):
        one.yaxis.set_major_locator(MaxNLocator(6, steps=(1, 2, 2.5, 5, 10), min_n_ticks=4))
    axes.axhline(0.0, color=GREY, linewidth=0.6, zorder=0.5)

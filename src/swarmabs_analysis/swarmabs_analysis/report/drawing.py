"""Drawing functions for the panels of a report: over time, for all robots, in the abstract space."""

from __future__ import annotations

from collections import defaultdict
from itertools import cycle
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from swarmabs_analysis.figures.responses import each_robot, robots_by_kind, same_limits
from swarmabs_analysis.figures.style import BLACK, DASHED, DOTTED, GREY
from swarmabs_analysis.report.percentile_bands import density, draw_bands
from swarmabs_bag.shown.colours import ABSENT, ERROR, FAILED, PLANE, REFERENCE, SAFE_STOP, TORQUE
from swarmabs_core.messages import EventKind, said
from swarmabs_core.steering import REFERENCE as REFERENCE_OFFSET
from swarmabs_core.systems.kinds import KINDS
from swarmabs_core.theory.constraint_sets import ConstraintSets

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase
    from numpy.typing import NDArray

    from swarmabs_analysis.figures.runs import RecordedRun
    from swarmabs_analysis.report.record import Recorded

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Draw = Callable[[FigureBase], None]
    Dashes = str | tuple[int, tuple[int, float]]

NAMED, MANY = 4, 20
"""Most robots with a label each, and with a line each."""
ROWS = 40
"""Most robots with a row each in the membership panel."""
_DECADES = 30.0
"""Ratio of largest to smallest value above which an axis is logarithmic."""
_FEW_MARKS, _MOST_MARKS = 12, 200
_LEGEND = 66
"""Characters in a row of a legend; the sample of a line counts as eight."""
_FINE, _COARSE = 241, 21
_SHADE = 0.2
"""Opacity of the shading of a disturbance."""
_OFFSET: Mapping[str, Any] = {"color": REFERENCE, "linewidth": 0.7, "linestyle": DASHED, "zorder": 0.6}
_EVENT_COLOURS: Mapping[int, str] = {
    EventKind.DEAD: FAILED,
    EventKind.LEFT: ABSENT,
    EventKind.JOINED: BLACK,
    EventKind.SAFE_STOP: SAFE_STOP,
    EventKind.STALLED: FAILED,
}
"""Colours of the events that change which robots take part; the others are grey."""


class Line(NamedTuple):
    """A line over time: label, values at all steps or at `rows`, and style."""

    label: str
    values: Floats
    colour: str
    dashes: Dashes = "-"
    rows: NDArray[np.int64] | None = None


class Mark(NamedTuple):
    """A straight line across a panel: label, place and style."""

    label: str
    place: float
    colour: str
    dashes: Dashes

    def draw(self, across: Callable[..., Line2D]) -> None:
        """Draw it by `Axes.axhline` or `Axes.axvline`."""
        across(self.place, color=self.colour, linestyle=self.dashes, linewidth=0.9, label=self.label)


def lines_over_time(
    recorded: Recorded,
    label: str,
    lines: Sequence[Line],
    *,
    level: Mark | None = None,
    moment: Mark | None = None,
    positive: bool = False,
) -> Draw:
    """Return a function that draws lines over time and marks a value (`level`) and a time (`moment`, s).

    With `positive`, only values above 0 are drawn, on a logarithmic axis if they span decades.
    """

    def draw(axes: Axes) -> Sequence[Line2D]:
        for line in lines:
            time = recorded.arrays.time if line.rows is None else recorded.arrays.time[line.rows]
            values = np.where(line.values > 0, line.values, np.nan) if positive else line.values
            axes.plot(time, values, color=line.colour, linestyle=line.dashes, label=line.label)
        if level is not None:
            level.draw(axes.axhline)
        if moment is not None:
            moment.draw(axes.axvline)
        axes.set_ylabel(label)
        if positive:
            _by_decades(axes, np.concatenate([line.values for line in lines]))
            axes.set_ylabel(f"{label} (logarithmic)" if axes.get_yscale() == "log" else label)
        return axes.lines

    return _over_time(recorded, draw)


def pair_over_time(recorded: Recorded, draw_pair: Callable[[Axes, RecordedRun], tuple[Axes, Axes]]) -> Draw:
    """Return a function that draws two quantities, each with its own axis, as in the figures of the paper."""

    def draw(axes: Axes) -> Sequence[Line2D]:
        pair = draw_pair(axes, recorded.run)
        same_limits([pair])
        return [line for one in pair for line in one.lines]

    return _over_time(recorded, draw)


def _over_time(recorded: Recorded, draw_in: Callable[[Axes], Sequence[Line2D | Patch]]) -> Draw:
    """Return a function that draws a panel over time; `draw_in` returns the entries of its legend."""

    def draw(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        finish(axes, recorded, draw_in(axes))

    return draw


def of_all_robots(recorded: Recorded, values: Floats, symbol: str, label: str, *, end: float | None = None) -> Draw:
    """Return a function that draws a quantity of all robots over time, shape (n+1, N), in a style for their number.

    With `end`, lines at plus and minus this value are drawn if robots come close to them.
    """

    def draw(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        _linear(axes, float(recorded.arrays.time[-1]))
        legend = _robots(axes, recorded, values, symbol)
        for line in list(axes.lines):
            if np.isnan(np.asarray(line.get_ydata(), dtype=float)).all():
                line.remove()
        axes.axhline(0.0, color=GREY, linewidth=0.6, zorder=0.5)
        axes.set_ylabel(label)
        finish(axes, recorded, legend)
        if end is not None and np.nanmax(np.abs(values), initial=0.0) > 0.6 * end:
            for side in (-end, end):
                axes.axhline(side, color=BLACK, linewidth=0.9, linestyle=DOTTED)

    return draw


def _robots(axes: Axes, recorded: Recorded, values: Floats, symbol: str) -> Sequence[Line2D | Patch]:
    """Draw a quantity of all robots, and return the entries of the legend."""
    count = len(recorded.arrays.agents.ids)
    if count > MANY:
        return draw_bands(axes, recorded, values)
    if count <= NAMED:
        each_robot(axes, recorded.arrays, values, symbol)
        return axes.lines
    robots_by_kind(axes, recorded.arrays, values)
    drawn = set(recorded.arrays.agents.kind[:, np.isfinite(values).any(axis=0)].ravel().tolist())
    return [Line2D([], [], color=kind.colour, label=said(kind.kind)) for kind in KINDS.values() if kind.kind in drawn]


def zoom(recorded: Recorded, begin: float, end: float) -> Draw:
    """Return a function that draws what is tracked, and positions or first coordinates, in a span of time, s."""
    time, followed, tables = recorded.arrays.time, recorded.tracking.followed, recorded.tables
    state = recorded.subject.term(tables.parent[followed[0] if followed else 0])
    robot = recorded.subject.term(tables.robot[0])
    inside = (time >= begin) & (time <= end)

    def draw(figure: FigureBase) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        upper.plot(time[inside], recorded.references[inside], color=REFERENCE, linestyle=DASHED)
        upper.plot(time[inside], recorded.tracked[inside], color=PLANE)
        upper.set_ylabel(state.label if len(followed) == 1 else state.unit)
        _linear(lower, float(time[-1]))
        named = _robots(lower, recorded, np.where(inside[:, None], recorded.coordinates[..., 0], np.nan), robot.symbol)
        lower.set(xlabel="time, s", ylabel=f"{robot.symbol}, {robot.unit}", xlim=(begin, end))
        _mark_settings(lower, recorded)
        few = len(recorded.arrays.agents.ids) <= MANY
        _legend(upper, [*(named if few else ()), *_mark_settings(upper, recorded)])
        upper.grid(visible=True)
        for axes in (upper, lower):
            for event in recorded.swarm.events:
                if event.kind in _EVENT_COLOURS and begin <= recorded.swarm.time_of(event) <= end:
                    moment = recorded.swarm.time_of(event)
                    axes.axvline(moment, color=_EVENT_COLOURS[event.kind], linewidth=1.0, linestyle=DOTTED)

    return draw


def paths(recorded: Recorded, labels: Sequence[str]) -> Draw:
    """Return a function that draws the paths of robots with two coordinates, which end in a dot."""

    def draw(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        agents = recorded.arrays.agents
        for column in range(len(agents.ids)):
            x, y = recorded.coordinates[:, column].T
            colour = KINDS[max(agents.kind[:, column].tolist())].colour
            axes.plot(x, y, color=colour, linewidth=0.9)
            last = np.flatnonzero(np.isfinite(x))[-1:]
            axes.plot(x[last], y[last], "o", color=colour, markersize=3.5)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel=labels[0], ylabel=labels[1])
        axes.grid(visible=True)

    return draw


def mass_density(recorded: Recorded) -> Draw:
    """Return a function that draws the mass density of the robots along the plane."""

    def draw(axes: Axes) -> Sequence[Line2D]:
        _linear(axes, float(recorded.arrays.time[-1]))
        axes.figure.colorbar(density(axes, recorded), ax=axes, label="kg per mm", pad=0.01)
        axes.set_ylabel("position p, m")
        return []

    return _over_time(recorded, draw)


def grid_over_time(recorded: Recorded, quantities: Mapping[str, tuple[Floats, str]]) -> Draw:
    """Return a function that draws eight quantities, given by name with values and unit, in a grid."""

    def draw(figure: FigureBase) -> None:
        grid = figure.subplots(4, 2, sharex=True)
        for axes, (name, (values, unit)) in zip(grid.flat, quantities.items(), strict=True):
            axes.plot(recorded.arrays.time, values, color=BLACK)
            axes.set_ylabel(f"{name}, {unit}")
            _linear(axes, float(recorded.arrays.time[-1]))
            _mark_settings(axes, recorded)
        for axes in grid[-1]:
            axes.set_xlabel("time, s")

    return draw


def statuses(recorded: Recorded, looks: Mapping[str, tuple[Flags, str]]) -> Draw:
    """Return a function that draws the status of the robots, given by name with flags (n+1, N) and colour.

    Few robots have a row each; for many, their number is drawn.
    """
    time, agents = recorded.arrays.time, recorded.arrays.agents

    def rows(axes: Axes) -> Sequence[Patch]:
        ends = np.append(time[1:], time[-1])
        for flags, colour in looks.values():
            for column in range(len(agents.ids)):
                edges = np.flatnonzero(np.diff(flags[:, column].astype(int), prepend=0, append=0))
                for begin, end in zip(edges[::2], edges[1::2], strict=True):
                    axes.fill_between(
                        [time[begin], ends[end - 1]], column - 0.35, column + 0.35, color=colour, linewidth=0.0
                    )
        axes.set_yticks(range(len(agents.ids)), [str(number) for number in agents.ids.tolist()])
        axes.set_ylim(len(agents.ids) - 0.4, -0.6)
        axes.set_ylabel("robot")
        return [Patch(color=colour, label=name) for name, (flags, colour) in looks.items() if flags.any()]

    def counts(axes: Axes) -> Sequence[Line2D]:
        for (name, (flags, colour)), dashes in zip(looks.items(), cycle(("-", DASHED, DOTTED)), strict=False):
            axes.step(time, flags.sum(axis=1), where="post", color=colour, linestyle=dashes, label=name)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("robots")
        return axes.lines

    return _over_time(recorded, rows if len(agents.ids) <= ROWS else counts)


def abstract_space(recorded: Recorded, masses: Sequence[float]) -> Draw:
    """Return a function that draws the path of the abstract state with the manifold and the constraint sets."""
    return lambda figure: _space(figure.add_subplot(), recorded, masses)


def _space(axes: Axes, recorded: Recorded, masses: Sequence[float]) -> None:
    scenario, arrays = recorded.run.scenario, recorded.run.arrays
    plane, manifold = scenario.plane, scenario.manifold
    states = (arrays.abstract, arrays.desired)
    torques = np.concatenate([state.torque for state in states])
    inertias = np.concatenate([state.inertia for state in states])
    reach = max(1.25 * float(np.nanmax(np.abs(torques), initial=0.0)), 0.1 * manifold.torque_max)
    high = 1.25 * max(float(np.nanmax(inertias, initial=0.0)), manifold.inertia(min(reach, manifold.torque_max)))
    sets = ConstraintSets(masses, plane.length, plane.gravity)
    boundary = 1.15 * sets.largest_admissible_inertia(0.0)
    high = boundary if high < boundary < 4.0 * high else high
    torque = np.linspace(-reach, reach, _FINE)
    least = np.array([sets.smallest_inertia(t) for t in torque.tolist()])
    inner = np.array([sets.largest_admissible_inertia(t) for t in torque.tolist()])
    inner = np.clip(inner, least, 2.0 * high)
    axes.fill_between(torque, least, inner, color=GREY, alpha=0.35, linewidth=0.0, label="A_A")
    if (inner < high).any():
        # An even function of the torque, and slow to compute for many different masses.
        sides = np.linspace(0.0, reach, _COARSE)
        highest = [sets.largest_inertia(t).lower for t in sides.tolist()]
        outer = np.interp(np.abs(torque), sides, np.clip(highest, 0.0, 2.0 * high))
        axes.fill_between(torque, inner, outer, color=GREY, alpha=0.15, linewidth=0.0, label="A_P", where=outer > inner)
    on_manifold = np.clip(torque, -manifold.torque_max, manifold.torque_max)
    inertia = [manifold.inertia(t) for t in on_manifold.tolist()]
    axes.plot(on_manifold, inertia, color=GREY, linewidth=1.8, label="manifold")
    actual, desired = states
    axes.plot(actual.torque, actual.inertia, color=TORQUE, linewidth=0.9, label="actual")
    axes.plot(desired.torque, desired.inertia, color=REFERENCE, linestyle=DASHED, linewidth=1.3, label="desired")
    for row, marker, name in ((0, "o", "start"), (-1, "s", "end")):
        axes.plot(actual.torque[row], actual.inertia[row], marker, markersize=4.5, color=TORQUE, label=name)
    axes.set(xlabel="torque τ, N m", ylabel="inertia J, kg m²", xlim=(-reach, reach), ylim=(0.0, high))
    axes.grid(visible=True)
    _legend(axes, axes.get_legend_handles_labels()[0])


def finish(axes: Axes, recorded: Recorded, named: Sequence[Line2D | Patch]) -> None:
    """Add the time axis, the legend, disturbances, changes of the reference and the marks of events to a panel."""
    _linear(axes, float(recorded.arrays.time[-1]))
    axes.set_xlabel("time, s")
    _legend(axes, [*named, *_mark_settings(axes, recorded)])
    _mark_events(axes, recorded)


def _linear(axes: Axes, end: float) -> None:
    axes.set_xlim(0.0, end)
    axes.grid(visible=True)


def _by_decades(axes: Axes, values: Floats) -> None:
    """Make the vertical axis logarithmic if the values span decades."""
    positive: Floats = values[np.isfinite(values) & (values > 0)]
    if len(positive) and float(np.max(positive)) > _DECADES * float(np.min(positive)):
        axes.set_yscale("log")


def _legend(axes: Axes, entries: Sequence[Artist]) -> None:
    named = [one for one in entries if not str(one.get_label()).startswith("_")]
    if named:
        axes.legend(
            handles=named,
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=max(1, min(4, _LEGEND // (8 + max(len(str(one.get_label())) for one in named)))),
            borderaxespad=0.2,
        )


def _mark_settings(axes: Axes, recorded: Recorded) -> list[Line2D | Patch]:
    """Shade disturbances and draw a line where the reference is offset; return the entries of the legend.

    Only what is within the limits of the time axis has an entry.
    """
    begin, end = axes.get_xlim()
    disturbed = [one for one in recorded.disturbances if one.begin < end and one.end > begin]
    offsets = [one for one in recorded.settings(REFERENCE_OFFSET) if begin <= one.begin <= end]
    for setting in disturbed:
        axes.axvspan(setting.begin, setting.end, color=ERROR, alpha=_SHADE, linewidth=0.8, zorder=-1.0)
    for setting in offsets:
        axes.axvline(setting.begin, **_OFFSET)
    shaded = [Patch(color=ERROR, alpha=_SHADE, label="disturbance")] if disturbed else []
    return [*shaded, *([Line2D([], [], label="reference step", **_OFFSET)] if offsets else [])]


def _mark_events(axes: Axes, recorded: Recorded) -> None:
    """Mark events at the upper edge: membership by triangles (if few, also by lines down), the others by dashes."""
    end = float(recorded.arrays.time[-1])
    edge = axes.get_xaxis_transform()
    times: dict[str, set[float]] = defaultdict(set)
    for event in recorded.swarm.events:
        if 0.0 <= recorded.swarm.time_of(event) <= end:
            times[_EVENT_COLOURS.get(event.kind, GREY)].add(recorded.swarm.time_of(event))
    few = sum(len(moments) for colour, moments in times.items() if colour != GREY) <= _FEW_MARKS
    scale = axes.xaxis.get_transform()
    first, last = scale.transform(np.array([0.0, end]))
    for colour, moments in sorted(times.items()):
        marked = colour != GREY
        shown = np.array(sorted(moments))
        places = np.floor(_MOST_MARKS * (scale.transform(shown) - first) / (last - first))
        shown = shown[np.unique(places, return_index=True)[1]]
        axes.plot(
            shown,
            np.ones(len(shown)),
            transform=edge,
            linestyle="none",
            marker="v" if marked else "|",
            markersize=4.5 if marked else 3.5,
            markeredgewidth=0.4,
            markeredgecolor=BLACK if marked else GREY,
            color=colour,
            clip_on=False,
            zorder=5.0 if marked else 4.0,
        )
        for time in sorted(moments) if marked and few else ():
            axes.axvline(time, color=colour, linewidth=0.7, linestyle=DOTTED, zorder=0.6)

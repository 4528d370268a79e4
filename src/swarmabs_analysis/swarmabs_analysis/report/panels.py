"""The pictures of a report: each draws into a figure and tells in words what it shows."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from swarmabs_analysis.figures.responses import (
    STRETCHED,
    abstract_error,
    each_robot,
    kinds,
    parent_state,
    robots_by_kind,
    same_limits,
    time_axis,
)
from swarmabs_analysis.figures.style import (
    BLACK,
    BLUE,
    DASHED,
    DOTTED,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
)
from swarmabs_analysis.report.formatting import counted, joined, quantity, span
from swarmabs_analysis.report.percentile_bands import density, draw_bands
from swarmabs_core.messages import EventKind, Kind
from swarmabs_core.theory.constraint_sets import largest_admissible_inertia, largest_inertia, smallest_inertia

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase
    from numpy.typing import NDArray

    from swarmabs_analysis.report.margins import Margins, Weights
    from swarmabs_analysis.report.record import Recorded

    Floats = NDArray[np.float64]

NAMED, MANY = 4, 20
"""Most robots with a colour each, and with a line each."""
TOLERANCE = 0.01
"""Error below which the plane counts as settled, rad."""
BANDS = (
    "Dark bands hold the middle 50 %, light ones 90 % of the robots that start on the same side of the axis; "
    "dotted lines are the outermost ones, solid ones the medians."
)
_STRETCH = "The first seconds, shaded, have half of each time axis."
_DECADES = 30.0
"""Ratio of the values from which on an axis is logarithmic."""
_ROWS = 40
"""Most robots with a row each in the picture of the membership."""
_FEW_MARKS, _MOST_MARKS = 12, 200
_FINE, _COARSE = 241, 21
EVENT_COLOURS: Mapping[int, str] = {
    EventKind.DEAD: VERMILION,
    EventKind.LEFT: ORANGE,
    EventKind.JOINED: GREEN,
    EventKind.SAFE_STOP: PURPLE,
    EventKind.STALLED: VERMILION,
}
"""Colours of the events that say who takes part; the others are grey."""


@dataclass(frozen=True, slots=True)
class Panel:
    """A picture: its heading, what draws it, what it shows in words with numbers, what else is to be known.

    `height` is in inches; `section` is the part of the report in which it stands.
    """

    key: str
    section: str
    heading: str
    draw: Callable[[FigureBase], None]
    about: str
    note: str = ""
    height: float = 2.2


def panels(recorded: Recorded, on_plane: Weights, margin: Margins) -> Iterator[Panel]:
    """Yield the pictures of a run, in the order of a report."""
    yield from _plane(recorded)
    yield from _robots(recorded)
    yield from _abstract(recorded, on_plane)
    yield from _margins(recorded, margin)
    yield _sums(recorded)
    yield _membership(recorded, on_plane)


def _plane(recorded: Recorded) -> Iterator[Panel]:
    arrays = recorded.arrays
    note = (
        "Angle and rate are what the plane's sensor says, with its noise and resolution; "
        "the true ones are not recorded."
        if recorded.measured
        else ""
    )

    def draw(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        pair = parent_state(axes, recorded.run)
        same_limits([pair])
        _finish(axes, recorded, [line for one in pair for line in one.lines])

    about = joined(
        span("angle θ", arrays.angle, "rad"),
        span("angle wanted", recorded.swarm.reference, "rad") if np.any(recorded.swarm.reference) else "",
        span("rate ω", arrays.angular_velocity, "rad/s"),
    )
    stretched = _STRETCH if float(arrays.time[-1]) >= 2.0 * STRETCHED else ""
    first = joined(note, stretched, by=" ")
    yield Panel("plane", "plane", "Angle, reference and rate of the plane", draw, about, first)

    def draw_error(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        error = np.abs(recorded.error)
        axes.plot(arrays.time, np.where(error > 0, error, np.nan), color=BLUE, label="|θ wanted - θ|")
        axes.axhline(TOLERANCE, color=BLACK, linestyle=DOTTED, linewidth=0.9, label="10 mrad")
        settled = recorded.metrics["settled_at"]
        if isinstance(settled, float):
            label = f"settled at {settled:g} s"
            axes.axvline(settled, color=GREEN, linestyle=DASHED, linewidth=0.9, label=label)
        axes.set_ylabel("error, rad")
        _by_decades(axes, error)
        _finish(axes, recorded, axes.lines)

    settled = recorded.metrics["settled_at"]
    about = joined(
        span("tracking error", recorded.error, "rad"),
        "it does not stay within 10 mrad" if settled is None else f"within 10 mrad from {settled:g} s on",
    )
    yield Panel("tracking", "plane", "Tracking error of the angle", draw_error, about, note)


def _robots(recorded: Recorded) -> Iterator[Panel]:
    agents = recorded.arrays.agents
    half = recorded.scenario.plane.length / 2.0
    note = (
        "These are the true states; each robot's own law used what its sensor said."
        if any((*recorded.scenario.swarm.sensor.noise, *recorded.scenario.swarm.sensor.resolution))
        else ""
    )
    bands = len(agents.ids) > MANY
    if bands:
        note = joined(BANDS, note, by=" ")
    said = joined(note, recorded.lies_note, by=" ")

    def positions(figure: FigureBase) -> None:
        axes = _quantity(figure, recorded, agents.position, "p", "position p, m")
        if np.nanmax(np.abs(agents.position), initial=0.0) > 0.6 * half:
            for end in (-half, half):
                axes.axhline(end, color=BLACK, linewidth=0.9, linestyle=DOTTED)

    about = joined(
        span(f"positions of {counted(len(agents.ids), 'robot')}", agents.position, "m", over_time=False),
        f"the plane ends at ±{half:g} m",
    )
    yield Panel("positions", "robots", "Positions of the robots", positions, about, said)
    if bands:

        def mass(figure: FigureBase) -> None:
            axes = figure.add_subplot()
            time_axis(axes, float(recorded.arrays.time[-1]))
            bar = density(axes, recorded)
            figure.colorbar(bar, ax=axes, label="kg per mm", pad=0.01)
            axes.set_ylabel("position p, m")
            _finish(axes, recorded, [])

        about = f"total mass {quantity(float(np.nansum(np.nanmax(agents.mass, axis=0))), 'kg')}"
        yield Panel("mass", "robots", "Where the mass of the robots is", mass, about, recorded.lies_note)
    about = span("velocities", agents.velocity, "m/s", over_time=False)
    yield Panel(
        "velocities",
        "robots",
        "Velocities of the robots",
        lambda figure: _draw_quantity(figure, recorded, agents.velocity, "v", "velocity v, m/s"),
        about,
        note,
    )
    names = {Kind.SINGLE_INTEGRATOR: ("single", "m/s"), Kind.DOUBLE_INTEGRATOR: ("double", "N")}
    for kind, (name, unit) in names.items():
        of_kind = (agents.kind == kind).any(axis=0)
        if of_kind.any():
            values = np.where(of_kind, agents.command, np.nan)
            yield Panel(
                f"commands-{name}",
                "robots",
                f"Commands of the {name} integrators",
                _drawing(recorded, values, "u", f"command u, {unit}"),
                span(f"commands of {counted(int(of_kind.sum()), f'{name} integrator')}", values, unit, over_time=False),
                note,
            )


def _abstract(recorded: Recorded, on_plane: Weights) -> Iterator[Panel]:
    arrays = recorded.arrays
    actual, desired = arrays.abstract, arrays.desired
    true = (on_plane.torque_over_gravity * recorded.scenario.plane.gravity, on_plane.inertia)
    note = ""
    if recorded.estimated:
        note = "The recorded τ is an estimate from the plane's motion; beside it stands what the robots' states give."
    for key, letter, unit, found, wanted, truth in (
        ("torque", "τ", "N m", actual.torque, desired.torque, true[0]),
        ("inertia", "J", "kg m²", actual.inertia, desired.inertia, true[1]),
    ):
        more = truth if recorded.estimated and key == "torque" else None
        about = joined(
            span(f"actual {key}", found, unit),
            span(f"desired {key}", wanted, unit),
            span("from the robots' states", more, unit) if more is not None else "",
        )
        yield Panel(
            key,
            "abstract",
            f"{key.capitalize()} {letter} of the swarm, desired and actual",
            _drawing_of_state(recorded, letter, unit, (found, wanted, more)),
            about,
            note if more is not None else "",
        )

    def errors(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        pair = abstract_error(axes, recorded.run)
        same_limits([pair])
        _finish(axes, recorded, [line for one in pair for line in one.lines])

    about = joined(
        span("error of τ", desired.torque - actual.torque, "N m"),
        span("error of J", desired.inertia - actual.inertia, "kg m²"),
    )
    yield Panel("abstract-error", "abstract", "Error of the abstract state", errors, about)
    spans = list(on_plane.spans())
    masses = spans[0][2] if spans else ()
    if len(masses) > 1 and min(masses) > 0:
        note = "Shaded: A_A, where every arrangement of the robots lies on the plane, and A_P, where only some do."
        if len(spans) > 1:
            note += " The sets are those of the robots at the beginning."
        about = joined(
            _last_state("ends at", actual.torque, actual.inertia),
            _last_state("wanted", desired.torque, desired.inertia),
        )
        yield Panel(
            "space",
            "abstract",
            "Path in the abstract space",
            lambda figure: _space(figure, recorded, masses),
            about,
            note,
            height=2.9,
        )


def _margins(recorded: Recorded, margin: Margins) -> Iterator[Panel]:
    time = recorded.arrays.time

    def end(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        axes.plot(time, margin.end, color=BLUE, label="L/2 - largest |p|")
        axes.axhline(0.0, color=VERMILION, linestyle=DASHED, linewidth=0.9, label="end of the plane")
        axes.set_ylabel("m")
        _finish(axes, recorded, axes.lines)

    yield Panel(
        "margin-end",
        "margins",
        "From the outermost robot to the plane's end",
        end,
        joined(span("margin", margin.end, "m"), _lowest(margin.end, time, "m")),
        recorded.lies_note,
    )

    def sets(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        axes.plot(time[margin.rows], margin.actual, color=BLUE, label="abstract state")
        axes.plot(time[margin.rows], margin.desired, color=BLACK, linestyle=DOTTED, label="desired one")
        axes.axhline(0.0, color=VERMILION, linestyle=DASHED, linewidth=0.9, label="boundary of A_A")
        axes.set_ylabel("distance, N m and kg m²")
        _finish(axes, recorded, axes.lines)

    yield Panel(
        "margin-set",
        "margins",
        "Distance to the boundary of A_A",
        sets,
        joined(
            span("of the abstract state", margin.actual, ""),
            _lowest(margin.actual, time[margin.rows], ""),
            span("of the desired one", margin.desired, ""),
        ),
        "Below 0, positions off the plane belong to the state as well. The norm adds N m and kg m², as the paper does.",
    )

    def singular(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        spread = np.where(margin.spread > 0, margin.spread, np.nan)
        axes.plot(time, spread, color=GREEN, label="S₃/S₀²")
        axes.set_ylabel("m²")
        _by_decades(axes, spread)
        _finish(axes, recorded, axes.lines)

    limit = 1e-12 * recorded.scenario.plane.length**2
    yield Panel(
        "margin-spread",
        "margins",
        "Spread of the robots, S₃/S₀²",
        singular,
        joined(span("S₃/S₀²", margin.spread, "m²"), _lowest(margin.spread, time, "m²")),
        f"Where it vanishes all robots stand at one point, and no law has a solution: they stop below {limit:.3g} m².",
    )


def _sums(recorded: Recorded) -> Panel:
    sums = recorded.arrays.auxiliary
    shown = {
        "S₀": (sums.s0, "kg²"),
        "S₁": (sums.s1, "kg² m"),
        "S₂": (sums.s2, "kg² m²"),
        "S₃": (sums.s3, "kg⁴ m²"),
        "D₀": (sums.d0, "kg²/s"),
        "D₁": (sums.d1, "kg² m/s"),
        "D₂": (sums.d2, "kg² m²/s"),
        "Q": (sums.q, "kg m²/s²"),
    }

    def draw(figure: FigureBase) -> None:
        grid = figure.subplots(4, 2, sharex=True)
        for axes, (name, (values, unit)) in zip(grid.flat, shown.items(), strict=True):
            axes.plot(recorded.arrays.time, values, color=BLUE)
            axes.set_ylabel(f"{name}, {unit}")
            time_axis(axes, float(recorded.arrays.time[-1]))
        for axes in grid[-1]:
            axes.set_xlabel("time, s")

    about = joined(*(span(name, values, unit) for name, (values, unit) in shown.items()))
    return Panel("sums", "sums", "Auxiliary sums", draw, about, height=4.8)


def _membership(recorded: Recorded, on_plane: Weights) -> Panel:
    arrays, agents, swarm = recorded.arrays, recorded.arrays.agents, recorded.swarm
    reporting, stopped = agents.kind > 0, swarm.have_status("safe_stop")
    standing = swarm.have_status("dead") | swarm.have_status("silent")
    looks = {
        "follows": (swarm.on_plane & ~stopped & ~standing, GREEN),
        "safe stop": (stopped, ORANGE),
        "stands still, out of the run": (standing, GREY),
    }

    def rows(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        ends = np.append(arrays.time[1:], arrays.time[-1])
        for flags, colour in looks.values():
            for column in range(len(agents.ids)):
                edges = np.flatnonzero(np.diff(flags[:, column].astype(int), prepend=0, append=0))
                for begin, end in zip(edges[::2], edges[1::2], strict=True):
                    axes.fill_between(
                        [arrays.time[begin], ends[end - 1]], column - 0.35, column + 0.35, color=colour, linewidth=0.0
                    )
        axes.set_yticks(range(len(agents.ids)), [str(number) for number in agents.ids.tolist()])
        axes.set_ylim(len(agents.ids) - 0.4, -0.6)
        axes.set_ylabel("robot")
        there = [Patch(color=colour, label=name) for name, (flags, colour) in looks.items() if flags.any()]
        _finish(axes, recorded, there)

    def counts(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        for (name, (flags, colour)), dashes in zip(looks.items(), ("-", DASHED, DOTTED), strict=True):
            axes.step(arrays.time, flags.sum(axis=1), where="post", color=colour, linestyle=dashes, label=name)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("robots")
        _finish(axes, recorded, axes.lines)

    there = on_plane.there.sum(axis=1)
    about = joined(
        f"robots on the plane: {there[0]} at first, {there[-1]} at last" if len(there) else "",
        f"robots that report: {reporting[0].sum()} at first, {reporting[-1].sum()} at last" if len(there) else "",
        f"robots ever in a safe stop: {stopped.any(axis=0).sum()}",
    )
    few = len(agents.ids) <= _ROWS
    height = 1.2 + 0.14 * len(agents.ids) if few else 2.2
    return Panel("membership", "membership", "Which robots take part", rows if few else counts, about, height=height)


def _drawing(recorded: Recorded, values: Floats, symbol: str, label: str) -> Callable[[FigureBase], None]:
    return lambda figure: _draw_quantity(figure, recorded, values, symbol, label)


def _draw_quantity(figure: FigureBase, recorded: Recorded, values: Floats, symbol: str, label: str) -> None:
    _quantity(figure, recorded, values, symbol, label)


def _quantity(figure: FigureBase, recorded: Recorded, values: Floats, symbol: str, label: str) -> Axes:
    """Draw a quantity of all robots over time, shape (n+1, N), in the way that suits their number."""
    axes = figure.add_subplot()
    time_axis(axes, float(recorded.arrays.time[-1]))
    count = len(recorded.arrays.agents.ids)
    if count <= NAMED:
        each_robot(axes, recorded.run, values, symbol)
        legend: Sequence[Line2D | Patch] = axes.lines
    elif count <= MANY:
        robots_by_kind(axes, recorded.run, values)
        drawn = {line.get_color() for line in axes.lines if np.isfinite(np.asarray(line.get_ydata(), float)).any()}
        legend = [one for one in kinds(recorded.run) if one.get_color() in drawn]
    else:
        legend = draw_bands(axes, recorded, values)
    for line in list(axes.lines):
        if np.isnan(np.asarray(line.get_ydata(), dtype=float)).all():
            line.remove()
    axes.axhline(0.0, color=GREY, linewidth=0.6, zorder=0.5)
    axes.set_ylabel(label)
    _finish(axes, recorded, legend)
    return axes


def _drawing_of_state(
    recorded: Recorded, letter: str, unit: str, states: tuple[Floats, Floats, Floats | None]
) -> Callable[[FigureBase], None]:
    found, wanted, truth = states

    def draw(figure: FigureBase) -> None:
        axes = figure.add_subplot()
        time = recorded.arrays.time
        axes.plot(time, found, color=BLUE, label=f"{letter} estimated" if truth is not None else f"{letter} actual")
        if truth is not None:
            axes.plot(time, truth, color=GREEN, linestyle=DASHED, label=f"{letter} from the robots' states")
        axes.plot(time, wanted, color=BLACK, linestyle=DOTTED, label=f"{letter} desired")
        axes.set_ylabel(f"{letter}, {unit}")
        _finish(axes, recorded, axes.lines)

    return draw


def _space(figure: FigureBase, recorded: Recorded, masses: Sequence[float]) -> None:
    """Draw the path of the abstract state with the manifold and the constraint sets around it."""
    axes = figure.add_subplot()
    arrays, plane, manifold = recorded.arrays, recorded.scenario.plane, recorded.scenario.manifold
    states = (arrays.abstract, arrays.desired)
    torques = np.concatenate([state.torque for state in states])
    inertias = np.concatenate([state.inertia for state in states])
    reach = max(1.25 * float(np.nanmax(np.abs(torques), initial=0.0)), 0.1 * manifold.torque_max)
    high = 1.25 * max(float(np.nanmax(inertias, initial=0.0)), manifold.inertia(min(reach, manifold.torque_max)))
    boundary = 1.15 * largest_admissible_inertia(0.0, masses, plane.length, plane.gravity)
    high = boundary if high < boundary < 4.0 * high else high
    torque = np.linspace(-reach, reach, _FINE)
    least = np.array([smallest_inertia(t, masses, plane.gravity) for t in torque.tolist()])
    inner = np.array([largest_admissible_inertia(t, masses, plane.length, plane.gravity) for t in torque.tolist()])
    inner = np.clip(inner, least, 2.0 * high)
    axes.fill_between(torque, least, inner, color=SKY, alpha=0.35, linewidth=0.0, label="A_A")
    if (inner < high).any():
        # Even in the torque, and slow to compute for many different masses.
        sides = np.linspace(0.0, reach, _COARSE)
        highest = [largest_inertia(t, masses, plane.length, plane.gravity).lower for t in sides.tolist()]
        outer = np.interp(np.abs(torque), sides, np.clip(highest, 0.0, 2.0 * high))
        axes.fill_between(
            torque, inner, outer, color=ORANGE, alpha=0.25, linewidth=0.0, label="A_P", where=outer > inner
        )
    on_manifold = np.clip(torque, -manifold.torque_max, manifold.torque_max)
    axes.plot(
        on_manifold,
        [manifold.inertia(t) for t in on_manifold.tolist()],
        color=GREEN,
        linewidth=1.8,
        label="manifold",
    )
    axes.plot(arrays.abstract.torque, arrays.abstract.inertia, color=BLUE, linewidth=0.9, label="actual")
    axes.plot(
        arrays.desired.torque,
        arrays.desired.inertia,
        color=BLACK,
        linestyle=DOTTED,
        linewidth=1.3,
        label="desired",
    )
    for row, marker, name in ((0, "o", "start"), (-1, "s", "end")):
        axes.plot(
            arrays.abstract.torque[row],
            arrays.abstract.inertia[row],
            linestyle="none",
            marker=marker,
            markersize=4.5,
            color=VERMILION,
            label=name,
        )
    axes.set(xlabel="torque τ, N m", ylabel="inertia J, kg m²", xlim=(-reach, reach), ylim=(0.0, high))
    axes.grid(visible=True)
    _legend(axes, axes.get_legend_handles_labels()[0])


def _finish(axes: Axes, recorded: Recorded, named: Sequence[Line2D | Patch]) -> None:
    """Give a panel over time its axis, its legend and the marks of the events."""
    time_axis(axes, float(recorded.arrays.time[-1]))
    axes.set_xlabel("time, s")
    _legend(axes, [one for one in named if not str(one.get_label()).startswith("_")])
    _mark_events(axes, recorded)


def _by_decades(axes: Axes, values: Floats) -> None:
    """Make the vertical axis logarithmic where the values ask for it."""
    positive: Floats = values[np.isfinite(values) & (values > 0)]
    if len(positive) and float(np.max(positive)) > _DECADES * float(np.min(positive)):
        axes.set_yscale("log")


def _legend(axes: Axes, named: Sequence[object]) -> None:
    if named:
        axes.legend(
            handles=named,
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=min(len(named), 4),
            borderaxespad=0.2,
        )


def _mark_events(axes: Axes, recorded: Recorded) -> None:
    """Mark events at the upper edge: by triangles who takes part, few of them through the panel too; else by dashes."""
    end = float(recorded.arrays.time[-1])
    edge = axes.get_xaxis_transform()
    times: dict[str, set[float]] = defaultdict(set)
    for event in recorded.swarm.events:
        if 0.0 <= recorded.swarm.time_of(event) <= end:
            times[EVENT_COLOURS.get(event.kind, GREY)].add(recorded.swarm.time_of(event))
    few = sum(len(found) for colour, found in times.items() if colour != GREY) <= _FEW_MARKS
    scale = axes.xaxis.get_transform()
    first, last = scale.transform(np.array([0.0, end]))
    for colour, found in sorted(times.items()):
        marked = colour != GREY
        every = np.array(sorted(found))
        places = np.floor(_MOST_MARKS * (scale.transform(every) - first) / (last - first))
        every = every[np.unique(places, return_index=True)[1]]
        axes.plot(
            every,
            np.ones(len(every)),
            transform=edge,
            linestyle="none",
            marker="v" if marked else "|",
            markersize=4.5 if marked else 3.5,
            markeredgewidth=0.4,
            color=colour,
            clip_on=False,
            zorder=5.0 if marked else 4.0,
        )
        for time in sorted(found) if marked and few else ():
            axes.axvline(time, color=colour, linewidth=0.7, linestyle=DOTTED, zorder=0.6)


def _lowest(values: Floats, time: Floats, unit: str) -> str:
    if not np.isfinite(values).any():
        return ""
    row = int(np.nanargmin(values))
    return f"lowest {quantity(float(values[row]), unit)} at {time[row]:g} s"


def _last_state(name: str, torque: Floats, inertia: Floats) -> str:
    if not len(torque) or not np.isfinite(torque[-1]) or not np.isfinite(inertia[-1]):
        return ""
    return f"{name} τ = {quantity(float(torque[-1]), 'N m')}, J = {quantity(float(inertia[-1]), 'kg m²')}"

"""The panels of a report: what each draws, and its description in words and numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_analysis.figures.responses import abstract_error
from swarmabs_analysis.figures.style import BLACK, DASHED, DOTTED
from swarmabs_analysis.report.drawing import (
    MANY,
    ROWS,
    Line,
    Mark,
    abstract_space,
    grid_over_time,
    lines_over_time,
    mass_density,
    of_all_robots,
    pair_over_time,
    paths,
    statuses,
    zoom,
)
from swarmabs_analysis.report.formatting import counted, joined, quantity, span, tolerated
from swarmabs_bag.shown.colours import (
    ABSENT,
    ERROR,
    FAILED,
    INERTIA,
    PLANE,
    REFERENCE,
    SAFE_STOP,
    TORQUE,
)
from swarmabs_core.abstraction import least_s3
from swarmabs_core.events import EventCode, code_of, said_event
from swarmabs_core.messages import EventKind, Kind, said
from swarmabs_core.systems.kinds import KINDS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import FigureBase
    from numpy.typing import NDArray

    from swarmabs_analysis.report.record import Recorded
    from swarmabs_analysis.report.subject import Term
    from swarmabs_core.messages import SwarmEvent
    from swarmabs_core.plant import Plane as TiltingPlane
    from swarmabs_core.systems import Quantity

    Floats = NDArray[np.float64]
    _Curves = Sequence[tuple[Quantity, Floats, Floats | None]]

BEFORE, AFTER, MOST_ZOOMS, MOST_NAMED = 1.0, 4.0, 6, 5
"""Time shown before and after an event, s, the most events that have a panel, and the most others named in it."""
ZOOMED = {
    EventKind.JOINED,
    EventKind.LEFT,
    EventKind.DEAD,
    EventKind.SAFE_STOP,
    EventKind.STALLED,
    EventKind.STEERING,
    EventKind.MODE_CHANGED,
}
BANDS = (
    "Dark bands contain the middle 50 %, light bands 90 % of the robots that start on the same side of the axis; "
    "dotted lines are the extremes, solid lines the medians."
)
MEASURED = (
    "Angle and rate are those of the plane's sensor, with its noise and resolution; the true ones are not recorded."
)
SENSED = "These are the true states; each robot's law used the measurements of its sensor."
ESTIMATED = "The recorded τ is an estimate from the plane's motion; the dotted line follows from the robots' states."
SETS = "Shaded: A_A, where all arrangements of the robots are on the plane, and A_P, where only some are."
FIRST_SETS = "The sets are those of the initial robots."
RANK = (
    "The smallest eigenvalue of the Gram matrix in units of the scales, by its largest diagonal entry: at 0 the robots "
    "cannot control all rows of the abstract state, and stop."
)
_OF_KINDS = tuple(kind.colour for kind in KINDS.values())
PALETTE = (PLANE, ERROR, TORQUE, INERTIA, *_OF_KINDS)
_ABSTRACT = (TORQUE, INERTIA, PLANE, ERROR, *_OF_KINDS)
"""Colours of the rows of the abstract state."""
NORM = "Below 0, the state also admits positions off the plane. The norm adds N m and kg m², as the paper does."


@dataclass(frozen=True, slots=True)
class Panel:
    """A picture: heading, drawing function, description in words and numbers, and a note.

    `height` is in inches; `section` is the part of the report that contains it.
    """

    key: str
    section: str
    heading: str
    draw: Callable[[FigureBase], None]
    about: str
    note: str = ""
    height: float = 2.2


def panels(recorded: Recorded) -> Iterator[Panel]:
    """Yield the pictures of a run, in the order of a report: those of all tables, and those of the plane's own data."""
    yield from _parent(recorded)
    yield from _zooms(recorded)
    yield from _robots(recorded)
    yield from _abstract(recorded)
    yield from _margins(recorded)
    if recorded.plane is not None:
        yield _sums(recorded)
    yield _membership(recorded)


def _parent(recorded: Recorded) -> Iterator[Panel]:
    """Yield the state of the parent by unit, what is tracked first, and the tracking error."""
    rows, followed = recorded.tables.parent, list(recorded.tracking.followed)
    note = MEASURED if recorded.measured else ""
    tracked: _Curves = [
        (rows[place], recorded.tracked[:, n], recorded.references[:, n]) for n, place in enumerate(followed)
    ]
    others: list[_Curves] = [
        [(rows[place], recorded.arrays.parent[:, place], None) for place in group] for group in _by_unit(rows, followed)
    ]
    for number, curves in enumerate(filter(None, (tracked, *others))):
        yield _curves(recorded, number, curves, note)
    if tracked:
        yield from _errors(recorded, note)


def _curves(recorded: Recorded, number: int, curves: _Curves, note: str) -> Panel:
    """Return a panel of numbers of the parent of the same unit over time, each with its reference, dashed, if any."""
    lines, texts = [], []
    terms = [recorded.subject.term(row) for row, *_ in curves]
    for term, (_, values, goal), colour in zip(terms, curves, cycle(PALETTE), strict=False):
        lines.append(Line(term.symbol, values, colour))
        texts.append(span(term.words, values, term.unit))
        if goal is not None:
            lines.append(Line(f"reference {term.symbol}", goal, REFERENCE if len(curves) == 1 else colour, DASHED))
            texts.append(span("reference", goal, term.unit) if np.any(goal) else "")
    goals = [goal for *_, goal in curves if goal is not None]
    heading = _titles(terms) + {0: "", 1: " and reference"}.get(len(goals), " and references")
    draw = lines_over_time(recorded, terms[0].label if len(curves) == 1 else terms[0].unit, lines)
    return Panel(
        f"parent-{number}", "parent", f"{heading} of the {recorded.subject.parent}", draw, joined(*texts), note
    )


def _errors(recorded: Recorded, note: str) -> Iterator[Panel]:
    """Yield the tracking error, and its size on a logarithmic axis."""
    tracking, settled = recorded.tracking, recorded.metrics["settled_at"]
    terms = [recorded.subject.term(recorded.tables.parent[place]) for place in tracking.followed]
    only, unit = len(terms) == 1, terms[0].unit
    moment = Mark(f"settled at {settled:g} s", settled, BLACK, DOTTED) if isinstance(settled, float) else None
    errors = (recorded.references - recorded.tracked).T
    colours = [ERROR] if only else PALETTE
    lines = [
        Line(f"reference - {term.symbol}", error, colour)
        for term, error, colour in zip(terms, errors, cycle(colours), strict=False)
    ]
    for tolerance in sorted(set(tracking.tolerances)):
        bound = np.full(len(recorded.arrays.time), tolerance)
        lines += [Line(f"±{tolerated(tolerance, unit)}", bound, BLACK, DOTTED), Line("_", -bound, BLACK, DOTTED)]
    within = recorded.within
    names = ["tracking error"] if only else [f"error of {term.words}" for term in terms]
    about = joined(
        *(span(name, error, unit) for name, error in zip(names, errors, strict=True)),
        f"it does not stay within {within}" if settled is None else f"it stays within {within} from {settled:g} s on",
    )
    draw = lines_over_time(recorded, f"error, {unit}", lines, moment=moment)
    heading = f"Tracking error of the {_titles(terms).lower()}"
    yield Panel("parent-error", "parent", heading, draw, about, note)
    size = f"|reference - {terms[0].symbol}|" if only else "norm of the errors"
    level = Mark(within, tracking.tolerances[0], BLACK, DOTTED) if only else None
    lines = [Line(size, np.abs(recorded.error), ERROR)]
    draw = lines_over_time(recorded, f"|error|, {unit}", lines, level=level, moment=moment, positive=True)
    about = "a straight descent is exponential"
    yield Panel("parent-error-decades", "parent", "Size of the tracking error", draw, about, note)


def _titles(terms: Sequence[Term]) -> str:
    """Return what several numbers are called in a heading."""
    return ", ".join([terms[0].title, *(term.words for term in terms[1:])])


def _by_unit(rows: Sequence[Quantity], without: Sequence[int] = ()) -> list[list[int]]:
    """Return the places of the other rows, grouped by unit."""
    others = [place for place in range(len(rows)) if place not in without]
    units = dict.fromkeys(rows[place].unit for place in others)
    return [[place for place in others if rows[place].unit == unit] for unit in units]


def _zooms(recorded: Recorded) -> Iterator[Panel]:
    """Yield angle and positions around the start and the events; if many, around those with the largest errors."""
    time, error = recorded.arrays.time, np.abs(recorded.error)
    last = float(time[-1])
    if last < 2.0 * (BEFORE + AFTER):
        return
    moments = {0.0: ["the start"]}
    followed, (first_row, *_) = recorded.tracking.followed, recorded.tables.robot
    upper = recorded.subject.term(recorded.tables.parent[followed[0]]).title.lower() if len(followed) == 1 else ""
    lower = recorded.subject.term(first_row).title.lower()
    zoomed = f"{upper or 'what is tracked'} with its dashed reference, and {lower}"
    begin = 0.0
    for event in recorded.swarm.events:
        at = recorded.swarm.time_of(event)
        if event.kind in ZOOMED and 0.0 < at < last:
            begin = at if at > begin + AFTER else begin
            who = f"robot {event.agent_id} " if event.agent_id else ""
            moments.setdefault(begin, []).append(f"{at:g} s: {who}{said_event(event)}{_set(recorded, event)}")

    def largest(moment: float) -> float:
        errors = error[(time >= moment) & (time <= moment + AFTER)]
        return float(np.nanmax(errors, initial=0.0))

    for number, moment in enumerate(sorted(sorted(moments, key=largest, reverse=True)[:MOST_ZOOMS])):
        first, *others = moments[moment]
        further = joined(*others[:MOST_NAMED], f"{len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else "")
        about = joined(
            zoomed,
            f"largest error {quantity(largest(moment), recorded.tracking.unit)}",
            f"then {further}" if further else "",
        )
        draw = zoom(recorded, max(0.0, moment - BEFORE), min(last, moment + AFTER))
        yield Panel(f"zoom-{number}", "zooms", f"Around {first}", draw, about, height=2.6)


def _set(recorded: Recorded, event: SwarmEvent) -> str:
    """Return the new value of the setting that an event changes, with its unit."""
    code = code_of(event)
    if code not in (EventCode.REFERENCE, EventCode.DISTURBANCE):
        return ""
    unit = recorded.tables.disturbance_unit if code is EventCode.DISTURBANCE else recorded.reference_unit
    return f" {quantity(event.value, unit)}"


def _robots(recorded: Recorded) -> Iterator[Panel]:
    """Yield coordinates, rates and commands of the robots, for each coordinate."""
    arrays, subject, rows, plane = recorded.arrays, recorded.subject, recorded.tables.robot, recorded.plane
    count = len(arrays.agents.ids)
    note = joined(BANDS if count > MANY else "", SENSED if recorded.sensed else "", by=" ")
    falsified = joined(note, recorded.falsified_note, by=" ")
    if len(rows) == 2:
        draw = paths(recorded, [subject.term(row).label for row in rows])
        about = f"each of {counted(count, 'robot')} ends in a dot"
        yield Panel("robots-paths", "robots", "Paths of the robots", draw, about, height=2.9)
    rates = arrays.agents.vector("velocities")
    for place, row in enumerate(rows):
        term, rate = subject.term(row), subject.rate(row)
        values = recorded.coordinates[..., place]
        half = None if plane is None else plane.length / 2.0
        draw = of_all_robots(recorded, values, term.symbol, term.label, end=half)
        where = span(f"{term.words} of {counted(count, 'robot')}", values, term.unit, over_time=False)
        about = joined(where, "" if half is None else f"the plane ends at ±{half:g} m")
        yield Panel(f"robots-coordinate-{place}", "robots", f"{term.title} of the robots", draw, about, falsified)
        if plane is not None and count > MANY:
            about = f"total mass {quantity(float(np.nansum(np.nanmax(arrays.agents.mass, axis=0))), 'kg')}"
            heading = "Mass density of the robots"
            yield Panel("mass", "robots", heading, mass_density(recorded), about, recorded.falsified_note)
        draw = of_all_robots(recorded, rates[..., place], rate.symbol, rate.label)
        about = span(rate.words, rates[..., place], rate.unit, over_time=False)
        yield Panel(f"robots-rate-{place}", "robots", f"{rate.title} of the robots", draw, about, note)
        yield from _commands(recorded, place, f" along {row.name}" if len(rows) > 1 else "", note)


def _commands(recorded: Recorded, place: int, along: str, note: str) -> Iterator[Panel]:
    """Yield a panel with the commands along a coordinate for each kind of robot, whose units differ."""
    rows, command = recorded.tables.robot, recorded.arrays.agents.vector("command")[..., place]
    name, units = rows[place].name, [row.unit for row in rows]
    for kind in Kind:
        of_kind = (recorded.arrays.agents.kind == kind).any(axis=0)
        if of_kind.any():
            values, own = np.where(of_kind, command, np.nan), KINDS[kind].command_units(units)[place]
            draw = of_all_robots(recorded, values, "u", f"command u{along}, {own}".removesuffix(", "))
            about = span(f"commands of {counted(int(of_kind.sum()), said(kind))}", values, own, over_time=False)
            heading = f"Commands of the {said(kind)}s{along}"
            yield Panel(f"robots-command-{name}-{kind.value}", "robots", heading, draw, about, note)


def _abstract(recorded: Recorded) -> Iterator[Panel]:
    """Yield the abstract state by unit with the desired one; on the plane also its error, and its path in space."""
    rows = recorded.tables.abstract
    actual, desired = (part.vector("value") for part in (recorded.arrays.abstract, recorded.arrays.desired))
    for number, group in enumerate(_by_unit(rows)):
        terms = [recorded.subject.term(rows[place]) for place in group]
        estimated = number == 0 and recorded.estimated
        lines, texts = [], []
        for term, place in zip(terms, group, strict=True):
            only, colour = len(group) == 1, _ABSTRACT[place % len(_ABSTRACT)]
            lines.append(Line(f"{term.symbol} {'estimated' if estimated else 'actual'}", actual[:, place], colour))
            if estimated:
                lines.append(Line(f"{term.symbol} from the robots' states", recorded.torque, ERROR, DOTTED))
            aim = REFERENCE if only else colour
            lines.append(Line(f"{term.symbol} desired", desired[:, place], aim, DASHED))
            texts.append(span(f"actual {term.words}", actual[:, place], term.unit))
            texts.append(span(f"desired {term.words}", desired[:, place], term.unit))
        if estimated:
            texts.append(span("from the robots' states", recorded.torque, terms[0].unit))
        heading = f"{_titles(terms)} of the swarm, desired and actual"
        draw = lines_over_time(recorded, terms[0].label if len(terms) == 1 else terms[0].unit, lines)
        note = ESTIMATED if estimated else ""
        yield Panel(f"abstract-{number}", "abstract", heading, draw, joined(*texts), note)
    if recorded.plane is not None:
        yield from _abstract_space(recorded)


def _abstract_space(recorded: Recorded) -> Iterator[Panel]:
    """Yield the error of the plane's abstract state, and its path with the manifold and the constraint sets."""
    actual, desired = recorded.arrays.abstract, recorded.arrays.desired
    about = joined(
        span("error of τ", desired.torque - actual.torque, "N m"),
        span("error of J", desired.inertia - actual.inertia, "kg m²"),
    )
    draw = pair_over_time(recorded, lambda axes, run: abstract_error(axes, run, (TORQUE, INERTIA)))
    yield Panel("abstract-error", "abstract", "Error of the abstract state", draw, about)
    spans = list(recorded.spans())
    masses = spans[0][2] if spans else ()
    if len(masses) > 1 and min(masses) > 0:
        about = joined(
            _last_state("ends at", actual.torque, actual.inertia),
            _last_state("desired", desired.torque, desired.inertia),
        )
        note = joined(SETS, FIRST_SETS if len(spans) > 1 else "", by=" ")
        draw = abstract_space(recorded, masses)
        yield Panel("space", "abstract", "Path in the abstract space", draw, about, note, height=2.9)


def _margins(recorded: Recorded) -> Iterator[Panel]:
    """Yield the distances to the constraints of the plane, otherwise from a singular Gram matrix."""
    if recorded.plane is not None:
        yield from _constraint_margins(recorded, recorded.plane)
        return
    margin = recorded.rank_margin
    draw = lines_over_time(recorded, "smallest eigenvalue", [Line("_", margin, BLACK)], positive=True)
    about = joined(span("smallest eigenvalue", margin, ""), _lowest(margin, recorded.arrays.time, ""))
    yield Panel("margins-gram", "margins", "Distance of the Gram matrix from singularity", draw, about, RANK)


def _constraint_margins(recorded: Recorded, plane: TiltingPlane) -> Iterator[Panel]:
    time, margin = recorded.arrays.time, recorded.margins
    limit = least_s3(1.0, plane.length)
    level = Mark("end of the plane", 0.0, FAILED, DASHED)
    draw = lines_over_time(recorded, "m", [Line("L/2 - largest |p|", margin.end, BLACK)], level=level)
    about = joined(span("margin", margin.end, "m"), _lowest(margin.end, time, "m"))
    heading = "Distance of the outermost robot to the plane's end"
    yield Panel("margin-end", "margins", heading, draw, about, recorded.falsified_note)
    lines = [
        Line("abstract state", margin.actual, TORQUE, rows=margin.rows),
        Line("desired state", margin.desired, REFERENCE, DASHED, rows=margin.rows),
    ]
    level = Mark("boundary of A_A", 0.0, FAILED, DASHED)
    draw = lines_over_time(recorded, "distance, N m and kg m²", lines, level=level)
    about = joined(
        span("abstract state", margin.actual, ""),
        _lowest(margin.actual, time[margin.rows], ""),
        span("desired state", margin.desired, ""),
    )
    yield Panel("margin-set", "margins", "Distance to the boundary of A_A", draw, about, NORM)
    draw = lines_over_time(recorded, "m²", [Line("S₃/S₀²", margin.spread, BLACK)], positive=True)
    about = joined(span("S₃/S₀²", margin.spread, "m²"), _lowest(margin.spread, time, "m²"))
    note = f"At 0 all robots are at one point; below {limit:.3g} m² the robots control the inertia only in part."
    yield Panel("margin-spread", "margins", "Spread of the robots, S₃/S₀²", draw, about, note)


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
    about = joined(*(span(name, values, unit) for name, (values, unit) in shown.items()))
    return Panel("sums", "sums", "Auxiliary sums", grid_over_time(recorded, shown), about, height=4.8)


def _membership(recorded: Recorded) -> Panel:
    agents, swarm = recorded.arrays.agents, recorded.swarm
    count, reporting, stopped = len(agents.ids), agents.kind > 0, swarm.have_status("safe_stop")
    dead, silent, limited = (swarm.have_status(status) for status in ("dead", "silent", "limited"))
    follows = swarm.on_plane & ~stopped & ~dead & ~silent
    kinds = agents.kind.max(axis=0, initial=0)
    looks = {
        **{
            f"{said(one.kind)} follows": (follows & (kinds == kind), one.colour)
            for kind, one in KINDS.items()
            if (kinds == kind).any()
        },
        **({"at a limit": (limited, ERROR)} if limited.any() else {}),
        "safe stop": (stopped, SAFE_STOP),
        "dead": (dead, FAILED),
        "silent": (silent & ~dead, ABSENT),
    }
    there, where = swarm.on_plane.sum(axis=1), recorded.subject.parent
    about = joined(
        f"robots on the {where}: initially {there[0]}, finally {there[-1]}" if len(there) else "",
        f"robots that report: initially {reporting[0].sum()}, finally {reporting[-1].sum()}" if len(there) else "",
        f"robots ever in a safe stop: {stopped.any(axis=0).sum()}",
    )
    height = 1.2 + 0.14 * count if count <= ROWS else 2.2
    heading = "Membership and status of the robots"
    return Panel("membership", "membership", heading, statuses(recorded, looks), about, height=height)


def _lowest(values: Floats, time: Floats, unit: str) -> str:
    if not np.isfinite(values).any():
        return ""
    row = int(np.nanargmin(values))
    return f"lowest {quantity(float(values[row]), unit)} at {time[row]:g} s"


def _last_state(name: str, torque: Floats, inertia: Floats) -> str:
    if not len(torque) or not np.isfinite(torque[-1]) or not np.isfinite(inertia[-1]):
        return ""
    return f"{name} τ = {quantity(float(torque[-1]), 'N m')}, J = {quantity(float(inertia[-1]), 'kg m²')}"

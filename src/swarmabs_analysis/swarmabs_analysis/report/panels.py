"""The panels of a report: what each draws, and its description in words and numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
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
from swarmabs_analysis.report.formatting import counted, joined, quantity, span
from swarmabs_bag.run.figures import TOLERANCE
from swarmabs_bag.shown.colours import (
    ABSENT,
    ERROR,
    FAILED,
    INERTIA,
    KINDS,
    PLANE,
    REFERENCE,
    SAFE_STOP,
    TORQUE,
)
from swarmabs_core.abstraction import least_s3
from swarmabs_core.events import EventCode, code_of, said_event
from swarmabs_core.messages import EventKind, Kind, said
from swarmabs_core.systems.kinds import MODELS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import FigureBase
    from numpy.typing import NDArray

    from swarmabs_analysis.report.record import Recorded
    from swarmabs_core.messages import SwarmEvent
    from swarmabs_core.systems import Quantity, SystemTables

    Floats = NDArray[np.float64]

_SETTLED = f"{1e3 * TOLERANCE:g} mrad"
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
PALETTE = (PLANE, ERROR, TORQUE, INERTIA, *KINDS.values())
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
    """Yield the pictures of a run, in the order of a report."""
    if recorded.system is not None:
        yield from _of_system(recorded, recorded.system)
    else:
        yield from _plane(recorded)
        yield from _zooms(recorded)
        yield from _robots(recorded)
        yield from _abstract(recorded)
        yield from _margins(recorded)
        yield _sums(recorded)
    yield _membership(recorded)


def _of_system(recorded: Recorded, system: SystemTables) -> Iterator[Panel]:
    """Yield the pictures of a run on another parent system than the plane."""
    arrays, followed = recorded.arrays, list(recorded.tracking.followed)
    references = dict(zip(followed, recorded.references.T, strict=True))
    groups = [followed] if followed else []
    for number, group in enumerate([*groups, *_by_unit(system.parent, followed)]):
        curves = [(system.parent[place], arrays.parent[:, place], references.get(place)) for place in group]
        yield _curves(recorded, f"parent-{number}", "State of the parent system", "recorded", curves)
    for group in groups:
        curves = [(system.parent[place], references[place] - arrays.parent[:, place], None) for place in group]
        panel = _curves(recorded, "parent-error", "Tracking error, reference minus state", "error of", curves)
        settled = recorded.metrics["settled_at"]
        when = "it does not settle" if settled is None else f"it stays within the tolerance from {settled:g} s on"
        yield replace(panel, about=joined(panel.about, when))
    yield from _zooms(recorded)
    count = len(arrays.agents.ids)
    note = joined(BANDS if count > MANY else "", recorded.falsified_note, by=" ")
    if len(system.robot) == 2:
        draw = paths(recorded, [row.label for row in system.robot])
        about = f"each of {counted(count, 'robot')} ends in a dot"
        yield Panel("robots-paths", "robots", "Paths of the robots", draw, about, height=2.9)
    for place, (name, unit, *_) in enumerate(system.robot):
        values = recorded.coordinates[..., place]
        draw = of_all_robots(recorded, values, name, f"{name}, {unit}".removesuffix(", "))
        about = span(f"coordinates {name}", values, unit, over_time=False)
        heading = f"Coordinates of the robots: {name}"
        yield Panel(f"robots-coordinate-{place}", "robots", heading, draw, about, note)
        yield from _commands(recorded, name, unit, arrays.agents.command[..., place], note)
    rows, actual, desired = system.abstract, arrays.abstract.value, arrays.desired.value
    for number, group in enumerate(_by_unit(rows)):
        curves = [(rows[place], actual[:, place], desired[:, place]) for place in group]
        yield _curves(recorded, f"abstract-{number}", "Abstract state of the swarm", "actual", curves, "desired")
    margin = recorded.rank_margin
    draw = lines_over_time(recorded, "smallest eigenvalue", [Line("_", margin, BLACK)], positive=True)
    about = joined(span("smallest eigenvalue", margin, ""), _lowest(margin, arrays.time, ""))
    yield Panel("margins-gram", "margins", "Distance of the Gram matrix from singularity", draw, about, RANK)


def _commands(recorded: Recorded, name: str, unit: str, command: Floats, note: str) -> Iterator[Panel]:
    """Yield a panel with the commands along a coordinate for each kind of robot, whose units differ."""
    for kind in Kind:
        of_kind = (recorded.arrays.agents.kind == kind).any(axis=0)
        if of_kind.any():
            values, own = np.where(of_kind, command, np.nan), MODELS[kind].command_unit(unit)
            draw = of_all_robots(recorded, values, f"u {name} ", f"command along {name}, {own}".removesuffix(", "))
            whose = counted(int(of_kind.sum()), said(kind))
            about = span(f"commands of {whose}", values, own, over_time=False)
            heading = f"Commands of the {said(kind)}s along {name}"
            yield Panel(f"robots-command-{name}-{kind.value}", "robots", heading, draw, about, note)


def _by_unit(rows: Sequence[Quantity], without: Sequence[int] = ()) -> list[list[int]]:
    """Return the places of the other rows, grouped by unit."""
    others = [place for place in range(len(rows)) if place not in without]
    units = dict.fromkeys(rows[place].unit for place in others)
    return [[place for place in others if rows[place].unit == unit] for unit in units]


def _curves(
    recorded: Recorded,
    key: str,
    heading: str,
    what: str,
    curves: Sequence[tuple[Quantity, Floats, Floats | None]],
    goal: str = "reference",
) -> Panel:
    """Return a panel of quantities of the same unit over time, each with its goal, dashed, if it has one."""
    lines, texts = [], []
    for ((name, unit, *_), values, aim), colour in zip(curves, cycle(PALETTE), strict=False):
        lines.append(Line(name, values, colour))
        texts.append(span(f"{what} {name}", values, unit))
        if aim is not None:
            lines.append(Line(f"{name} {goal}", aim, REFERENCE if len(curves) == 1 else colour, DASHED))
            texts.append(span(goal, aim, unit))
    heading = f"{heading}: {', '.join(name for (name, *_), *_ in curves)}"
    draw = lines_over_time(recorded, f"{name}, {unit}" if len(curves) == 1 else unit, lines)
    return Panel(key, key.partition("-")[0], heading, draw, joined(*texts))


def _plane(recorded: Recorded) -> Iterator[Panel]:
    arrays, reference = recorded.arrays, recorded.arrays.reference
    note = MEASURED if recorded.measured else ""
    settled = recorded.metrics["settled_at"]
    lines = [Line("θ", arrays.angle, PLANE), Line("reference θ", reference, REFERENCE, DASHED)]
    about = joined(
        span("angle θ", arrays.angle, "rad"),
        span("reference", reference, "rad") if np.any(reference) else "",
    )
    draw = lines_over_time(recorded, "θ, rad", lines)
    yield Panel("plane", "plane", "Angle and reference of the plane", draw, about, note)
    draw = lines_over_time(recorded, "ω, rad/s", [Line("ω", arrays.angular_velocity, PLANE)])
    about = span("rate ω", arrays.angular_velocity, "rad/s")
    yield Panel("rate", "plane", "Rate of the plane", draw, about, note)
    moment = Mark(f"settled at {settled:g} s", settled, BLACK, DOTTED) if isinstance(settled, float) else None
    bound = np.full(len(arrays.time), TOLERANCE)
    lines = [
        Line("reference - θ", recorded.error, ERROR),
        Line(f"±{_SETTLED}", bound, BLACK, DOTTED),
        Line("_", -bound, BLACK, DOTTED),
    ]
    about = joined(
        span("tracking error", recorded.error, "rad"),
        f"it does not stay within {_SETTLED}"
        if settled is None
        else f"it stays within {_SETTLED} from {settled:g} s on",
    )
    draw = lines_over_time(recorded, "error, rad", lines, moment=moment)
    yield Panel("tracking", "plane", "Tracking error of the angle", draw, about, note)
    draw = lines_over_time(
        recorded,
        "|error|, rad",
        [Line("|reference - θ|", np.abs(recorded.error), ERROR)],
        level=Mark(_SETTLED, TOLERANCE, BLACK, DOTTED),
        moment=moment,
        positive=True,
    )
    about = "a straight descent is exponential"
    yield Panel("tracking-decades", "plane", "Size of the tracking error", draw, about, note)


def _zooms(recorded: Recorded) -> Iterator[Panel]:
    """Yield angle and positions around the start and the events; if many, around those with the largest errors."""
    time, error = recorded.arrays.time, np.abs(recorded.error)
    last = float(time[-1])
    if last < 2.0 * (BEFORE + AFTER):
        return
    moments = {0.0: ["the start"]}
    begin = 0.0
    for event in recorded.swarm.events:
        at = recorded.swarm.time_of(event)
        if event.kind in ZOOMED and 0.0 < at < last:
            begin = at if at > begin + AFTER else begin
            who = f"robot {event.agent_id} " if event.agent_id else ""
            moments.setdefault(begin, []).append(f"{at:g} s: {who}{said_event(event)}{_set(recorded, event)}")

    def largest(moment: float) -> float:
        found = error[(time >= moment) & (time <= moment + AFTER)]
        return float(np.nanmax(found, initial=0.0))

    for number, moment in enumerate(sorted(sorted(moments, key=largest, reverse=True)[:MOST_ZOOMS])):
        first, *others = moments[moment]
        further = joined(*others[:MOST_NAMED], f"{len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else "")
        about = joined(
            recorded.subject.zoomed,
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
    unit = recorded.subject.disturbance_unit if code is EventCode.DISTURBANCE else recorded.reference_unit
    return f" {quantity(event.value, unit)}"


def _robots(recorded: Recorded) -> Iterator[Panel]:
    agents, sensor = recorded.arrays.agents, recorded.scenario.swarm.sensor
    count, half = len(agents.ids), recorded.scenario.plane.length / 2.0
    note = SENSED if any((*sensor.noise, *sensor.resolution)) else ""
    note = joined(BANDS if count > MANY else "", note, by=" ")
    draw = of_all_robots(recorded, agents.position, "p", "position p, m", end=half)
    where = span(f"positions of {counted(count, 'robot')}", agents.position, "m", over_time=False)
    about = joined(where, f"the plane ends at ±{half:g} m")
    yield Panel(
        "positions",
        "robots",
        "Positions of the robots",
        draw,
        about,
        joined(note, recorded.falsified_note, by=" "),
    )
    if count > MANY:
        about = f"total mass {quantity(float(np.nansum(np.nanmax(agents.mass, axis=0))), 'kg')}"
        heading = "Mass density of the robots"
        yield Panel("mass", "robots", heading, mass_density(recorded), about, recorded.falsified_note)
    draw = of_all_robots(recorded, agents.velocity, "v", "velocity v, m/s")
    about = span("velocities", agents.velocity, "m/s", over_time=False)
    yield Panel("velocities", "robots", "Velocities of the robots", draw, about, note)
    for kind, name, unit in ((Kind.SINGLE_INTEGRATOR, "single", "m/s"), (Kind.DOUBLE_INTEGRATOR, "double", "N")):
        of_kind = (agents.kind == kind).any(axis=0)
        if of_kind.any():
            values = np.where(of_kind, agents.command, np.nan)
            whose = counted(int(of_kind.sum()), f"{name} integrator")
            draw = of_all_robots(recorded, values, "u", f"command u, {unit}")
            about = span(f"commands of {whose}", values, unit, over_time=False)
            yield Panel(f"commands-{name}", "robots", f"Commands of the {name} integrators", draw, about, note)


def _abstract(recorded: Recorded) -> Iterator[Panel]:
    actual, desired = recorded.arrays.abstract, recorded.arrays.desired
    for key, letter, unit, colour, found, target, weight in (
        ("torque", "τ", "N m", TORQUE, actual.torque, desired.torque, recorded.torque if recorded.estimated else None),
        ("inertia", "J", "kg m²", INERTIA, actual.inertia, desired.inertia, None),
    ):
        lines = [Line(f"{letter} {'actual' if weight is None else 'estimated'}", found, colour)]
        if weight is not None:
            lines.append(Line(f"{letter} from the robots' states", weight, ERROR, DOTTED))
        lines.append(Line(f"{letter} desired", target, REFERENCE, DASHED))
        about = joined(
            span(f"actual {key}", found, unit),
            span(f"desired {key}", target, unit),
            span("from the robots' states", weight, unit) if weight is not None else "",
        )
        heading = f"{key.capitalize()} {letter} of the swarm, desired and actual"
        draw = lines_over_time(recorded, f"{letter}, {unit}", lines)
        yield Panel(key, "abstract", heading, draw, about, ESTIMATED if weight is not None else "")
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
    time, margin = recorded.arrays.time, recorded.margins
    limit = least_s3(1.0, recorded.scenario.plane.length)
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
    dead, silent = swarm.have_status("dead"), swarm.have_status("silent")
    follows = swarm.on_plane & ~stopped & ~dead & ~silent
    kinds = agents.kind.max(axis=0, initial=0)
    looks = {
        **{f"{said(kind)} follows": (follows & (kinds == kind), KINDS[kind]) for kind in recorded.subject.kinds},
        **({"at a limit": (swarm.have_status("limited"), ERROR)} if recorded.subject.limits else {}),
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

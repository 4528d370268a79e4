"""A report as one self-contained HTML page: no network, no script, no other file."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jinja2 import Environment

from swarmabs_analysis.report.formatting import counted, printable_lines, sentence, shown
from swarmabs_analysis.report.pictures import page_picture
from swarmabs_config.scenario import dump_scenario
from swarmabs_config.theory import check_scenario
from swarmabs_core.events import said_event
from swarmabs_core.messages import Kind, SwarmEvent, said
from swarmabs_run.rendering import templates

if TYPE_CHECKING:
    from collections.abc import Sequence

    from markupsafe import Markup
    from numpy.typing import NDArray

    from swarmabs_analysis.report.panels import Panel
    from swarmabs_analysis.report.record import Recorded

GENERATOR = "swarmabs report"
"""Marks a page as a report; see `check_target`."""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""Content security policy of the page: a browser loads nothing and uses only inline styles and images."""
MOST_EVENTS = 60
"""Most events with a row each; of more, those of one kind and robot share a row."""

SECTIONS = {
    "metrics": "Metrics",
    "parent": "Parent system",
    "zooms": "Around the events",
    "robots": "Robots",
    "abstract": "Abstract state",
    "margins": "Constraint margins",
    "sums": "Auxiliary sums",
    "membership": "Membership",
    "events": "Events",
    "timing": "Timing",
    "theory": "Theory",
    "scenario": "Scenario",
    "origin": "Versions and bag",
}
"""Headings of the sections. A section has a template of its name, panels that name it, or both."""
TEXTS = ("metrics", "events", "timing", "theory", "scenario", "origin")
"""The sections that have a template."""

Row = tuple[str, ...]


class Picture(NamedTuple):
    """A panel and its drawing."""

    panel: Panel
    svg: Markup


def page(recorded: Recorded, panels: Sequence[Panel]) -> str:
    """Return the HTML text of a report."""
    pictures: dict[str, list[Picture]] = defaultdict(list)
    for panel in panels:
        pictures[panel.section].append(Picture(panel, page_picture(panel)))
    scenario, agents = recorded.scenario, recorded.arrays.agents
    counts = {kind: int((agents.kind == kind).any(axis=0).sum()) for kind in Kind}
    time = recorded.arrays.time
    groups, whole = _groups(recorded)
    theory = None if recorded.plane is None else check_scenario(scenario)
    texts = tuple(key for key in TEXTS if key != "theory" or theory)
    return (
        _environment()
        .get_template("report.html.j2")
        .render(
            generator=GENERATOR,
            policy=POLICY,
            sections=[(key, heading) for key, heading in SECTIONS.items() if key in texts or key in pictures],
            texts=texts,
            pictures=pictures,
            recorded=recorded,
            swarm=recorded.swarm,
            scenario=scenario,
            margin=None if theory is None else recorded.margins,
            robots=sum(counts.values()),
            kinds=", ".join(counted(count, said(kind)) for kind, count in counts.items() if count),
            end=round(float(time[-1]), 6) if len(time) else 0.0,
            realtime=_realtime(recorded),
            groups=groups,
            whole=whole,
            theory=theory,
            theorems=() if theory is None else (*theory.theorems, theory.beyond),
            dump=dump_scenario(scenario.resolved()),
            versions=_versions(recorded),
            counts=[(f"/{topic}", f"{count:,}") for topic, count in recorded.counts.items()],
        )
    )


def _environment() -> Environment:
    """Return the environment of the templates, which escapes every value."""
    environment = templates("swarmabs_analysis.report")
    environment.filters |= {
        "counted": counted,
        "digits": format,
        "exact": repr,
        "kind": said_event,
        "lines": printable_lines,
        "lowest": lowest,
        "number": _number,
        "sentence": sentence,
        "shown": shown,
    }
    return environment


def lowest(values: NDArray[np.float64]) -> float | None:
    """Return the smallest finite value, or None."""
    return float(np.nanmin(values)) if np.isfinite(values).any() else None


def _number(value: object) -> float | None:
    """Return a finite number as float, or None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        return None
    return float(value)


def _realtime(recorded: Recorded) -> list[Row]:
    """Return losses, ages of the broadcasts followed and missed periods, as rows."""
    realtime = recorded.realtime
    if realtime is None:
        return []
    rows: list[Row] = [
        (f"missing messages of {topic}", f"{loss['missing']:,} of {loss['received'] + loss['missing']:,}")
        for topic, loss in realtime["losses"].items()
    ]
    rows += [
        (f"broadcasts followed at an age of {age} steps", f"{n:,}") for age, n in realtime["broadcast_ages"].items()
    ]
    rows.append(("safe stops", f"{realtime['safe_stops']:,}"))
    timing = (recorded.summary or {}).get("realtime")
    missed = timing.get("missed_periods") if isinstance(timing, dict) else None
    for name, periods in (missed if isinstance(missed, dict) else {}).items():
        rows.append((f"periods missed by {shown(name)}", shown(periods)))
    return rows


def _groups(recorded: Recorded) -> tuple[list[Row], bool]:
    """Return rows of many events grouped by kind and robot, or by kind alone if that is still too many, and which.

    For few events there are no rows.
    """
    events = recorded.swarm.events
    if len(events) <= MOST_EVENTS:
        return [], False
    groups: dict[tuple[str, int], list[SwarmEvent]] = defaultdict(list)
    for event in events:
        groups[said_event(event), event.agent_id].append(event)
    whole = len(groups) > MOST_EVENTS
    if whole:
        groups.clear()
        for event in events:
            groups[said_event(event), 0].append(event)
    return [_group(recorded, kind, robot, group, whole=whole) for (kind, robot), group in groups.items()], whole


def _group(recorded: Recorded, kind: str, robot: int, group: list[SwarmEvent], *, whole: bool) -> Row:
    robots = {event.agent_id for event in group if event.agent_id}
    values = [event.value for event in group]
    return (
        kind,
        counted(len(robots), "robot") if whole else str(robot or "-"),
        f"{len(group):,}",
        f"{recorded.swarm.time_of(group[0]):g} s",
        f"{recorded.swarm.time_of(group[-1]):g} s",
        f"{values[0]:.4g}" if len(group) == 1 else f"{min(values):.4g} to {max(values):.4g}",
        shown(group[0].detail),
    )


def _versions(recorded: Recorded) -> list[Row]:
    """Return the versions and the machine recorded in the bag, as rows."""
    versions = recorded.provenance.get("versions")
    named = {str(name): value for name, value in versions.items()} if isinstance(versions, dict) else {}
    rows: list[Row] = [(shown(name), shown(value)) for name, value in sorted(named.items())]
    for name, key in (("machine", "machine"), ("byte order", "byte_order"), ("arithmetic", "arithmetic")):
        if key in recorded.provenance:
            rows.append((name, shown(recorded.provenance[key])))
    return rows

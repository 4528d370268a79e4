"""A report as one HTML page that needs nothing else: no network, no script, no other file."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmabs_analysis.report.html import Child, document, element, facts, number, table, text_block
from swarmabs_analysis.report.pictures import page_picture
from swarmabs_analysis.report.stylesheet import STYLESHEET
from swarmabs_analysis.report.words import counted, shown
from swarmabs_config.scenario import dump_scenario
from swarmabs_core.messages import EventKind, SwarmEvent, said
from swarmabs_core.theory.check import check_scenario
from swarmabs_core.theory.report import Verdict

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from xml.etree import ElementTree as ET

    from swarmabs_analysis.report.panels import Panel
    from swarmabs_analysis.report.record import Recorded
    from swarmabs_analysis.report.weights import Margins

GENERATOR = "swarmabs report"
"""Marks a page as a report; see `swarmabs_analysis.report.files`."""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""What a browser may load for the page: nothing, but use its own styles and images."""
MOST_EVENTS = 60
"""Events up to which each has a row; of more, those of one kind and robot share one."""

_SECTIONS = {
    "metrics": "Metrics",
    "plane": "Plane",
    "robots": "Robots",
    "abstract": "Abstract state",
    "margins": "Constraint margins",
    "sums": "Auxiliary sums",
    "membership": "Membership",
    "events": "Events",
    "timing": "Timing",
    "theory": "What the theory says",
    "scenario": "Scenario",
    "origin": "Versions and bag",
}
_VERDICTS = {Verdict.HOLDS: "good", Verdict.FAILS: "bad", Verdict.NOT_APPLICABLE: "quiet"}


def page(recorded: Recorded, panels: Sequence[Panel], margin: Margins) -> str:
    """Return the HTML text of a report."""
    pictures: dict[str, list[Panel]] = defaultdict(list)
    for panel in panels:
        pictures[panel.section].append(panel)
    contents: Mapping[str, Iterable[Child]] = {
        "metrics": _metrics(recorded, margin),
        "events": _events(recorded),
        "timing": _timing(recorded),
        "theory": _theory(recorded),
        "scenario": _scenario(recorded),
        "origin": _origin(recorded),
    }
    sections = []
    for key, heading in _SECTIONS.items():
        inside = list(contents.get(key, ()))
        if pictures[key]:
            inside.append(element("div", *map(_figure, pictures[key]), class_="figures"))
        if inside:
            sections.append((key, heading, inside))
    links = [element("li", element("a", heading, href=f"#{key}")) for key, heading, _ in sections]
    name = shown(recorded.scenario.name)
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=POLICY),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("meta", name="generator", content=GENERATOR),
        element("title", f"{name}: report of a run"),
        element("style", STYLESHEET),
    )
    body = element(
        "body",
        element("header", *_header(recorded, name), element("nav", element("ul", *links), aria_label="Contents")),
        element("main", *(_section(key, heading, inside) for key, heading, inside in sections)),
        element("footer", "Made from the bag alone, with what lies beside it where it says so. SI units throughout."),
    )
    return document(element("html", head, body, lang="en"))


def _section(key: str, heading: str, inside: Iterable[Child]) -> ET.Element:
    return element("section", element("h2", heading, id=f"{key}-heading"), *inside, id=key)


def _header(recorded: Recorded, name: str) -> Iterator[ET.Element]:
    yield element("h1", name)
    good = recorded.swarm.status == "ok"
    text = "completed" if good else recorded.swarm.status
    reason = f": {shown(recorded.swarm.reason)}" if recorded.swarm.reason not in {None, recorded.swarm.status} else ""
    yield element("p", element("span", text, class_=f"status {'good' if good else 'bad'}"), reason)
    scenario, agents = recorded.scenario, recorded.arrays.agents
    singles = int((agents.kind == 1).any(axis=0).sum())
    steps: list[Child] = [number(recorded.steps, "", ",")]
    if recorded.steps != scenario.steps:
        steps.append(f" of {scenario.steps:,}")
    end = round(float(recorded.arrays.time[-1]), 6) if len(recorded.arrays.time) else 0.0
    listed = facts(
        (
            (
                "Robots",
                element(
                    "span",
                    number(len(agents.ids), "", "d"),
                    f" ({singles} single, {len(agents.ids) - singles} double integrators)",
                ),
            ),
            ("Parent controller", scenario.controller.type),
            (
                "Recorded time",
                element("span", number(end, "s", "g"), f" of {scenario.duration_ns / 1e9:g} s"),
            ),
            ("Steps", element("span", *steps, f", {scenario.period:g} s each")),
            ("Driver", shown(recorded.provenance.get("driver", "not recorded"))),
            ("Seed", str(scenario.seed)),
        )
    )
    digest = recorded.metrics["digest"]
    row = element("div", element("dt", "Digest"), element("dd", element("code", str(digest or "-"))), class_="wide")
    listed.append(row)
    yield listed


def _metrics(recorded: Recorded, margin: Margins) -> Iterator[ET.Element]:
    found = recorded.metrics
    rows: list[tuple[str, Child, str]] = [
        (
            "Settled at",
            number(_float(found["settled_at"]), "s"),
            "first time after which the angle stays within 10 mrad of its reference; - if it does not",
        ),
        ("RMS error", number(_float(found["rms_error"]), "rad"), "of the angle, over all recorded steps"),
        ("Final error", number(_float(found["final_error"]), "rad"), "reference minus angle at the last recorded step"),
        ("Largest |position|", number(_float(found["max_abs_position"]), "m"), "of any robot from the axis"),
    ]
    for name, values, unit, meaning in (
        ("Margin to the plane's end", margin.end, "m", "smallest distance of a robot; negative if one was beyond"),
        ("Margin to A_A's boundary", margin.actual, "", "smallest distance of the abstract state, N m and kg m²"),
        ("The same, desired state", margin.desired, "", "smallest distance of the desired abstract state"),
        ("Smallest S₃/S₀²", margin.spread, "m²", "spread of the robots; at 0 no law has a solution"),
    ):
        rows.append((name, number(_lowest(values), unit), meaning))
    messages = found["messages"]
    rows.append(("Messages", number(messages if isinstance(messages, int) else None, "", ",d"), "in the bag"))
    yield table(("", "value", "meaning"), rows)
    if recorded.realtime is not None:
        yield _realtime(recorded)
    if not recorded.drawable:
        yield element("p", "Fewer than two steps are recorded, so there is nothing to draw over time.")
    if recorded.measured:
        yield element("p", "The errors are those of the measured angle: the plane's sensor is imperfect.")
    if recorded.lies_note:
        yield element("p", recorded.lies_note)


def _realtime(recorded: Recorded) -> ET.Element:
    """Return what was missed and how old was what robots followed."""
    found = recorded.realtime or {}
    rows: list[tuple[str, Child]] = [
        (f"missing of {topic}", f"{loss['missing']:,} of {loss['received'] + loss['missing']:,}")
        for topic, loss in found["losses"].items()
    ]
    rows += [(f"broadcasts followed after {age} steps", f"{n:,}") for age, n in found["broadcast_ages"].items()]
    rows.append(("safe stops", f"{found['safe_stops']:,}"))
    timing = (recorded.summary or {}).get("realtime")
    missed = timing.get("missed_periods") if isinstance(timing, dict) else None
    for name, periods in (missed if isinstance(missed, dict) else {}).items():
        rows.append((f"periods missed by {shown(name)}", shown(periods)))
    return table(("in real time", "number"), rows, "Missing is what was lost on its way to the recorder, or not sent")


def _figure(panel: Panel) -> ET.Element:
    picture = page_picture(panel)
    picture.set("role", "img")
    picture.set("aria-label", f"{panel.heading}. {panel.about}")
    caption = element("figcaption", element("p", f"{panel.about[:1].upper()}{panel.about[1:]}."))
    if panel.note:
        caption.append(element("p", panel.note))
    return element("figure", element("h3", panel.heading), picture, caption, id=f"panel-{panel.key}")


def _events(recorded: Recorded) -> Iterator[ET.Element]:
    events = recorded.swarm.events
    if not events:
        yield element("p", "Nothing happened that a node announced.")
        return
    if recorded.drawable:
        yield element(
            "p",
            "At the upper edge of the pictures triangles mark who takes part (red: dead or stalled, orange: left, "
            "green: joined, purple: safe stop), and dashes the other events.",
        )
    if len(events) <= MOST_EVENTS:
        rows = [
            (
                f"{recorded.swarm.time_of(event):g} s",
                str(event.step),
                str(event.agent_id or "-"),
                _kind(event),
                number(event.value, ""),
                shown(event.detail),
            )
            for event in events
        ]
        yield table(("time", "step", "robot", "kind", "value", "text"), rows, counted(len(events), "event"))
        return
    by_robot = _grouped(events, lambda event: (_kind(event), event.agent_id))
    whole = len(by_robot) > MOST_EVENTS
    groups = _grouped(events, lambda event: (_kind(event), 0)) if whole else by_robot
    rows_of_groups = []
    for (kind, robot), group in groups.items():
        robots = sorted({event.agent_id for event in group if event.agent_id})
        who = counted(len(robots), "robot") if whole else str(robot or "-")
        values = [event.value for event in group]
        rows_of_groups.append(
            (
                kind,
                who,
                f"{len(group):,}",
                f"{recorded.swarm.time_of(group[0]):g} s",
                f"{recorded.swarm.time_of(group[-1]):g} s",
                f"{values[0]:.4g}" if len(group) == 1 else f"{min(values):.4g} to {max(values):.4g}",
                shown(group[0].detail),
            )
        )
    caption = f"{len(events):,} events, those of one kind{'' if whole else ' and robot'} in a row"
    yield table(("kind", "robot", "events", "first", "last", "value", "text of the first"), rows_of_groups, caption)


def _grouped(events: Iterable[SwarmEvent], key: Any) -> dict[tuple[str, int], list[SwarmEvent]]:
    groups: dict[tuple[str, int], list[SwarmEvent]] = defaultdict(list)
    for event in events:
        groups[key(event)].append(event)
    return groups


def _kind(event: SwarmEvent) -> str:
    try:
        return said(EventKind(event.kind))
    except ValueError:
        return f"kind {event.kind}"


def _timing(recorded: Recorded) -> Iterator[ET.Element]:
    summary = recorded.summary
    note = recorded.summary_note
    yield element("p", f"{note[:1].upper()}{note[1:]}.")
    if summary is None:
        return
    wall, factor = _float(summary.get("wall_time")), _float(summary.get("real_time_factor"))
    rows: list[tuple[str, Child, str]] = [("Wall time", number(wall, "s"), "of the whole command")]
    setup, startup = _float(summary.get("setup_time")), _float(summary.get("startup_time"))
    if setup:
        rows.append(("Set-up", number(setup, "s"), "of the checkout, before anything else"))
    if startup is not None:
        rows.append(("Start", number(startup, "s"), "from there to the first step: scenario, processes"))
    if factor and wall is not None:
        stepping = recorded.scenario.duration_ns / 1e9 / factor
        rest = max(wall - (setup or 0.0) - (startup or 0.0) - stepping, 0.0)
        rows += [
            ("Stepping", number(stepping, "s"), "from the first step to the last"),
            ("Rest", number(rest, "s"), "closing the bag" if startup is not None else "start and closing the bag"),
            ("Speed", number(recorded.scenario.steps / stepping, "steps/s"), "without start and end"),
            ("Real-time factor", number(factor, ""), "simulated time per time of stepping"),
        ]
    yield table(("", "value", "meaning"), rows)


def _theory(recorded: Recorded) -> Iterator[ET.Element]:
    report = check_scenario(recorded.scenario)
    covered = "covers" if report.covered else "does not cover"
    yield element("p", "The theory, as corrected, ", element("strong", covered), " this scenario.")
    rows = []
    for theorem in (*report.theorems, report.beyond):
        if not theorem.applicable:
            continue
        failed = "; ".join(
            f"{one.name}: {one.corrected.value:.4g} is not {one.corrected.relation} {one.corrected.bound:.4g}"
            for one in theorem.failed
        )
        rows.append((theorem.title, _verdict(theorem.verdict), _verdict(theorem.printed_verdict), failed or "-"))
    yield table(("theorem", "corrected", "as printed", "what fails"), rows)
    caption = f"With |θ| ≤ {report.angle_max:g} rad. The whole check, with each condition: swarm check BAG."
    yield element("p", caption, class_="quiet")


def _verdict(verdict: Verdict) -> ET.Element:
    text = "-" if verdict is Verdict.NOT_APPLICABLE else verdict.value
    return element("span", text, class_=_VERDICTS[verdict])


def _scenario(recorded: Recorded) -> Iterator[ET.Element]:
    text = dump_scenario(recorded.scenario.resolved())
    yield element(
        "details",
        element("summary", "The scenario with every default filled in: enough to run it again"),
        text_block(text),
    )


def _origin(recorded: Recorded) -> Iterator[ET.Element]:
    found = recorded.provenance
    versions = found.get("versions")
    named = {str(name): value for name, value in versions.items()} if isinstance(versions, dict) else {}
    rows = [(shown(name), shown(value)) for name, value in sorted(named.items())]
    for name, key in (("machine", "machine"), ("byte order", "byte_order"), ("fingerprint", "libm_fingerprint")):
        if key in found:
            rows.append((name, shown(found[key])))
    if rows:
        yield table(("what", "version"), rows, "What the run was made with; equal fingerprints promise equal digests")
    else:
        yield element("p", "The bag does not say with what it was made.")
    counts = [(f"/{topic}", f"{count:,}") for topic, count in recorded.counts.items()]
    yield table(("topic", "messages"), counts, f"Messages in {shown(recorded.swarm.bag.name)}")


def _lowest(values: Any) -> float | None:
    return float(np.nanmin(values)) if np.isfinite(values).any() else None


def _float(value: object) -> float | None:
    """Return a finite number, None for what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        return None
    return float(value)

"""Presentation of results: tables, charts, and the comparison of two results."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

from benchmarks.baseline_programs import BASELINES
from benchmarks.model import AGENTS, ROUND_TRIP, costs, model, spread_out
from benchmarks.product import FAILED, PACKED, PRODUCT
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from matplotlib.axes import Axes

    Document = Mapping[str, Any]

_NAMES = {
    "rclpy_best_effort": "bare rclpy",
    "rclpy_reliable": "bare rclpy, reliable",
    "zeromq": "ZeroMQ",
    "datagrams": "Unix datagrams",
    PRODUCT: "swarm run --no-packed",
    PACKED: "swarm run --packed",
}
# The Okabe-Ito palette, which is safe for colour-blind readers; markers and line styles differ, too.
_STYLES = {
    PRODUCT: ("#d55e00", "o", "-"),
    PACKED: ("#e69f00", "P", "-"),
    "rclpy_best_effort": ("#0072b2", "s", "--"),
    "rclpy_reliable": ("#56b4e9", "D", "--"),
    "zeromq": ("#009e73", "^", "-."),
    "datagrams": ("#666666", "v", ":"),
}
_MIB = 2**20
_DEPLOYMENTS = ((1000, 10), (1000, 50), (1000, 1000), (10_000, 50), (10_000, 200), (10_000, 10_000))
"""Pairs of robots and hosts for which the steps per second are derived."""
_MB = 1e6
READERS = ("verify", "compare", "info", "load_arrays")
"""What reads whole bags, by names in the suite ``reading``."""


class Table(NamedTuple):
    """A table: name, caption, headings and rows."""

    name: str
    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def shown(spread: Mapping[str, float] | None, unit: float = 1.0) -> str:
    """Return a median with the smallest and the largest value as text."""
    if spread is None:
        return "-"
    middle, low, high = (f"{_short(spread[key] / unit)}" for key in ("median", "smallest", "largest"))
    return middle if low == high else f"{middle} ({low}-{high})"


def _short(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def tables(document: Document) -> tuple[Table, ...]:
    """Return the tables of the suites that a result contains."""
    made = (
        ("product", _speed),
        ("product", _cost),
        ("start", _start),
        ("memory", _memory),
        ("large", _large),
        ("simulate", _simulate),
        ("sweep", _sweep),
        ("recorder", _recorder),
        ("reading", _reading),
        ("functions", _functions),
    )
    return (*(make(document[suite]) for suite, make in made if suite in document), *_modelled(document))


def _speed(rows: list[dict[str, Any]]) -> Table:
    order = (PRODUCT, PACKED, *BASELINES)
    ratios = ("ratio_to_floor", "packed_ratio_to_floor", "ratio_to_zeromq", "packed_ratio_to_zeromq")
    return Table(
        "speed",
        "steps per second, and the speed of swarm run, without and with packed messages, relative to the faster bare"
        " rclpy and to ZeroMQ",
        ("robots", *(_NAMES[key] for key in order), "of rclpy", "packed of rclpy", "of ZeroMQ", "packed of ZeroMQ"),
        tuple(
            (
                str(row["robots"]),
                *(shown(row["summary"]["steps_per_second"].get(key)) for key in order),
                *(shown(row["summary"].get(key)) for key in ratios),
            )
            for row in rows
        ),
    )


def _cost(rows: list[dict[str, Any]]) -> Table:
    roles = ("plane", "observer", "controller", "recorder")
    found = []
    for row in rows:
        for key in (PRODUCT, PACKED, row["summary"]["floor"], "zeromq"):
            loads = [load for repeat in row["repeats"] if (load := repeat.get(key, {}).get("load")) is not None]
            if loads:
                shares = [f"{median(load['cpu_share'].get(role, 0.0) for load in loads):.0%}" for role in roles]
                measures = ("cpu_ms_per_step", "switches_per_agent_step")
                values = [_short(median(load[measure] for load in loads)) for measure in measures]
                other = f"{median(load['other_load'] for load in loads):.0%}"
                found.append((str(row["robots"]), _NAMES[key], *values, *shares, other))
    return Table(
        "cost",
        "processor time of all processes, ms per step; context switches per robot and step; shares of one core by role,"
        " and the share of the machine used by other processes",
        ("robots", "what", "CPU ms", "switches", *roles, "others"),
        tuple(found),
    )


def _start(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "start",
        "starts in which all processes connected and made the first step, the time (s) from the command to that step"
        " and from Ctrl-C to the end of all processes, and the number of other processes that kept the machine busy",
        ("robots", "clean starts", "processes retried", "first step", "end", "busy processes"),
        tuple(
            (
                str(row["robots"]),
                _clean(row),
                str(row.get("retried", "-")),
                *(shown(row["summary"][key]) for key in ("start_seconds", "shut_down_seconds")),
                str(row.get("busy_processes", "-")),
            )
            for row in rows
        ),
    )


def _clean(row: Mapping[str, Any]) -> str:
    """Return the number of clean starts as text; old results do not have it."""
    return f"{row['clean']} of {row['starts']}" if "starts" in row else "-"


def _memory(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "memory",
        "memory of a robot's process and of all processes, with shared pages counted once (PSS), MiB",
        ("robots", "per robot", "total"),
        _rows(rows, ("agent_bytes", "total_bytes"), _MIB),
    )


def _large(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "large",
        "several robots per process, with recording: the time (s) to the first step, steps per second, processor time"
        " of all processes per step (ms), memory of all processes (PSS, MiB), and the number of failed runs",
        ("robots", "per process", "first step", "steps/s", "CPU ms", "memory", "failed"),
        tuple(
            (
                str(row["robots"]),
                str(row["agents_per_process"]),
                *(shown(row["summary"][key]) for key in ("start_seconds", "steps_per_second", "cpu_ms_per_step")),
                shown(row["summary"]["total_bytes"], _MIB),
                str(len(row["failures"])),
            )
            for row in rows
        ),
    )


def _modelled(document: Document) -> tuple[Table, ...]:
    """Return the cost model and its extrapolation to many hosts; empty if no run was sampled twice."""
    found = costs(document.get("product", ()))
    known, cores = model(found), document["machine"]["usable_cores"]
    if known is None:
        return ()
    fit = f"{_short(known.step.a)} ms + {_short(1000.0 * known.step.b)} us per robot"
    cost = Table(
        "model",
        f"wall time of a step, measured and fitted as {fit}; processor time of a step; and its share of {cores} cores",
        (
            "robots",
            "step, ms",
            "fitted, ms",
            "CPU of robots, ms",
            "of coordinators, ms",
            "busiest coordinator, ms",
            "share of cores",
        ),
        tuple(
            (
                str(c.robots),
                _short(c.step),
                _short(known.step.at(c.robots)),
                _short(c.cpu.get(AGENTS, 0.0)),
                _short(c.coordinators),
                _short(max((cost for role, cost in c.cpu.items() if role != AGENTS), default=0.0)),
                f"{(c.coordinators + c.cpu.get(AGENTS, 0.0)) / (c.step * cores):.0%}",
            )
            for c in found
        ),
    )
    hosts = Table(
        "hosts",
        f"derived, not measured: steps per second on hosts with {cores} such cores and a separate host for the"
        f" coordinators, with {ROUND_TRIP:g} ms of network time per step",
        ("robots", "hosts", "robots per host", "one message per robot", "one message per host"),
        tuple(
            (
                str(robots),
                str(number),
                str(robots // number),
                *(_short(1000.0 / spread_out(known, robots, number, cores, relays=relays)) for relays in (False, True)),
            )
            for robots, number in _DEPLOYMENTS
        ),
    )
    return cost, hosts


def _simulate(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "simulate",
        "simulated seconds per second",
        ("robots", "without a bag", "with a bag"),
        _rows(rows, ("real_time_factor_without_bag", "real_time_factor")),
    )


def _sweep(rows: list[dict[str, Any]]) -> Table:
    speeds = ("start_seconds", "cases_per_second", "cpu_ratio")
    return Table(
        "sweep",
        "a sweep of pd_het_4 (30 s) on all cores: the time (s) until its workers have computed their first cases, cases"
        " per second, processor time per case relative to the simulation alone, memory of the largest worker (MiB), and"
        " that relative to its start",
        ("robots", "start", "cases/s", "relative to simulate", "memory", "growth"),
        tuple(
            (
                str(row["robots"]),
                *(shown(row["summary"][key]) for key in speeds),
                shown(row["summary"]["worker_bytes"], _MIB),
                shown(row["summary"]["growth"]),
            )
            for row in rows
        ),
    )


def _recorder(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "recorder",
        "messages per second from DDS to the bag, the share of one core that this takes, and messages per second of"
        " processor time",
        ("robots", "messages/s", "share of a core", "messages/CPU s"),
        _rows(rows, ("messages_per_second", "core_share", "messages_per_core_second")),
    )


def _reading(rows: list[dict[str, Any]]) -> Table:
    found = []
    for row in rows:
        summary = row["summary"]
        sizes = (shown(summary[key], _MB) for key in ("bag_bytes", "arrays_bytes_per_second"))
        rates = (shown(summary.get(name), 1000.0) for name in READERS)
        found.append((str(row["robots"]), *sizes, shown(summary["ratio_to_iteration"]), *rates))
    return Table(
        "reading",
        "loading a bag into arrays: size of the bag before compression, speed, and the time relative to an iteration of"
        " the mcap library over the raw messages; and thousands of messages per second of processor time",
        ("robots", "MB", "MB/s", "relative to raw", *READERS),
        tuple(found),
    )


def _functions(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "functions",
        "time of a call, ns, in the fastest of many passes: correctly rounded, by the machine's library, and the ratio",
        ("function", "arguments", "correctly rounded", "machine", "ratio"),
        tuple(
            (
                row["function"],
                row["between"],
                *(shown(row["summary"][key]) for key in ("nanoseconds", "machine_nanoseconds", "ratio")),
            )
            for row in rows
        ),
    )


def _rows(rows: list[dict[str, Any]], keys: tuple[str, ...], unit: float = 1.0) -> tuple[tuple[str, ...], ...]:
    """Return table rows with these spreads."""
    return tuple((str(row["robots"]), *(shown(row["summary"][key], unit) for key in keys)) for row in rows)


def notes(document: Document) -> list[str]:
    """Return notes on how the tables were measured."""
    machine, settings = document["machine"], document["settings"]
    found = [
        f"measured {document['created']}",
        f"on {machine['usable_cores']} of {machine['cores']} cores, {machine['processor']}, Linux {machine['kernel']}",
        f"load average before: {machine['load_before']}",
        f"repeats: {settings['repeat']} of {settings['window']:g} s each; values are median (smallest-largest)",
    ]
    found += [f"not measured: {name} with {robots} robots: {why}" for robots, name, why in missing(document)]
    if "solver" in document:
        solver = document["solver"]
        angle = max(repeat["largest_difference"] for repeat in solver["repeats"])
        found += [
            f"simulate takes {shown(solver['ratio'])} times as long as {solver['solver']}",
            f"  for {solver['problem']}; their angles differ by {angle:.1g} rad at most",
        ]
    return found


def missing(document: Document) -> list[tuple[int, str, str]]:
    """Return robots, name and reason of every measurement of the product's suite that failed."""
    return [
        (row["robots"], _NAMES[name], result[FAILED])
        for row in document.get(PRODUCT, ())
        for repeat in row["repeats"]
        for name, result in repeat.items()
        if FAILED in result
    ]


def markdown(table: Table) -> str:
    """Return a table in Markdown, without its caption."""
    lines = [table.headings, ("---",) * len(table.headings), *table.rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def draw(document: Document, picture: Path) -> None:
    """Plot steps per second against the number of robots."""
    figure = Figure(figsize=(7.2, 4.6), dpi=130, layout="constrained")
    axes = figure.subplots()
    rows = document["product"]
    for key in _STYLES:
        points = [(row["robots"], row["summary"]["steps_per_second"].get(key)) for row in rows]
        _curve(axes, [(robots, speed) for robots, speed in points if speed], key, _NAMES[key])
    axes.set(xlabel="robots, one process each", ylabel="steps per second")
    _finish(axes, [row["robots"] for row in rows])
    axes.legend(frameon=False)
    figure.savefig(picture, facecolor="white")


def draw_large(document: Document, picture: Path) -> None:
    """Plot start time and speed of large simulations against the number of robots."""
    figure = Figure(figsize=(7.2, 3.4), dpi=130, layout="constrained")
    rows = document["large"]
    panels = (("start_seconds", "s to the first step", "zeromq"), ("steps_per_second", "steps per second", PRODUCT))
    for axes, (measure, label, style) in zip(figure.subplots(1, len(panels)), panels, strict=True):
        axes.set(xlabel=f"robots, {rows[0]['agents_per_process']} per process", ylabel=label)
        points = [(row["robots"], row["summary"][measure]) for row in rows if row["summary"][measure] is not None]
        if points:  # logarithmic axes cannot be empty
            _curve(axes, points, style, label)
            _finish(axes, [row["robots"] for row in rows])
    figure.savefig(picture, facecolor="white")


def _curve(axes: Axes, points: list[tuple[int, Mapping[str, float]]], style: str, label: str) -> None:
    """Plot medians with error bars from smallest to largest."""
    colour, mark, dashes = _STYLES[style]
    spreads = [spread for _, spread in points]
    middle = [spread["median"] for spread in spreads]
    below = [spread["median"] - spread["smallest"] for spread in spreads]
    above = [spread["largest"] - spread["median"] for spread in spreads]
    axes.errorbar(
        [robots for robots, _ in points],
        middle,
        yerr=(below, above),
        label=label,
        color=colour,
        marker=mark,
        linestyle=dashes,
        linewidth=2.2 if style in {PRODUCT, PACKED} else 1.4,
        capsize=3,
    )


def _finish(axes: Axes, numbers: list[int]) -> None:
    """Give both axes logarithmic scales with plain numbers."""
    axes.set(xscale="log", yscale="log")
    axes.set_xticks(numbers, [str(number) for number in numbers])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(which="both", color="#eeeeee")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _measures(document: Document) -> Iterator[tuple[str, str, str, Mapping[str, float]]]:
    """Yield suite, robots or function, name and spread of every measurement."""
    for suite in ("product", "start", "memory", "large", "simulate", "sweep", "recorder", "reading", "functions"):
        for row in document.get(suite, ()):
            summary = dict(row["summary"])
            if suite == PRODUCT:
                summary |= summary.pop("steps_per_second")
            for name, spread in summary.items():
                if isinstance(spread, dict):
                    measured = f"{row['function']}, {row['between']}" if suite == "functions" else str(row["robots"])
                    yield suite, measured, name, spread


def comparison(old: Document, new: Document) -> Table:
    """Return the ratios new/old of measurements in both results; overlapping ranges count as no difference."""
    before = {(suite, measured, name): spread for suite, measured, name, spread in _measures(old)}
    rows = []
    for suite, measured, name, spread in _measures(new):
        known = before.get((suite, measured, name))
        if known is not None and known["median"]:
            apart = spread["smallest"] > known["largest"] or spread["largest"] < known["smallest"]
            ratio = f"{spread['median'] / known['median']:.2f}"
            verdict = "" if apart else "within the spread"
            rows.append((suite, measured, name, shown(known), shown(spread), ratio, verdict))
    rows.extend(_compared_starts(old, new))
    return Table(
        "comparison",
        "medians (smallest-largest) of two results",
        ("suite", "robots or function", "measure", "old", "new", "new/old", ""),
        tuple(rows),
    )


def _compared_starts(old: Document, new: Document) -> Iterator[tuple[str, str, str, str, str, str, str]]:
    """Yield the clean starts that both results have counted."""
    counted = {row["robots"]: row for row in old.get("start", ()) if row.get("clean")}
    for row in new.get("start", ()):
        known = counted.get(row["robots"])
        if known is not None and "starts" in row:
            ratio = (row["clean"] / row["starts"]) / (known["clean"] / known["starts"])
            yield ("start", str(row["robots"]), "clean starts", _clean(known), _clean(row), f"{ratio:.2f}", "")

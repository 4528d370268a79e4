"""A result for people: tables, a picture, and the comparison of two results."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_bringup.bench.floors import FLOORS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    Document = Mapping[str, Any]

_NAMES = {
    "rclpy_best_effort": "bare rclpy",
    "rclpy_reliable": "bare rclpy, reliable",
    "zeromq": "ZeroMQ",
    "datagrams": "Unix datagrams",
    "product": "swarm run",
}
# Okabe and Ito's colours, which people with any colour vision tell apart; marks and dashes differ too.
_LOOKS = {
    "product": ("#d55e00", "o", "-"),
    "rclpy_best_effort": ("#0072b2", "s", "--"),
    "rclpy_reliable": ("#56b4e9", "D", "--"),
    "zeromq": ("#009e73", "^", "-."),
    "datagrams": ("#666666", "v", ":"),
}
_MIB = 2**20


class Table(NamedTuple):
    """A table: its name, what it shows, its headings, its rows."""

    name: str
    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def shown(spread: Mapping[str, float] | None, unit: float = 1.0) -> str:
    """Say a median with the smallest and the largest value."""
    if spread is None:
        return "-"
    middle, low, high = (f"{_short(spread[key] / unit)}" for key in ("median", "smallest", "largest"))
    return middle if low == high else f"{middle} ({low}-{high})"


def _short(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def tables(document: Document) -> tuple[Table, ...]:
    """Return the tables of a result, of those suites that were measured."""
    made = (
        ("product", _speed),
        ("product", _cost),
        ("start", _start),
        ("memory", _memory),
        ("simulate", _simulate),
        ("recorder", _recorder),
    )
    return tuple(make(document[suite]) for suite, make in made if suite in document)


def _speed(rows: list[dict[str, Any]]) -> Table:
    order = ("product", *FLOORS)
    return Table(
        "speed",
        "steps per second, and those of swarm run in parts of the better bare rclpy's and of ZeroMQ's",
        ("robots", *(_NAMES[key] for key in order), "of rclpy", "of ZeroMQ"),
        tuple(
            (
                str(row["robots"]),
                *(shown(row["summary"]["steps_per_second"][key]) for key in order),
                shown(row["summary"]["ratio_to_floor"]),
                shown(row["summary"]["ratio_to_zeromq"]),
            )
            for row in rows
        ),
    )


def _cost(rows: list[dict[str, Any]]) -> Table:
    roles = ("plane", "observer", "controller", "recorder")
    found = []
    for row in rows:
        for key in ("product", row["summary"]["floor"], "zeromq"):
            loads = [repeat[key]["load"] for repeat in row["repeats"] if repeat[key]["load"] is not None]
            if loads:
                shares = [f"{median(load['cpu_share'].get(role, 0.0) for load in loads):.0%}" for role in roles]
                measures = ("cpu_ms_per_step", "switches_per_agent_step")
                values = [_short(median(load[measure] for load in loads)) for measure in measures]
                other = f"{median(load['other_load'] for load in loads):.0%}"
                found.append((str(row["robots"]), _NAMES[key], *values, *shares, other))
    return Table(
        "cost",
        "processor time of all processes, ms per step; context switches per robot and step; shares of one core, and of"
        " the machine what others took",
        ("robots", "what", "CPU ms", "switches", *roles, "others"),
        tuple(found),
    )


def _start(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "start",
        "from the command to the first step, and from Ctrl-C to the end of all processes, s",
        ("robots", "first step", "end"),
        _rows(rows, ("start_seconds", "shut_down_seconds")),
    )


def _memory(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "memory",
        "of a robot's process and of all processes, what is shared counted once (PSS), MiB",
        ("robots", "a robot", "all"),
        _rows(rows, ("agent_bytes", "total_bytes"), _MIB),
    )


def _simulate(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "simulate",
        "simulated seconds per second",
        ("robots", "without a bag", "with a bag"),
        _rows(rows, ("real_time_factor_without_bag", "real_time_factor")),
    )


def _recorder(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "recorder",
        "messages per second from DDS to the bag, the share of one core meanwhile, and messages per second of"
        " its processor time",
        ("robots", "messages/s", "of a core", "messages/CPU s"),
        _rows(rows, ("messages_per_second", "core_share", "messages_per_core_second")),
    )


def _rows(rows: list[dict[str, Any]], keys: tuple[str, ...], unit: float = 1.0) -> tuple[tuple[str, ...], ...]:
    """Return rows that show these spreads."""
    return tuple((str(row["robots"]), *(shown(row["summary"][key], unit) for key in keys)) for row in rows)


def notes(document: Document) -> list[str]:
    """Return what a reader of the tables must know besides."""
    machine, settings = document["machine"], document["settings"]
    found = [
        f"measured {document['created']}",
        f"on {machine['usable_cores']} of {machine['cores']} cores, {machine['processor']}, Linux {machine['kernel']}",
        f"load average before: {machine['load_before']}",
        f"median (smallest-largest) of {settings['repeat']} windows of {settings['window']:g} s",
    ]
    if "solver" in document:
        solver = document["solver"]
        angle = max(repeat["largest_difference"] for repeat in solver["repeats"])
        found += [
            f"simulate takes {shown(solver['ratio'])} of the time of {solver['solver']}",
            f"  for {solver['problem']}; their angles differ by {angle:.1g} rad at most",
        ]
    return found


def markdown(table: Table) -> str:
    """Return a table in Markdown, without its caption."""
    lines = [table.headings, ("---",) * len(table.headings), *table.rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def draw(document: Document, picture: Path) -> None:
    """Draw the steps per second by the number of robots."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import
    from matplotlib.ticker import NullFormatter, ScalarFormatter  # noqa: PLC0415

    figure = Figure(figsize=(7.2, 4.6), dpi=130, layout="constrained")
    axes = figure.subplots()
    rows = document["product"]
    numbers = [row["robots"] for row in rows]
    for key, (colour, mark, dashes) in _LOOKS.items():
        spreads = [row["summary"]["steps_per_second"][key] for row in rows]
        middle = [spread["median"] for spread in spreads]
        below = [spread["median"] - spread["smallest"] for spread in spreads]
        above = [spread["largest"] - spread["median"] for spread in spreads]
        axes.errorbar(
            numbers,
            middle,
            yerr=(below, above),
            label=_NAMES[key],
            color=colour,
            marker=mark,
            linestyle=dashes,
            linewidth=2.2 if key == "product" else 1.4,
            capsize=3,
        )
    axes.set(xscale="log", yscale="log", xlabel="robots, one process each", ylabel="steps per second")
    axes.set_xticks(numbers, [str(number) for number in numbers])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.grid(which="both", color="#eeeeee")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    figure.savefig(picture, facecolor="white")


def _measures(document: Document) -> Iterator[tuple[str, int, str, Mapping[str, float]]]:
    """Yield suite, robots, name and spread of all that was measured."""
    for suite in ("product", "start", "memory", "simulate", "recorder"):
        for row in document.get(suite, ()):
            summary = dict(row["summary"])
            summary |= summary.pop("steps_per_second", {})
            for name, spread in summary.items():
                if isinstance(spread, dict):
                    yield suite, row["robots"], name, spread


def comparison(old: Document, new: Document) -> Table:
    """Return what two results have in common, as new by old; ranges that overlap are no difference."""
    before = {(suite, robots, name): spread for suite, robots, name, spread in _measures(old)}
    rows = []
    for suite, robots, name, spread in _measures(new):
        known = before.get((suite, robots, name))
        if known is not None and known["median"]:
            apart = spread["smallest"] > known["largest"] or spread["largest"] < known["smallest"]
            ratio = f"{spread['median'] / known['median']:.2f}"
            verdict = "" if apart else "within the spread"
            rows.append((suite, str(robots), name, shown(known), shown(spread), ratio, verdict))
    return Table(
        "comparison",
        "medians (smallest-largest) of two results",
        ("suite", "robots", "measure", "old", "new", "new/old", ""),
        tuple(rows),
    )

"""Terminal tables of the differences of two bags, or of nodes under test and their recording."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

from rich import box
from rich.console import Group
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from swarmabs_analysis.difference import component_of
from swarmabs_bag.run.figures import Tracking
from swarmabs_config.model.errors import printable, shorten
from swarmabs_core.messages import TOPICS
from swarmabs_core.systems import PLANE_TABLES
from swarmabs_core.systems.components import components

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from rich.console import Console, ConsoleOptions, RenderableType, RenderResult

    from swarmabs_analysis.comparison.bags import BagSummary, Comparison, SettingDifference
    from swarmabs_analysis.comparison.messages import Deviation, TopicComparison
    from swarmabs_core.systems import SystemTables

_MOST_ROWS = 40
_UNLIMITED = 1000


class ResponsiveTable(Table):
    """A table that becomes one line of text per row where it does not fit.

    Right-justified columns hold the numbers of a row; the others name it.
    """

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the table, or a line per row."""
        needed = Measurement.get(console, options.update(max_width=_UNLIMITED), self).maximum
        if needed <= options.max_width:
            yield from super().__rich_console__(console, options)
            return
        names = [column for column in self.columns if column.justify != "right"]
        numbers = [column for column in self.columns if column.justify == "right"]
        rows = list(zip(*(column.cells for column in (*names, *numbers)), strict=True))
        for row in rows:
            values = zip(numbers, row[len(names) :], strict=True)
            told = ", ".join(f"{column.header} {value}" for column, value in values if value)
            yield Text(" ".join(map(str, row[: len(names)])) + (f": {told}" if told else ""), overflow="fold")


def render(comparison: Comparison) -> RenderableType:
    """Return the comparison as tables: both bags, verdict, deviations, then the differences other than messages.

    Print it without cropping, so that a terminal that is too narrow for a digest continues it on its next line.
    """
    parts: list[RenderableType] = [_sides(comparison), _digests(comparison), _verdict(comparison)]
    if not comparison.messages.equal:
        parts += [_topics(comparison.messages.topics), _fields(comparison.messages.topics, comparison.system)]
    for name, differences in (("scenario", comparison.scenario), ("provenance", comparison.provenance)):
        if differences:
            parts.append(_settings(name, differences))
    return Group(*parts)


def _verdict(comparison: Comparison) -> str:
    first = comparison.messages.first
    if first is not None:
        return f"[bold]different[/]: first {_shown(first.side_by_side())}"
    return "[bold]equal[/] as far as they can be read" if comparison.damaged else "[bold]equal[/], bit for bit"


def _sides(comparison: Comparison) -> Table:
    table = Table(box=box.SIMPLE, pad_edge=False)
    table.add_column("", style="bold")
    table.add_column("A", overflow="fold")
    table.add_column("B", overflow="fold")
    for name, a, b in _facts(comparison):
        if a or b:
            table.add_row(name, _shown(a), _shown(b))
    return table


def _digests(comparison: Comparison) -> Text:
    """Return both digests, a line each: beside each other they would be torn, and could not be copied."""
    sides = {"A": comparison.a, "B": comparison.b}
    lines = [f"digest {name}  {side.digest or '-'}\n" for name, side in sides.items()]
    return Text("".join(lines), no_wrap=True, overflow="ignore")


def _facts(comparison: Comparison) -> Iterator[tuple[str, str, str]]:
    a, b = comparison.a, comparison.b
    yield "file", a.file, b.file
    yield "damaged", a.problem or "", b.problem or ""
    yield "ended early", a.aborted or "", b.aborted or ""
    yield "no scenario", a.scenario_problem or "", b.scenario_problem or ""
    yield "steps", _steps(a), _steps(b)
    yield "period, s", _number(a.period), _number(b.period)
    yield "robots", str(a.robots), str(b.robots)
    yield "robots only in this bag", _ids(comparison.robots_only_in_a), _ids(comparison.robots_only_in_b)
    for key, figure in Tracking.of(comparison.system or PLANE_TABLES).figures.items():
        name = figure.label if comparison.system else figure.name  # different systems have different units
        yield name, _number(a.figures[key]), _number(b.figures[key])
    yield "not compared", ", ".join(a.not_compared), ", ".join(b.not_compared)


def _topics(topics: Sequence[TopicComparison]) -> ResponsiveTable:
    table = ResponsiveTable(box=box.SIMPLE, pad_edge=False)
    table.add_column("topic", no_wrap=True)
    for heading in ("in both", "differ", "not in A", "not in B"):
        table.add_column(heading, justify="right")
    for topic in topics:
        counts = (topic.compared, topic.differing, topic.missing_in_a, topic.missing_in_b)
        table.add_row(topic.topic, *(f"{count:,}" for count in counts))
    return table


def _fields(topics: Sequence[TopicComparison], system: SystemTables | None) -> ResponsiveTable | str:
    """Return a table by topic and field that fits 80 characters unless a deviation is not finite."""
    rows = [
        {"topic": topic.topic, **asdict(field), "field": _named(topic.topic, field.field, system)}
        for topic in topics
        for field in topic.fields
    ]
    columns = {"differing": "differ", "largest": "largest", "step": "at step", "agent": "agent", "rms": "rms"}
    if any(row["undefined"] for row in rows):
        columns["undefined"] = "not finite"
    return _deviations(rows, columns) if rows else ""


def _named(topic: str, field: str, system: SystemTables | None) -> str:
    """Return a field with the name and unit of its quantity, if it is known."""
    vector, index = component_of(field)
    if system is None or index < 0:
        return field
    message = next(one.message for one in TOPICS if one.name == topic)
    named = components(system, message).get(vector, ())
    return _shown(f"{field} {named[index].name}, {named[index].unit}") if index < len(named) else field


def deviation_table(rows: Iterable[Mapping[str, Deviation]]) -> ResponsiveTable:
    """Return a table of the deviations of the nodes under test from a recording; see `_deviations`."""
    columns = {"differing": "differ", "largest": "largest", "step": "at step", "agent": "robot"}
    return _deviations(rows, columns)


def _deviations(rows: Iterable[Mapping[str, Deviation]], columns: Mapping[str, str]) -> ResponsiveTable:
    """Return the deviations of fields, grouped by topic.

    Parameters
    ----------
    rows : iterable of mapping
        `FieldDeviation` of each field as data, with its ``topic``; the fields of a topic must be adjacent.
    columns : mapping
        Headings by name of the datum.
    """
    table = ResponsiveTable(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("field", no_wrap=True)
    for heading in columns.values():
        table.add_column(heading, justify="right")
    topic = None
    for row in rows:
        if row["topic"] != topic:
            topic = row["topic"]
            table.add_row(str(topic))
        table.add_row(f"  {row['field']}", *(_cell(name, row[name]) for name in columns))
    return table


def _cell(name: str, value: Deviation) -> str:
    if name in {"step", "agent"}:  # no robot is number 0
        return "-" if value is None or (name == "agent" and not value) else str(value)
    return _number(value)


def _settings(name: str, differences: Sequence[SettingDifference]) -> Table:
    table = Table(box=box.SIMPLE, pad_edge=False)
    for heading in (name, "A", "B"):
        table.add_column(heading, overflow="fold")
    for one in differences[:_MOST_ROWS]:
        table.add_row(_shown(one.field), _value(one.a, one.missing == "A"), _value(one.b, one.missing == "B"))
    if len(differences) > _MOST_ROWS:
        table.add_row(f"and {len(differences) - _MOST_ROWS} more, with --json", "", "")
    return table


def _steps(side: BagSummary) -> str:
    return "-" if side.first_step is None else f"{side.first_step} to {side.last_step}"


def _ids(robots: Sequence[int]) -> str:
    return ", ".join(map(str, robots[:10])) + (f" and {len(robots) - 10} more" if len(robots) > 10 else "")


def _number(value: Deviation) -> str:
    return "-" if value is None else f"{value:.6g}" if isinstance(value, float) else f"{value:,}"


def _value(value: object, missing: bool) -> str:  # noqa: FBT001 - private, called with names in sight
    return "not there" if missing else _shown(json.dumps(value))


def _shown(text: str) -> str:
    """Return text from a file, safe for the terminal."""
    return escape(printable(shorten(text, 200)))

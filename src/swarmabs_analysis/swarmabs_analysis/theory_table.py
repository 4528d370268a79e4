"""A check of the theory as tables for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Group
from rich.table import Table
from rich.text import Text

from swarmabs_core.theory.report import Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import RenderableType

    from swarmabs_core.theory.report import Condition, Document, Form, Report, Theorem

_STYLES = {Verdict.HOLDS: "green", Verdict.FAILS: "bold red", Verdict.NOT_APPLICABLE: "dim"}


def render(report: Report) -> Group:
    """Return the report as tables: the theorem that applies first, then sets, sampled time and what does not apply."""
    parts: list[RenderableType] = [
        Text(f"{report.scenario}: {report.controller} with {report.swarm}, theta_max = {report.angle_max:g} rad"),
        Text(),
    ]
    theorems = (*report.theorems, report.beyond)
    for theorem in theorems:
        if theorem.applicable:
            parts += [*_theorem(theorem), Text()]
    parts += [_pairs("region of attraction", report.attraction), Text()]
    parts += [_pairs("abstract states", report.abstract_states), Text()]
    parts += [
        Text(f"{theorem.label}: not applicable, {theorem.note}", style="dim")
        for theorem in theorems
        if not theorem.applicable
    ]
    parts += [Text(f"note: {note}") for note in report.notes]
    parts += [_conclusion(report)]
    return Group(*parts)


def _theorem(theorem: Theorem) -> list[RenderableType]:
    title = Text(f"{theorem.label}, {theorem.title}: ", style="bold")
    title.append(theorem.verdict.value, _STYLES[theorem.verdict])
    if theorem.printed_verdict is not Verdict.NOT_APPLICABLE:
        title.append(f" (as printed: {theorem.printed_verdict.value})", "not bold")
    table = Table(box=None, pad_edge=False, show_edge=False, header_style="dim")
    table.add_column("condition", overflow="fold")
    table.add_column("", style="dim")
    table.add_column("form", overflow="fold", ratio=1)
    for name in ("value", "bound", "margin"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    for condition in theorem.conditions:
        _add(table, condition)
    notes = [Text(f"  {theorem.note}", style="dim")] if theorem.note else []
    return [title, *notes, table]


def _add(table: Table, condition: Condition) -> None:
    name = condition.name
    if condition.printed is not None:
        table.add_row(name, "printed", *_cells(condition.printed))
        name = ""
    table.add_row(name, "corrected", *_cells(condition.corrected))
    if condition.inputs:
        inputs = ", ".join(f"{key} = {_shown(value)}" for key, value in condition.inputs.items())
        table.add_row("", "from", Text(inputs, style="dim"))
    if condition.note:
        failed = condition.verdict is Verdict.FAILS
        table.add_row("", "", Text(condition.note, style="yellow" if failed else "dim"))


def _cells(form: Form) -> tuple[Text, str, str, str, Text]:
    return (
        Text(form.text),
        f"{form.value:.4g}",
        f"{form.bound:.4g}",
        f"{form.margin:.4g}",
        Text(form.verdict.value, style=_STYLES[form.verdict]),
    )


def _pairs(title: str, values: Mapping[str, Document]) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, show_header=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for key, value in values.items():
        table.add_row(key.replace("_", " "), Text(_shown(value)))
    return table


def _shown(value: object) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return ", ".join(f"{key.replace('_', ' ')} {_shown(one)}" for key, one in value.items())
    if isinstance(value, tuple):
        return f"({', '.join(_shown(one) for one in value)})"
    return str(value)


def _conclusion(report: Report) -> Text:
    if report.covered:
        return Text("the theory, as corrected, covers this scenario", style="green")
    failed = ", ".join(f"{theorem.label}: {condition.name}" for theorem, condition in report.failed)
    reason = f"these conditions fail: {failed}" if failed else "no theorem is about this parent controller"
    return Text(f"the theory does not cover this scenario; {reason}", style="bold red")

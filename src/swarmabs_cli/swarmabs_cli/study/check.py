"""``swarm check``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import click
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from swarmabs_bag.attached import scenario_of
from swarmabs_cli.options import duration_option, examples, json_option, scenario_argument, set_option
from swarmabs_cli.output import print_json, print_warnings
from swarmabs_config.theory import check_scenario
from swarmabs_core.theory.report import Condition, Form, Report, Theorem, Verdict

_STYLES = {Verdict.HOLDS: "green", Verdict.FAILS: "bold red", Verdict.NOT_APPLICABLE: "dim"}


@click.command(epilog=examples("check pd_het_4", "check arise_het_4 --all"))
@scenario_argument
@set_option()
@duration_option
@click.option(
    "--angle-max",
    type=click.FloatRange(0.0, math.pi / 2, min_open=True, max_open=True),
    default=0.2,
    show_default=True,
    metavar="RAD",
    help="Bound theta_max on the angle in the state-feedback theorems.",
)
@click.option("--all", "everything", is_flag=True, help="Print every condition with its margin, not just failures.")
@click.option("--strict", is_flag=True, help="Exit with 1 if an applicable corrected condition fails.")
@json_option
def check(
    scenario: str,
    overrides: tuple[str, ...],
    duration: str | None,
    angle_max: float,
    *,
    everything: bool,
    strict: bool,
    as_json: bool,
) -> int:
    """Check a scenario against the paper's stability theorems.

    Nothing is run. The verdict comes first, then the conditions that fail; --all prints every condition, as printed in
    the paper and as corrected, with its margin. SCENARIO is a built-in scenario (see `scenario list`), a YAML file, or
    a bag.
    """
    if duration is not None:
        overrides = (*overrides, f"duration={duration}")
    loaded = scenario_of(scenario, overrides)
    print_warnings(loaded.warnings())
    report = check_scenario(loaded, angle_max)
    if as_json:
        print_json(report.document())
    else:
        console = Console(highlight=False)
        if not console.is_terminal:
            console.width = 120
        console.print(render(report, everything=everything))
    return 1 if strict and report.failed else 0


def render(report: Report, *, everything: bool) -> Group:
    """Return the verdict, a line for each theorem, and the conditions that fail; with `everything`, all conditions."""
    bound = "" if report.angle_max is None else f", theta_max = {report.angle_max:g} rad"
    parts: list[RenderableType] = [
        Text(f"{report.scenario}: {report.controller} with {report.swarm}{bound}"),
        _conclusion(report),
        Text(),
    ]
    theorems = (*report.theorems, report.beyond)
    for theorem in theorems:
        if theorem.applicable:
            shown = theorem.conditions if everything else theorem.failed
            parts += [_title(theorem), *(_conditions(theorem, shown) if shown else ())]
            parts += [Text()] if shown else []
    if everything:
        parts += [_pairs("region of attraction", report.attraction), Text()] if report.attraction else []
        parts += [_pairs("abstract states", report.abstract_states), Text()] if report.abstract_states else []
        parts += [
            Text(f"{theorem.label}: not applicable, {theorem.note}", style="dim")
            for theorem in theorems
            if not theorem.applicable
        ]
    parts += [Text(f"note: {note}") for note in report.notes]
    if not everything:
        parts += [Text("--all shows every condition with its value, bound and margin", style="dim")]
    return Group(*parts)


def _title(theorem: Theorem) -> Text:
    title = Text(f"{theorem.label}, {theorem.title}: ", style="bold")
    title.append(theorem.verdict.value, _STYLES[theorem.verdict])
    if theorem.printed_verdict is not Verdict.NOT_APPLICABLE:
        title.append(f" (as printed: {theorem.printed_verdict.value})", "not bold")
    return title


def _conditions(theorem: Theorem, conditions: Sequence[Condition]) -> list[RenderableType]:
    table = Table(box=None, pad_edge=False, show_edge=False, header_style="dim")
    table.add_column("condition", overflow="fold")
    table.add_column("", style="dim")
    table.add_column("form", overflow="fold", ratio=1)
    for name in ("value", "bound", "margin"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    for condition in conditions:
        _add(table, condition)
    notes = [Text(f"  {theorem.note}", style="dim")] if theorem.note else []
    return [*notes, table]


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


def _pairs(title: str, values: Mapping[str, object]) -> Table:
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
        return Text("covered: the corrected theorems hold for this scenario", style="green")
    failed = ", ".join(f"{theorem.label}: {condition.name}" for theorem, condition in report.failed)
    reason = f"these conditions fail: {failed}" if failed else "no theorem applies to this parent controller"
    return Text(f"not covered: {reason}", style="bold red")

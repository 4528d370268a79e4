"""``swarm check``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import click
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from swarmabs_analysis.losses.check import check_losses
from swarmabs_bag.attached import scenario_of
from swarmabs_cli.options import Number, duration_option, examples, json_option, scenario_argument, set_option
from swarmabs_cli.output import print_json, print_warnings
from swarmabs_config.scenario import warnings_of
from swarmabs_config.theory import check_scenario
from swarmabs_core.theory.report import Condition, Coverage, Form, Loss, Report, Theorem, Verdict

MOST_LOSSES = 10
"""Most losses in the printed table."""
_STYLES = {
    Verdict.HOLDS: "green",
    Verdict.FAILS: "bold red",
    Verdict.UNKNOWN: "bold yellow",
    Verdict.NOT_APPLICABLE: "dim",
}


@click.command(epilog=examples("check", "check arise_het_4 --all"))
@scenario_argument
@set_option()
@duration_option
@click.option(
    "--angle-max",
    type=Number(0.0, math.pi / 2, min_open=True, max_open=True),
    default=0.2,
    show_default=True,
    metavar="RAD",
    help="Bound theta_max on the angle in the state-feedback theorems.",
)
@click.option("--all", "everything", is_flag=True, help="Print every condition with its margin, not just failures.")
@click.option("--any-loss", is_flag=True, help="Also kill each robot and each pair of robots, in simulations.")
@click.option("--strict", is_flag=True, help="Exit with 1 unless the scenario is covered.")
@json_option
def check(
    scenario: str,
    overrides: tuple[str, ...],
    duration: str | None,
    angle_max: float,
    *,
    everything: bool,
    any_loss: bool,
    strict: bool,
    as_json: bool,
) -> int:
    """Check a scenario against the paper's stability theorems, and simulate its losses of robots.

    Nothing is recorded. The verdict comes first, then the conditions that fail; --all prints every condition, as
    printed in the paper and as corrected, with its margin. SCENARIO is a built-in scenario (see `scenario list`), by
    default pd_het_4, a YAML file, or a bag.
    """
    if duration is not None:
        overrides = (*overrides, f"duration={duration}")
    loaded = scenario_of(scenario, overrides)
    print_warnings(warnings_of(loaded))
    report = check_losses(loaded, check_scenario(loaded, angle_max), any_loss=any_loss)
    if as_json:
        print_json(report.document())
    else:
        console = Console(highlight=False)
        if not console.is_terminal:
            console.width = 120
        console.print(render(report, everything=everything))
    return 1 if strict and not report.covered else 0


def render(report: Report, *, everything: bool) -> Group:
    """Return the verdict, a line for each theorem, and the conditions that fail; with `everything`, all conditions."""
    bound = "" if report.angle_max is None else f", theta_max = {report.angle_max:g} rad"
    parts: list[RenderableType] = [
        Text(f"{report.scenario}: {report.controller} with {report.swarm}{bound}"),
        _conclusion(report),
        Text(),
    ]
    for theorem in report.groups:
        if theorem.applicable:
            shown = theorem.conditions if everything else (*theorem.failed, *theorem.of(Verdict.UNKNOWN))
            parts += [_title(theorem), *(_conditions(theorem, shown) if shown else ())]
            parts += [Text()] if shown else []
    if everything:
        parts += [_pairs("region of attraction", report.attraction), Text()] if report.attraction else []
        parts += [_pairs("abstract states", report.abstract_states), Text()] if report.abstract_states else []
        parts += [
            Text(f"{theorem.label}: not applicable, {theorem.note}", style="dim")
            for theorem in report.groups
            if not theorem.applicable
        ]
    parts += [_losses(report.losses), Text()] if report.losses else []
    parts += [Text(f"note: {note}") for note in report.notes]
    if not everything:
        parts += [Text("--all shows every condition with its value, bound and margin", style="dim")]
    return Group(*parts)


def _losses(losses: Sequence[Loss]) -> Table:
    table = Table(title=f"losses of robots, the worst of {len(losses)}", title_justify="left", title_style="bold")
    table.box, table.pad_edge, table.show_edge, table.header_style = None, False, False, "dim"
    table.add_column("loss", overflow="fold")
    for name in ("at, s", "speed", "reach", "deviation", "least pivot", "limited"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("fails", overflow="fold", style=_STYLES[Verdict.FAILS])
    for loss in losses[:MOST_LOSSES]:
        numbers = (loss.time, loss.speed, loss.reach, loss.deviation, loss.pivot, loss.limited)
        robots = ", ".join(map(str, loss.robots))
        table.add_row(f"{loss.change} {robots}", *(f"{x:.4g}" for x in numbers), ", ".join(loss.failed))
    return table


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
        holds = condition.verdict is Verdict.HOLDS
        table.add_row("", "", Text(condition.note, style="dim" if holds else "yellow"))


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
        simulated = " and the simulated conditions" if report.simulated else ""
        return Text(f"covered: the corrected theorems{simulated} hold for this scenario", style="green")
    if report.verdict is Coverage.UNKNOWN:
        reasons = (f"{theorem.label}: {condition.name}: {condition.note}" for theorem, condition in report.unknown)
        return Text(f"could not be evaluated: {', '.join(reasons)}", style="bold yellow")
    failed = ", ".join(f"{theorem.label}: {condition.name}" for theorem, condition in report.failed)
    reason = f"these conditions fail: {failed}" if failed else "no theorem applies to this parent controller"
    return Text(f"not covered: {reason}", style="bold red")

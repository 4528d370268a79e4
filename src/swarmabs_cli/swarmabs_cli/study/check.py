"""``swarm check``."""

from __future__ import annotations

import math

import click
from rich.console import Console

from swarmabs_analysis.theory_table import render
from swarmabs_bag.attached import scenario_of
from swarmabs_cli.options import duration_option, json_option, scenario_argument, set_option
from swarmabs_cli.output import print_json, print_warnings
from swarmabs_config.theory import check_scenario


@click.command()
@scenario_argument
@set_option()
@duration_option
@click.option(
    "--angle-max",
    type=click.FloatRange(0.0, math.pi / 2, min_open=True, max_open=True),
    default=0.2,
    show_default=True,
    metavar="RAD",
    help="Bound theta_max of the angle in the theorems of state feedback.",
)
@click.option("--strict", is_flag=True, help="Exit with 1 if an applicable corrected condition fails.")
@json_option
def check(
    scenario: str, overrides: tuple[str, ...], duration: str | None, angle_max: float, *, strict: bool, as_json: bool
) -> int:
    """Say whether the paper's theorems cover a scenario: each condition as printed and as corrected, with its margin.

    Nothing is run. SCENARIO is a built-in scenario (`swarm scenario list`), a YAML file, or a bag.
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
        console.print(render(report))
    return 1 if strict and report.failed else 0

"""``swarm check``."""

from __future__ import annotations

import math

import click

from swarmabs_cli.output import json_option, print_json


@click.command()
@click.argument("scenario", default="pd_het_4", metavar="[SCENARIO|FILE.yaml|BAG]")
@click.option(
    "--set", "overrides", multiple=True, metavar="A.B=VALUE", help="Change a value of the scenario; repeatable."
)
@click.option("--duration", metavar="SECONDS", help="Simulated time; the same as --set duration=SECONDS.")
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
    from rich.console import Console  # noqa: PLC0415 - slow, not for --help

    from swarmabs_analysis.theory_table import render  # noqa: PLC0415
    from swarmabs_config.scenarios import find_scenario  # noqa: PLC0415
    from swarmabs_config.theory import check_scenario  # noqa: PLC0415

    if duration is not None:
        overrides = (*overrides, f"duration={duration}")
    loaded = find_scenario(scenario, overrides)
    for warning in loaded.warnings():
        click.echo(f"warning: {warning}", err=True)
    report = check_scenario(loaded, angle_max)
    if as_json:
        print_json(report.document())
    else:
        console = Console(highlight=False)
        if not console.is_terminal:
            console.width = 120
        console.print(render(report))
    return 1 if strict and report.failed else 0

"""``swarm scenario``."""

from __future__ import annotations

import click
from rich.table import Table

from swarmabs_bag.attached import scenario_of
from swarmabs_cli.options import examples, json_option, set_option
from swarmabs_cli.output import print_json, print_tables, print_warnings
from swarmabs_config.scenario import dump_scenario, json_schema, warnings_of
from swarmabs_config.scenarios import builtin_scenarios, described, load_builtin


@click.group(
    epilog=examples("scenario list", "scenario show pd_het_4 > mine.yaml", "scenario schema > scenario.schema.json")
)
def scenario() -> None:
    """List and show scenarios, and print their JSON Schema."""


@scenario.command("list")
@json_option
def list_scenarios(*, as_json: bool) -> None:
    """List the built-in scenarios with their figures in the paper."""
    rows = []
    for name, path in builtin_scenarios().items():
        loaded = load_builtin(name)
        kinds = [agent.kind for agent in loaded.agents]
        description, figure = described(path)
        rows.append(
            {
                "name": name,
                "description": description,
                "figure": figure,
                "controller": loaded.controller.type,
                "single_integrators": kinds.count("single_integrator"),
                "double_integrators": kinds.count("double_integrator"),
                "duration": loaded.duration,
                "step": loaded.step,
                "file": str(path),
            }
        )
    if as_json:
        print_json(rows)
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("scenario", "time", "figure", "description"):
        table.add_column(heading, no_wrap=heading != "description")
    for row in rows:
        table.add_row(str(row["name"]), f"{row['duration']:g} s", str(row["figure"]), str(row["description"]))
    print_tables(table)


@scenario.command("show")
@click.argument("name", metavar="SCENARIO|FILE.yaml|BAG")
@set_option("Change a value; repeatable.")
@json_option
def show(name: str, overrides: tuple[str, ...], *, as_json: bool) -> None:
    """Print a scenario with every default filled in."""
    loaded = scenario_of(name, overrides).resolved()
    print_warnings(warnings_of(loaded))
    if as_json:
        print_json(loaded.model_dump(mode="json", by_alias=True))
    else:
        click.echo(dump_scenario(loaded), nl=False)


@scenario.command("schema")
def schema() -> None:
    """Print the JSON Schema of scenario files."""
    print_json(json_schema())

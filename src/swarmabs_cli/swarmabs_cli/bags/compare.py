"""``swarm compare``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_analysis.comparison.bags import compare_bags
from swarmabs_analysis.comparison.table import render
from swarmabs_cli.options import json_option
from swarmabs_cli.output import print_json, print_tables


@click.command()
@click.argument("a", type=click.Path(path_type=Path), metavar="BAG")
@click.argument("b", type=click.Path(path_type=Path), metavar="BAG")
@click.option(
    "--namespace",
    "namespaces",
    multiple=True,
    metavar="NAME",
    help="Which swarm to read, if there are several in it; given twice, that of the first bag and of the second.",
)
@json_option
def compare(a: Path, b: Path, *, namespaces: tuple[str, ...], as_json: bool) -> int:
    """Compare two bags message by message: first difference, deviations by topic and field, figures side by side.

    A BAG is a run's folder, its bag folder, or an .mcap file. Exit code 1 if they differ or one is damaged.
    """
    if len(namespaces) > 2:
        raise click.UsageError("--namespace may be given once or twice: there are two bags.")

    of_a, of_b = (namespaces[0], namespaces[-1]) if namespaces else (None, None)
    comparison = compare_bags(a, b, namespaces=(of_a, of_b))
    if as_json:
        print_json(comparison.to_dict())
    else:
        print_tables(render(comparison))
    return 0 if comparison.equal else 1

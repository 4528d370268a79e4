"""``swarm compare``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_analysis.comparison.bags import compare_bags
from swarmabs_analysis.comparison.table import render
from swarmabs_cli.options import examples, json_option
from swarmabs_cli.output import print_json, print_tables


@click.command(epilog=examples("compare runs/pd_het_4-001 runs/pd_het_4-002"))
@click.argument("a", type=click.Path(path_type=Path), metavar="BAG")
@click.argument("b", type=click.Path(path_type=Path), metavar="BAG")
@click.option(
    "--namespace",
    "namespaces",
    multiple=True,
    metavar="NAME",
    help="Swarm to read if the bags hold several; give it twice for a different one in each bag.",
)
@json_option
def compare(a: Path, b: Path, *, namespaces: tuple[str, ...], as_json: bool) -> int:
    """Compare two bags message by message.

    The result names the first difference, the largest deviation of each field, and the figures of both runs. A BAG is
    the folder of a run, its bag folder, or an .mcap file. The exit code is 1 if the bags differ or one is damaged.
    """
    if len(namespaces) > 2:
        raise click.UsageError(f"--namespace is given {len(namespaces)} times; give it once, or once for each bag.")

    of_a, of_b = (namespaces[0], namespaces[-1]) if namespaces else (None, None)
    comparison = compare_bags(a, b, namespaces=(of_a, of_b))
    if as_json:
        print_json(comparison.to_dict())
    else:
        print_tables(render(comparison))
    return 0 if comparison.equal else 1

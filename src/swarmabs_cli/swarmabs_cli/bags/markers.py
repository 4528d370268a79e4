"""``swarm markers``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.options import Number, bag_argument, examples, json_option, namespace_option, output_option
from swarmabs_cli.output import print_files
from swarmabs_view.visualization.bag import write_markers


@click.command(epilog=examples("markers runs/pd_het_4-001 -o with_markers"))
@bag_argument
@output_option("New folder for the bag.", required=True)
@click.option(
    "--rate",
    type=Number(0.1, 1000.0),
    default=30.0,
    show_default=True,
    metavar="HZ",
    help="Maximum frames per second of recorded time.",
)
@namespace_option
@json_option
def markers(bag: Path, output: Path, *, rate: float, namespace: str | None, as_json: bool) -> None:
    """Write a copy of a bag with markers for RViz and Foxglove.

    The copy also holds the joint state and the URDF of the plane.
    """
    print_files((write_markers(bag, output, rate=rate, namespace=namespace),), as_json=as_json)

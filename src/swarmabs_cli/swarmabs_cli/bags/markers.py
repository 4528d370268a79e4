"""``swarm markers``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.options import bag_argument, namespace_option, output_option
from swarmabs_view.visualization.bag import write_markers


@click.command()
@bag_argument
@output_option("New folder for the bag.", required=True)
@click.option(
    "--rate",
    type=click.FloatRange(0.1, 1000.0),
    default=30.0,
    show_default=True,
    metavar="HZ",
    help="Most frames per second of recorded time.",
)
@namespace_option
def markers(bag: Path, output: Path, rate: float, namespace: str | None) -> None:
    """Write a bag once more, with markers, joint state and URDF, for Foxglove and RViz."""
    click.echo(write_markers(bag, output, rate=rate, namespace=namespace))

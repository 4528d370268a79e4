"""``swarm export``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from swarmabs_analysis.export import TableFormat, export_arrays, export_tables
from swarmabs_cli.options import bag_argument, namespace_option, output_option

FORMATS = ("csv", "parquet", "numpy")


@click.command()
@bag_argument
@output_option("New folder for csv and parquet, new .npz file for numpy.", required=True)
@click.option(
    "--format", "file_format", type=click.Choice(FORMATS), default="csv", show_default=True, help="Kind of files."
)
@namespace_option
def export(bag: Path, output: Path, file_format: Literal["numpy"] | TableFormat, namespace: str | None) -> int:
    """Write a bag as tables or arrays for notebooks.

    csv, parquet: a table per topic, a row per message. numpy: the arrays of a run, by step and robot.
    """
    files = (
        (export_arrays(bag, output, namespace=namespace),)
        if file_format == "numpy"
        else export_tables(bag, output, file_format, namespace=namespace)
    )
    for file in files:
        click.echo(file)
    return 0

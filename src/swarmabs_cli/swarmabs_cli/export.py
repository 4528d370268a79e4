"""``swarm export``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from swarmabs_cli.namespace import namespace_option

if TYPE_CHECKING:
    from swarmabs_analysis.export import TableFormat

FORMATS = ("csv", "parquet", "numpy")


@click.command()
@click.argument("bag", type=click.Path(path_type=Path), metavar="BAG")
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    help="New folder for csv and parquet, new .npz file for numpy.",
)
@click.option(
    "--format", "file_format", type=click.Choice(FORMATS), default="csv", show_default=True, help="Kind of files."
)
@namespace_option
def export(bag: Path, output: Path, file_format: Literal["numpy"] | TableFormat, namespace: str | None) -> int:
    """Write a bag as tables or arrays for notebooks.

    csv, parquet: a table per topic, a row per message. numpy: the arrays of a run, by step and robot.
    """
    from swarmabs_analysis.export import export_arrays, export_tables  # noqa: PLC0415 - slow, not for --help

    files = (
        (export_arrays(bag, output, namespace=namespace),)
        if file_format == "numpy"
        else export_tables(bag, output, file_format, namespace=namespace)
    )
    for file in files:
        click.echo(file)
    return 0

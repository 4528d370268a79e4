"""``swarm export``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from swarmabs_analysis.export import TableFormat, export_arrays, export_tables
from swarmabs_cli.options import bag_argument, examples, json_option, namespace_option, output_option
from swarmabs_cli.output import print_files

FORMATS = ("csv", "parquet", "numpy")


@click.command(
    epilog=examples("export runs/pd_het_4-001 -o tables", "export runs/pd_het_4-001 --format numpy -o run.npz")
)
@bag_argument
@output_option("New folder (csv, parquet) or new .npz file (numpy).", required=True)
@click.option(
    "--format", "file_format", type=click.Choice(FORMATS), default="csv", show_default=True, help="File format."
)
@namespace_option
@json_option
def export(
    bag: Path, output: Path, *, file_format: Literal["numpy"] | TableFormat, namespace: str | None, as_json: bool
) -> int:
    """Export a bag to CSV, Parquet or NumPy.

    csv and parquet hold one table per topic with one row per message; numpy holds the arrays of a run by step and
    robot.
    """
    files = (
        (export_arrays(bag, output, namespace=namespace),)
        if file_format == "numpy"
        else export_tables(bag, output, file_format, namespace=namespace)
    )
    print_files(files, as_json=as_json)
    return 0

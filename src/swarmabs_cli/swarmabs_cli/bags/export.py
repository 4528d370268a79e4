"""``swarm export``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_analysis.export import SUFFIXES, ArrayFormat, TableFormat, export_arrays, export_tables
from swarmabs_cli.options import bag_argument, examples, json_option, namespace_option, output_option
from swarmabs_cli.output import print_files

FORMATS = ("csv", "parquet", *SUFFIXES)


@click.command(epilog=examples("export runs/pd_het_4-001 -o tables", "export runs/pd_het_4-001 -o run.mat"))
@bag_argument
@output_option("New folder (csv, parquet), new .npz file (numpy) or new .mat file (mat).", required=True)
@click.option(
    "--format",
    "file_format",
    type=click.Choice(FORMATS),
    help="File format.  [default: that of the ending .npz or .mat of -o, otherwise csv]",
)
@namespace_option
@json_option
def export(
    bag: Path, output: Path, *, file_format: ArrayFormat | TableFormat | None, namespace: str | None, as_json: bool
) -> int:
    """Export a bag to CSV, Parquet, NumPy or MATLAB.

    csv and parquet hold one table per topic with one row per message; numpy and mat hold the arrays of a run by step
    and robot.
    """
    arrays: dict[str, ArrayFormat] = {suffix: name for name, suffix in SUFFIXES.items()}
    if file_format is None:
        file_format = arrays.get(output.suffix) or "csv"
    files: tuple[Path, ...]
    match file_format:
        case "csv" | "parquet":
            files = export_tables(bag, output, file_format, namespace=namespace)
        case _:
            files = (export_arrays(bag, output, file_format, namespace=namespace),)
    print_files(files, as_json=as_json)
    return 0

"""``swarm compare``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_bringup.cli.output import json_option, print_json


@click.command()
@click.argument("a", type=click.Path(path_type=Path), metavar="BAG")
@click.argument("b", type=click.Path(path_type=Path), metavar="BAG")
@json_option
def compare(a: Path, b: Path, *, as_json: bool) -> int:
    """Compare two bags message by message: first difference, deviations by topic and field, figures side by side.

    A BAG is a run's folder, its bag folder, or an .mcap file. Exit code 1 if they differ or one is damaged.
    """
    from rich.console import Console  # noqa: PLC0415 - slow, not for --help

    from swarmabs_bringup.comparison import compare_bags  # noqa: PLC0415
    from swarmabs_bringup.comparison.table import render  # noqa: PLC0415

    comparison = compare_bags(a, b)
    if as_json:
        print_json(comparison.to_dict())
    else:
        console = Console(highlight=False)
        if not console.is_terminal:
            console.width = 120
        console.print(render(comparison))
    return 0 if comparison.equal else 1

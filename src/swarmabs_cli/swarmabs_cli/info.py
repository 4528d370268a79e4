"""``swarm info``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.output import json_option, print_json, print_tables


@click.command()
@click.argument("bags", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="BAG...")
@json_option
def info(bags: tuple[Path, ...], *, as_json: bool) -> int:
    """Say what bags hold; a BAG is a run's folder, its bag folder, or an .mcap file."""
    from swarmabs_bag.info import bag_info, render  # noqa: PLC0415 - slow, not for --help

    found = [bag_info(path) for path in bags]
    if as_json:
        documents = [one.to_dict() for one in found]
        print_json(documents[0] if len(documents) == 1 else documents)
    else:
        print_tables(*map(render, found))
    return 0 if all(one.complete for one in found) else 1

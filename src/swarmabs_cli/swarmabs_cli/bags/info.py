"""``swarm info``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_bag.info import bag_info, render
from swarmabs_cli.options import bags_argument, json_option
from swarmabs_cli.output import print_documents, print_tables


@click.command()
@bags_argument
@json_option
def info(bags: tuple[Path, ...], *, as_json: bool) -> int:
    """Say what bags hold; a BAG is a run's folder, its bag folder, or an .mcap file."""
    found = [bag_info(path) for path in bags]
    if as_json:
        documents = [one.to_dict() for one in found]
        print_documents(documents)
    else:
        print_tables(*map(render, found))
    return 0 if all(one.complete for one in found) else 1

"""``swarm info``: the contents of bags."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from swarmabs_bag.info import bag_info, render
from swarmabs_cli.options import bags_argument, examples, json_option
from swarmabs_cli.output import print_documents, print_tables


@click.command(epilog=examples("info runs/pd_het_4-001"))
@bags_argument
@json_option
def info(bags: tuple[Path, ...], *, as_json: bool) -> int:
    """Show what bags contain and whether they are complete.

    A BAG is the folder of a run, its bag folder, or an .mcap file.
    """
    summaries = [bag_info(path) for path in bags]
    if as_json:
        print_documents([asdict(one) for one in summaries])
    else:
        print_tables(*map(render, summaries))
    return 0 if all(one.complete for one in summaries) else 1

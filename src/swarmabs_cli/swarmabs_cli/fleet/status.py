"""``swarm status``."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import click
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from swarmabs_cli.operation import patience_option, swarm_argument
from swarmabs_cli.options import json_option
from swarmabs_cli.output import print_json
from swarmabs_fleet.operate.client import joined
from swarmabs_fleet.operate.health import HealthMonitor, Row, in_order
from swarmabs_fleet.operate.target import target

_STYLES = {"OK": "green", "WARN": "yellow"}


@click.command()
@swarm_argument
@click.option("--watch", is_flag=True, help="Go on until interrupted.")
@patience_option
@json_option
def status(swarm: Path, patience: float, *, watch: bool, as_json: bool) -> int:
    """Show what every node of a fleet, or of a run in real time, says of its health.

    The exit code is 1 if one is silent or in error.
    """
    if watch and as_json:
        raise click.UsageError("--watch and --json exclude each other")
    with target(swarm) as found, joined(found) as client:
        monitor = HealthMonitor(found.hosts)
        if watch:
            with Live(_table(monitor.rows(0.0)), refresh_per_second=2) as live:

                def refresh() -> bool:
                    live.update(_table(monitor.rows(time.monotonic())))
                    return False

                client.listen(monitor, float("inf"), refresh)
        client.listen(monitor, patience, monitor.complete)
        rows = monitor.rows(time.monotonic())
    if as_json:
        nodes = [row._asdict() for row in rows]
        print_json({"swarm": found.name, "in_order": in_order(rows), "nodes": nodes})
    else:
        Console(highlight=False).print(_table(rows))
    return 0 if in_order(rows) else 1


def _table(rows: Sequence[Row]) -> Table:
    table = Table(box=None, pad_edge=False)
    for head in ("node", "host", "health", "says"):
        table.add_column(head, overflow="fold")
    for row in rows:
        level = Text(row.level, style=_STYLES.get(row.level, "red"))
        table.add_row(Text(row.node), Text(row.host), level, Text(row.text))
    return table

"""``swarm status``, ``stop``, ``reset``, ``drain`` and ``join``: for swarms in real time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from swarmabs_cli.output import json_option, print_json

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.table import Table

    from swarmabs_fleet.operate.health import Row

_STYLES = {"OK": "green", "WARN": "yellow"}

_swarm = click.argument("swarm", metavar="FLEET.yaml|RUN", type=click.Path(exists=True, path_type=Path))
_patience = click.option(
    "--timeout",
    "patience",
    type=click.FloatRange(0.1, 600.0),
    default=5.0,
    show_default=True,
    metavar="SECONDS",
    help="Time to find the swarm's nodes, and then for each answer.",
)


@click.command()
@_swarm
@click.option("--watch", is_flag=True, help="Go on until interrupted.")
@_patience
@json_option
def status(swarm: Path, patience: float, *, watch: bool, as_json: bool) -> int:
    """Show what every node of a fleet, or of a run in real time, says of its health.

    The exit code is 1 if one is silent or in error.
    """
    from swarmabs_fleet.operate.client import joined  # noqa: PLC0415
    from swarmabs_fleet.operate.health import HealthMonitor, in_order  # noqa: PLC0415 - slow, not for --help
    from swarmabs_fleet.operate.target import target  # noqa: PLC0415

    if watch and as_json:
        raise click.UsageError("--watch and --json exclude each other")
    with target(swarm) as found, joined(found) as client:
        monitor = HealthMonitor(found.hosts)
        if watch:
            from rich.live import Live  # noqa: PLC0415

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
        from rich.console import Console  # noqa: PLC0415

        Console(highlight=False).print(_table(rows))
    return 0 if in_order(rows) else 1


@click.command()
@_swarm
@_patience
def stop(swarm: Path, patience: float) -> int:
    """Stop all robots of a fleet, or of a run in real time, until `reset`."""
    return _call(swarm, lambda _: "swarm/stop", patience, "all robots are told to stop, until reset")


@click.command()
@_swarm
@_patience
def reset(swarm: Path, patience: float) -> int:
    """Let the robots move again after `stop`, or for the first time in a fleet that begins stopped."""
    return _call(swarm, lambda _: "swarm/reset", patience, "robots stand for a second, then they follow again")


@click.command()
@_swarm
@click.argument("robot", type=int)
@_patience
def drain(swarm: Path, robot: int, patience: float) -> int:
    """Take one robot out, such as for charging; its weight counts as gone from the plane."""
    text = f"robot {robot} has stopped and counts as off the plane"
    return _call(swarm, lambda found: f"{found.robot(robot)}/leave", patience, text)


@click.command()
@_swarm
@click.argument("robot", type=int)
@_patience
def join(swarm: Path, robot: int, patience: float) -> int:
    """Let a robot take part again after `drain`."""
    text = f"robot {robot} takes part again"
    return _call(swarm, lambda found: f"{found.robot(robot)}/join", patience, text)


@click.command()
@_swarm
@click.argument("robot", type=int)
@_patience
def remove(swarm: Path, robot: int, patience: float) -> int:
    """Say of a silent robot that it was carried off the plane, since it cannot say so itself."""
    from swarmabs_config.graph import OBSERVER  # noqa: PLC0415
    from swarmabs_core.errors import RunError  # noqa: PLC0415
    from swarmabs_core.realtime.observer import CARRIED_AWAY  # noqa: PLC0415
    from swarmabs_fleet.operate.client import joined  # noqa: PLC0415
    from swarmabs_fleet.operate.health import HealthMonitor  # noqa: PLC0415 - slow, not for --help
    from swarmabs_fleet.operate.target import target  # noqa: PLC0415

    with target(swarm) as found:
        found.robot(robot)
        monitor = HealthMonitor({OBSERVER: found.hosts.get(OBSERVER, "unknown")})

        def gone() -> bool:
            return str(robot) in monitor.value(OBSERVER, "left").split()

        with joined(found) as client, client.announced(robot, CARRIED_AWAY, patience):
            client.listen(monitor, patience, gone)
    if not gone():
        raise RunError(
            f"{found.name}: the observer has not taken robot {robot} off the plane; it does so only with one that is "
            "silent, another can leave by itself: drain"
        )
    click.echo(f"{found.name}: robot {robot} counts as off the plane")
    return 0


def _call(swarm: Path, service: Callable[[Any], str], patience: float, done: str) -> int:
    from swarmabs_fleet.operate.client import joined  # noqa: PLC0415 - slow, not for --help
    from swarmabs_fleet.operate.target import target  # noqa: PLC0415

    with target(swarm) as found:
        name = service(found)
        with joined(found) as client:
            client.call(name, patience)
    click.echo(f"{found.name}: {done}")
    return 0


def _table(rows: Sequence[Row]) -> Table:
    from rich.table import Table  # noqa: PLC0415 - slow to import
    from rich.text import Text  # noqa: PLC0415

    table = Table(box=None, pad_edge=False)
    for head in ("node", "host", "health", "says"):
        table.add_column(head, overflow="fold")
    for row in rows:
        level = Text(row.level, style=_STYLES.get(row.level, "red"))
        table.add_row(Text(row.node), Text(row.host), level, Text(row.text))
    return table

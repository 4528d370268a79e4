"""What the commands share that operate a swarm in real time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from swarmabs_fleet.operate.client import joined
from swarmabs_fleet.operate.target import Target, target

swarm_argument = click.argument("swarm", metavar="FLEET.yaml|RUN", type=click.Path(exists=True, path_type=Path))
robot_argument = click.argument("robot", type=int)
patience_option = click.option(
    "--timeout",
    "patience",
    type=click.FloatRange(0.1, 600.0),
    default=5.0,
    show_default=True,
    metavar="SECONDS",
    help="Time to find the swarm's nodes, and then for each answer.",
)


def call(swarm: Path, service: Callable[[Target], str], patience: float, done: str) -> int:
    """Call a service of a swarm's node, and say what is done then."""
    with target(swarm) as found:
        name = service(found)
        with joined(found) as client:
            client.call(name, patience)
    click.echo(f"{found.name}: {done}")
    return 0

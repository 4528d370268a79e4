"""``swarm remove``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.operation import patience_option, robot_argument, swarm_argument
from swarmabs_config.graph import OBSERVER
from swarmabs_core.errors import RunError
from swarmabs_core.realtime.observer import CARRIED_AWAY
from swarmabs_fleet.operate.client import joined
from swarmabs_fleet.operate.health import HealthMonitor
from swarmabs_fleet.operate.target import target


@click.command()
@swarm_argument
@robot_argument
@patience_option
def remove(swarm: Path, robot: int, patience: float) -> int:
    """Say of a silent robot that it was carried off the plane, since it cannot say so itself."""
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

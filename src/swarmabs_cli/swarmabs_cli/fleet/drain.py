"""``swarm drain``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.operation import call, patience_option, robot_argument, swarm_argument


@click.command()
@swarm_argument
@robot_argument
@patience_option
def drain(swarm: Path, robot: int, patience: float) -> int:
    """Take one robot out, such as for charging; its weight counts as gone from the plane."""
    text = f"robot {robot} has stopped and counts as off the plane"
    return call(swarm, lambda found: f"{found.robot(robot)}/leave", patience, text)

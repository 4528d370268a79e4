"""``swarm join``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.operation import call, patience_option, robot_argument, swarm_argument


@click.command()
@swarm_argument
@robot_argument
@patience_option
def join(swarm: Path, robot: int, patience: float) -> int:
    """Let a robot take part again after `drain`."""
    text = f"robot {robot} takes part again"
    return call(swarm, lambda found: f"{found.robot(robot)}/join", patience, text)

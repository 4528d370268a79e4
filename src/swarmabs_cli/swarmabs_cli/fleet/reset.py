"""``swarm reset``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.operation import call, patience_option, swarm_argument


@click.command()
@swarm_argument
@patience_option
def reset(swarm: Path, patience: float) -> int:
    """Let the robots move again after `stop`, or for the first time in a fleet that begins stopped."""
    return call(swarm, lambda _: "swarm/reset", patience, "robots stand for a second, then they follow again")

"""``swarm stop``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.operation import call, patience_option, swarm_argument


@click.command()
@swarm_argument
@patience_option
def stop(swarm: Path, patience: float) -> int:
    """Stop all robots of a fleet, or of a run in real time, until `reset`."""
    return call(swarm, lambda _: "swarm/stop", patience, "all robots are told to stop, until reset")

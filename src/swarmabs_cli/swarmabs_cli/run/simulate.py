"""``swarm simulate``."""

from __future__ import annotations

from typing import Any

import click

from swarmabs_cli.runs import carry_out, run_options
from swarmabs_run.simulated_run import simulate_run


@click.command()
@run_options
def simulate(**options: Any) -> int:
    """Run a scenario in one process without DDS; it gives the same digest as `run`."""
    return carry_out(simulate_run, realtime=False, **options)

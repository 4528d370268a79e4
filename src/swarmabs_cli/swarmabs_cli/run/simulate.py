"""``swarm simulate``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from swarmabs_cli.options import RunParameters, examples, run_options
from swarmabs_cli.runs import carry_out
from swarmabs_run.simulated_run import simulate_run

if TYPE_CHECKING:
    from typing_extensions import Unpack


@click.command(epilog=examples("simulate", "simulate arise_het_20 --duration 20"))
@run_options
def simulate(**options: Unpack[RunParameters]) -> int:
    """Run a scenario in one process, without DDS.

    The results and the digest are the same as with `run`, several times faster. SCENARIO is a built-in scenario (see
    `scenario list`), by default pd_het_4, a YAML file, or a bag, whose scenario is run again.
    """
    return carry_out(simulate_run, options, realtime=False)

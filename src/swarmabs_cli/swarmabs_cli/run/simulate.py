"""``swarm simulate``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from swarmabs_bag.run_folder import RunFolder
from swarmabs_bag.splitting import Split
from swarmabs_cli.runs import carry_out, run_options
from swarmabs_config.scenario import Scenario
from swarmabs_run.orchestration.progress import Outcome, Progress
from swarmabs_run.simulated_run import simulate_run


@click.command()
@run_options
def simulate(**options: Any) -> int:
    """Run a scenario in one process without DDS; it gives the same digest as `run`."""

    def execute(
        scenario: Scenario,
        folder: RunFolder,
        record: bool,  # noqa: FBT001
        split: Split,
        show: Callable[[Progress], None],
    ) -> Outcome:
        return simulate_run(scenario, folder, record=record, on_progress=show, split=split)

    return carry_out(execute, realtime=False, **options)

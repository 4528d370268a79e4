"""``swarm soak``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmabs_cli.output import json_option, print_json
from swarmabs_core.errors import RunError

if TYPE_CHECKING:
    from swarmabs_analysis.soak.run import Soak

RUNS = Path("runs")
HOURS = 1.0


@click.command()
@click.option("--hours", type=click.FloatRange(0.0, 1e5, min_open=True), help="Simulated hours.  [default: 1]")
@click.option("--runs", type=click.IntRange(1, 10**7), help="Number of runs instead of hours.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of all runs.")
@click.option("--robots", type=click.IntRange(4, 1000), help="Robots in each run.  [default: drawn]")
@click.option("--realtime", is_flag=True, help="A fleet in real time: bad networks, clocks, deaths, stops.")
@click.option("--only", type=click.IntRange(0), metavar="NUMBER", help="Repeat the one run of this number.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder of the report.  [default: runs/soak-NNN]")
@json_option
def soak(
    hours: float | None,
    runs: int | None,
    seed: int,
    robots: int | None,
    only: int | None,
    output: Path | None,
    *,
    realtime: bool,
    as_json: bool,
) -> int:
    """Run random scenarios with random faults for hours of simulated time, and check what must hold in every step.

    The folder gets soak.md and soak.json, and of each run in which something does not hold its scenario and its bag.
    """
    from swarmabs_analysis.soak.engine import LockstepEngine  # noqa: PLC0415
    from swarmabs_analysis.soak.fleet_engine import FleetEngine  # noqa: PLC0415
    from swarmabs_analysis.soak.report import to_dict, write_report  # noqa: PLC0415
    from swarmabs_analysis.soak.run import Extent, run_soak  # noqa: PLC0415
    from swarmabs_bag.run_folder import new_run_folder, next_run_folder  # noqa: PLC0415
    from swarmabs_cli.elapsed import since_start  # noqa: PLC0415 - slow, not for --help

    if sum(given is not None for given in (hours, runs, only)) > 1:
        raise click.UsageError("give one of --hours, --runs and --only")
    if only is not None:
        extent = Extent(seed, only, 1, robots, realtime)
    elif runs is not None:
        extent = Extent(seed, 0, runs, robots, realtime)
    else:
        extent = Extent.of_hours(seed, hours or HOURS, robots, realtime=realtime)
    folder = new_run_folder(output) if output is not None else next_run_folder(RUNS, "soak")
    try:
        done = run_soak(extent, FleetEngine() if realtime else LockstepEngine(), folder.path, _tell)
        document = to_dict(done, since_start())
        write_report(document, folder.path)
    except OSError as error:
        from swarmabs_bag.errors import remedy  # noqa: PLC0415

        raise RunError(f"{folder.path}: {error.strerror or error}; {remedy(error)}") from error
    if as_json:
        print_json(document)
    else:
        click.echo((folder.path / "soak.md").read_text(encoding="utf-8"))
        click.echo(f"folder: {folder.path}")
    if done.status != "ok":
        click.echo(f"error: {_reason(done)}", err=True)
    return 0 if done.status == "ok" else 1


def _reason(done: Soak) -> str:
    """Say why a soak is not fine."""
    if done.failed:
        first = done.failed[0]
        return (
            f"{len(done.failed)} of {len(done.trials)} runs failed, first {first.number}: "
            f"{first.violations[0].invariant}: {first.violations[0].text}; again by "
            f"{done.extent.command(first.number)}"
        )
    growing = [one.what for one in done.growth if not one.ok]
    return f"the process grows: {', '.join(growing)}" if growing else "interrupted"


def _tell(done: Soak) -> None:
    """Say on standard error how far a soak is."""
    trial = done.trials[-1]
    verdict = "ok" if not trial.violations else f"FAILED: {trial.violations[0].invariant}"
    recovery = trial.figures.get("recovery")
    recovered = "" if recovery is None else f"; recovered after {recovery:.2f} s"
    click.echo(
        f"run {trial.number} ({len(done.trials)} of {done.extent.runs}): {verdict}; {trial.agents} robots, "
        f"{', '.join(trial.faults)}{recovered}",
        err=True,
    )

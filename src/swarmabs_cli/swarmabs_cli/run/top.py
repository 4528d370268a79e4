"""``swarm top``."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import click
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from swarmabs_cli.options import RUNS, Number, examples, json_option
from swarmabs_cli.output import print_json, print_tables
from swarmabs_run.processes import RunProcesses, Snapshot, document, newest_run

SAMPLE = 0.5
"""Time, s, over which a single snapshot measures the processor time."""
_SLICE = 0.1


@click.command(epilog=examples("top", "top runs/pd_het_4-001 --once"))
@click.argument("run", required=False, metavar="[RUN]", type=click.Path(path_type=Path))
@click.option("--once", is_flag=True, help="Print one snapshot and exit.")
@click.option(
    "--interval",
    type=Number(0.2, 3600.0),
    default=2.0,
    show_default=True,
    metavar="SECONDS",
    help="Time between two snapshots.",
)
@json_option
def top(run: Path | None, interval: float, *, once: bool, as_json: bool) -> None:
    """Show the processes of a running simulation.

    RUN is the folder of the run; the default is the newest run in runs/ that has not ended. The display ends with the
    run. With --json the command takes a single snapshot.
    """
    folder = newest_run(RUNS) if run is None else run
    processes = RunProcesses(folder)
    processes.snapshot(time.monotonic(), shares=0)  # processor time counts from here on
    if once or as_json:
        time.sleep(SAMPLE)
        snapshot = processes.snapshot(time.monotonic(), shares=None)
        if as_json:
            print_json(document(folder, snapshot))
        else:
            print_tables(_table(folder, snapshot))
        return
    if not sys.stdout.isatty():
        while _wait(processes.running, interval):
            print_tables(_table(folder, processes.snapshot(time.monotonic())))
        return

    with Live(auto_refresh=False, transient=True) as live:
        wait = SAMPLE
        while _wait(processes.running, wait):
            live.update(_table(folder, processes.snapshot(time.monotonic())), refresh=True)
            wait = interval
    click.echo(f"{folder}: the run has ended")


def _wait(running: Callable[[], bool], seconds: float) -> bool:
    """Wait until the time is over or the run has ended; tell whether it is still running."""
    deadline = time.monotonic() + seconds
    while running():
        left = deadline - time.monotonic()
        if left <= 0.0:
            return True
        time.sleep(min(left, _SLICE))
    return False


def _table(folder: Path, snapshot: Snapshot) -> Group:
    table = Table(box=None, pad_edge=False)
    table.add_column("process", no_wrap=True)
    for name in ("pid", "CPU %", "PSS MB", "RSS MB"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("state", no_wrap=True)
    for row in snapshot.rows:
        cpu = "?" if row.cpu is None else f"{row.cpu:.1f}"
        table.add_row(Text(row.name), str(row.pid), cpu, _megabytes(row.pss), _megabytes(row.rss), row.state)
    cpu_sum = sum(row.cpu or 0.0 for row in snapshot.rows)
    shares = [row.pss for row in snapshot.rows if row.pss is not None]
    pss_sum = sum(shares) if len(shares) == len(snapshot.rows) else None
    table.add_row("all", str(len(snapshot.rows)), f"{cpu_sum:.1f}", _megabytes(pss_sum), "", "", style="bold")
    return Group(Text(_title(folder, snapshot), style="bold"), table)


def _title(folder: Path, snapshot: Snapshot) -> str:
    progress = snapshot.progress
    if progress is None:
        return f"{folder}: starting"
    rate = "" if snapshot.step_rate is None else f", {snapshot.step_rate:.0f} steps/s"
    return f"{folder}: {progress.phase}, step {progress.step} of {progress.steps}{rate}"


def _megabytes(number: int | None) -> str:
    return "?" if number is None else f"{number / 1e6:.1f}"

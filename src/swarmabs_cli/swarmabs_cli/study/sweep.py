"""``swarm sweep``."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column

from swarmabs_analysis.sweep.folder import find_folder, make_folder
from swarmabs_analysis.sweep.study import load_sweep
from swarmabs_cli.options import A_PATH, RUNS, WholeNumber, examples, json_option, output_option, set_option
from swarmabs_cli.output import print_json

_LINE_INTERVAL = 5.0
"""Time, s, between two lines."""


@click.command(
    epilog=examples(
        "sweep examples/sweeps/masses_and_delays.yaml -o sweep",
        "sweep examples/sweeps/masses_and_delays.yaml -o sweep --resume",
    )
)
@click.argument("file", metavar="SWEEP.yaml", type=A_PATH)
@output_option("Folder of the results.  [default: runs/NAME-NNN]")
@set_option()
@click.option("--jobs", type=WholeNumber(1, 1024), help="Processes on this machine.  [default: one per core]")
@click.option("--scheduler", metavar="ADDRESS", help="Compute on the workers of this Dask scheduler, tcp://HOST:PORT.")
@click.option("--resume", is_flag=True, help="Continue the sweep in the folder, if there is one.")
@json_option
def sweep(
    file: Path,
    output: Path | None,
    overrides: tuple[str, ...],
    jobs: int | None,
    scheduler: str | None,
    *,
    resume: bool,
    as_json: bool,
) -> int:
    """Run many variants of a scenario.

    SWEEP.yaml names the scenario and what varies: a grid of parameters, or parameters drawn at random. The folder
    receives results.parquet, results.csv and results.mat with one row per case, columns.csv with their units,
    summary.json and a picture. Continue an interrupted sweep with --resume.
    """
    if resume and output is None:
        raise click.UsageError("--resume needs the folder of the sweep; name it with -o DIR")
    if jobs is not None and scheduler is not None:
        raise click.UsageError("--jobs cannot be combined with --scheduler, which has its own workers; remove --jobs")
    # Imported here, since the help needs none of them.
    from swarmabs_analysis.sweep.executor import LocalExecutor, SchedulerExecutor  # noqa: PLC0415
    from swarmabs_analysis.sweep.run import run_sweep  # noqa: PLC0415

    study = load_sweep(file, overrides)
    with closing(LocalExecutor(jobs) if scheduler is None else SchedulerExecutor(scheduler)) as executor:
        begun = resume and output is not None and output.exists() and any(output.iterdir())
        folder = find_folder(study, output) if begun and output is not None else make_folder(study, output, RUNS)
        summary = folder.complete()
        if summary is None:
            with folder, _shown(study.sweep.name, study.sweep.count) as show:
                summary = run_sweep(study, folder, executor, show)
    if as_json:
        print_json(summary)
    else:
        outcomes = ", ".join(f"{count} {name}" for name, count in summary["outcomes"].items() if count)
        click.echo(f"{summary['finished']} of {summary['cases']} cases: {outcomes or 'none'}")
        click.echo(f"folder: {folder.path}")
    if summary["reason"] is not None:
        click.echo(f"error: {summary['reason']}", err=True)
    return 0 if summary["status"] == "ok" else 1


@contextmanager
def _shown(name: str, cases: int) -> Iterator[Callable[[Counter[str]], None]]:
    """Show the progress of a sweep on standard error: a bar on a terminal, else a line every few seconds."""

    def describe(outcomes: Counter[str]) -> str:
        ended = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
        return f"{name}: {outcomes.total()} of {cases} cases" + (f"; {ended}" if ended else "")

    if sys.stderr.isatty():
        one_line = Column(no_wrap=True, overflow="ellipsis")
        columns = (BarColumn(bar_width=20), TimeRemainingColumn(compact=True))
        text = TextColumn("{task.description}", markup=False, table_column=one_line)
        with Progress(text, *columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(describe(Counter()), total=cases)
            yield lambda outcomes: bar.update(task, completed=outcomes.total(), description=describe(outcomes))
        return
    shown = -_LINE_INTERVAL

    def update(outcomes: Counter[str]) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown >= _LINE_INTERVAL or outcomes.total() == cases:
            shown = now
            click.echo(describe(outcomes), err=True)

    yield update

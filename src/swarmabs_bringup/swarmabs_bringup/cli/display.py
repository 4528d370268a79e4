"""How far a run is: one line that is rewritten on a terminal, now and then a line elsewhere."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from swarmabs_bringup.orchestration.progress import Progress
    from swarmabs_core.scenario import Scenario

_TERMINAL_INTERVAL = 0.1
_LINE_INTERVAL = 5.0


@contextmanager
def shown_progress(scenario: Scenario) -> Iterator[Callable[[Progress], None]]:
    """Show the progress of a run on standard error for the time of the block; the yielded function is told of it."""
    if sys.stderr.isatty():
        with _terminal(scenario) as show:
            yield show
    else:
        yield _lines(scenario)


def describe(progress: Progress, scenario: Scenario) -> str:
    """Say in a line how far a run is."""
    if progress.phase == "starting":
        return f"{scenario.name}: starting, {progress.ready} of {progress.processes} processes ready"
    parts = [f"{scenario.name}: step {progress.step} of {progress.steps}"]
    if progress.phase == "closing":
        parts.append("completing the bag")
    elif progress.step_rate:
        parts.append(f"{progress.step_rate:.0f} steps/s, {progress.step_rate * scenario.period:.1f} x real time")
    if progress.angle is not None and progress.error is not None:
        parts.append(f"angle {progress.angle:+.4f} rad, error {progress.error:+.4f} rad")
    return "; ".join(parts)


@contextmanager
def _terminal(scenario: Scenario) -> Iterator[Callable[[Progress], None]]:
    from rich.console import Console  # noqa: PLC0415 - slow to import, and needed on a terminal only
    from rich.progress import (  # noqa: PLC0415
        BarColumn,
        Progress as Bar,
        TaskProgressColumn,
        TextColumn,
    )

    bar = Bar(
        BarColumn(bar_width=20),
        TaskProgressColumn(),
        TextColumn("{task.description}", markup=False),
        console=Console(stderr=True),
        auto_refresh=False,
        transient=True,
    )
    shown = 0.0
    with bar:
        task = bar.add_task(f"{scenario.name}: starting", total=scenario.steps)

        def show(progress: Progress) -> None:
            nonlocal shown
            now = time.monotonic()
            if now - shown >= _TERMINAL_INTERVAL:
                shown = now
                bar.update(task, completed=progress.step, description=describe(progress, scenario), refresh=True)

        yield show


def _lines(scenario: Scenario) -> Callable[[Progress], None]:
    shown, phase = time.monotonic(), ""

    def show(progress: Progress) -> None:
        nonlocal shown, phase
        now = time.monotonic()
        if progress.phase != phase or now - shown >= _LINE_INTERVAL:
            shown, phase = now, progress.phase
            click.echo(describe(progress, scenario), err=True)

    return show

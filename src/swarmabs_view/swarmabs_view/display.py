"""How far a run is: a panel that is rewritten on a terminal, now and then a line elsewhere."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.live import Live

from swarmabs_view.panel import RunPanel

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from swarmabs_config.scenario import Scenario
    from swarmabs_run.orchestration.progress import Progress

_TERMINAL_INTERVAL = 0.2
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
    if progress.angle is not None:
        error = "" if progress.error is None else f", error {progress.error:+.4f} rad"
        parts.append(f"angle {progress.angle:+.4f} rad{error}")
    return "; ".join(parts)


@contextmanager
def _terminal(scenario: Scenario) -> Iterator[Callable[[Progress], None]]:
    console = Console(stderr=True, highlight=False)
    if console.is_dumb_terminal:  # it cannot go back to what is written already
        yield _lines(scenario)
        return
    panel = RunPanel(scenario)
    shown = 0.0
    # Drawn by the function that is told, not by a thread: the launcher is forked from here.
    with Live(panel, console=console, auto_refresh=False, transient=True) as live:

        def show(progress: Progress) -> None:
            nonlocal shown
            now = time.monotonic()
            if now - shown >= _TERMINAL_INTERVAL:
                shown = now
                panel.take(progress, describe(progress, scenario))
                live.refresh()

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

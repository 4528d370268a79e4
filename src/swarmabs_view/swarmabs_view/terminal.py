"""A run on a terminal: its progress and its processes, redrawn in place, or periodic lines elsewhere."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Protocol

import click
from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from swarmabs_bag.recorder.swarm_summary import LETTERS, THOUSAND
from swarmabs_bag.run.figures import tracking_of
from swarmabs_config.graph import SILENCE
from swarmabs_core.messages import Kind
from swarmabs_core.systems.kinds import KINDS
from swarmabs_run.orchestration.run_files import RunOverError, is_running, read_processes, read_progress
from swarmabs_run.processes import GONE, ProcessMonitor

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from rich.console import ConsoleOptions, RenderResult

    from swarmabs_bag.recorder.swarm_summary import SwarmSummary
    from swarmabs_config.scenario import Scenario
    from swarmabs_run.processes import ProcessState
    from swarmabs_run.run import Progress

_TERMINAL_INTERVAL, _LINE_INTERVAL = 0.2, 5.0
"""Time between two updates of the panel, and between two lines, s."""
PROCESS_INTERVAL = 2.0
"""Time between two queries of the processes, s."""
_BUSIEST = 3
LEAST_WIDTH, LEAST_HEIGHT = 50, 9
"""Smaller terminals get a single line."""
WIDEST = 100
ECHO = "^C"
"""Text that a terminal appends to the panel on Ctrl-C; the panel leaves room for it, or it would wrap."""
LANES = 8
"""Most robots with a lane each; more share one."""
_BINS = 400
_BARS = " ▁▂▃▄▅▆▇█"
_ASCII_BARS = " .:-=+*#@"
_STATUS = {
    LETTERS["active"]: ("active", "green"),
    LETTERS["limited"]: ("limited", "cyan"),
    LETTERS["safe_stop"]: ("in safe stop", "yellow"),
    LETTERS["left"]: ("left", "dim"),
    LETTERS["dead"]: ("dead", "magenta"),
    LETTERS["silent"]: ("silent", "red"),
    LETTERS[None]: ("no data", "dim"),
}
_SIGNS = {"circle": ("●", "o"), "square": ("■", "#"), "diamond": ("◆", "^")}
"""Signs of the shapes of robots, and those in ASCII."""
_NOWHERE = (LETTERS["left"], LETTERS[None])
"""Letters of robots that are not on the plane, or whose position is not known."""
_LABEL = 8


class ProgressDisplay(Protocol):
    """Shows the progress of a run on standard error; call it from the thread that entered `shown_progress`."""

    def __call__(self, progress: Progress) -> None:
        """Show the progress, with its new warnings."""

    def warn(self, warnings: Iterable[object]) -> None:
        """Print warnings, above the panel if there is one."""


@contextmanager
def shown_progress(scenario: Scenario, folder: Path | None = None) -> Iterator[ProgressDisplay]:
    """Show the progress of a run on standard error inside the block; pass it to the yielded display.

    The panel also shows the processes of the run, if it has any and its folder is given.
    """
    console = Console(stderr=True, highlight=False)
    if not sys.stderr.isatty() or console.is_dumb_terminal:  # such a terminal cannot move the cursor back
        yield _Lines(scenario)
        return
    panel = RunPanel(scenario)
    # Drawn by the display itself, not by a thread, because this process forks the launcher.
    with Live(panel, console=console, auto_refresh=False, transient=True) as live:
        yield _Terminal(panel, live, folder)


def watch_run(folder: Path) -> None:
    """Show progress and processes of a run that another command has started, on standard output until the run ends.

    Raises
    ------
    InputError
        If the folder is not that of a run in progress.
    """
    if not is_running(folder):
        raise RunOverError(folder)
    console = Console(highlight=False)
    table = ProcessTable(folder)
    if not console.is_terminal or console.is_dumb_terminal:
        while _wait(folder, _LINE_INTERVAL):
            table.update(time.monotonic())
            console.print(table)
    else:
        with Live(table, console=console, auto_refresh=False, transient=True) as live:
            while _wait(folder, PROCESS_INTERVAL):
                table.update(time.monotonic())
                live.refresh()
    console.print(f"{folder}: the run has ended", markup=False)


def _wait(folder: Path, seconds: float) -> bool:
    """Wait until the time, s, is over or the run has ended; return whether it is still running."""
    deadline = time.monotonic() + seconds
    while is_running(folder):
        left = deadline - time.monotonic()
        if left <= 0.0:
            return True
        time.sleep(min(left, _TERMINAL_INTERVAL))
    return False


class Processes:
    """The processes of the run in a folder, from the time on at which all are ready."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._monitor: ProcessMonitor | None = None

    def states(self) -> list[ProcessState]:
        """Return the state of each process, none if they are not ready or the run has none."""
        if self._monitor is None:
            pids = read_processes(self._folder)
            if pids is None:
                return []
            self._monitor = ProcessMonitor(pids)
        return self._monitor.states()


class ProcessTable:
    """Renders progress and processes of the run in a folder; it has no clock and does not print."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._processes = Processes(folder)
        self._states: list[ProcessState] = []
        self._title = f"{folder}: starting"

    def update(self, now: float) -> None:
        """Read progress and processes at a time (s, monotonic); processor time counts from the previous update."""
        self._states = self._processes.states()
        progress = read_progress(self._folder / "logs")
        if progress is not None:
            rate = progress.step_rate if now - progress.told_at < SILENCE else None
            speed = "" if rate is None else f", {rate:.0f} steps/s"
            self._title = f"{self._folder}: {progress.phase}, step {progress.step} of {progress.steps}{speed}"

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw a title, and a row for each process."""
        yield Text(self._title, style="bold")
        table = Table(box=None, pad_edge=False)
        table.add_column("process", no_wrap=True)
        for name in ("pid", "CPU %", "memory MB"):
            table.add_column(name, justify="right", no_wrap=True)
        table.add_column("state", no_wrap=True)
        for row in self._states:
            cpu = "" if row.cpu is None else f"{row.cpu:.1f}"
            memory = "" if row.memory is None else f"{row.memory / 1e6:.1f}"
            table.add_row(Text(row.name), str(row.pid), cpu, memory, row.state)
        yield table


def describe(progress: Progress, scenario: Scenario) -> str:
    """Describe the progress of a run in a line."""
    if progress.phase == "starting":
        return f"{scenario.name}: starting, {progress.ready} of {progress.processes} processes ready"
    parts = [f"{scenario.name}: step {progress.step} of {progress.steps}"]
    speed = speed_of(progress, scenario)
    if speed:
        parts.append(speed)
    if progress.angle is not None:
        tracking = tracking_of(scenario)
        error = "" if progress.error is None else f", error {progress.error:+.4f} {tracking.unit}"
        parts.append(f"{tracking.name} {progress.angle:+.4f} {tracking.unit}{error}")
    return "; ".join(parts)


def speed_of(progress: Progress, scenario: Scenario) -> str:
    """Return how fast a run is, or why it makes no steps; empty if that is not known yet."""
    if progress.phase == "closing":
        return "completing the bag"
    if progress.phase == "paused":
        return "paused"
    if not progress.step_rate:
        return ""
    return f"{progress.step_rate:.0f} steps/s, {progress.step_rate * scenario.period:.1f} x real time"


class _Terminal:
    def __init__(self, panel: RunPanel, live: Live, folder: Path | None) -> None:
        self._panel, self._live = panel, live
        self._processes = None if folder is None else Processes(folder)
        self._news = Warnings().of
        self._shown = self._asked = 0.0

    def __call__(self, progress: Progress) -> None:
        self.warn(self._news(progress))
        now = time.monotonic()
        if now - self._shown >= _TERMINAL_INTERVAL:
            self._shown = now
            if self._processes is not None and progress.phase == "running" and now - self._asked >= PROCESS_INTERVAL:
                self._asked = now
                self._panel.processes = self._processes.states()
            self._panel.take(progress)
            self._live.refresh()

    def warn(self, warnings: Iterable[object]) -> None:
        for text in warnings:  # the console redraws the panel below
            self._live.console.print(Text(f"warning: {text}"))


class _Lines:
    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._news = Warnings().of
        self._shown, self._phase = time.monotonic(), ""

    def __call__(self, progress: Progress) -> None:
        self.warn(self._news(progress))
        now = time.monotonic()
        if progress.phase != self._phase or now - self._shown >= _LINE_INTERVAL:
            self._shown, self._phase = now, progress.phase
            click.echo(describe(progress, self._scenario), err=True)

    def warn(self, warnings: Iterable[object]) -> None:
        for text in warnings:
            click.echo(f"warning: {text}", err=True)


class Warnings:
    """The warnings of a running run, each once: about the first robots that leave the ranges of their coordinates."""

    def __init__(self) -> None:
        self._told: set[str] = set()

    def of(self, progress: Progress) -> list[str]:
        """Return the warnings that are new."""
        strays = [] if progress.robots is None else [text for text in progress.robots.strays if text not in self._told]
        self._told.update(strays)
        return strays


class RunPanel:
    """Renders a run as a panel, or as one line in little space; it has no clock and does not print.

    Attributes
    ----------
    processes : list of ProcessState
        The processes of the run; empty if it has none.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._tracking = tracking_of(scenario)
        self._kinds = {agent.id: agent.kind for agent in scenario.agents}
        self.processes: list[ProcessState] = []
        self._errors: list[float | None] = [None] * _BINS
        self._progress: Progress | None = None

    def take(self, progress: Progress) -> None:
        """Update the panel with the latest progress."""
        self._progress = progress
        if progress.error is not None:
            bin_ = min(_BINS * progress.step // max(progress.steps, 1), _BINS - 1)
            self._errors[bin_] = max(abs(progress.error), self._errors[bin_] or 0.0)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the run in the available space; nothing before the first progress, when addresses are printed."""
        width, height = options.max_width - len(ECHO), console.size.height
        progress = self._progress
        if progress is None:
            return
        if width < LEAST_WIDTH or height < LEAST_HEIGHT or progress.phase == "starting":
            line = Text(describe(progress, self._scenario), end="")
            line.truncate(max(width, 1), overflow="ellipsis")
            yield line
            return
        width = min(width, WIDEST)
        yield Panel(
            Group(*self._lines(progress, width - 4, height - 3, ascii_only=options.ascii_only)),
            title=Text(f"{self._scenario.name}: step {progress.step} of {progress.steps}"),
            title_align="left",
            width=width,
            box=box.ASCII if options.ascii_only else box.ROUNDED,
        )

    def _lines(self, progress: Progress, width: int, height: int, *, ascii_only: bool) -> list[Text]:
        lines = [
            self._bar(progress, width, ascii_only=ascii_only),
            _line(self._tracking.name, self._angle(progress)),
            _line("error", self._sparkline(width - _LABEL - 12, progress, ascii_only=ascii_only)),
            _line("speed", Text(speed_of(progress, self._scenario) or "not known yet")),
        ]
        if self.processes:
            lines.append(_line("process", _load(self.processes)))
        seen = progress.robots
        if seen is not None:
            lines += [_line("" if number else "further", Text(text)) for number, text in enumerate(seen.further)]
            lines.append(_line("robots", _counts(seen)))
            lanes = self._lanes(seen, width - _LABEL, ascii_only=ascii_only)
            events = [_line("events" if i == 0 else "", Text(text)) for i, text in enumerate(seen.events)]
            room = height - len(lines)
            if len(lanes) + min(len(events), 1) > room:
                lanes = self._one_lane(seen, width - _LABEL, ascii_only=ascii_only)
            lines += lanes[: max(room, 0)]
            room = height - len(lines)
            lines += events[-room:] if room > 0 else []
        return lines

    def _bar(self, progress: Progress, width: int, *, ascii_only: bool) -> Text:
        part = progress.step / max(progress.steps, 1)
        room = width - 6
        full = round(part * room)
        done, open_ = ("#", "-") if ascii_only else ("━", "─")
        return Text.assemble((done * full, "green"), (open_ * (room - full), "dim"), f" {100 * part:4.0f}%")

    def _angle(self, progress: Progress) -> Text:
        if progress.angle is None:
            return Text("not known yet")
        unit, error = self._tracking.unit, progress.error
        shown = f"{progress.angle:+.4f} {unit}"
        if error is not None and len(self._tracking.followed) == 1:
            shown += f", reference {progress.angle + error:+.4f} {unit}"
        return Text(shown if error is None else f"{shown}, error {error:+.4f} {unit}")

    def _sparkline(self, width: int, progress: Progress, *, ascii_only: bool) -> Text:
        """Draw |error| over the whole run, scaled to its largest value."""
        width = max(min(width, _BINS), 1)
        columns: list[float | None] = [None] * width
        for index, error in enumerate(self._errors):
            if error is not None and error == error and error != float("inf"):  # noqa: PLR0124 - NaN is not drawn
                column = index * width // _BINS
                columns[column] = max(error, columns[column] or 0.0)
        last = min(width * progress.step // max(progress.steps, 1), width - 1)
        previous = 0.0
        for column in range(last + 1):  # a fast run leaves columns without a value
            error = columns[column]
            previous = columns[column] = previous if error is None else error
        largest = max((error for error in columns if error is not None), default=0.0)
        bars = _ASCII_BARS if ascii_only else _BARS
        return Text("".join(_column(error, largest, bars) for error in columns)).append(
            f" {largest:.4f} {self._tracking.unit}", style="dim"
        )

    def _lanes(self, seen: SwarmSummary, width: int, *, ascii_only: bool) -> list[Text]:
        """Draw each robot in its lane, or many robots in a common one."""
        if not seen.places:
            return []
        if len(seen.places) > LANES:
            return self._one_lane(seen, width, ascii_only=ascii_only)
        lanes = []
        robots = zip(sorted(self._kinds), seen.statuses, seen.places, strict=True)
        for agent_id, status, place in robots:
            cells = _empty_lane(width, ascii_only=ascii_only)
            if status not in _NOWHERE:
                sign = self._sign(agent_id, status, ascii_only=ascii_only)
                cells[_cell(place, width)] = (sign, _STATUS[status][1])
            lanes.append(_line(f"{agent_id:>6}", _joined(cells)))
        return lanes

    def _one_lane(self, seen: SwarmSummary, width: int, *, ascii_only: bool) -> list[Text]:
        if not seen.places:
            return []
        numbers = [0] * width
        worst = ["A"] * width
        for status, place in zip(seen.statuses, seen.places, strict=True):
            if status not in _NOWHERE:
                cell = _cell(place, width)
                numbers[cell] += 1
                worst[cell] = max(worst[cell], status, key="ADS-".index)
        cells = _empty_lane(width, ascii_only=ascii_only)
        for cell, number in enumerate(numbers):
            if number:
                cells[cell] = (str(number) if number < 10 else "+", _STATUS[worst[cell]][1])
        return [_line("plane", _joined(cells))]

    def _sign(self, agent_id: int, status: str, *, ascii_only: bool) -> str:
        if status == LETTERS["dead"]:
            return "x" if ascii_only else "×"
        sign, ascii_sign = _SIGNS[KINDS[Kind.of(self._kinds[agent_id])].shape]
        return ascii_sign if ascii_only else sign


def _line(label: str, content: Text) -> Text:
    return Text.assemble((f"{label[: _LABEL - 1]:<{_LABEL}}", "bold"), content, no_wrap=True, overflow="ellipsis")


def _load(processes: Sequence[ProcessState]) -> Text:
    """Describe how many processes there are, their load, the busiest of them, and those that are gone."""
    busiest = sorted((one for one in processes if one.cpu), key=lambda one: -(one.cpu or 0.0))[:_BUSIEST]
    load = sum(one.cpu or 0.0 for one in processes)
    parts = [f"{len(processes)} with {load:.0f} % CPU", *(f"{one.name} {one.cpu:.0f} %" for one in busiest)]
    text = Text(", ".join(parts))
    gone = [one.name for one in processes if one.state == GONE]
    return text.append(f", gone: {', '.join(gone)}", style="red") if gone else text


def _counts(seen: SwarmSummary) -> Text:
    text = Text()
    for status, (name, style) in _STATUS.items():
        number = seen.counts.get(status, 0)
        if number:
            text.append(f"{', ' if text else ''}{number} {name}", style=style)
    return text


def _empty_lane(width: int, *, ascii_only: bool) -> list[tuple[str, str]]:
    rail, axis = ("-", "+") if ascii_only else ("─", "┼")
    cells = [(rail, "dim")] * width
    cells[_cell(0, width)] = (axis, "dim")
    return cells


def _joined(cells: list[tuple[str, str]]) -> Text:
    """Join cells, merging those of the same style, which is much faster to print."""
    parts = ((style, "".join(text for text, _ in group)) for style, group in groupby(cells, itemgetter(1)))
    return Text.assemble(*((text, style) for style, text in parts))


def _cell(place: int, width: int) -> int:
    """Return the column of a place; the first and last column are the ends of the plane."""
    return round((place + THOUSAND) * (width - 1) / (2 * THOUSAND))


def _column(error: float | None, largest: float, bars: str) -> str:
    if error is None:
        return " "
    return bars[1 + min(int(error / largest * (len(bars) - 1)), len(bars) - 2)] if largest else bars[1]

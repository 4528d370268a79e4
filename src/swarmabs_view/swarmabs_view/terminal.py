"""Progress of a run: a panel that is redrawn on a terminal, or periodic lines elsewhere."""

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
from rich.text import Text

from swarmabs_bag.recorder.swarm_summary import LETTERS, THOUSAND
from swarmabs_bag.run.figures import tracking_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rich.console import ConsoleOptions, RenderResult

    from swarmabs_bag.recorder.swarm_summary import SwarmSummary
    from swarmabs_config.scenario import AnyScenario
    from swarmabs_run.run import Progress

_TERMINAL_INTERVAL, _LINE_INTERVAL = 0.2, 5.0
"""Time between two updates of the panel, and between two lines, s."""
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
def shown_progress(scenario: AnyScenario) -> Iterator[ProgressDisplay]:
    """Show the progress of a run on standard error inside the block; pass it to the yielded display."""
    console = Console(stderr=True, highlight=False)
    if not sys.stderr.isatty() or console.is_dumb_terminal:  # such a terminal cannot move the cursor back
        yield _Lines(scenario)
        return
    panel = RunPanel(scenario)
    # Drawn by the display itself, not by a thread, because this process forks the launcher.
    with Live(panel, console=console, auto_refresh=False, transient=True) as live:
        yield _Terminal(scenario, panel, live)


def describe(progress: Progress, scenario: AnyScenario) -> str:
    """Describe the progress of a run in a line."""
    if progress.phase == "starting":
        return f"{scenario.name}: starting, {progress.ready} of {progress.processes} processes ready"
    parts = [f"{scenario.name}: step {progress.step} of {progress.steps}"]
    if progress.phase == "closing":
        parts.append("completing the bag")
    elif progress.step_rate:
        parts.append(f"{progress.step_rate:.0f} steps/s, {progress.step_rate * scenario.period:.1f} x real time")
    if progress.angle is not None:
        tracking = tracking_of(scenario)
        error = "" if progress.error is None else f", error {progress.error:+.4f} {tracking.unit}"
        parts.append(f"{tracking.name} {progress.angle:+.4f} {tracking.unit}{error}")
    return "; ".join(parts)


class _Terminal:
    def __init__(self, scenario: AnyScenario, panel: RunPanel, live: Live) -> None:
        self._scenario, self._panel, self._live = scenario, panel, live
        self._news = Warnings().of
        self._shown = 0.0

    def __call__(self, progress: Progress) -> None:
        self.warn(self._news(progress))
        now = time.monotonic()
        if now - self._shown >= _TERMINAL_INTERVAL:
            self._shown = now
            self._panel.take(progress, describe(progress, self._scenario))
            self._live.refresh()

    def warn(self, warnings: Iterable[object]) -> None:
        for text in warnings:  # the console redraws the panel below
            self._live.console.print(Text(f"warning: {text}"))


class _Lines:
    def __init__(self, scenario: AnyScenario) -> None:
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
    """Renders a run as a panel, or as one line in little space; it has no clock and does not print."""

    def __init__(self, scenario: AnyScenario) -> None:
        self._scenario = scenario
        self._tracking = tracking_of(scenario)
        self._kinds = {agent.id: agent.kind for agent in scenario.agents}
        self._errors: list[float | None] = [None] * _BINS
        self._progress: Progress | None = None
        self._line = f"{scenario.name}: starting"

    def take(self, progress: Progress, one_line: str) -> None:
        """Update the panel with the latest progress."""
        self._progress, self._line = progress, one_line
        if progress.error is not None:
            bin_ = min(_BINS * progress.step // max(progress.steps, 1), _BINS - 1)
            self._errors[bin_] = max(abs(progress.error), self._errors[bin_] or 0.0)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the run in the available space."""
        width, height = options.max_width - len(ECHO), console.size.height
        progress = self._progress
        if width < LEAST_WIDTH or height < LEAST_HEIGHT or progress is None or progress.phase == "starting":
            line = Text(self._line, end="")
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
            _line("speed", self._speed(progress)),
        ]
        seen = progress.robots
        if seen is not None:
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
        known = 0.0
        for column in range(last + 1):  # a fast run leaves columns without a value
            found = columns[column]
            known = columns[column] = known if found is None else found
        largest = max((error for error in columns if error is not None), default=0.0)
        bars = _ASCII_BARS if ascii_only else _BARS
        return Text("".join(_column(error, largest, bars) for error in columns)).append(
            f" {largest:.4f} {self._tracking.unit}", style="dim"
        )

    def _speed(self, progress: Progress) -> Text:
        if progress.phase == "closing":
            return Text("completing the bag")
        if not progress.step_rate:
            return Text("not known yet")
        times = progress.step_rate * self._scenario.period
        return Text(f"{progress.step_rate:.0f} steps/s, {times:.1f} x real time")

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
        round_ = self._kinds[agent_id] == "single_integrator"
        if ascii_only:
            return "o" if round_ else "#"
        return "●" if round_ else "■"


def _line(label: str, content: Text) -> Text:
    return Text.assemble((f"{label[: _LABEL - 1]:<{_LABEL}}", "bold"), content, no_wrap=True, overflow="ellipsis")


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

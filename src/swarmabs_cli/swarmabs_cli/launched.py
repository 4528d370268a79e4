"""What the command `run` does while its launcher loads, and afterwards."""

from __future__ import annotations

import sys
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from swarmabs_cli.options import RunParameters
from swarmabs_cli.output import open_page, private_page
from swarmabs_cli.runs import carry_out
from swarmabs_config.scenario import on_plane
from swarmabs_core.errors import InputError
from swarmabs_run.ending import interrupt_once
from swarmabs_run.orchestration.launcher_process import LauncherProcess
from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.orchestration.realtime_run import RealtimeRun
from swarmabs_run.orchestration.run_files import since_start
from swarmabs_run.run import SLOWEST_STEP, Outcome, RunOptions
from swarmabs_view.ports import check_foxglove
from swarmabs_view.viewers import PageViewer, markers_viewer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager
    from pathlib import Path

    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import Scenario


class Parameters(RunParameters):
    """What the options give to the command `run`."""

    agents_per_process: int
    packed: bool | None
    realtime: bool
    steer: bool
    rate: float | None
    markers: bool
    foxglove: bool
    foxglove_port: int
    view: bool
    view_port: int | None
    open_browser: bool


def run_scenario(launcher: LauncherProcess, options: Parameters) -> int:
    """Run a scenario with the processes that a launcher forks; the options are those of the command."""
    with ExitStack() as stack:
        page = None
        if options["view"]:
            port, opens = options["view_port"] or 0, options["open_browser"]
            page = stack.enter_context(_page(port, steered=options["steer"], opens=opens))
        code, _ = _run(launcher, page, options)
        if page is not None:
            page.stay()
        return code


def run_scenarios(
    launcher: LauncherProcess, following: Callable[[str | None], tuple[Parameters, bool]], *, open_browser: bool
) -> int:
    """Show steered runs on one page, until one ends other than by a request for the next one.

    The `launcher` is that of the first run. `following` returns, for the run after a request, None for the first, the
    options of the command and whether the run begins paused. The exit code is 0 if the user ends the last.
    """
    (options, paused), begun = following(None), 0.0
    with _page(0, steered=True, opens=open_browser) as page:
        while True:
            with launcher:
                code, request = _run(launcher, page, options, paused=paused, restarts=True, begun=begun)
            if request is None:
                page.stay()
                return code
            begun = since_start()
            interrupt_once()  # as at the beginning of the command
            (options, paused), launcher = following(request), LauncherProcess("lockstep")


def _run(
    launcher: LauncherProcess,
    page: _Page | None,
    options: Parameters,
    *,
    paused: bool = False,
    restarts: bool = False,
    begun: float = 0.0,
) -> tuple[int, str | None]:
    """Run a scenario; return the exit code, and the request that ended the run so that another one starts.

    One that `restarts` is a show, see `carry_out`.
    """
    requests: list[str | None] = []
    realtime, rate = options["realtime"], options["rate"]

    def execute(scenario: Scenario, folder: RunFolder, recording: RunOptions) -> Outcome:
        if page is not None:
            page.show(folder.path)
        with shown(folder.path):
            if realtime:
                return RealtimeRun(scenario, folder, recording).run(launcher)
            asked = replace(
                recording,
                agents_per_process=options["agents_per_process"],
                packed=options["packed"],
                steered=options["steer"],
                step_seconds=_step_seconds(scenario, rate),
                paused=paused,
                restarts=restarts,
            )
            outcome = LockstepRun(scenario, folder, asked).run(launcher)
            requests.append(outcome.restart)
            return outcome

    drawn = "--markers" if options["markers"] else "--foxglove" if options["foxglove"] else None

    def check(scenario: Scenario) -> None:
        if drawn is not None:
            on_plane(scenario, drawn)
        _step_seconds(scenario, rate)

    shown = _marker_viewers(options, clock=not realtime)
    code = carry_out(
        execute,
        options,
        realtime=realtime,
        steered=options["steer"],
        meanwhile=True,
        show=restarts,
        begun=begun,
        check=check,
    )
    return code, next(iter(requests), None)


class _Page:
    """The page of a run, or of one run after the other at the same address; the first time, the browser may open it."""

    def __init__(self, viewer: PageViewer, stack: ExitStack, *, opens: bool) -> None:
        self._viewer = viewer
        self._stack = stack
        self._opens = opens
        self._told = False

    def show(self, folder: Path) -> None:
        """Show the run in a folder, which is about to start."""
        viewer = self._viewer
        viewer.start(folder)
        if self._told:
            return
        self._told = True
        click.echo(f"view: {viewer.url}", err=True)
        if viewer.steering_url is not None:
            click.echo(f"view, to steer: {viewer.steering_url}", err=True)
        if self._opens and viewer.steering_url is not None:
            open_page(self._stack.enter_context(private_page(viewer.steering_url)))
        elif self._opens:
            open_page(viewer.url)

    def stay(self) -> None:
        """On a terminal, play the bag until the user ends it."""
        if sys.stdin.isatty() and sys.stderr.isatty():
            interrupt_once()
            click.echo(f"view: {self._viewer.url} plays the bag until Ctrl-C", err=True)
            self._viewer.wait()


@contextmanager
def _page(port: int, *, steered: bool, opens: bool) -> Iterator[_Page]:
    with ExitStack() as stack:
        yield _Page(stack.enter_context(PageViewer(port, steered=steered)), stack, opens=opens)


def _step_seconds(scenario: Scenario, rate: float | None) -> float:
    """Return the shortest wall time of a step, s; 0: as fast as possible.

    Raises
    ------
    InputError
        If the run would be so slow that it looked like a stall.
    """
    seconds = 0.0 if rate is None else scenario.period / rate
    slowest = min(SLOWEST_STEP, 0.5 * scenario.lockstep.stall_timeout)
    if seconds > slowest:
        raise InputError(
            f"--rate {rate:g}: a step would take {seconds:g} s, and more than {slowest:g} s counts as a stall; use "
            f"at least {scenario.period / slowest:g}"
        )
    return seconds


def _marker_viewers(options: Parameters, *, clock: bool) -> Callable[[Path], AbstractContextManager[None]]:
    """Return a context manager that serves markers and Foxglove as the options of a run say.

    With `clock`, the time of the run is published, because it differs from that of the machine.
    """
    markers, foxglove, port = options["markers"], options["foxglove"], options["foxglove_port"]
    if not (markers or foxglove):
        return lambda _: nullcontext()
    if foxglove:
        check_foxglove(port)
        click.echo(f"Foxglove: open a connection to ws://127.0.0.1:{port}", err=True)
    served = port if foxglove else None
    return lambda folder: markers_viewer(folder, ros=markers, foxglove_port=served, clock=clock)

"""``swarm run``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from swarmabs_bag.run_folder import RunFolder
from swarmabs_cli.options import examples
from swarmabs_cli.output import open_page
from swarmabs_cli.runs import carry_out, run_options
from swarmabs_config.scenario import AnyScenario, on_plane
from swarmabs_core.errors import InputError
from swarmabs_run.ending import end_grace, interrupt_once
from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.orchestration.realtime_run import RealtimeRun
from swarmabs_run.run import SLOWEST_STEP, Outcome, RunOptions
from swarmabs_view.ports import check_foxglove
from swarmabs_view.viewers import PageViewer, markers_viewer

FOXGLOVE_PORT = 8765
"""The default port of Foxglove."""


@click.command(
    epilog=examples("run", "run pd_di_4 --set plane.angle=0.2 --duration 10", "run arise_het_20 --view --open")
)
@run_options
@click.option(
    "--agents-per-process",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    help="Robots per process, for large simulations.",
)
@click.option("--packed", is_flag=True, help="Broadcast one message instead of three: faster with many robots.")
@click.option("--realtime", is_flag=True, help="Run in real time, as on robots, with simulated bodies.")
@click.option("--steer", is_flag=True, help="Accept changes from the command `steer` during the run.")
@click.option(
    "--rate",
    type=click.FloatRange(0.0, min_open=True, max=1e6),
    help="With --steer: upper limit of simulated time per real time.  [default: none]",
)
@click.option("--view", is_flag=True, help="Show the run as a page in the browser.")
@click.option("--view-port", type=click.IntRange(0, 65535), help="With --view: port of the page.  [default: any]")
@click.option("--open", "open_browser", is_flag=True, help="With --view: open the browser.")
@click.option("--markers", is_flag=True, help="Publish markers, joint state and URDF for RViz and Foxglove.")
@click.option("--foxglove", is_flag=True, help="Serve the run to Foxglove on this machine (WebSocket).")
@click.option(
    "--foxglove-port",
    type=click.IntRange(1, 65535),
    default=FOXGLOVE_PORT,
    show_default=True,
    help="With --foxglove: TCP port.",
)
def run(
    *,
    agents_per_process: int,
    packed: bool,
    realtime: bool,
    steer: bool,
    rate: float | None,
    view: bool,
    view_port: int | None,
    open_browser: bool,
    **options: Any,
) -> int:
    """Run a scenario with one process per robot over DDS.

    SCENARIO is a built-in scenario (see `scenario list`), a YAML file, or a bag, whose scenario is run again. Runs are
    in lockstep unless you pass --realtime. With --view on a terminal, the page stays open after the run and plays its
    bag until you press Ctrl-C.
    """
    end_grace()
    given = {"--packed": packed, "--agents-per-process": agents_per_process > 1, "--steer": steer}
    if realtime and any(given.values()):
        option = next(name for name, there in given.items() if there)
        raise InputError(f"{option} cannot be combined with --realtime, it needs lockstep; remove one of them")
    if rate is not None and not steer:
        raise InputError("--rate needs --steer; add --steer, or remove --rate")
    if steer and options["no_bag"]:
        raise InputError("--steer cannot be combined with --no-bag, since changes are recorded; remove one of them")
    if not view and (view_port is not None or open_browser):
        option = "--open" if open_browser else "--view-port"
        raise click.UsageError(f"{option} needs --view; add --view, or remove {option}.")
    with PageViewer(view_port or 0, steered=steer) if view else nullcontext() as viewer:

        def execute(scenario: AnyScenario, folder: RunFolder, recording: RunOptions) -> Outcome:
            if viewer is not None:
                viewer.start(folder.path)
                click.echo(f"view: {viewer.url}", err=True)
                if viewer.steering_url is not None:
                    click.echo(f"view, to steer: {viewer.steering_url}", err=True)
                if open_browser:
                    open_page(viewer.url)
            with shown(folder.path):
                if realtime:
                    return RealtimeRun(on_plane(scenario, "real time"), folder, recording).run()
                asked = replace(
                    recording,
                    agents_per_process=agents_per_process,
                    packed=packed,
                    steered=steer,
                    step_seconds=_step_seconds(scenario, rate),
                )
                return LockstepRun(scenario, folder, asked).run()

        drawn = next((f"--{name}" for name in ("markers", "foxglove") if options[name]), None)

        def check(scenario: AnyScenario) -> None:
            if drawn is not None:
                on_plane(scenario, drawn)
            _step_seconds(scenario, rate)

        shown = _marker_viewers(options, clock=not realtime)
        code = carry_out(execute, realtime=realtime, check=check, steered=steer, **options)
        if viewer is not None and sys.stdin.isatty() and sys.stderr.isatty():
            interrupt_once()
            click.echo(f"view: {viewer.url} plays the bag until Ctrl-C", err=True)
            viewer.wait()
        return code


def _step_seconds(scenario: AnyScenario, rate: float | None) -> float:
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


def _marker_viewers(options: dict[str, Any], *, clock: bool) -> Callable[[Path], AbstractContextManager[None]]:
    """Remove the options of markers and Foxglove from those of a run; return a context manager that serves them.

    With `clock`, the time of the run is published, because it differs from that of the machine.
    """
    markers, foxglove, port = (options.pop(name) for name in ("markers", "foxglove", "foxglove_port"))
    if not (markers or foxglove):
        return lambda _: nullcontext()
    if foxglove:
        check_foxglove(port)
        click.echo(f"Foxglove: open a connection to ws://127.0.0.1:{port}", err=True)
    served = port if foxglove else None
    return lambda folder: markers_viewer(folder, ros=markers, foxglove_port=served, clock=clock)

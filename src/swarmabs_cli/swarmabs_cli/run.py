"""``swarm run`` and ``swarm simulate``."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from swarmabs_cli.elapsed import setup_seconds, since_start, startup_seconds
from swarmabs_cli.interrupts import interrupt_once, no_more_interrupts
from swarmabs_cli.markers import shown_beside, shown_options
from swarmabs_cli.output import json_option, print_json
from swarmabs_cli.view import open_page
from swarmabs_core.errors import InputError, RunError
from swarmabs_view.display import shown_progress

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_analysis.rerun import RecordedRun
    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_bag.splitting import Split
    from swarmabs_config.scenario import Scenario
    from swarmabs_run.orchestration.progress import Outcome, Progress
    from swarmabs_view.viewer_process import PageViewer

    Execute = Callable[[Scenario, RunFolder, bool, Split, Callable[[Progress], None]], Outcome]

RUNS = Path("runs")


def _whole(unit: str, largest: int) -> Callable[[click.Context, click.Parameter, str], int]:
    """Return what reads a whole number from 0 on, as the options of the same name of ``ros2 bag record`` take it."""

    def read(_context: click.Context, _option: click.Parameter, text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = -1
        if not 0 <= number <= largest:
            raise click.BadParameter(
                f"give a whole number of {unit} from 1 to {largest}, or 0 for a bag in one file, and not {text!r}: "
                "like the same option of ros2 bag record it takes no fractions."
            )
        return number

    return read


def _options(function: Callable[..., Any]) -> Callable[..., Any]:
    decorators = (
        click.argument("scenario", default="pd_het_4", metavar="[SCENARIO|FILE.yaml|BAG]"),
        click.option(
            "-o", "--output", type=click.Path(path_type=Path), help="Folder of the results.  [default: runs/NAME-NNN]"
        ),
        click.option(
            "--set", "overrides", multiple=True, metavar="A.B=VALUE", help="Change a value of the scenario; repeatable."
        ),
        click.option("--duration", metavar="SECONDS", help="Simulated time; the same as --set duration=SECONDS."),
        click.option("--no-bag", is_flag=True, help="Write no bag; digest and figures are computed all the same."),
        click.option(
            "--max-bag-size",
            default="0",
            callback=_whole("bytes", 2**63 - 1),
            metavar="BYTES",
            help="Size after which the bag goes on in a new file.  [default: never]",
        ),
        click.option(
            "--max-bag-duration",
            default="0",
            callback=_whole("seconds", 10**9),
            metavar="SECONDS",
            help="Simulated time after which the bag goes on in a new file.  [default: never]",
        ),
        json_option,
    )
    for decorator in reversed(decorators):
        function = decorator(function)
    return function


@click.command()
@_options
@click.option(
    "--agents-per-process",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    help="Robots that share a process, for large simulations.",
)
@click.option("--packed", is_flag=True, help="Send the robots the three broadcasts as one message: faster if many.")
@click.option("--realtime", is_flag=True, help="Let the clock make the steps, as on robots, with simulated bodies.")
@click.option("--steer", is_flag=True, help="Let the run be changed while it goes on, by the command `steer`.")
@click.option(
    "--rate",
    type=click.FloatRange(0.0, min_open=True, max=1e6),
    help="With --steer: simulated time per real time, at most.  [default: as fast as possible]",
)
@click.option("--view", is_flag=True, help="Show the run as a page in the browser.")
@click.option("--view-port", type=click.IntRange(0, 65535), help="With --view: port of the page.  [default: any]")
@click.option("--open", "open_browser", is_flag=True, help="With --view: open the page in the browser.")
@shown_options
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
    """Run a scenario as one process per robot over DDS, in lockstep or in real time.

    SCENARIO is a built-in scenario (`swarm scenario list`), a YAML file, or a bag, whose own scenario is run again.

    With --view, on a terminal, the page stays when the run is over, and plays its bag, until Ctrl-C.
    """
    given = {"--packed": packed, "--agents-per-process": agents_per_process > 1, "--steer": steer}
    if realtime and any(given.values()):
        option = next(name for name, there in given.items() if there)
        raise InputError(f"{option} is for runs in lockstep; leave it or --realtime out")
    if rate is not None and not steer:
        raise InputError("--rate is for a run with --steer; leave one of them out, or add the other")
    if steer and options["no_bag"]:
        raise InputError("--steer with --no-bag: what is done to a run is recorded; leave one of them out")
    if not view and (view_port is not None or open_browser):
        raise click.UsageError(f"{'--open' if open_browser else '--view-port'} is for a run with --view.")
    with _viewer(view_port or 0, steered=steer) if view else nullcontext() as viewer:

        def execute(
            scenario: Scenario,
            folder: RunFolder,
            record: bool,  # noqa: FBT001
            split: Split,
            show: Callable[[Progress], None],
        ) -> Outcome:
            from swarmabs_run.orchestration import LockstepRun, RealtimeRun  # noqa: PLC0415 - needs all of ROS

            if viewer is not None:
                viewer.start(folder.path)
                click.echo(f"view: {viewer.url}", err=True)
                if viewer.steering_url is not None:
                    click.echo(f"view, to steer: {viewer.steering_url}", err=True)
                if open_browser:
                    open_page(viewer.url)
            with shown(folder.path):
                if realtime:
                    return RealtimeRun(scenario, folder, record=record, on_progress=show, split=split).run()
                return LockstepRun(
                    scenario,
                    folder,
                    record=record,
                    on_progress=show,
                    agents_per_process=agents_per_process,
                    packed=packed,
                    split=split,
                    steered=steer,
                    step_seconds=_step_seconds(scenario, rate),
                ).run()

        shown = shown_beside(options, clock=not realtime)
        code = _carry_out(
            execute,
            realtime=realtime,
            check=lambda scenario: _step_seconds(scenario, rate),
            steered=steer,
            **options,
        )
        if viewer is not None and sys.stdin.isatty() and sys.stderr.isatty():
            interrupt_once()
            click.echo(f"view: {viewer.url} plays the bag until Ctrl-C", err=True)
            viewer.wait()
        return code


def _viewer(port: int, *, steered: bool) -> PageViewer:
    from swarmabs_view.viewer_process import PageViewer  # noqa: PLC0415 - slow, not for --help

    return PageViewer(port, steered=steered)


def _step_seconds(scenario: Scenario, rate: float | None) -> float:
    """Return the shortest wall time of a step, s; 0 for none.

    Raises
    ------
    InputError
        If a run that is as slow could not be told from one that stalls.
    """
    from swarmabs_run.steering.pace import SLOWEST  # noqa: PLC0415 - slow, not for --help

    seconds = 0.0 if rate is None else scenario.period / rate
    slowest = min(SLOWEST, 0.5 * scenario.lockstep.stall_timeout)
    if seconds > slowest:
        raise InputError(
            f"--rate {rate:g}: a step would take {seconds:g} s, and more than {slowest:g} s looks like a stall; use "
            f"at least {scenario.period / slowest:g}"
        )
    return seconds


@click.command()
@_options
def simulate(**options: Any) -> int:
    """Run a scenario in one process without DDS; it gives the same digest as `run`."""

    def execute(
        scenario: Scenario,
        folder: RunFolder,
        record: bool,  # noqa: FBT001
        split: Split,
        show: Callable[[Progress], None],
    ) -> Outcome:
        from swarmabs_run.simulated_run import simulate_run  # noqa: PLC0415 - as above

        return simulate_run(scenario, folder, record=record, on_progress=show, split=split)

    return _carry_out(execute, realtime=False, **options)


def _carry_out(
    execute: Execute,
    *,
    realtime: bool,
    scenario: str,
    output: Path | None,
    overrides: tuple[str, ...],
    duration: str | None,
    no_bag: bool,
    max_bag_size: int,
    max_bag_duration: int,
    as_json: bool,
    steered: bool = False,
    check: Callable[[Scenario], object] = bool,
) -> int:
    """Load, run, sum up, print; return the exit code."""
    from swarmabs_analysis.rerun import recorded_run  # noqa: PLC0415
    from swarmabs_bag.run_folder import new_run_folder, next_run_folder  # noqa: PLC0415 - slow, not for --help
    from swarmabs_bag.splitting import Split  # noqa: PLC0415
    from swarmabs_config.scenarios import find_scenario, names_bag  # noqa: PLC0415
    from swarmabs_config.theory import check_scenario  # noqa: PLC0415
    from swarmabs_core.theory.warnings import theory_warnings  # noqa: PLC0415
    from swarmabs_run.summary import Times, summarise, summary_table  # noqa: PLC0415

    if duration is not None:
        overrides = (*overrides, f"duration={duration}")
    recorded = recorded_run(scenario, overrides) if names_bag(scenario) else None
    loaded = find_scenario(scenario, overrides) if recorded is None else recorded.scenario
    check(loaded)
    if realtime:
        _check_realtime(loaded, recorded)
    folder = new_run_folder(output) if output is not None else next_run_folder(RUNS, loaded.name)
    differences = recorded.differences if recorded is not None else ()
    for warning in (*loaded.warnings(), *theory_warnings(check_scenario(loaded)), *differences):
        click.echo(f"warning: {warning}", err=True)
    loaded = loaded.resolved()
    if steered:
        click.echo(f"to steer the run: ./scripts/swarm steer {folder.path} ACTION VALUE", err=True)
    try:
        loading = since_start()
        with shown_progress(loaded) as show:
            outcome = execute(loaded, folder, not no_bag, Split(max_bag_size, max_bag_duration * 10**9), show)
            no_more_interrupts()
        summary = summarise(
            loaded,
            outcome,
            Times(since_start(), setup_seconds(), startup_seconds(loading, outcome)),
            rerun_of=recorded.judge(outcome, folder.bag, changed=bool(overrides) or steered)
            if recorded is not None
            else None,
        )
        folder.write_summary(summary)
    except OSError as error:
        from swarmabs_bag.errors import remedy  # noqa: PLC0415

        raise RunError(f"{folder.path}: {error.strerror or error}; {remedy(error)}") from error
    for warning in outcome.warnings:
        click.echo(f"warning: {warning}", err=True)
    if as_json:
        print_json(summary)
    else:
        from rich.console import Console  # noqa: PLC0415 - slow to import

        Console(soft_wrap=True, highlight=False).print(summary_table(summary, folder))
    if outcome.reason is not None:
        click.echo(f"error: {outcome.reason}", err=True)
    if summary["rerun_of"] is not None and summary["rerun_of"]["same"] is False:
        click.echo(f"error: this is not the run of {scenario}; see the command compare, and warnings above", err=True)
        return 1
    return 0 if outcome.status == "ok" else 1


def _check_realtime(scenario: Scenario, recorded: RecordedRun | None) -> None:
    """Refuse what is for lockstep only, before there is a folder.

    Raises
    ------
    InputError
        With what to do instead.
    """
    from swarmabs_config.realtime import check_realtime  # noqa: PLC0415 - as above

    if recorded is not None:
        raise InputError(
            f"{recorded.bag}: a bag is run again in lockstep, where it can reach the same digest; for a run in real "
            "time give the scenario.yaml of its folder"
        )
    check_realtime(scenario.resolved())

"""What `run` and `simulate` share: their options, and the way from a scenario to its summary."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click
from rich.console import Console

from swarmabs_analysis.rerun import RecordedRun, recorded_run
from swarmabs_bag.errors import remedy
from swarmabs_bag.run_folder import RunFolder, Split
from swarmabs_cli.elapsed import since_start, times
from swarmabs_cli.interrupts import no_more_interrupts
from swarmabs_cli.options import (
    duration_option,
    json_option,
    output_option,
    scenario_argument,
    set_option,
    together,
)
from swarmabs_cli.output import print_json, print_warnings, results_folder
from swarmabs_config.realtime import check_realtime
from swarmabs_config.scenario import Scenario
from swarmabs_config.scenarios import find_scenario, names_bag
from swarmabs_config.theory import check_scenario
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.run import Outcome, RunOptions
from swarmabs_run.summary import summarise, summary_table
from swarmabs_view.terminal import shown_progress

Execute = Callable[[Scenario, RunFolder, RunOptions], Outcome]
"""Runs a scenario and leaves its results in a folder, such as `swarmabs_run.simulated_run.simulate_run`."""


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


run_options = together(
    scenario_argument,
    output_option("Folder of the results.  [default: runs/NAME-NNN]"),
    set_option(),
    duration_option,
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


def carry_out(
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
    if duration is not None:
        overrides = (*overrides, f"duration={duration}")
    recorded = recorded_run(scenario, overrides) if names_bag(scenario) else None
    loaded = find_scenario(scenario, overrides) if recorded is None else recorded.scenario
    check(loaded)
    if realtime:
        _check_realtime(loaded, recorded)
    folder = results_folder(output, loaded.name)
    differences = recorded.differences if recorded is not None else ()
    print_warnings((*loaded.warnings(), *check_scenario(loaded).warnings(), *differences))
    loaded = loaded.resolved()
    if steered:
        click.echo(f"to steer the run: ./scripts/swarm steer {folder.path} ACTION VALUE", err=True)
    try:
        loading = since_start()
        with shown_progress(loaded) as show:
            split = Split(max_bag_size, max_bag_duration * 10**9)
            outcome = execute(loaded, folder, RunOptions(record=not no_bag, split=split, on_progress=show))
            no_more_interrupts()
        summary = summarise(
            loaded,
            outcome,
            times(loading, outcome),
            rerun_of=recorded.judge(outcome, folder.bag, changed=bool(overrides) or steered)
            if recorded is not None
            else None,
        )
        folder.write_summary(summary)
    except OSError as error:
        raise RunError(f"{folder.path}: {error.strerror or error}; {remedy(error)}") from error
    print_warnings(outcome.warnings)
    if as_json:
        print_json(summary)
    else:
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
    if recorded is not None:
        raise InputError(
            f"{recorded.bag}: a bag is run again in lockstep, where it can reach the same digest; for a run in real "
            "time give the scenario.yaml of its folder"
        )
    check_realtime(scenario.resolved())

"""Shared by the commands that run scenarios: the steps from a scenario to its summary."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import click
from rich.console import Console

from swarmabs_bag.errors import remedy
from swarmabs_bag.run.figures import tracking_of
from swarmabs_bag.run_folder import RunFolder, Split
from swarmabs_cli.output import print_json, print_warnings, results_folder
from swarmabs_config.installation import COMMAND
from swarmabs_config.realtime import check_realtime
from swarmabs_config.scenario import Scenario, warnings_of
from swarmabs_config.scenarios import find_scenario, names_bag
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.ending import no_more_interrupts
from swarmabs_run.orchestration.run_files import since_start
from swarmabs_run.run import Outcome, Progress, RunOptions
from swarmabs_run.summary import Summary, Times, summarise, summary_table
from swarmabs_view.terminal import ProgressDisplay, shown_progress

if TYPE_CHECKING:
    from swarmabs_analysis.rerun import RepeatableRun, Rerun
    from swarmabs_cli.options import RunParameters

Execute = Callable[[Scenario, RunFolder, RunOptions], Outcome]
"""Runs a scenario and leaves its results in a folder, such as `swarmabs_run.simulated_run.simulate_run`."""
SETUP = "SWARMABS_SETUP"
"""Environment variable in which ``scripts/swarm`` passes its process id and the duration of the set-up, s."""


def carry_out(
    execute: Execute,
    options: RunParameters,
    *,
    realtime: bool,
    steered: bool = False,
    meanwhile: bool = False,
    show: bool = False,
    begun: float = 0.0,
    check: Callable[[Scenario], object] = bool,
) -> int:
    """Load and run a scenario, and print the summary; return the exit code.

    With `meanwhile`, the theory is checked while other processes make the steps. The user ends a `show`, so that an
    interrupt after its first step is no failure. The times of the summary count from `begun`, the value of
    `since_start` when the run was requested, s; 0 for the run of the command itself.
    """
    scenario, bag_scenario, overrides = options["scenario"], options["bag_scenario"], options["overrides"]
    short = (("duration", options["duration"]), ("coordination", options["coordination"]))
    overrides = (*overrides, *(f"{name}={value}" for name, value in short if value is not None))
    if bag_scenario is not None and not names_bag(scenario):
        raise InputError(f"--scenario is for a bag without one, but {scenario} is not a bag; remove --scenario")
    recorded = _recorded_run(scenario, overrides, bag_scenario) if names_bag(scenario) else None
    loaded = find_scenario(scenario, overrides) if recorded is None else recorded.scenario
    check(loaded)
    if realtime:
        _check_realtime(loaded, recorded)
    folder = results_folder(options["output"], loaded.name)
    differences = recorded.differences if recorded is not None else ()
    print_warnings((*warnings_of(loaded), *differences))
    if not meanwhile:
        print_warnings(_theory_warnings(loaded))
    loaded = loaded.resolved()
    if steered:
        click.echo(f"to steer the run: {COMMAND} steer {folder.path} ACTION VALUE", err=True)
    split = Split(options["max_bag_size"], options["max_bag_duration"] * 10**9)

    def run(display: ProgressDisplay) -> Outcome:
        recording = RunOptions(record=not options["no_bag"], split=split, on_progress=display)
        if not meanwhile:
            return execute(loaded, folder, recording)
        with _theory_printed(loaded, display) as shown:
            return execute(loaded, folder, replace(recording, on_progress=shown))

    def judge(outcome: Outcome) -> Rerun | None:
        if recorded is None:
            return None
        return recorded.judge(outcome, folder.bag, changed=bool(overrides) or steered)

    outcome, summary = summed_up(loaded, folder, run, judge, begun)
    print_summary(loaded, summary, folder, outcome, as_json=options["as_json"])
    if show and outcome.status == "interrupted" and outcome.start_seconds is not None:
        return 0
    if outcome.reason is not None:
        click.echo(f"error: {outcome.reason}", err=True)
    if summary["rerun_of"] is not None and summary["rerun_of"]["same"] is False:
        click.echo(f"error: the digest differs from that of {scenario}; see the warnings above, and compare", err=True)
        return 1
    return 0 if outcome.status == "ok" else 1


def _recorded_run(bag: str, overrides: tuple[str, ...], scenario: str | None) -> RepeatableRun:
    """Return the run that a bag repeats."""
    from swarmabs_analysis.rerun import recorded_run  # noqa: PLC0415 - scenarios do not need what reads bags

    return recorded_run(bag, overrides, scenario=scenario)


def _theory_warnings(scenario: Scenario) -> tuple[str, ...]:
    from swarmabs_config.theory import theory_warnings  # noqa: PLC0415 - NumPy loads longer than a run starts

    return theory_warnings(scenario)


@contextmanager
def _theory_printed(scenario: Scenario, show: ProgressDisplay) -> Iterator[Callable[[Progress], None]]:
    """Yield a function that shows progress and, after the start of the run, checks the theory in a thread.

    The display prints the warnings, at the latest when the run has ended.
    """
    with ThreadPoolExecutor(1) as pool:
        checked: Future[tuple[str, ...]] | None = None
        printed = False

        def shown(progress: Progress) -> None:
            nonlocal checked, printed
            show(progress)
            if checked is None:
                if progress.phase != "starting":
                    checked = pool.submit(_theory_warnings, scenario)
            elif not printed and checked.done():
                printed = True
                show.warn(checked.result())

        try:
            yield shown
        finally:
            if checked is not None and not printed:
                show.warn(checked.result())


def _check_realtime(scenario: Scenario, recorded: RepeatableRun | None) -> None:
    """Reject what only lockstep supports, before the folder is made."""
    if recorded is not None:
        raise InputError(
            f"{recorded.bag}: a bag can be run again only in lockstep; remove --realtime, or name the scenario.yaml in "
            "its folder"
        )
    check_realtime(scenario.resolved())


def summed_up(
    scenario: Scenario,
    folder: RunFolder,
    run: Callable[[ProgressDisplay], Outcome],
    judge: Callable[[Outcome], Rerun | None],
    begun: float,
) -> tuple[Outcome, Summary]:
    """Run while showing the progress; return the outcome and the written summary.

    `judge` compares the run with the recorded one that it repeats, if it does. The times count from `begun`, as in
    `carry_out`. A run in which robots flew off has failed, unless it repeats what was recorded.
    """
    try:
        loading = since_start()
        with shown_progress(scenario, folder.path) as show:
            done = run(show)
            no_more_interrupts()
        rerun = judge(done)
        outcome = done.judged(repeats=rerun is not None and rerun["same"] is True)
        verdict = {"status": outcome.status, "reason": outcome.reason, "rerun_of": rerun}
        summary = {**summarise(scenario, done, times(loading, done, begun)), **verdict}
        folder.write_summary(summary)
    except OSError as error:
        raise RunError(f"{folder.path}: {error.strerror or error}; {remedy(error)}") from error
    return outcome, summary


def print_summary(
    scenario: Scenario,
    summary: Summary,
    folder: RunFolder,
    outcome: Outcome,
    *,
    as_json: bool,
) -> None:
    """Print the summary of a run."""
    print_warnings(outcome.warnings)
    if as_json:
        print_json(summary)
    else:
        Console(soft_wrap=True, highlight=False).print(summary_table(summary, folder, tracking_of(scenario)))
        if folder.bag.exists():
            click.echo(f"\n{COMMAND} view {folder.path} --open   # play the run in the browser")
            click.echo(f"{COMMAND} report {folder.path}   # write a report")


def setup_seconds() -> float:
    """Return the part of `since_start` that the set-up of the checkout took, s; 0 for commands that this one starts."""
    pid, _, seconds = os.environ.get(SETUP, "").partition(":")
    return float(seconds) if pid == str(os.getpid()) else 0.0


def times(loading: float, outcome: Outcome, begun: float = 0.0) -> Times:
    """Return the durations of a run, from the values of `since_start` at its beginning and at its request, s.

    The set-up belongs to the run of the command itself, which was requested at 0.
    """
    setup, start = 0.0 if begun else setup_seconds(), outcome.start_seconds
    return Times(since_start() - begun, setup, None if start is None else loading - begun - setup + start)

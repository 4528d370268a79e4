"""A run in one process without DDS, with the same results folder as a run of many."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_core.errors import RunError
from swarmabs_run.interruption import end_asked
from swarmabs_run.orchestration.progress import Outcome, Progress
from swarmabs_run.simulation import simulated_steps

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from swarmabs_bag.recording import Step
    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import Scenario
    from swarmabs_run.orchestration.progress import Phase

_TELL_EVERY = 0.1


def simulate_run(
    scenario: Scenario,
    folder: RunFolder,
    *,
    record: bool = True,
    on_progress: Callable[[Progress], None] | None = None,
    split: Split = ONE_FILE,
) -> Outcome:
    """Simulate a scenario and record it.

    Parameters
    ----------
    scenario : Scenario
        The scenario; generated robots are listed.
    folder : RunFolder
        An empty folder for the results.
    record : bool
        Whether to write a bag.
    on_progress : callable, optional
        Told how the run goes, some ten times a second.
    split : Split
        When the bag goes on in a new file, by default never.
    """
    folder.fill(scenario)
    with end_asked() as ended:  # from before there is a bag, so that it is completed whenever that is
        recording = Recording(scenario, folder.bag if record else None, driver="simulate", split=split)
        return record_steps(simulated_steps(scenario), scenario, recording, on_progress=on_progress, ended=ended)


def record_steps(
    steps: Iterator[Step],
    scenario: Scenario,
    recording: Recording,
    *,
    on_progress: Callable[[Progress], None] | None = None,
    ended: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Record steps that are computed in this process.

    Parameters
    ----------
    steps : iterator of Step
        The steps, computed while they are iterated over.
    scenario : Scenario
        What they are steps of.
    recording : Recording
        Where they go; it is completed, however they end.
    on_progress : callable, optional
        Told how the run goes, some ten times a second.
    ended : callable
        Tells whether an end was asked for before.
    """
    begun = told = time.monotonic()

    def tell(phase: Phase, now: float) -> None:
        latest = recording.latest
        if on_progress is not None and latest is not None:
            rate = latest.step / (now - begun) if now > begun else 0.0
            done = Progress(phase, 1, 1, latest.step, scenario.steps, rate, latest.angle, latest.error)
            on_progress(replace(done, robots=recording.summary()))

    try:
        with end_asked() as asked:
            for step in steps:
                recording.add(step)
                if asked() or ended():
                    return Outcome("interrupted", "interrupted", recording.abort("interrupted"))
                now = time.monotonic()
                if now - told >= _TELL_EVERY:
                    told = now
                    tell("running", now)
            stepping = time.monotonic() - begun
            tell("closing", begun + stepping)
            figures = recording.close()
    except RunError as error:
        return Outcome("failed", str(error), recording.abort(str(error)))
    return Outcome("ok", None, figures, 0.0, stepping)

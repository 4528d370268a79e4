"""A run in one process without DDS, with the same results folder as a run of many processes."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from swarmabs_bag.recorder.recording import Recording
from swarmabs_core.errors import RunError
from swarmabs_run.ending import end_asked
from swarmabs_run.run import DEFAULTS, Outcome, Progress, RunOptions
from swarmabs_run.simulation import simulated_steps

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import Scenario
    from swarmabs_run.run import Phase

_PROGRESS_INTERVAL = 0.1
"""Time, s, between two reports of progress."""


def simulate_run(scenario: Scenario, folder: RunFolder, options: RunOptions = DEFAULTS) -> Outcome:
    """Simulate a scenario that lists its generated robots, and record it in an empty folder."""
    folder.fill(scenario)
    with end_asked() as ended:  # entered before the bag is created, so that an interrupted bag is always completed
        bag = folder.bag if options.record else None
        recording = Recording(scenario, bag, driver="simulate", split=options.split)
        return _recorded(scenario, recording, options.on_progress, ended)


def _recorded(
    scenario: Scenario,
    recording: Recording,
    on_progress: Callable[[Progress], None] | None,
    ended: Callable[[], bool],
) -> Outcome:
    """Simulate and record; the recording is always completed, however the steps end."""
    begun = reported = time.monotonic()

    def report(phase: Phase, now: float) -> None:
        latest = recording.run.latest
        if on_progress is not None and latest is not None:
            rate = latest.step / (now - begun) if now > begun else 0.0
            done = Progress(phase, 1, 1, latest.step, scenario.steps, rate, latest.angle, latest.error)
            on_progress(replace(done, robots=recording.summary()))

    try:
        for step in simulated_steps(scenario):
            recording.add(step)
            if ended():
                return Outcome("interrupted", "interrupted", recording.abort("interrupted"))
            now = time.monotonic()
            if now - reported >= _PROGRESS_INTERVAL:
                reported = now
                report("running", now)
        stepping = time.monotonic() - begun
        report("closing", begun + stepping)
        figures = recording.close()
    except RunError as error:
        return Outcome("failed", str(error), recording.abort(str(error)))
    return Outcome("ok", None, figures, 0.0, stepping)

"""What the recorder node can take: alone with a process that feeds it, so that nothing else is in its way."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from swarmabs_bag.run_folder import new_run_folder
from swarmabs_cli.bench_framework.product import Watch, checked
from swarmabs_cli.bench_framework.scenarios import swarm_of
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, RECORDING_PROGRESS
from swarmabs_run.orchestration import LockstepRun
from swarmabs_run.orchestration.plan import RECORDER, ProcessPlan

if TYPE_CHECKING:
    from collections.abc import Sequence

MESSAGES_PER_SECOND = 30_000
"""Speed that the length of the run is made for."""
MOST = 150_000
"""Messages that are made beforehand at most."""
_COORDINATED = 4
"""Messages of a step that do not come from robots."""


@dataclass(frozen=True, slots=True)
class RecorderResult:
    """Speed of the recorder while it was fed.

    Parameters
    ----------
    messages_per_second : float
        From DDS to the bag.
    core_share : float, optional
        Share of one core that it used meanwhile; None if the run was too short to look twice.
    messages_per_core_second : float, optional
        What it could take if it had a core for itself, and somebody to fill it.
    """

    messages_per_second: float
    core_share: float | None
    messages_per_core_second: float | None


def measure_recorder(robots: int, *, warm_up: float, window: float) -> RecorderResult:
    """Feed a recorder with the messages of a swarm for about a window (s).

    Raises
    ------
    KeyboardInterrupt
        If it was interrupted.
    RunError
        If recorder or feeder failed.
    """
    per_step = robots + _COORDINATED
    messages = min(MOST, (warm_up + window) * MESSAGES_PER_SECOND)
    steps = max(20, round(messages / per_step))
    watch = Watch(warm_up)
    with TemporaryDirectory(prefix="swarmabs-bench-") as folder:
        run = new_run_folder(Path(folder) / "run")
        outcome = LockstepRun(swarm_of(robots, steps), run, on_progress=watch, arrange=_recorder_and_feeder).run()
    _, stepping = checked(outcome)
    rate = per_step * watch.rate(steps, stepping)
    load = watch.load()
    share = None if load is None else load.cpu_share.get("recorder")
    used = None if load is None or not share else per_step * load.steps / (share * load.seconds)
    return RecorderResult(rate, share, used)


def _recorder_and_feeder(planned: Sequence[ProcessPlan]) -> Sequence[ProcessPlan]:
    """Put a feeder in the place of everybody but the recorder."""
    recorder = next(process for process in planned if process.name == RECORDER)
    topics = (*MAIN_TOPICS, EVENTS, RECORDING_PROGRESS)
    match = {"match": [f"{topic.name} 1" for topic in topics]}
    kept = ("period_ns", "last_step", "stall_timeout", "repeat_after", "repeat_steps", "scenario_file")
    feeder = ProcessPlan(
        "feeder",
        "swarmabs_cli.bench_framework.feeder",
        0,
        {name: recorder.parameters[name] for name in kept} | match,
        (*MAIN_TOPICS, EVENTS),
        (RECORDING_PROGRESS,),
    )
    return replace(recorder, parameters=recorder.parameters | match), feeder

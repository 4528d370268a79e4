"""Throughput of the recorder node, which runs with only a feeder process."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from benchmarks.common import COORDINATED, Settings, measure_run, program, repeated, row, spread

from swarmabs_config.graph import RECORDER
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, RECORDING_PROGRESS
from swarmabs_run.orchestration.plan import ProcessPlan

MESSAGES_PER_SECOND = 30_000
"""Assumed speed, from which the length of the run follows."""
MOST = 150_000
"""Limit of precomputed messages."""
_LONGEST_WARM_UP = 0.5


@dataclass(frozen=True, slots=True)
class RecorderResult:
    """Throughput of the recorder.

    Parameters
    ----------
    messages_per_second : float
        From DDS to the bag.
    core_share : float, optional
        Share of one core that it used; None if the run was too short for two samples.
    messages_per_core_second : float, optional
        Extrapolated throughput with one core fully used.
    """

    messages_per_second: float
    core_share: float | None
    messages_per_core_second: float | None


def measure(settings: Settings) -> dict[str, Any]:
    """Feed a recorder with the messages of every swarm size."""
    rows = []
    for robots in settings.robots:
        results = repeated(robots, "recorder", settings, measure_recorder)
        names = ("messages_per_second", "core_share", "messages_per_core_second")
        summary = {name: spread(getattr(result, name) for result in results) for name in names}
        rows.append(row(robots, results, summary))
    return {"recorder": rows}


def measure_recorder(robots: int, settings: Settings) -> RecorderResult:
    """Feed a recorder with the messages of a swarm for about a window.

    Raises
    ------
    KeyboardInterrupt
        If the run was interrupted.
    RunError
        If recorder or feeder failed.
    """
    per_step = robots + COORDINATED
    warm_up = min(_LONGEST_WARM_UP, settings.warm_up)
    messages = min(MOST, (warm_up + settings.window) * MESSAGES_PER_SECOND)
    result = measure_run(
        robots, max(20, round(messages / per_step)), warm_up, packed=False, arrange=_recorder_and_feeder
    )
    load = result.load
    share = None if load is None else load.cpu_share.get("recorder")
    used = None if load is None or not share else per_step * load.steps / (share * load.seconds)
    return RecorderResult(per_step * result.steps_per_second, share, used)


def _recorder_and_feeder(planned: Sequence[ProcessPlan]) -> Sequence[ProcessPlan]:
    """Replace all processes except the recorder by a feeder."""
    recorder = next(process for process in planned if process.name == RECORDER)
    topics = (*MAIN_TOPICS, EVENTS, RECORDING_PROGRESS)
    match = {"match": [f"{topic.name} 1" for topic in topics]}
    kept = ("period_ns", "last_step", "stall_timeout", "repeat_after", "repeat_steps", "scenario_file")
    feeder = ProcessPlan(
        "feeder",
        "benchmarks.feeder",
        0,
        {name: recorder.parameters[name] for name in kept} | match,
        (*MAIN_TOPICS, EVENTS),
        (RECORDING_PROGRESS,),
    )
    return replace(recorder, parameters=recorder.parameters | match), feeder


if __name__ == "__main__":
    sys.exit(program(measure))

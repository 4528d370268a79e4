"""A sweep of pd_het_4 on all cores: start of its workers, and processor time relative to the simulations alone."""

from __future__ import annotations

import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import Any

import psutil
from benchmarks.common import Settings, program, row, spread, tell

from swarmabs_analysis.sweep.evaluate import Task
from swarmabs_analysis.sweep.executor import LocalExecutor
from swarmabs_analysis.sweep.study import Study, load_sweep
from swarmabs_bag.run.figures import RunFigures, tracking_of
from swarmabs_config import configure
from swarmabs_config.scenario import parse_scenario
from swarmabs_run.simulation import simulated_steps

_ROBOTS = 4
_SWEEP = """\
schema: 1
scenario: pd_het_4
random:
  plane.angle: {{uniform: [-0.1, 0.1]}}
samples: {cases}
seed: 1
"""
_ALONE = 10
"""Most cases that are also simulated alone."""


@dataclass(frozen=True, slots=True)
class SweepResult:
    """A sweep, and some of its cases simulated in a loop by as many processes.

    Parameters
    ----------
    start_seconds : float
        From the start of the workers until as many cases of one step are finished.
    cases_per_second : float
        Afterwards.
    cpu_ratio : float
        Processor time of all processes of the sweep per case, relative to that of the simulation alone.
    worker_bytes : int
        Resident memory of the largest worker at the end.
    growth : float
        This memory relative to that before the cases.
    """

    start_seconds: float
    cases_per_second: float
    cpu_ratio: float
    worker_bytes: int
    growth: float


def measure(settings: Settings) -> dict[str, Any]:
    """Measure sweeps of about a window each."""
    results = []
    for number in range(settings.repeat):
        tell(f"{_ROBOTS} robots, sweep, repeat {number + 1} of {settings.repeat}")
        results.append(measure_sweep(settings.window))
    names = SweepResult.__slots__
    summary = {name: spread(getattr(result, name) for result in results) for name in names}
    return {"sweep": [row(_ROBOTS, results, summary)]}


def measure_sweep(window: float) -> SweepResult:
    """Measure a sweep of about a window, s."""
    cores = len(os.sched_getaffinity(0))
    study = _study(max(2 * cores, round(cores * window / _alone([_study(1).task(0)]))))
    tasks = [study.task(index) for index in range(study.sweep.count)]
    first = [task._replace(overrides=(*task.overrides, "duration=0.01")) for task in tasks[:cores]]
    with closing(LocalExecutor(cores)) as executor:
        begun = time.monotonic()
        rows = executor.compute(iter((*first, *tasks)), lambda: None)
        for _ in first:
            next(rows)
        started, used, held = time.monotonic(), *_used()
        for _ in tasks:
            next(rows)
        ended, used_at_end, held_at_end = time.monotonic(), *_used()
    cpu = (used_at_end - used) / len(tasks)
    with ProcessPoolExecutor(cores, get_context("spawn")) as pool:  # as many at a time as in the sweep
        alone = fmean(pool.map(_alone, [tasks[:_ALONE]] * cores))
    return SweepResult(started - begun, len(tasks) / (ended - started), cpu / alone, held_at_end, held_at_end / held)


def _study(cases: int) -> Study:
    with TemporaryDirectory(prefix="swarmabs-bench-") as folder:
        file = Path(folder) / "bench.yaml"
        file.write_text(_SWEEP.format(cases=cases), encoding="utf-8")
        return load_sweep(file)


def _alone(tasks: list[Task]) -> float:
    """Return the processor time, s, that the simulation of a case takes in this process."""
    scenarios = [parse_scenario(task.scenario, overrides=task.overrides) for task in tasks]
    begun = time.process_time()
    for scenario in scenarios:
        figures = RunFigures(configure.reference(scenario), tracking_of(scenario))
        for step in simulated_steps(scenario):
            figures.add(step)
        figures.summary()
    return (time.process_time() - begun) / len(scenarios)


def _used() -> tuple[float, int]:
    """Return the processor time, s, of this process and its children, and the memory, bytes, of the largest child."""
    own = psutil.Process()
    children = own.children(recursive=True)
    times = [process.cpu_times() for process in (own, *children)]
    return sum(each.user + each.system for each in times), max(child.memory_info().rss for child in children)


if __name__ == "__main__":
    sys.exit(program(measure))

"""Shared by the programs: settings, the measured swarms, sampling of a run, and the summary of repeats."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.processes import Load, Memory, Sample, load_between, memory_of, sample, workers_of

from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenario import Scenario, load_scenario
from swarmabs_config.scenarios import builtin_scenarios
from swarmabs_core.errors import RunError
from swarmabs_run.ending import terminable
from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.orchestration.plan import Arrange
from swarmabs_run.run import Outcome, Progress, RunOptions

BASE = "arise_het_200"
STEP = 0.01
"""Period of the measured swarms, s."""
COORDINATED = 4
"""Messages per step that do not come from robots."""
_LATE = 0.9
"""Fraction of a run at which its processes are sampled for the second time; at its end they exit."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What to measure.

    Parameters
    ----------
    suites : tuple of str
        Suites to run.
    robots : tuple of int
        Swarm sizes, at least two each.
    repeat : int
        Number of repeats of each measurement.
    window, warm_up : float
        Duration of a measurement and of the warm-up before it, s.
    starts : int, optional
        Number of runs started and stopped for the suites start and memory; None for `repeat`.
    busy : bool
        Whether other processes load the machine during these suites.
    large : tuple of int
        Swarm sizes of the suite large.
    agents_per_process : int
        Robots per process in the suite large.
    """

    suites: tuple[str, ...] = ()
    robots: tuple[int, ...] = (4, 20, 64, 200)
    repeat: int = 3
    window: float = 6.0
    warm_up: float = 2.0
    starts: int | None = None
    busy: bool = False
    large: tuple[int, ...] = (200, 500, 1000, 2000)
    agents_per_process: int = 50


def program(measure: Callable[[Settings], dict[str, Any]]) -> int:
    """Run a program: it takes settings as JSON in its argument and prints its part of the result as JSON."""
    settings = Settings(**json.loads(sys.argv[1])) if len(sys.argv) > 1 else Settings()
    try:
        with terminable():
            found = measure(settings)
    except RunError as error:
        tell(f"error: {error}")
        return 1
    except KeyboardInterrupt:
        return 1
    json.dump(found, sys.stdout, allow_nan=False)
    return 0


def tell(line: str) -> None:
    """Print a line of progress to standard error."""
    print(line, file=sys.stderr, flush=True)


def repeated(robots: int, what: str, settings: Settings, measure: Callable[[int, Settings], Any]) -> list[Any]:
    """Measure a swarm size `repeat` times and return the results."""
    found = []
    for number in range(settings.repeat):
        tell(f"{robots} robots, repeat {number + 1} of {settings.repeat}: {what}")
        found.append(measure(robots, settings))
    return found


def row(robots: int, results: Iterable[Any], summary: dict[str, dict[str, float] | None]) -> dict[str, Any]:
    """Return the entry of a swarm size in the result."""
    return {"robots": robots, "summary": summary, "repeats": [asdict(result) for result in results]}


def spread(values: Iterable[float | None]) -> dict[str, float] | None:
    """Return median, smallest and largest of the values that are not None, None without values."""
    found = [value for value in values if value is not None]
    return {"median": median(found), "smallest": min(found), "largest": max(found)} if found else None


def swarm_of(robots: int, steps: int) -> Scenario:
    """Return a scenario with the adaptive controller, half of the robots of each kind.

    Parameters
    ----------
    robots : int
        At least two.
    steps : int
        At least one.
    """
    singles = robots // 2
    found: Scenario = load_scenario(
        builtin_scenarios()[BASE],
        (
            f"name=bench_{robots}",
            f"step={STEP}",
            f"duration={steps * STEP:.2f}",
            f"swarm.generate.single_integrator={singles}",
            f"swarm.generate.double_integrator={robots - singles}",
        ),
    ).resolved()
    return found


class Watch:
    """Samples the processes of a run after its warm-up and shortly before its end.

    Parameters
    ----------
    warm_up : float
        Time, s, after the first step that is not measured.
    with_memory : bool
        Whether to measure the memory of the processes, too, at the end of the warm-up.
    """

    def __init__(self, warm_up: float, *, with_memory: bool = False) -> None:
        self._warm_up = warm_up
        self._with_memory = with_memory
        self._processes: dict[int, str] = {}
        self.started: float | None = None
        self.first: Sample | None = None
        self.last: Sample | None = None
        self.memory: Memory | None = None

    def __call__(self, progress: Progress) -> None:
        """Handle progress of the run."""
        now = time.monotonic()
        if progress.phase != "running":
            return
        if self.started is None:
            self.started = now
            self._processes = workers_of(os.getpid())  # slow, so not between a step and its sample
        elif self.first is None:
            if not progress.step or now - self.started < self._warm_up:
                return
            if self._with_memory and self.memory is None:
                self.memory = memory_of(self._processes)  # slow, as above
            else:
                self.first = sample(self._processes, progress.step, now)
        elif self.last is None and progress.step >= _LATE * progress.steps:
            self.last = sample(self._processes, progress.step, now)

    def load(self) -> Load | None:
        """Return the load of the run between the two samples."""
        if self.first is None or self.last is None:
            return None
        return load_between(self.first, self.last, self._processes)

    def rate(self, steps: int, stepping_seconds: float) -> float:
        """Return the steps per second after the warm-up of a run of `steps` in `stepping_seconds`."""
        if self.started is None or self.first is None:
            return steps / stepping_seconds
        return (steps - self.first.step) / (self.started + stepping_seconds - self.first.time)


@dataclass(frozen=True, slots=True)
class RunResult:
    """Speed and load of a complete run.

    Parameters
    ----------
    steps_per_second : float
        From the end of the warm-up to the last recorded step.
    start_seconds, closing_seconds : float
        From the start of the run to its first step, and from the last recorded step to the end of all processes.
    load : Load, optional
        None if the run was too short for two samples.
    memory : Memory, optional
        At the end of the warm-up, if requested and if the run was long enough.
    """

    steps_per_second: float
    start_seconds: float
    closing_seconds: float
    load: Load | None
    memory: Memory | None = None


def measure_run(
    robots: int,
    steps: int,
    warm_up: float,
    *,
    with_memory: bool = False,
    arrange: Arrange = tuple,
    **options: Any,
) -> RunResult:
    """Run a swarm as ``swarm run`` does; `options` are fields of `RunOptions`.

    Raises
    ------
    KeyboardInterrupt
        If the run was interrupted; it handles Ctrl-C itself in order to close its bag.
    RunError
        If the run failed.
    """
    watch = Watch(warm_up, with_memory=with_memory)
    with TemporaryDirectory(prefix="swarmabs-bench-") as folder:
        made = new_run_folder(Path(folder) / "run")
        begun = time.monotonic()
        outcome = LockstepRun(swarm_of(robots, steps), made, RunOptions(on_progress=watch, **options), arrange).run()
        ended = time.monotonic()
    start, stepping = checked(outcome)
    return RunResult(watch.rate(steps, stepping), start, ended - begun - start - stepping, watch.load(), watch.memory)


def checked(outcome: Outcome) -> tuple[float, float]:
    """Return the start time and the stepping time, s, of a successful run.

    Raises
    ------
    KeyboardInterrupt
        If the run was interrupted.
    RunError
        If the run failed.
    """
    if outcome.status == "interrupted":
        raise KeyboardInterrupt
    if outcome.status != "ok" or not outcome.stepping_seconds or outcome.start_seconds is None:
        raise RunError(f"a measured run failed: {outcome.reason}")
    return outcome.start_seconds, outcome.stepping_seconds

"""The complete product, measured in the same way as the floors: real mathematics, recording on."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from swarmabs_bag.run_folder import new_run_folder
from swarmabs_cli.bench_framework.processes import Load, Memory, Sample, crew_of, load_between, memory_of, sample
from swarmabs_cli.bench_framework.scenarios import swarm_of
from swarmabs_core.errors import RunError
from swarmabs_run.orchestration import LockstepRun

if TYPE_CHECKING:
    from swarmabs_run.orchestration import Outcome, Progress

LATE = 0.9
"""Part of a run at which its processes are looked at for the second time; at its end they end."""


@dataclass(frozen=True, slots=True)
class ProductResult:
    """Speed of a complete run, and what it cost.

    Parameters
    ----------
    steps_per_second : float
        From the end of the warm-up to the last step recorded.
    start_seconds, closing_seconds : float
        From the beginning of the run to its first step, and from the last step recorded to the end of all processes.
    load : Load, optional
        None if the run was too short to look twice.
    """

    steps_per_second: float
    start_seconds: float
    closing_seconds: float
    load: Load | None


class Watch:
    """Looks at a run's processes after its warm-up and shortly before its end.

    Parameters
    ----------
    warm_up : float
        Time, s, after the first step that does not count.
    look_at_memory : bool
        Whether to measure the processes' memory too, at the end of the warm-up.
    """

    def __init__(self, warm_up: float, *, look_at_memory: bool = False) -> None:
        self._warm_up = warm_up
        self._look_at_memory = look_at_memory
        self._crew: dict[int, str] = {}
        self.started: float | None = None
        self.first: Sample | None = None
        self.last: Sample | None = None
        self.memory: Memory | None = None

    def __call__(self, progress: Progress) -> None:
        """Take notice of a run's progress."""
        now = time.monotonic()
        if progress.phase != "running":
            return
        if self.started is None:
            self.started = now
            self._crew = crew_of(os.getpid())  # takes its time, which must not stand between a step and its sample
        elif self.first is None:
            if not progress.step or now - self.started < self._warm_up:
                return
            if self._look_at_memory and self.memory is None:
                self.memory = memory_of(self._crew)  # takes its time, as above
            else:
                self.first = sample(self._crew, progress.step, now)
        elif self.last is None and progress.step >= LATE * progress.steps:
            self.last = sample(self._crew, progress.step, now)

    def load(self) -> Load | None:
        """Return what the run cost between the two looks."""
        if self.first is None or self.last is None:
            return None
        return load_between(self.first, self.last, self._crew)

    def rate(self, steps: int, stepping_seconds: float) -> float:
        """Return the steps per second after the warm-up of a run that made so many steps in so much time."""
        if self.started is None or self.first is None:
            return steps / stepping_seconds
        return (steps - self.first.step) / (self.started + stepping_seconds - self.first.time)


def measure_product(robots: int, steps: int, *, warm_up: float, packed: bool = False) -> ProductResult:
    """Run a swarm for so many steps as ``swarm run`` does, or ``swarm run --packed``.

    Raises
    ------
    KeyboardInterrupt
        If it was interrupted; a run takes Ctrl-C for itself, so that it can close its bag.
    RunError
        If it failed.
    """
    watch = Watch(warm_up)
    with TemporaryDirectory(prefix="swarmabs-bench-") as folder:
        begun = time.monotonic()
        made = new_run_folder(Path(folder) / "run")
        outcome = LockstepRun(swarm_of(robots, steps), made, on_progress=watch, packed=packed).run()
        ended = time.monotonic()
    start, stepping = checked(outcome)
    return ProductResult(
        watch.rate(steps, stepping),
        start,
        ended - begun - start - stepping,
        watch.load(),
    )


def checked(outcome: Outcome) -> tuple[float, float]:
    """Return the times (s) that a run took to start and to step, if it went well.

    Raises
    ------
    KeyboardInterrupt
        If it was interrupted.
    RunError
        If it failed.
    """
    if outcome.status == "interrupted":
        raise KeyboardInterrupt
    if outcome.status != "ok" or not outcome.stepping_seconds or outcome.start_seconds is None:
        raise RunError(f"a measured run failed: {outcome.reason}")
    return outcome.start_seconds, outcome.stepping_seconds

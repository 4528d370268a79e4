"""Large simulations: several robots in a process, each its own state machine that hears the broadcasts alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from swarmabs_bag.run_folder import new_run_folder
from swarmabs_cli.bench_framework.product import Watch, checked
from swarmabs_cli.bench_framework.scenarios import swarm_of
from swarmabs_run.orchestration import LockstepRun

if TYPE_CHECKING:
    from swarmabs_cli.bench_framework.processes import Load, Memory

ROBOT_STEPS_PER_SECOND = 25_000
"""Steps of single robots per second that the length of a run is made for."""
_FEWEST = 20


@dataclass(frozen=True, slots=True)
class LargeResult:
    """How a large simulation runs.

    Parameters
    ----------
    start_seconds : float
        From the beginning of the run to its first step.
    steps_per_second : float
        From the end of the warm-up to the last step recorded.
    memory : Memory, optional
        At the end of the warm-up; None if the run was too short, as for `load`.
    load : Load, optional
        What the steps cost.
    """

    start_seconds: float
    steps_per_second: float
    memory: Memory | None
    load: Load | None


def measure_large(robots: int, agents_per_process: int, *, warm_up: float, window: float) -> LargeResult:
    """Run a swarm, recording on, for about a window (s).

    Raises
    ------
    KeyboardInterrupt
        If it was interrupted.
    RunError
        If it failed.
    """
    steps = max(_FEWEST, round(ROBOT_STEPS_PER_SECOND / robots * (warm_up + window)))
    watch = Watch(warm_up, look_at_memory=True)
    with TemporaryDirectory(prefix="swarmabs-bench-") as folder:
        run = new_run_folder(Path(folder) / "run")
        outcome = LockstepRun(
            swarm_of(robots, steps), run, on_progress=watch, agents_per_process=agents_per_process
        ).run()
    start, stepping = checked(outcome)
    return LargeResult(start, watch.rate(steps, stepping), watch.memory, watch.load())

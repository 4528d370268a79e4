"""Large simulations: several robots share a process; each is a state machine that receives only the broadcasts."""

from __future__ import annotations

import sys
from typing import Any

from benchmarks.common import RunResult, Settings, measure_run, program, row, spread, tell

from swarmabs_core.errors import RunError

ROBOT_STEPS_PER_SECOND = 25_000
"""Assumed robot steps per second, from which the length of a run follows."""
_FEWEST_STEPS = 20


def measure(settings: Settings) -> dict[str, Any]:
    """Measure start, speed and memory; runs that fail are part of the result."""
    return {"large": [_row(robots, settings) for robots in settings.large]}


def _row(robots: int, settings: Settings) -> dict[str, Any]:
    results: list[RunResult] = []
    failures: list[str] = []
    shared = settings.agents_per_process
    steps = max(_FEWEST_STEPS, round(ROBOT_STEPS_PER_SECOND / robots * (settings.warm_up + settings.window)))
    for number in range(settings.repeat):
        tell(f"{robots} robots, {shared} per process, repeat {number + 1} of {settings.repeat}")
        try:
            result = measure_run(robots, steps, settings.warm_up, with_memory=True, agents_per_process=shared)
        except RunError as error:
            failures.append(str(error))
            tell(f"  {error}")
            continue
        tell(f"  first step after {result.start_seconds:.1f} s, {result.steps_per_second:.1f} steps/s")
        results.append(result)
    summary = {
        "start_seconds": spread(result.start_seconds for result in results),
        "steps_per_second": spread(result.steps_per_second for result in results),
        "total_bytes": spread(result.memory.total for result in results if result.memory is not None),
        "cpu_ms_per_step": spread(result.load.cpu_ms_per_step for result in results if result.load is not None),
    }
    return {**row(robots, results, summary), "agents_per_process": shared, "failures": failures}


if __name__ == "__main__":
    sys.exit(program(measure))

"""Simulated seconds per second: with and without a bag, and compared with SciPy on the same closed loop."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from benchmarks.common import Settings, checked, program, spread, swarm_of, tell
from benchmarks.continuous import METHOD, RTOL, solve

from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenario import Scenario, load_scenario, on_plane
from swarmabs_config.scenarios import builtin_scenarios
from swarmabs_run.run import RunOptions
from swarmabs_run.simulated_run import simulate_run
from swarmabs_run.simulation import simulate

SOLVER = f"scipy.integrate.solve_ivp, {METHOD}, rtol {RTOL:g}"
_PILOT = 20
"""Steps of the pilot run, from which the number of steps per window follows."""
_SOLVED_SECONDS = 30.0


@dataclass(frozen=True, slots=True)
class SolverResult:
    """Times for the closed loop of four single integrators under the PD controller.

    Parameters
    ----------
    simulate_seconds, solver_seconds : float
        Wall time of ``simulate --no-bag``, and of `SOLVER` in continuous time.
    ratio : float
        `simulate_seconds` / `solver_seconds`: below 1, simulate is faster.
    largest_difference : float
        Largest difference of the angles, rad; only simulate samples the control law.
    """

    simulated_seconds: float
    simulate_seconds: float
    solver_seconds: float
    ratio: float
    largest_difference: float


def measure(settings: Settings) -> dict[str, Any]:
    """Measure every swarm size, then four robots against the solver."""
    rows = []
    for robots in settings.robots:
        tell(f"{robots} robots: simulate with and without a bag")
        factors = [measure_simulate(robots, settings.window) for _ in range(settings.repeat)]
        with_bag, without_bag = zip(*factors, strict=True)
        summary = {"real_time_factor": spread(with_bag), "real_time_factor_without_bag": spread(without_bag)}
        rows.append({"robots": robots, "summary": summary})
    tell(f"simulate against {SOLVER}")
    solved = [measure_against_solver(_SOLVED_SECONDS) for _ in range(settings.repeat)]
    against = {
        "solver": SOLVER,
        "problem": "four single integrators under the PD controller, continuous time",
        "ratio": spread(result.ratio for result in solved),
        "repeats": [asdict(result) for result in solved],
    }
    return {"simulate": rows, "solver": against}


def measure_simulate(robots: int, window: float) -> tuple[float, float]:
    """Return simulated seconds per second of a swarm with and without a bag, each measured for about `window`, s.

    Raises
    ------
    KeyboardInterrupt
        If the run was interrupted.
    """
    for _ in range(2):  # the first run also imports modules
        pilot = _stepping_seconds(swarm_of(robots, _PILOT), record=False)
    scenario = swarm_of(robots, max(_PILOT, round(_PILOT * window / pilot)))
    duration = scenario.steps * scenario.period
    without_bag, with_bag = (_stepping_seconds(scenario, record=record) for record in (False, True))
    return duration / with_bag, duration / without_bag


def measure_against_solver(seconds: float) -> SolverResult:
    """Simulate and solve the same closed loop for a duration, s."""
    scenario = load_scenario(builtin_scenarios()["pd_si_4"], (f"duration={seconds:g}",)).resolved()
    simulated = _stepping_seconds(scenario, record=False)
    begun = time.perf_counter()
    angle = solve(on_plane(scenario, "the solver"))
    solved = time.perf_counter() - begun
    difference = float(np.abs(simulate(scenario).angle - angle).max())
    return SolverResult(seconds, simulated, solved, simulated / solved, difference)


def _stepping_seconds(scenario: Scenario, *, record: bool) -> float:
    with TemporaryDirectory(prefix="swarmabs-bench-") as folder:
        _, stepping = checked(simulate_run(scenario, new_run_folder(Path(folder) / "run"), RunOptions(record=record)))
    return stepping


if __name__ == "__main__":
    sys.exit(program(measure))

"""Speed of ``simulate``, by itself and against a general solver on the same closed loop."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_bag.run_folder import new_run_folder
from swarmabs_cli.bench_framework.continuous import METHOD, RTOL, solve
from swarmabs_cli.bench_framework.product import checked
from swarmabs_cli.bench_framework.scenarios import pd_of_four, swarm_of
from swarmabs_run.simulated_run import simulate_run
from swarmabs_run.simulation import simulate

if TYPE_CHECKING:
    from swarmabs_config.scenario import Scenario

SOLVER = f"scipy.integrate.solve_ivp, {METHOD}, rtol {RTOL:g}"
_PILOT = 20
"""Steps of the run that tells how many steps a window is."""


@dataclass(frozen=True, slots=True)
class SimulateResult:
    """Simulated seconds per second of wall time, with the bag and without."""

    real_time_factor: float
    real_time_factor_without_bag: float


@dataclass(frozen=True, slots=True)
class SolverResult:
    """The closed loop of four single integrators under the PD controller, so many seconds of it.

    Parameters
    ----------
    simulate_seconds, solver_seconds : float
        Wall time of ``simulate --no-bag``, and of `SOLVER` in continuous time.
    ratio : float
        The first by the second: below 1, simulate is faster.
    largest_difference : float
        Between the angles of both, rad: they solve the same problem up to the sampling of the control law.
    """

    simulated_seconds: float
    simulate_seconds: float
    solver_seconds: float
    ratio: float
    largest_difference: float


def measure_simulate(robots: int, *, window: float) -> SimulateResult:
    """Simulate a swarm with and without a bag for about a window (s) each.

    Raises
    ------
    KeyboardInterrupt
        If it was interrupted.
    """
    for _ in range(2):  # the first one imports what it needs
        pilot = _stepping_seconds(swarm_of(robots, _PILOT), record=False)
    scenario = swarm_of(robots, max(_PILOT, round(_PILOT * window / pilot)))
    duration = scenario.steps * scenario.period
    without_bag, with_bag = (_stepping_seconds(scenario, record=record) for record in (False, True))
    return SimulateResult(duration / with_bag, duration / without_bag)


def measure_against_solver(*, seconds: float) -> SolverResult:
    """Simulate and solve so many seconds of the same closed loop."""
    scenario = pd_of_four(seconds)
    simulated = _stepping_seconds(scenario, record=False)
    begun = time.perf_counter()
    angle = solve(scenario)
    solved = time.perf_counter() - begun
    difference = float(np.abs(simulate(scenario).angle - angle).max())
    return SolverResult(seconds, simulated, solved, simulated / solved, difference)


def _stepping_seconds(scenario: Scenario, *, record: bool) -> float:
    with TemporaryDirectory(prefix="swarmabs-bench-") as folder:
        _, stepping = checked(simulate_run(scenario, new_run_folder(Path(folder) / "run"), record=record))
    return stepping

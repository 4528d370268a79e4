"""What `simulate` is timed against solves the same problem."""

from __future__ import annotations

import numpy as np

from swarmabs_cli.bench_framework.continuous import solve
from swarmabs_cli.bench_framework.scenarios import pd_of_four
from swarmabs_run.simulation import simulate


def test_the_solver_and_the_simulation_agree_up_to_the_sampling() -> None:
    scenario = pd_of_four(5.0)
    angle = solve(scenario)
    assert angle.shape == (scenario.steps + 1,)
    assert np.abs(angle - simulate(scenario).angle).max() < 1e-3
    assert abs(angle[-1]) < 0.5 * abs(angle[0])

"""What `simulate` is timed against solves the same problem."""

from __future__ import annotations

from benchmarks.simulate import measure_against_solver


def test_the_solver_and_the_simulation_agree_up_to_the_sampling() -> None:
    found = measure_against_solver(5.0)
    assert 0.0 < found.largest_difference < 1e-3
    assert found.ratio == found.simulate_seconds / found.solver_seconds

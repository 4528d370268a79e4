"""The sampled closed loop against its continuous-time limit, solved independently (`oracle`)."""

import random

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.swarmabs_core.helpers import builtin
from tests.swarmabs_core.oracle import solve

from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_core.arrays import RunArrays
from swarmabs_run.simulation import simulate

TRANSIENT = 5.0
"""Until when a deviation belongs to the transient, s."""


def deviations(scenario: Scenario, run: RunArrays) -> NDArray[np.float64]:
    """Return the largest deviations of angle (rad), torque (N m) and inertia (kg m^2), in the transient and later."""
    exact = solve(scenario)
    differences = np.abs(
        [run.angle - exact.angle, run.abstract.torque - exact.torque, run.abstract.inertia - exact.inertia]
    )
    late = exact.time >= TRANSIENT
    return np.array([differences[:, ~late].max(axis=1), differences[:, late].max(axis=1, initial=0.0)])


# About three times what was seen, in the transient and afterwards.
BOUNDS = {
    "pd_si_4": ((9e-4, 2.0e-2, 1.0e-4), (4e-5, 5e-5, 3e-8)),
    "pd_di_4": ((2e-3, 2.4e-2, 1.4e-4), (1.2e-4, 1.4e-4, 1.4e-7)),
    "pd_het_4": ((1.5e-3, 2.3e-2, 1.1e-4), (9e-5, 1.1e-4, 2e-7)),
    "arise_si_4": ((1.1e-3, 1.4e-2, 1.8e-4), (8e-5, 1.1e-3, 4.5e-6)),
    "arise_di_4": ((2.9e-3, 4.5e-2, 2.0e-4), (1.6e-4, 1.8e-3, 1.1e-5)),
    "arise_het_4": ((9e-4, 2.3e-2, 1.0e-4), (1.2e-4, 1.5e-3, 1.6e-5)),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.full] * (name != "pd_het_4")) for name in BOUNDS]
)
def test_runs_of_the_paper_follow_the_continuous_loop_and_level_the_plane(name: str) -> None:
    """With PD, |th| < 0.01 rad after about 4 s, 4e-4 rad at 30 s, and all robots within .14 m."""
    run = simulate(builtin(name))
    assert (deviations(builtin(name), run) <= BOUNDS[name]).all()
    if name.startswith("pd"):
        angle = np.abs(run.angle)
        assert (angle[450:] < 0.01).all() and angle[-1] < 4e-4
        assert np.abs(run.agents.position).max() < 0.145


@pytest.mark.parametrize("name", ["pd_het_4", "arise_di_4"])
@pytest.mark.system
def test_deviation_halves_with_the_period(name: str) -> None:
    scenarios = [builtin(name, "duration=3", f"step={step}") for step in (0.01, 0.005, 0.0025)]
    coarse, fine, finest = (deviations(scenario, simulate(scenario))[0] for scenario in scenarios)
    assert (fine < 0.57 * coarse).all()
    assert (finest < 0.57 * fine).all()


@pytest.mark.parametrize("case", [0, 1, 2, *(pytest.param(case, marks=pytest.mark.full) for case in range(3, 8))])
def test_random_swarms_gains_and_periods(case: int) -> None:
    """3 to 40 robots of any kinds, up to twice the period: the bounds of the four robots still hold."""
    draw = random.Random(case)
    count = draw.randint(3, 40)
    single = draw.randint(0, count)
    k, kp, kd = draw.uniform(5.0, 15.0), draw.uniform(5.0, 15.0), draw.uniform(4.0, 8.0)
    controller, angle, amplitude = draw.choice([("pd", 0.1, 0.0), ("arise", 0.075, 0.1)])
    scenario = parse_scenario(
        f"""
        schema: 1
        duration: 8
        step: {draw.choice([0.005, 0.01, 0.02])}
        plane: {{angle: {angle}, disturbance: {{amplitude: {amplitude}}}}}
        controller: {{type: {controller}}}
        swarm:
          gains: {{k: [{k}, {k}], kp: [{kp}, {kp}], kd: [{kd}, {kd}]}}
          generate: {{single_integrator: {single}, double_integrator: {count - single}, seed: {case}}}
        """
    )
    assert (deviations(scenario, simulate(scenario)) <= ((5e-3, 5e-2, 7e-4), (4e-4, 1e-3, 2e-5))).all()

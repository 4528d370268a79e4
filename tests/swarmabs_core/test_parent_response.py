from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from tests.swarmabs_core.helpers import Run, builtin

from swarmabs_config.scenario import Scenario
from swarmabs_core.messages import AbstractState, PlaneState
from swarmabs_core.parent_response import TorqueEstimator
from swarmabs_core.plant import Friction

Array = NDArray[np.float64]

SMOOTH = Friction(0.1, 3.0, 2.0, 0.2, 3.0, 1.0)
J, JS = 0.5, 0.03


def swinging(period: float, end: float) -> tuple[Array, Array]:
    """Solve a plane under a torque and a disturbance that are given as functions of time by SciPy."""

    def rhs(t: float, x: Array) -> list[float]:
        forces = -np.cos(x[0]) * (1.0 + np.sin(t)) - 0.4 * np.sin(3.0 * t) - SMOOTH.torque(x[1])
        return [x[1], forces / (J + JS)]

    time = np.arange(0.0, end, period)
    return time, solve_ivp(rhs, (0.0, time[-1]), (0.3, 0.0), "DOP853", t_eval=time, rtol=1e-12, atol=1e-13).y


def mean_torque(time: Array, angle: Array) -> Array:
    """Return tau_s + tau_d/cos th in the middles of the periods."""
    middle = 0.5 * (time[1:] + time[:-1])
    return 1.0 + np.sin(middle) + 0.4 * np.sin(3.0 * middle) / np.cos(0.5 * (angle[1:] + angle[:-1]))


def test_without_filter_it_is_the_mean_over_the_period_to_second_order() -> None:
    errors = []
    for period in (0.02, 0.01, 0.005):
        time, (angle, rate) = swinging(period, 2.0)
        estimator = TorqueEstimator(J, SMOOTH, 1e9, period)
        found = np.array([estimator.update(th, w, JS)[0] for th, w in zip(angle, rate, strict=True)])
        assert found[0] == 0.0
        errors.append(np.abs(found[1:] - mean_torque(time, angle)).max())
    assert errors[2] < 1e-2
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.2)


def test_filter_is_of_first_order() -> None:
    """On a plane held by the friction of a constant rate, the estimate approaches -f(w)/cos th by 1 - e^(-lambda t)."""
    estimator = TorqueEstimator(J, SMOOTH, 20.0, 0.01)
    found = [estimator.update(0.3, 0.5, JS) for _ in range(60)]
    final = -SMOOTH.torque(0.5) / np.cos(0.3)
    expected = final * (1.0 - np.exp(-20.0 * 0.01 * np.arange(60)))
    assert [torque for torque, _ in found] == pytest.approx(expected, abs=1e-12)
    assert [rate for _, rate in found[1:]] == pytest.approx(np.diff(expected) / 0.01, abs=1e-10)


def test_noise_of_the_rate_is_spread_as_the_documentation_says() -> None:
    sigma, bandwidth, period = 1e-3, 50.0, 0.01
    still = Friction(0.0, 1.0, 1.0, 0.0, 1.0, 0.0)
    estimator = TorqueEstimator(J, still, bandwidth, period)
    noise = sigma * np.random.default_rng(3).standard_normal(20_000)
    found = np.array([estimator.update(0.0, w, JS)[0] for w in noise])
    share = 1.0 - np.exp(-bandwidth * period)
    expected = (J + JS) * sigma / period * share * np.sqrt(2.0 / (2.0 - share))
    assert found[100:].std() == pytest.approx(expected, rel=0.03)


def truth(scenario: Scenario, run: Run) -> tuple[Array, Array]:
    """Return time and the torque of weight and disturbance, from the robots' positions alone."""
    masses = {agent.id: agent.mass for agent in scenario.agents}
    weight = np.array(
        [9.81 * sum(masses[s.agent_id] * s.position for s in run.states(k)) for k in range(len(run.steps))]
    )
    time = np.arange(len(run.steps)) * scenario.period
    d = scenario.plane.disturbance
    angle = run.column(PlaneState, "angle")
    return time, weight + d.amplitude * np.sin(d.angular_frequency * time) / np.cos(angle)


@pytest.mark.parametrize("name", ["pd_si_4", "arise_si_4", "pd_het_4"])
def test_swarm_controlled_by_the_planes_response(name: str) -> None:
    scenario = builtin(name, "duration=15", "observer.type=parent_response")
    run = Run(scenario)
    time, expected = truth(scenario, run)
    error = np.abs(run.column(AbstractState, "torque") - expected)
    assert error[time > 5.0].max() < 1e-4
    assert error[(time > 0.5) & (time < 5.0)].max() < 2e-2


def test_what_is_not_measured_is_compensated_since_the_plane_feels_it() -> None:
    errors = {}
    for observer in ("sum", "parent_response"):
        scenario = builtin("arise_si_4", "duration=20", f"observer.type={observer}")
        run = Run(scenario)
        time = np.arange(len(run.steps)) * scenario.period
        reference = 0.7 * np.sin(0.0471238898038469 * time)
        errors[observer] = np.abs(reference - run.column(PlaneState, "angle"))[time > 10.0].max()
    assert errors["parent_response"] < 0.2 * errors["sum"]


def test_inertia_is_that_of_the_robots() -> None:
    run = Run(builtin("pd_si_4", "duration=1", "observer.type=parent_response"))
    for step in range(101):
        expected = sum(s.mass * s.position**2 for s in run.states(step))
        assert run.one(AbstractState, step).inertia == pytest.approx(expected, rel=1e-14)

"""Metrics of step responses, against python-control and against the formulas of second-order systems."""

from math import exp, pi, sqrt

import control
import numpy as np
import pytest

from swarmabs_analysis.step_response import step_response
from swarmabs_run.simulation import simulate

TIME = np.linspace(0.0, 20.0, 4001)


@pytest.mark.parametrize("damping", [0.2, 0.5, 0.7, 1.0, 1.5])
@pytest.mark.parametrize(("start", "end"), [(0.0, 1.0), (0.1, 0.0), (-0.2, 0.05)])
def test_a_second_order_system_agrees_with_control_and_textbook(damping: float, start: float, end: float) -> None:
    system = control.tf([4.0], [1.0, 4.0 * damping, 4.0])
    unit = np.asarray(control.step_response(system, TIME).outputs)
    response = step_response(TIME, start + (end - start) * unit, np.full(len(TIME), end))
    assert response is not None
    oracle = control.step_info(unit, TIME, final_output=unit[-1])
    assert response.rise_time == pytest.approx(oracle["RiseTime"], abs=0.006)
    assert response.settling_time == pytest.approx(oracle["SettlingTime"], abs=0.006)
    assert response.overshoot == pytest.approx(oracle["Overshoot"], abs=1e-6)
    expected = 100.0 * exp(-pi * damping / sqrt(1.0 - damping**2)) if damping < 1.0 else 0.0
    assert response.overshoot == pytest.approx(expected, abs=0.1)
    assert response.steady_state_error == pytest.approx(0.0, abs=2e-3)


def test_metrics_are_those_of_the_samples_by_hand() -> None:
    """From 10 % in the sample at 3 s to 90 % at 5 s; the last sample outside the band of 2 % is at 8 s."""
    value = np.array([0.0, 0.0, 0.05, 0.1, 0.5, 0.92, 1.2, 1.01, 0.95, 0.99, 1.0, 1.0])
    reference = np.where(np.arange(len(value)) < 1, 0.0, 1.05)
    response = step_response(np.arange(len(value), dtype=float), value, reference)
    assert response is not None
    assert (response.at, response.rise_time, response.settling_time) == (1.0, 2.0, 8.0)
    assert response.overshoot == pytest.approx(20.0)
    assert response.steady_state_error == pytest.approx(0.05)


def test_the_last_step_counts_and_an_error_that_remains_is_reported() -> None:
    reference = np.where(TIME < 10.0, 1.0, 3.0)
    value = np.where(TIME < 10.0, 1.0, 1.0 + 1.5 * (1.0 - np.exp(-(TIME - 10.0))))
    response = step_response(TIME, value, reference)
    assert response is not None
    assert response.at == pytest.approx(10.0)
    assert response.rise_time == pytest.approx(np.log(9.0), abs=0.01)
    assert response.settling_time == pytest.approx(np.log(50.0), abs=0.02)
    assert response.overshoot == 0.0
    assert response.steady_state_error == pytest.approx(0.5, abs=1e-3)


def test_what_is_no_step_response_has_no_metrics() -> None:
    flat = np.zeros(len(TIME))
    assert step_response(TIME, np.sin(TIME), 0.1 * np.sin(TIME)) is None
    assert step_response(TIME, flat, flat) is None
    assert step_response(TIME, np.where(TIME > 5.0, np.nan, TIME), flat) is None
    assert step_response(TIME[:0], flat[:0], flat[:0]) is None


def test_metrics_of_a_run_with_an_offset_of_the_reference() -> None:
    offset = {"kind": "reference", "at": 8.0, "offset": 0.1}
    run = simulate("pd_het_4", {"duration": 20.0, "faults": [offset]})
    response = step_response(run.time, run.angle, run.reference)
    assert response is not None
    after = run.angle[run.time >= 8.0]
    oracle = control.step_info(after - after[0], run.time[run.time >= 8.0] - 8.0, final_output=after[-1] - after[0])
    assert response.at == 8.0
    assert response.rise_time == pytest.approx(oracle["RiseTime"], abs=0.011)
    assert response.settling_time == pytest.approx(oracle["SettlingTime"], abs=0.011)
    assert response.steady_state_error == pytest.approx(0.1 - after[-1])

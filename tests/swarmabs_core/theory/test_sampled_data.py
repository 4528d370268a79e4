"""Limits of sampled time against closed forms, other libraries and runs that just converge or just diverge."""

from __future__ import annotations

import json
from math import exp, pi, sin

import control
import numpy as np
import pytest
from scipy.signal import cont2discrete
from tests.swarmabs_core.helpers import Run, builtin

from swarmabs_core.messages import PlaneState
from swarmabs_core.theory import sampled_data


@pytest.mark.parametrize(("gain", "delay"), [(10.0, 0), (10.0, 1), (3.7, 2), (25.0, 6)])
def test_single_integrators_have_a_limit_in_closed_form(gain: float, delay: int) -> None:
    # e[k+1] = e[k] - K h e[k-n] is stable iff 0 < K h < 2 sin(pi/(2 (2 n + 1))).
    limit = sampled_data.largest_period(sampled_data.single_integrator_loop(gain), delay)
    assert limit == pytest.approx(2.0 * sin(pi / (2.0 * (2 * delay + 1))) / gain, rel=1e-6)


def test_the_papers_single_integrators_bear_fifteen_steps() -> None:
    # 0.1 < 2 sin(pi/(2 (2 n + 1))) up to n = 15: 0.10128 and 0.09516.
    assert sampled_data.largest_delay(sampled_data.single_integrator_loop(10.0), 0.01) == 15


@pytest.mark.parametrize(("kp", "kd"), [(10.0, 5.0), (10.0, 1.0), (40.0, 3.0), (4.0, 30.0)])
def test_double_integrators_have_a_limit_in_closed_form(kp: float, kd: float) -> None:
    # Jury's conditions of z^2 - (2 - kd h - kp h^2/2) z + 1 - kd h + kp h^2/2.
    limit = sampled_data.largest_period(sampled_data.double_integrator_loop(kp, kd))
    assert limit == pytest.approx(min(2.0 / kd, 2.0 * kd / kp), rel=1e-6)


@pytest.mark.parametrize("delay", [1, 4])
def test_delayed_double_integrators_converge_below_and_diverge_above_the_limit(delay: int) -> None:
    limit = sampled_data.largest_period(sampled_data.double_integrator_loop(10.0, 5.0), delay)
    integrators = np.array([[0.0, 1.0], [0.0, 0.0]])

    def size(period: float) -> float:
        free, entry, *_ = cont2discrete((integrators, np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1))), period)
        states = [np.array([1.0, 0.0])] * (delay + 1)
        for _ in range(4000):
            command = -(10.0 * states[-1 - delay][0] + 5.0 * states[-1 - delay][1])
            states.append(free @ states[-1] + entry[:, 0] * command)
        return float(np.abs(states[-1]).max())

    assert size(0.98 * limit) < 0.1
    assert size(1.02 * limit) > 10.0


@pytest.mark.parametrize(("mass", "damping", "ksd"), [(0.3552, 0.729, 1.0), (0.25, 0.0, 2.0)])
def test_added_damping_has_a_limit(mass: float, damping: float, ksd: float) -> None:
    limit = sampled_data.largest_period(sampled_data.added_damping_loop(mass, damping, ksd))

    def factor(period: float) -> float:  # of v over a period with the force -k_sd v held
        if not damping:
            return 1.0 - ksd * period / mass
        decay = exp(-damping * period / mass)
        return decay - ksd * (1.0 - decay) / damping

    assert factor(limit) == pytest.approx(-1.0, abs=1e-6)


def test_strong_natural_damping_bears_any_added_one() -> None:
    limit = sampled_data.largest_period(sampled_data.added_damping_loop(0.5, 2.0, 1.0))
    assert limit == sampled_data.LONGEST_PERIOD


def test_companion_matrix_is_that_of_a_delayed_transfer_function() -> None:
    period, delay = 0.02, 3
    plant = control.c2d(control.tf([1.0], [1.0, 0.0, 0.0]), period)
    loop = control.feedback(plant * control.tf([1.0], [1.0] + [0.0] * delay, period) * 10.0, 1)
    found = np.linalg.eigvals(sampled_data.double_integrator_loop(10.0, 0.0)(period, delay))
    poles = control.poles(loop)
    for pole in poles:  # the others are 0: histories that are not fed back
        assert np.abs(found - pole).min() < 1e-6


def test_plane_without_swarm_errors_is_the_continuous_loop_for_short_periods() -> None:
    # A fast swarm and a short period: what remains is plane, feedback and filter.
    loop = sampled_data.parent_loop(0.525, 1.0, (3.1623, 3.2859), (0.0, 0.0), (2000.0, None))(1e-4, 0)
    values = np.linalg.eigvals(loop).astype(complex)
    found = np.log(values[values != 0]) / 1e-4  # the integral is not used
    w = 50.0
    continuous = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [0.0, -1.0 / 0.525, -1.0 / 0.525, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [w * w * 3.1623, w * w * 3.2859, -w * w, -2.0 * w],
        ]
    )
    for pole in np.linalg.eigvals(continuous):
        assert np.abs(found - pole).min() < 1e-2 * abs(pole)


@pytest.mark.parametrize("kind", ["si", "di"])
@pytest.mark.parametrize("controller", ["pd", "arise"])
def test_runs_converge_below_and_diverge_above_the_limit(kind: str, controller: str) -> None:
    """Simulate the whole system near rest, with linear friction and robots without damping."""
    delay = 4
    swarm = (10.0, None) if kind == "si" else (10.0, 5.0)
    # Of ARISE (ks + 1) (alpha1, 1) and ((ks + 1) alpha2 + beta/smoothing) (alpha1, 1).
    feedback, integral = ((3.1623, 3.2859), (0.0, 0.0)) if controller == "pd" else ((2.0, 2.0), (62 / 3, 62 / 3))
    limit = sampled_data.largest_period(sampled_data.parent_loop(0.525, 1.0, feedback, integral, swarm), delay)
    robots = [
        {"id": number, "kind": "single_integrator", "mass": 0.5, "position": position}
        if kind == "si"
        else {"id": number, "kind": "double_integrator", "damping": 0.0, "mass": 0.5, "position": position}
        for number, position in enumerate((0.0125**0.5, -(0.0125**0.5)) * 2, start=1)
    ]
    common = [
        "plane={angle: 1.0e-7, friction: [0, 1000, 700, 0, 1000, 1]}",
        f"faults=[{{kind: delay, steps: {delay}}}]",
        f"swarm={{agents: {json.dumps(robots)}, gains: {{ksd: 0.0}}}}",
        *(["controller.trajectory={type: constant, angle: 0.0}"] if controller == "arise" else []),
    ]

    def growth(factor: float) -> float:
        step = round(factor * limit, 6)
        times = [f"step={step}", f"duration={round(1000 * step, 6)}"]
        angles = np.abs(Run(builtin(f"{controller}_{kind}_4", *times, *common)).column(PlaneState, "angle"))
        return float(angles[-300:].max() / angles[400:700].max())

    assert growth(0.98) < 0.9
    assert growth(1.02) > 1.1

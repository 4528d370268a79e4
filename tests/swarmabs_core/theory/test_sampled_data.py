"""Limits of sampled time against closed forms and runs that just converge or just diverge."""

import json
from math import exp, pi, sin

import numpy as np
import pytest
from tests.swarmabs_core.helpers import Run, builtin

from swarmabs_core.messages import PlaneState
from swarmabs_core.theory import sampled_data


@pytest.mark.parametrize(("gain", "delay"), [(10.0, 0), (10.0, 1), (3.7, 2), (25.0, 6)])
def test_single_integrators_have_a_limit_in_closed_form(gain: float, delay: int) -> None:
    # e[k+1] = e[k] - K h e[k-n] is stable iff 0 < K h < 2 sin(pi/(2 (2 n + 1))).
    limit = sampled_data.largest_period(sampled_data.single_integrator_loop(gain), delay)
    assert limit == pytest.approx(2.0 * sin(pi / (2.0 * (2 * delay + 1))) / gain, rel=1e-6)


@pytest.mark.parametrize(("kp", "kd"), [(10.0, 5.0), (10.0, 1.0), (40.0, 3.0), (4.0, 30.0)])
def test_double_integrators_have_a_limit_in_closed_form(kp: float, kd: float) -> None:
    # Jury's conditions of z^2 - (2 - kd h - kp h^2/2) z + 1 - kd h + kp h^2/2.
    limit = sampled_data.largest_period(sampled_data.double_integrator_loop(kp, kd))
    assert limit == pytest.approx(min(2.0 / kd, 2.0 * kd / kp), rel=1e-6)


@pytest.mark.parametrize(("mass", "damping", "ksd"), [(0.3552, 0.729, 1.0), (0.25, 0.0, 2.0)])
def test_added_damping_has_a_limit(mass: float, damping: float, ksd: float) -> None:
    limit = sampled_data.largest_period(sampled_data.added_damping_loop(mass, damping, ksd))

    def factor(period: float) -> float:  # of v over a period with the force -k_sd v held
        if not damping:
            return 1.0 - ksd * period / mass
        decay = exp(-damping * period / mass)
        return decay - ksd * (1.0 - decay) / damping

    assert factor(limit) == pytest.approx(-1.0, abs=1e-6)


def test_loops_without_a_limit_or_without_any_stable_period_are_told() -> None:
    strong = sampled_data.added_damping_loop(0.5, 2.0, 1.0)  # natural damping bears any added one
    assert sampled_data.largest_period(strong) == 10.0
    assert sampled_data.largest_delay(strong, 0.01) == 100
    driven = sampled_data.single_integrator_loop(-1.0)
    assert sampled_data.largest_period(driven) == 0.0
    assert sampled_data.largest_delay(driven, 0.01) == -1
    assert sampled_data.largest_delay(sampled_data.single_integrator_loop(10.0), 0.01) == 15


@pytest.mark.parametrize(
    ("controller", "kind", "height", "compensated"),
    [
        ("pd", "di", 0.03, "false"),
        ("arise", "si", 0.02, "true"),
        ("pid", "si", 0.02, "false"),
    ],
)
@pytest.mark.system
def test_runs_converge_below_and_diverge_above_the_limit(
    controller: str, kind: str, height: float, compensated: str
) -> None:
    """Simulate the whole system near rest, with linear friction and robots without damping."""
    delay = 4
    swarm = (10.0, None) if kind == "si" else (10.0, 5.0)
    # Of ARISE (ks + 1) (alpha1, 1) and ((ks + 1) alpha2 + beta/smoothing) (alpha1, 1).
    feedback, integral = {
        "pd": ((3.1623, 3.2859), (0.0, 0.0)),
        "pid": ((6.68, 3.72), (2.59, 0.0)),
        "arise": ((2.0, 2.0), (62 / 3, 62 / 3)),
    }[controller]
    weight, inertia = 9.81 * (4 * 0.5 * height + 2.0 * height), 0.525 + 4 * 0.5 * height**2
    feedback = feedback[0] + weight * (compensated == "true"), feedback[1]
    loop = sampled_data.parent_loop(inertia, 1.0, feedback, integral, swarm, (weight, height / 9.81))
    limit = sampled_data.largest_period(loop, delay)
    robot: dict[str, object] = (
        {"kind": "single_integrator"} if kind == "si" else {"kind": "double_integrator", "damping": 0.0}
    )
    positions = (0.0125**0.5, -(0.0125**0.5)) * 2
    robot["center_height"] = height
    robots = [{"id": number, "mass": 0.5, "position": p, **robot} for number, p in enumerate(positions, start=1)]
    common = [
        f"plane={{angle: 1.0e-7, friction: [0, 1000, 700, 0, 1000, 1], mass: 2.0, center_height: {height}}}",
        *(["controller.type=pid"] if controller == "pid" else []),
        f"controller.height_compensation={compensated}",
        f"faults=[{{kind: delay, steps: {delay}}}]",
        f"swarm={{agents: {json.dumps(robots)}, gains: {{ksd: 0.0}}}}",
        *(["controller.trajectory={type: constant, angle: 0.0}"] if controller == "arise" else []),
    ]

    def growth(factor: float) -> float:
        step = round(factor * limit, 6)
        times = [f"step={step}", f"duration={round(1000 * step, 6)}"]
        angles = np.abs(
            Run(builtin(f"{'arise' if controller == 'arise' else 'pd'}_{kind}_4", *times, *common)).column(
                PlaneState, "angle"
            )
        )
        return float(angles[-300:].max() / angles[400:700].max())

    assert growth(0.98) < 0.9
    assert growth(1.02) > 1.1

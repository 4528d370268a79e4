"""Local stability of the plane under PID, against the roots of the polynomial and simulated runs."""

import json

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from tests.swarmabs_core.helpers import builtin

from swarmabs_config.theory import check_scenario, setting
from swarmabs_core.theory.check import warnings
from swarmabs_core.theory.pid import hurwitz_conditions
from swarmabs_core.theory.report import Coverage, Theorem, Verdict
from swarmabs_run.simulation import simulate

PID = "controller.type=pid"
gains = st.floats(0.0, 20.0)


def pid_theorem(*overrides: str) -> Theorem:
    (theorem,) = (one for one in check_scenario(builtin("pd_het_4", PID, *overrides)).theorems if one.applicable)
    assert theorem.label == "PID"
    return theorem


@settings(max_examples=200)
@given(gains, gains, gains, st.floats(0.01, 5.0), st.floats(0.0, 5.0), st.floats(-2.0, 10.0))
def test_the_conditions_hold_exactly_if_all_roots_have_negative_real_parts(
    k1: float, k2: float, k3: float, inertia: float, slope: float, toppling: float
) -> None:
    conditions = list(hurwitz_conditions((k1, k2, k3), inertia, slope, toppling))
    assume(all(abs(condition.margin) > 1e-3 for condition in conditions) and k2 + slope > 1e-3)
    roots = np.roots([inertia, k2 + slope, k1 - toppling, k3])
    assert all(condition.verdict is Verdict.HOLDS for condition in conditions) == (roots.real.max() < 0.0)


def test_the_theorem_is_local_so_the_scenario_is_neither_covered_nor_warned_of() -> None:
    """(3.72 + 1) 6.68 and (0.5 + 0.0125/4 + 0.025) 2.59, with the integral's limit of 0.5 N m."""
    report = check_scenario(builtin("pd_het_4", PID))
    assert report.verdict is Coverage.UNKNOWN
    assert [condition.name for condition in pid_theorem().of(Verdict.UNKNOWN)] == ["initial state"]
    (routh,) = (condition for condition in pid_theorem().conditions if condition.name == "Routh")
    assert (routh.corrected.value, routh.corrected.bound) == pytest.approx((31.5296, 1.36785), abs=1e-3)
    assert list(warnings(setting(builtin("pd_het_4", PID)))) == []
    assert all("PID" not in one.label for one in check_scenario(builtin("pd_het_4")).theorems)
    json.dumps(report.document(), allow_nan=False)


@pytest.mark.parametrize(
    ("overrides", "failing"),
    [
        (("controller.gains=[0, 3, 1]",), {"k1", "Routh"}),
        (("controller.gains=[3, 3, 0]",), {"k3"}),
        (("controller.gains=[1, 0.1, 3]",), {"Routh"}),
        (("controller.integral_limit=3",), {"integral limit"}),
        (("manifold.torque_max=0.4",), {"integral limit"}),
        (("plane={mass: 10, center_height: 0.1}",), {"k1", "Routh"}),
        (("plane={mass: 10, center_height: 0.1}", "controller.height_compensation=true"), set()),
        (("plane={mass: 6, center_height: 0.1}",), set()),
        (("plane.disturbance.amplitude=0.1",), {"disturbance"}),
    ],
)
def test_what_fails(overrides: tuple[str, ...], failing: set[str]) -> None:
    assert {condition.name for condition in pid_theorem(*overrides).failed} == failing


LINEAR = "plane.friction=[0, 1000, 700, 0, 1000, 1]"
FAST = "swarm.gains={k: [100, 100], kp: [2500, 2500], kd: [100, 100]}"


@pytest.mark.parametrize(("share", "grows"), [(0.8, False), (1.2, True)])
@pytest.mark.system
def test_runs_converge_below_and_grow_above_the_bound_of_routh(share: float, grows: bool) -> None:  # noqa: FBT001
    """A slow loop, of which the swarm, the filter and the period are a small part: 1.2 (1.2)/0.525 = 2.74."""
    k3 = share * (0.2 + 1.0) * 1.2 / 0.525
    loop = (f"controller={{type: pid, gains: [1.2, 0.2, {k3}], integral_limit: 2}}", LINEAR, FAST)
    angle = np.abs(simulate(builtin("pd_si_4", *loop, "plane.angle=1e-5", "duration=40")).angle)
    late, early = angle[-1000:].max(), angle[500:1500].max()
    assert (late > 1.5 * early) if grows else (late < 0.5 * early)


@pytest.mark.system
def test_a_constant_torque_leaves_an_offset_with_pd_and_none_with_pid() -> None:
    """With PD 0.15/3.1623 = 0.047 rad."""
    pushed = ("faults=[{kind: disturbance, at: 1.0, torque: 0.15}]", "duration=20")
    with_pd, with_pid = (simulate(builtin("pd_het_4", *pushed, *also)).angle for also in ((), (PID,)))
    assert with_pd[-1] == pytest.approx(-0.0474, abs=2e-3)
    assert np.abs(with_pid[1500:]).max() < 2e-3


def test_a_torque_that_the_swarm_cannot_give_does_not_wind_the_integral_up() -> None:
    """1.5 N m for 1.5 s against a limit of 1 N m: without a limit of the integral the plane would return to +0.34."""
    pushed = ("manifold.torque_max=1", "faults=[{kind: disturbance, at: 5.0, torque: 1.5, until: 6.5}]", "duration=16")
    angle = simulate(builtin("pd_het_4", PID, *pushed)).angle
    assert angle.min() < -0.6
    assert angle[650:].max() < 0.015
    assert np.abs(angle[1000:]).max() < 0.01

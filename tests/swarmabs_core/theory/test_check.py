"""Reports of whole scenarios against values computed by hand, and against other ways to the same number."""

from __future__ import annotations

import json
import random
from math import cos, hypot, sqrt

import numpy as np
import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_config.theory import check_scenario
from swarmabs_core.plant import Friction
from swarmabs_core.theory.arise import error_gradient
from swarmabs_core.theory.report import Condition, Report, Theorem, Verdict

ALL = ("pd_si_4", "pd_di_4", "pd_het_4", "arise_si_4", "arise_di_4", "arise_het_4", "arise_het_20", "arise_het_200")
KINDS = {"si": "SI", "di": "DI", "het": "noHomo"}


def theorem(report: Report, label: str) -> Theorem:
    (found,) = [one for one in (*report.theorems, report.beyond) if one.label == label]
    return found


def condition(found: Theorem, name: str) -> Condition:
    (one,) = [one for one in found.conditions if one.name == name]
    return one


@pytest.mark.parametrize("name", ALL)
def test_one_of_the_six_theorems_is_about_each_run(name: str) -> None:
    report = check_scenario(builtin(name))
    controller, kind, _ = name.split("_")
    label = f"{'LQR' if controller == 'pd' else 'ARISE'}_{KINDS[kind]}_sys"
    assert [one.label for one in report.theorems if one.applicable] == [
        label,
        "GeneralStability",
        "GeneralConstrainedStability",
    ]
    assert len(report.theorems) == 8
    assert all(one.note for one in report.theorems if not one.applicable)
    json.dumps(report.document(), allow_nan=False)


@pytest.mark.parametrize("name", ["pd_si_4", "pd_di_4", "pd_het_4"])
def test_the_papers_pd_runs_are_covered(name: str) -> None:
    report = check_scenario(builtin(name))
    assert report.covered
    assert not list(report.warnings())
    general = theorem(report, "GeneralStability")
    assert (general.verdict, general.printed_verdict) == (Verdict.HOLDS, Verdict.FAILS)


def test_region_of_attraction_of_the_papers_pd_run() -> None:
    report = check_scenario(builtin("pd_si_4"))
    found = report.attraction
    assert found["printed_radius_squared"] == pytest.approx(0.0200)
    assert found["corrected_radius_squared"] == pytest.approx(0.0400)
    assert found["initial_error_squared"] == pytest.approx(0.01 + 0.0482**2 + 0.0026**2, abs=1e-5)
    assert (found["in_printed_ball"], found["in_corrected_ball"], found["in_level_set"]) == (True, True, True)
    wider = check_scenario(builtin("pd_si_4", "manifold={torque_max: 7.5, curvature: 0.0125, offset: 0.025}"))
    assert wider.attraction["corrected_radius_squared"] == pytest.approx(0.0326, abs=5e-5)


def test_k2_is_compared_with_the_rate_of_the_inertia() -> None:
    found = condition(theorem(check_scenario(builtin("pd_si_4")), "LQR_SI_sys"), "k2")
    assert found.printed is not None
    # 2.0577949 of tau_max and 0.525 at z = 0: lemma J_dot_is_bounded is largest there.
    assert found.printed.bound == pytest.approx(0.125 * 3.2859 * 5.01 / 0.525 / (2.0 * cos(0.2)))
    assert found.corrected.value == pytest.approx(cos(0.2) * 3.2859 + 1.0)
    assert found.inputs["tolerated_inertia_rate_corrected"] == pytest.approx(8.4408, abs=5e-5)


def test_with_ks_1_the_theorem_does_not_cover_the_papers_run() -> None:
    report = check_scenario(builtin("arise_si_4"))
    found = condition(theorem(report, "ARISE_SI_sys"), "ks, friction alone")
    assert found.printed is not None
    assert (found.printed.bound, found.corrected.bound) == pytest.approx((24.0, 144.0))
    assert (found.printed.verdict, found.verdict) == (Verdict.FAILS, Verdict.FAILS)
    assert found.corrected.margin == pytest.approx(-143.0)
    assert not report.covered
    assert "with ks = 1 the ARISE theorem does not cover this run" in found.note
    (line,) = report.warnings()
    assert found.note in line


@pytest.mark.parametrize(("ks", "verdict"), [(143.9, Verdict.FAILS), (144.1, Verdict.HOLDS)])
def test_ks_must_exceed_144(ks: float, verdict: Verdict) -> None:
    report = check_scenario(builtin("arise_si_4", f"controller.ks={ks}"))
    assert condition(theorem(report, "ARISE_SI_sys"), "ks, friction alone").verdict is verdict
    assert condition(theorem(report, "ARISE_SI_sys"), "ks, all terms at rest").verdict is Verdict.FAILS


def test_large_gains_leave_a_region_of_attraction() -> None:
    overrides = ("controller.ks=3000", "controller.gamma=[1, 1, 1, 1]")
    report = check_scenario(builtin("arise_si_4", *overrides))
    assert report.attraction["corrected_radius_squared"] > 0.0  # type: ignore[operator] # of a JSON document
    assert theorem(report, "GeneralStability").conditions[0].verdict is Verdict.HOLDS


def test_gradient_of_the_error_term_by_differences() -> None:
    friction, inertia, alpha1, alpha2 = Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0), 0.525, 1.3, 2.4

    def error_term(z: tuple[float, ...]) -> float:
        """N of a resting reference: I r' without what the control law and the Lyapunov function account for."""
        e1, e2, r = z
        de1 = e2 - alpha1 * e1
        de2 = r - alpha2 * e2
        dde1 = de2 - alpha1 * de1
        step = 1e-9
        friction_rate = (friction.torque(-de1 - dde1 * step) - friction.torque(-de1 + dde1 * step)) / (2.0 * step)
        return inertia * (alpha1 * dde1 + alpha2 * de2) + friction_rate + e2

    size = 1e-6
    gradient = [(error_term(tuple(size * row)) - error_term(tuple(-size * row))) / (2.0 * size) for row in np.eye(3)]
    assert error_gradient(inertia, friction.slope_at_rest(), alpha1, alpha2) == pytest.approx(gradient, rel=1e-3)


def test_e2_at_the_start_belongs_to_the_papers_reference() -> None:
    state = condition(theorem(check_scenario(builtin("arise_si_4")), "ARISE_SI_sys"), "initial state").inputs["state"]
    assert isinstance(state, tuple)
    assert state[:2] == pytest.approx((-0.075, -0.0420), abs=5e-5)  # printed: -0.0618
    assert len(state) == 3 + 2 + 4 + 1


def test_disturbance_bounds_beta() -> None:
    found = condition(theorem(check_scenario(builtin("arise_si_4")), "ARISE_SI_sys"), "beta")
    # tau_d' = 0.05 cos(t/2) and tau_d'' = -0.025 sin(t/2) dominate: 0.05 + 0.025/2.
    assert found.corrected.bound == pytest.approx(0.0625, rel=1e-3)
    strong = check_scenario(builtin("arise_si_4", "plane.disturbance={amplitude: 1.0, angular_frequency: 0.5}"))
    assert condition(theorem(strong, "ARISE_SI_sys"), "beta").verdict is Verdict.FAILS


@pytest.mark.parametrize(
    ("overrides", "failing"),
    [
        (("plane.angle=0.3",), {"initial state"}),
        (("controller.gains=[3, -2]",), {"k2", "Lyapunov function", "initial state"}),
        (("controller.gains=[-3, 2]",), {"k1", "initial state"}),
        (("plane.disturbance.amplitude=0.1",), {"disturbance"}),
        (("manifold.torque_max=1.5",), {"torque limit"}),
    ],
)
def test_what_fails_is_named(overrides: tuple[str, ...], failing: set[str]) -> None:
    report = check_scenario(builtin("pd_het_4", *overrides))
    assert {one.name for one in theorem(report, "LQR_noHomo_sys").failed} == failing
    line = next(report.warnings())
    assert all(name in line for name in failing - {"k1"})


def test_another_bound_of_the_angle_gives_another_set() -> None:
    scenario = builtin("pd_si_4", "plane.angle=0.18")
    assert not check_scenario(scenario, 0.2).covered
    assert check_scenario(scenario, 0.25).covered


@pytest.mark.parametrize(
    ("position", "kd", "verdict"), [(0.125, 5.0, Verdict.HOLDS), (0.5, 1.0, Verdict.FAILS), (0.5, 6.4, Verdict.HOLDS)]
)
def test_underdamped_swarms_must_not_start_with_a_large_inertia(position: float, kd: float, verdict: Verdict) -> None:
    positions = [f"swarm.agents.{i}.position={position if i % 2 else -position}" for i in range(4)]
    report = check_scenario(builtin("pd_di_4", f"swarm.gains.kd=[{kd}, {kd}]", *positions))
    assert condition(report.beyond, "inertia swing").verdict is verdict


def test_too_long_periods_and_delays_fail() -> None:
    late = check_scenario(builtin("pd_si_4", "step=0.25", "duration=5.0"))
    assert condition(late.beyond, "period, SI errors").verdict is Verdict.FAILS
    old = check_scenario(builtin("pd_si_4", "faults=[{kind: delay, steps: 16}]"))
    assert condition(old.beyond, "delay, SI errors").verdict is Verdict.FAILS
    oldest = check_scenario(builtin("pd_si_4", "faults=[{kind: delay, steps: 2147483647}]"))
    assert condition(oldest.beyond, "delay, SI errors").verdict is Verdict.FAILS
    assert condition(oldest.beyond, "period, SI errors").verdict is Verdict.FAILS
    (line,) = old.warnings()
    assert line.startswith("sampled time: ")


def test_manifold_leaves_the_set_in_which_all_positions_are_on_the_plane() -> None:
    found = check_scenario(builtin("pd_si_4")).document()
    assert isinstance(found, dict)
    states = found["abstract_states"]
    assert isinstance(states, dict)
    assert isinstance(states["manifold_reach"], dict)
    assert states["manifold_reach"]["admissible"] == pytest.approx(2.288, abs=5e-4)
    assert states["manifold_in_A_A"] is False
    assert isinstance(states["initial"], dict)
    assert states["initial"]["class"] == "A_A"


def drawn(seed: int) -> Scenario:
    """Return a random scenario under state feedback."""
    draw = random.Random(seed)
    robots = []
    for number in range(1, draw.randint(3, 12) + 1):
        body = f"id: {number}, mass: {draw.uniform(0.25, 0.75)!r}, position: {draw.uniform(-0.3, 0.3)!r}"
        double = draw.random() < 0.5
        kind = f"kind: double_integrator, damping: {draw.uniform(0, 1.5)!r}" if double else "kind: single_integrator"
        robots.append(f"    - {{{body}, {kind}}}")
    gains = f"k: [{draw.uniform(2, 20)!r}, 10], kp: [10, {draw.uniform(2, 20)!r}], kd: [{draw.uniform(1, 9)!r}, 5]"
    lines = [
        "schema: 1",
        f"plane: {{angle: {draw.uniform(-0.15, 0.15)!r}, inertia: {draw.uniform(0.3, 3)!r}}}",
        f"controller: {{type: pd, gains: [{draw.uniform(1, 6)!r}, {draw.uniform(1, 6)!r}]}}",
        f"manifold: {{torque_max: {draw.uniform(3, 5)!r}}}",
        "swarm:",
        f"  gains: {{{gains}}}",
        "  agents:",
        *robots,
    ]
    return parse_scenario("\n".join(lines))


@pytest.mark.parametrize("seed", range(8))
def test_random_scenarios_against_the_definitions(seed: int) -> None:
    scenario = drawn(seed)
    report = check_scenario(scenario)
    robots, plane = scenario.agents, scenario.plane
    (gains,) = [scenario.controller.model_dump(by_alias=True)["gains"]]
    torque = 9.81 * sum(robot.mass * robot.position for robot in robots)
    inertia = sum(robot.mass * robot.position**2 for robot in robots)
    wanted = gains[0] * plane.angle
    error = (wanted - torque, 0.0125 * wanted**2 + 0.025 - inertia)
    assert report.attraction["initial_error_squared"] == pytest.approx(plane.angle**2 + hypot(*error) ** 2)
    largest = plane.inertia + 0.0125 * scenario.manifold.torque_max**2 + 0.025
    assert report.attraction["corrected_radius_squared"] == pytest.approx(0.04 / max(1.0, largest))
    assert report.attraction["printed_radius_squared"] == pytest.approx(0.04 / max(2.0, largest))
    (found,) = [one for one in report.theorems[:6] if one.applicable]
    if any(robot.kind == "double_integrator" for robot in robots):
        swarm = scenario.swarm.gains
        bounds = [min(sqrt(kp), kd, 4 * kp * kd / (4 * kp + kd**2)) for kp, kd in zip(swarm.kp, swarm.kd, strict=True)]
        assert condition(found, "epsilon").corrected.value == pytest.approx(min(bounds))
    assert condition(found, "k2").corrected.value == pytest.approx(cos(0.2) * gains[1] + 1.0)

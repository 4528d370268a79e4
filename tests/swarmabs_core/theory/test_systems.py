"""The theory for parent systems: the sampled loop against poles of the continuous one, and what fails when it must."""

import re
from math import exp

import numpy as np
import pytest
from tests.systems import BEAM_SCENARIO, SATELLITE_SCENARIO

from swarmabs_config.scenario import parse_scenario
from swarmabs_config.theory import check_scenario
from swarmabs_core.theory.report import Condition, Coverage, Report, Verdict

pytestmark = pytest.mark.usefixtures("systems")
LIFT = """
schema: 1
system: {type: lift}
swarm:
  gains: {k: 20.0}
  agents:
    - {id: 1, kind: first_order_lag, coordinates: [0.0], constants: {place: 0.6}}
    - {id: 2, kind: first_order_lag, coordinates: [0.0], constants: {place: -0.5, time_constant: 0.04}}
    - {id: 3, kind: first_order_lag, coordinates: [0.0], constants: {place: 0.3, time_constant: 0.06}}
"""


def report(text: str, *overrides: str) -> Report:
    return check_scenario(parse_scenario(text, overrides=overrides))


def conditions(text: str, *overrides: str) -> dict[str, Condition]:
    found = report(text, *overrides)
    return {one.name: one for theorem in (*found.theorems, found.beyond) for one in theorem.conditions}


def slowest(integral: float = 0.0, bandwidth: float = 50.0) -> float:
    """Return the largest real part of the poles of beam, filter and damper, whose mass is that at rest, 1/s."""
    filtered = np.polymul([1.0, bandwidth], [1.0, bandwidth]) * 2500.0 / bandwidth**2
    # J s^3 + c s^2 + k s before the filter, and damping s^2 + integral behind it
    closed = np.polyadd(np.polymul([0.8 + 0.025, 0.3, 5.0, 0.0], filtered), 2500.0 * np.array([2.0, 0.0, integral]))
    roots = np.roots(closed)
    return float(max(root.real for root in roots if abs(root) > 1e-9))


@pytest.mark.parametrize(
    ("integral", "system"), [(0.0, ()), (2.0, ()), (2.0, ("system.type=faulty", "system.fault=replacing"))]
)
def test_the_spectral_radius_is_that_of_the_slowest_pole(integral: float, system: tuple[str, ...]) -> None:
    """With its integral, the controller keeps a number that the loop must contain, perhaps in a frozen object."""
    loop = conditions(BEAM_SCENARIO, "step=0.002", *system, f"system.integral={integral}")["loop"]
    assert np.log(loop.corrected.value) / 0.002 == pytest.approx(slowest(integral), rel=0.02)
    assert loop.inputs["unseen"] == 4 - 2 + (not integral), "an integral that is not used is not seen either"
    assert loop.inputs["numbers"] == 2 + 2 + 1 + 4


def test_the_loop_and_the_completions_know_the_requests_of_the_scenario() -> None:
    given = "requests={bandwidth: 3.0, low: [-0.5], high: [0.25]}"
    loop = conditions(BEAM_SCENARIO, "step=0.002", given)["loop"]
    assert np.log(loop.corrected.value) / 0.002 == pytest.approx(slowest(bandwidth=3.0), rel=0.02)
    assert abs(slowest(bandwidth=3.0) / slowest() - 1.0) > 0.1
    assert conditions(BEAM_SCENARIO, "system.far=0.026", given)["reach"].inputs["first_outside"] == (-0.5,)


def test_an_integral_that_is_too_strong_is_unstable() -> None:
    assert slowest(20.0) > 0.0
    loop = conditions(BEAM_SCENARIO, "system.integral=20")["loop"]
    assert loop.verdict is Verdict.FAILS
    assert loop.corrected.value == pytest.approx(exp(slowest(20.0) * 0.01), rel=2e-3)
    found = report(BEAM_SCENARIO, "system.integral=20")
    assert {"loop", "V_p"} == {condition.name for _, condition in found.failed}
    assert not found.covered


@pytest.mark.parametrize(("step", "radius"), [(0.01, None), (0.1, 1.0), (0.12, 1.4)])
def test_the_period_is_limited_by_the_gain_of_the_swarm(step: float, radius: float | None) -> None:
    found = conditions(LIFT, f"step={step}", "duration=0.6")
    period = found["period, first order"]
    assert period.corrected.bound == pytest.approx(2.0 / 20.0, rel=1e-6)
    if radius is None:
        assert found["loop"].corrected.value < 1.0
    else:
        assert found["loop"].corrected.value == pytest.approx(radius, rel=1e-6), "1 - h K"
    assert step == 0.1 or (period.verdict is Verdict.HOLDS) == (step < 0.1)


def test_a_delay_of_broadcasts_tightens_the_limit_of_the_period() -> None:
    found = conditions(BEAM_SCENARIO, "faults=[{kind: delay, steps: 3}]")["period, first order"]
    assert found.corrected.bound == pytest.approx(2.0 * np.sin(np.pi / 14.0) / 5.0, rel=1e-6)
    assert any("faults" in note for note in report(BEAM_SCENARIO, "faults=[{kind: delay, steps: 3}]").notes)


def test_the_margin_states_that_nothing_couples_the_parent_to_the_error() -> None:
    found = conditions(BEAM_SCENARIO, "swarm.gains.k=[5.0, 8.0]")
    assert found["l"].corrected.value == pytest.approx(5.0 * (1.0 - 0.025))
    margin = found["margin"]
    assert margin.verdict is Verdict.HOLDS
    c2, c3, c5, decay, kappa = (margin.inputs[name] for name in ("c2", "c3", "c5", "l", "smallest_kappa"))
    assert c3 < 1e-6, "a' = v exactly"
    assert kappa == pytest.approx(c5 / decay + c2 * c2 / (4.0 * decay))  # type: ignore[operator]
    doubled = conditions(BEAM_SCENARIO, "swarm.gains.k=10.0")["margin"].inputs["smallest_kappa"]
    assert 0.0 < doubled < kappa  # type: ignore[operator]


def test_double_integrators_have_conditions_of_their_own() -> None:
    text = BEAM_SCENARIO.replace("single_integrator", "double_integrator")
    found = conditions(text, "swarm.gains.kp=[16, 9]", "swarm.gains.kd=8", "swarm.gains.sigma=1.5")
    assert found["period, second order, 16, 8"].corrected.bound == pytest.approx(2.0 / 8.0, rel=1e-3)
    assert found["period, unseen motion"].corrected.bound == pytest.approx(2.0 / 1.5, rel=1e-6)
    assert found["loop"].inputs == {"numbers": 13, "unseen": 3}
    assert found["loop"].corrected.value == pytest.approx(max(1.0 - 0.015, exp(slowest() * 0.01)), rel=2e-3)
    general = report(text).theorems[0]
    assert not general.applicable
    assert "single integrators" in general.note
    assert "period, first order" in conditions(text, "swarm.force_law=velocity")
    mixed = conditions(text, "swarm.agents.0.kind=single_integrator")
    assert {"period, first order", "period, unseen motion"} < mixed.keys()


def test_requests_that_the_robots_cannot_reach_fail() -> None:
    found = conditions(BEAM_SCENARIO, "system.type=faulty", "system.fault=unreachable")
    completion = found["completion"].corrected
    assert (completion.value, completion.bound) == (1, 7)
    assert found["completion"].inputs["first_missed"] == (-5.0,)
    sound = conditions(BEAM_SCENARIO)
    assert sound["completion"].verdict is sound["reach"].verdict is sound["Gram matrix"].verdict is Verdict.HOLDS
    assert conditions(BEAM_SCENARIO, "system.far=0.1")["reach"].inputs["first_outside"] == (-5.0,)


def test_a_satellite_that_turns_slowly_on_fast_wheels_is_covered() -> None:
    """The scaled slope of one step has a singular value of 2e-9 of the largest one; the slowest pole is known."""
    assert report(SATELLITE_SCENARIO).verdict is Coverage.COVERED
    slow = min(abs(root) for root in np.roots([1.0, 0.4, 1e-4]))
    assert conditions(SATELLITE_SCENARIO)["loop"].corrected.value == pytest.approx(exp(-slow * 0.01), abs=1e-8)


@pytest.mark.parametrize(
    ("text", "overrides", "name", "reason"),
    [
        (SATELLITE_SCENARIO, ["system.push=0.01"], "loop", r"no state of rest was found near the start"),
        (BEAM_SCENARIO, ["system.hit=8e-4", "system.angle=5e-4"], "loop", r"step 1: the beam hit the ground"),
        (
            BEAM_SCENARIO,
            ["system.type=faulty", "system.fault=far_out"],
            "completion",
            r"ValueError: too far out \(systems_of_tests\.py:\d+\)",
        ),
    ],
)
def test_what_could_not_be_evaluated_is_neither_covered_nor_refuted(
    text: str, overrides: list[str], name: str, reason: str
) -> None:
    found = report(text, *overrides)
    assert found.verdict is Coverage.UNKNOWN
    assert not found.failed
    assert [condition.name for _, condition in found.unknown] == [name]
    (condition,) = (condition for _, condition in found.unknown)
    assert condition.verdict is Verdict.UNKNOWN
    assert re.fullmatch(reason, condition.note)
    if name == "loop":
        assert found.theorems[0].note == "no state of rest is known"


def test_a_condition_that_fails_decides_whatever_else_could_not_be_evaluated() -> None:
    found = report(SATELLITE_SCENARIO, "system.push=0.01", "swarm.gains.k=250")
    assert found.unknown and found.failed
    assert found.verdict is Coverage.NOT_COVERED


def test_the_loop_of_a_large_swarm_is_left_out_with_a_note() -> None:
    many = ", ".join(
        f"{{id: {n}, kind: single_integrator, coordinates: [{0.1 + n / 1000}], constants: {{mass: 0.01}}}}"
        for n in range(1, 122)
    )
    found = report(BEAM_SCENARIO, f"swarm.agents=[{many}]")
    assert "loop" not in [condition.name for condition in found.beyond.conditions]
    assert any("up to 120 coordinates only" in note for note in found.notes)

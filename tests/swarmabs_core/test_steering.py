"""Offsets of the reference and torques that disturb the plane, set at steps (docs/steering.md)."""

from __future__ import annotations

from math import cos

import pytest
from tests.swarmabs_core.helpers import Run, builtin

from swarmabs_bag.figures import RunFigures
from swarmabs_config import configure
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.membership import UNPLANNED
from swarmabs_core.messages import AbstractState, AgentState, DesiredAbstractState, EventKind, PlaneState, Status
from swarmabs_core.steering import OffsetReference, StepChange, StepSchedule
from swarmabs_run.simulation import simulate

SHORT = "duration=1.0"


def faults(*texts: str) -> str:
    return f"faults=[{', '.join('{' + text + '}' for text in texts)}]"


def told(run: Run) -> list[tuple[int, int, int, float, str]]:
    return [(e.step, e.agent_id, e.kind, e.value, e.detail) for e in run.events() if e.kind != EventKind.LIMIT_HIT]


def first_difference(one: Run, other: Run, kind: type[PlaneState | DesiredAbstractState]) -> int:
    pairs = zip(one.of(kind), other.of(kind), strict=True)
    return next(a.step for a, b in pairs if a != b)


def test_staircase() -> None:
    schedule = StepSchedule([StepChange(5, 0.5), StepChange(2, -1.0)])
    assert [schedule.at(step) for step in range(7)] == [0.0, 0.0, -1.0, -1.0, -1.0, 0.5, 0.5]
    assert {step: schedule.changing(step) for step in range(7) if schedule.changing(step) is not None} == {
        2: -1.0,
        5: 0.5,
    }
    schedule.set(3, 0.0)
    assert [schedule.at(step) for step in (2, 3, 4, 5)] == [-1.0, 0.0, 0.0, 0.5]
    assert not StepSchedule()
    assert StepSchedule().at(3) == 0.0


@pytest.mark.parametrize("text", ["", "1", "1 2 3", "-1 0.5", "x 1", "1 nan", "1 inf", "1.5 2"])
def test_a_stair_in_writing(text: str) -> None:
    assert StepChange.parse(str(StepChange(12, 0.1))) == StepChange(12, 0.1)
    with pytest.raises(InputError, match="STEP VALUE"):
        StepChange.parse(text)


def test_the_reference_of_a_step_has_the_offset_of_the_step() -> None:
    """Also where the time of a step is no round number: 0.07 s is 7.000000000000001 periods."""
    reference = OffsetReference(lambda time: time, StepSchedule([StepChange(7, 0.5)]), 10_000_000)
    assert [reference(step * 10_000_000 / 1e9) for step in (6, 7, 8)] == [0.06, 0.07 + 0.5, 0.08 + 0.5]
    reference.shift(8, 0.0)
    assert reference(0.08) == 0.08


@pytest.mark.parametrize("law", ["pd", "lqr", "arise"])
def test_the_step_from_which_an_offset_holds(law: str) -> None:
    """The desired state of the step is the first to differ; the robots' commands of the step follow it at once."""
    plain = Run(builtin("arise_het_4" if law == "arise" else "pd_het_4", SHORT, f"controller.type={law}"))
    scenario = builtin(
        "arise_het_4" if law == "arise" else "pd_het_4",
        SHORT,
        f"controller.type={law}",
        faults("kind: reference, at: 0.3, offset: 0.05"),
    )
    run = Run(scenario)
    assert first_difference(plain, run, DesiredAbstractState) == 30
    assert first_difference(plain, run, PlaneState) == 31
    assert told(run) == [(30, 0, EventKind.STEERING, 0.05, "reference")]


def test_an_offset_makes_one_constant_reference_another() -> None:
    """0.125 + 0.25 rad is 0.375 rad without rounding: ARISE cannot tell the two apart, in any bit."""
    common = ("duration=3.0", "controller.adaptive_initial=[0.4, 0.009, 0.01, 0.8]")
    plain = Run(builtin("arise_het_4", *common, "controller.trajectory={type: constant, angle: 0.375}"))
    offset = Run(
        builtin(
            "arise_het_4",
            *common,
            "controller.trajectory={type: constant, angle: 0.125}",
            faults("kind: reference, at: 0, offset: 0.25"),
        )
    )
    assert plain.digest() == offset.digest()


def test_pd_levels_the_plane_at_the_offset_and_the_figures_follow() -> None:
    scenario = builtin("pd_het_4", faults("kind: reference, at: 5, offset: 0.1, until: 20"), "duration=20.0")
    run = simulate(scenario)
    friction = scenario.plane.friction[3] / 3.1623
    assert abs(run.angle[-2] - 0.1) < friction, "what friction holds, the law without an integral does not move"
    metrics = RunFigures(configure.reference(scenario))
    for step in Run(scenario).steps:
        metrics.add(step)
    figures = metrics.figures()
    expected = [0.1 if 500 <= k < 2000 else 0.0 for k in range(2001)]
    errors = [want - angle for want, angle in zip(expected, run.angle.tolist(), strict=True)]
    assert figures["final_error"] == errors[-1] < -0.09
    assert figures["rms_error"] == pytest.approx((sum(e * e for e in errors) / 2001) ** 0.5, rel=1e-12)


def test_a_torque_holds_from_its_step_on_until_it_is_over() -> None:
    """The plane feels it in the period that begins with the step; without friction it rests where torques balance."""
    quiet = "plane.friction=[0, 0, 0, 0, 0, 1.0]"
    plain = Run(builtin("pd_het_4", SHORT, quiet))
    run = Run(builtin("pd_het_4", SHORT, quiet, faults("kind: disturbance, at: 0.3, torque: 0.25, until: 0.5")))
    assert first_difference(plain, run, PlaneState) == 31
    assert told(run) == [
        (30, 0, EventKind.STEERING, 0.25, "disturbance"),
        (50, 0, EventKind.STEERING, 0.0, "disturbance"),
    ]
    long = simulate(builtin("pd_het_4", "duration=30.0", quiet, faults("kind: disturbance, at: 0, torque: 0.25")))
    angle = float(long.angle[-1])
    assert 3.1623 * angle * cos(angle) == pytest.approx(-0.25, abs=1e-9)


def test_settings_follow_one_another() -> None:
    run = Run(
        builtin(
            "pd_het_4",
            SHORT,
            faults(
                "kind: disturbance, at: 0.2, torque: 0.1, until: 0.4",
                "kind: reference, at: 0.2, offset: 0.1",
                "kind: reference, at: 0.6, offset: -0.1",
                "kind: disturbance, at: 0.4, torque: 0.2",
            ),
        )
    )
    assert sorted(told(run)) == [
        (20, 0, EventKind.STEERING, 0.1, "disturbance"),
        (20, 0, EventKind.STEERING, 0.1, "reference"),
        (40, 0, EventKind.STEERING, 0.2, "disturbance"),
        (60, 0, EventKind.STEERING, -0.1, "reference"),
    ]


def test_a_robot_that_is_taken_off_the_plane() -> None:
    """It does not know: its last state says nothing of it; from the next step its weight is gone."""
    run = Run(builtin("pd_het_4", SHORT, faults("kind: remove, at: 0.3, agent: 3")))
    states = run.agent(3)
    assert list(states) == list(range(31))
    assert states[30].status == Status.ACTIVE
    assert [run.one(AbstractState, step).agent_count for step in (30, 31, 100)] == [4, 3, 3]
    assert told(run) == [(31, 3, EventKind.LEFT, states[30].position, "remove")]
    for step in (30, 31, 100):
        weights = [state.mass * state.position for state in run.states(step)]
        assert run.one(AbstractState, step).torque == pytest.approx(9.81 * sum(weights), rel=1e-12, abs=1e-12)


def test_a_robot_that_nobody_adds_is_not_there() -> None:
    scenario = builtin("pd_het_4", SHORT, "faults=[{kind: join, at: null, agent: 4}]")
    assert [agent.id for agent in scenario.initial_agents] == [1, 2, 3]
    assert [change.step for change in configure.schedule(scenario)] == [UNPLANNED]
    run = Run(scenario)
    assert {state.agent_id for state in run.of(AgentState)} == {1, 2, 3}
    assert run.events() == []


HEAD = "schema: 1\nswarm:\n  generate: {double_integrator: 3, mass: [1, 2]}\n"


@pytest.mark.parametrize(
    ("entries", "error"),
    [
        ("{kind: reference, at: 1}", "f:4: faults.0.offset: 'offset' is missing"),
        ("{kind: reference, at: 1, offset: 1.5}", "f:4: faults.0.offset: 1.5 is out of range; give a number < 1.5"),
        ("{kind: reference, at: 31, offset: 1}", "f:4: faults.0.at: 31.0 s is step 3100, after the last step 3000"),
        (
            "{kind: disturbance, at: 1, torque: .nan}",
            "f:4: faults.0.torque: .nan is not a finite number; give a finite number",
        ),
        (
            "{kind: disturbance, at: 2, torque: 1, until: 1}",
            "f:4: faults.0: the fault ends at 1.0 s, before it begins; use 'until' with a time after 2.0 s",
        ),
        (
            "{kind: disturbance, at: 2, torque: 1, until: 2.001}",
            "f:4: faults.0.until: the fault begins and ends with step 200; let it last a step or more",
        ),
        (
            "{kind: disturbance, at: 2, torque: 1, until: 4}, {kind: disturbance, at: 3, torque: 1}",
            "f:4: faults.1: a second disturbance at the same time (see line 4); let one end before the other begins",
        ),
        (
            "{kind: reference, at: 2, offset: 1}, {kind: reference, at: 2.001, offset: 0.5}",
            "f:4: faults.1: a second reference at the same time",
        ),
        (
            "{kind: join, at: null, agent: 3}, {kind: kill, at: 3, agent: 3}",
            "f:4: faults.1: robot 3 is there only when it is added, and nobody knows when (see line 4); leave this",
        ),
        ("{kind: kill, at: null, agent: 3}", "f:4: faults.0.at: expected a number, found nothing (null)"),
    ],
)
def test_what_is_refused(entries: str, error: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_scenario(f"{HEAD}faults: [{entries}]", source="f")
    assert str(caught.value).startswith(error)

"""Losses of robots, before a run: against the closed form of what can be reached, statics, and recorded losses."""

import json
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from tests.swarmabs_core.helpers import builtin

from swarmabs_analysis.losses import check as losses
from swarmabs_analysis.losses.check import check_losses
from swarmabs_cli.study.check import check as command
from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_config.theory import check_scenario
from swarmabs_core.theory.report import Loss, Report, Theorem, Verdict
from swarmabs_run.simulation import simulate

MASSES = 0.36, 0.35, 0.67, 0.46
OFFSET, G = 0.025, 9.81
DIES = "faults=[{kind: kill, at: 0.0, agent: 3}]"


EMPTY = Report("", "", "", None, (), Theorem("", ""), {}, {}, ())
"""A report without theorems, which take longer."""


def checked(scenario: Scenario, *, any_loss: bool = False) -> Report:
    return check_losses(scenario, check_scenario(scenario), any_loss=any_loss)


def simulated(scenario: Scenario, *, any_loss: bool = False) -> Report:
    return check_losses(scenario, EMPTY, any_loss=any_loss)


def groups(report: Report) -> dict[str, Theorem]:
    return {group.label: group for group in report.simulated}


def failed(report: Report) -> set[str]:
    return {f"{group.label}.{condition.name}" for group, condition in report.failed if group in report.simulated}


def beam(place: float) -> Scenario:
    """Return a level beam under robots whose torque is 0 and that must come together; robot 3, at a place, dies."""
    others = -MASSES[2] * place / MASSES[0], 0.1, -0.1 * MASSES[1] / MASSES[3]
    places = (*others[:2], place, others[2])
    agents = ", ".join(
        f"{{id: {n}, kind: single_integrator, coordinates: [{x!r}], constants: {{mass: {m}}}}}"
        for n, (x, m) in enumerate(zip(places, MASSES, strict=True), 1)
    )
    text = f"schema: 1\nduration: 5.0\nsystem: {{type: beam, angle: 0.0}}\nswarm: {{agents: [{agents}]}}"
    return parse_scenario(text, overrides=[DIES])


@pytest.mark.usefixtures("systems")
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_robot_that_dies_too_far_out_for_a_fixed_completion_flings_the_others(share: float) -> None:
    """The others can have a second moment B - m p^2 and a first one of -m p only if B > m p^2 (1 + m/(M - m))."""
    mass, rest = MASSES[2], sum(MASSES) - MASSES[2]
    place = share * sqrt(OFFSET / (mass * (1.0 + mass / rest)))
    report = checked(beam(place))
    (loss,) = report.losses
    assert (loss.robots, loss.change, loss.time, loss.simulated) == ((3,), "kill", 0.0, 5.0)
    assert groups(report)["undisturbed"].verdict is Verdict.HOLDS
    if share < 1.0:
        spread = OFFSET - mass * place * place * (1.0 + mass / rest)
        assert loss.pivot == pytest.approx(4.0 * spread / rest, rel=0.01), "of ((g^2 M, 2 tau), (2 tau, 4 J)), scaled"
        assert loss.failed == ()
        assert report.covered
    else:
        assert loss.pivot < 1e-3
        assert "speed" in loss.failed
        assert not report.covered


LIFT = """
schema: 1
duration: 8.0
system: {type: lift}
swarm:
  gains: {k: 20.0}
  agents:
    - {id: 1, kind: first_order_lag, coordinates: [9.8], constants: {place: 0.6, top: 40.0}}
    - {id: 2, kind: first_order_lag, coordinates: [9.8], constants: {place: -0.5, top: 40.0}}
    - {id: 3, kind: first_order_lag, coordinates: [9.8], constants: {place: 0.3, top: 40.0}}
"""
HEAVIEST = 3.0 * G * 0.6 / 1.1
"""Thrust of rotor 2 that holds the lift with rotor 1 alone: f1 + f2 = m g, 0.6 f1 = 0.5 f2."""


@pytest.mark.usefixtures("systems")
@pytest.mark.parametrize(("share", "lost"), [(1.03, False), (0.97, True)])
@pytest.mark.system
def test_rotors_that_are_too_weak_after_a_loss_do_not_cover_it(share: float, *, lost: bool) -> None:
    top = f"swarm.agents.1.constants.top={share * HEAVIEST!r}"
    scenario = parse_scenario(LIFT, overrides=[top, "faults=[{kind: remove, at: 4.0, agent: 3}]"])
    assert check_scenario(scenario).covered, "the theorems ignore limits"
    report = checked(scenario)
    assert groups(report)["undisturbed"].verdict is Verdict.HOLDS
    missed = {"settled", "limits"} if lost else set()
    assert set(report.losses[0].failed) == missed, "beside a rotor at its limit, the other cannot do both"
    assert report.covered is not lost


@pytest.mark.usefixtures("systems")
@pytest.mark.parametrize(("share", "holds"), [(1.05, True), (0.95, False)])
def test_rotors_that_cannot_hold_the_weight_are_not_covered_without_any_loss(share: float, *, holds: bool) -> None:
    tops = [f"swarm.agents.{n}.constants.top={share * 3.0 * G * part!r}" for n, part in enumerate((0.25, 0.5, 0.25))]
    report = checked(parse_scenario(LIFT, overrides=[*tops, "swarm.agents.2.constants.place=0.4"]))
    assert report.covered is holds
    assert not report.losses
    assert (not failed(report)) is holds


def test_a_robot_that_dies_far_out_on_the_plane_is_covered() -> None:
    """Without torque the others cannot have the manifold's inertia about a robot beyond 0.153 m."""
    far = "swarm.agents.2.position=0.16"
    report = simulated(builtin("pd_si_4", "duration=5.0", far, DIES))
    (loss,) = report.losses
    assert (loss.robots, loss.change, loss.failed) == ((3,), "kill", ())
    assert loss.speed < 1.0 and loss.reach < 0.5 and loss.pivot > 1e-4
    assert not failed(report)


def test_robots_that_creep_leave_the_plane_tilted() -> None:
    report = simulated(builtin("pd_si_4", "duration=5.0", "limits.velocity=1e-4"))
    assert failed(report) == {"undisturbed.limits"}
    assert groups(report)["undisturbed"].conditions[0].inputs["limited_share"] == pytest.approx(1.0, abs=0.01)
    assert not failed(simulated(builtin("pd_si_4", "duration=5.0", "limits.velocity=0.5")))


def test_losses_have_the_numbers_of_a_run_with_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """A loss on request is that of a fault, and both are those that a simulation of the fault gives."""
    monkeypatch.setattr(losses, "AFTER_ANY", 1.0)
    plain = builtin("pd_het_4", "duration=2.0")
    report = simulated(plain, any_loss=True)
    assert {loss.robots for loss in report.losses} == {
        *((n,) for n in (1, 2, 3, 4)),
        *((1, 2), (1, 3), (1, 4), (2, 3), (2, 4), (3, 4)),
    }
    late = next(loss for loss in report.losses if loss.time > 0.0 and not loss.failed)
    faults = [{"kind": "kill", "at": late.time, "agent": robot} for robot in late.robots]
    run = simulate(plain, {"faults": faults, "duration": late.time + 1.0})
    begin = round(100 * late.time) + 1
    alive = ~np.isin(run.agents.ids, late.robots)
    places, speeds = run.agents.position[begin:, alive], run.agents.velocity[begin:, alive]
    assert late.simulated == 1.0
    assert late.deviation == pytest.approx(np.abs(run.angle[begin:]).max(), rel=1e-12)
    assert late.speed == pytest.approx(np.abs(speeds).max(), rel=1e-12)
    assert late.reach == pytest.approx(np.abs(places).max(), rel=1e-12)
    planned = simulated(builtin("pd_het_4", f"faults={faults}", f"duration={late.time + 1.0}")).losses
    assert [loss.deviation for loss in planned] == [late.deviation]


@pytest.mark.parametrize(("length", "verdict"), [(1.0, Verdict.HOLDS), (0.27, Verdict.FAILS)])
def test_the_end_of_the_plane_that_a_robot_comes_closest_to_is_named(length: float, verdict: Verdict) -> None:
    scenario = builtin("pd_het_4", "duration=0.5", f"plane.length={length}", "faults=[{kind: kill, at: 0.3, agent: 1}]")
    conditions = groups(simulated(scenario))["undisturbed"].conditions
    (reach,) = (condition for condition in conditions if condition.name == "reach")
    run = simulate(scenario, {"faults": []})
    place = run.agents.position.flat[np.argmax(np.abs(run.agents.position))]
    assert (reach.corrected.value, reach.corrected.bound) == (place, np.copysign(length / 2.0, place))
    assert reach.verdict is verdict


def test_what_follows_each_planned_loss_is_judged_until_the_next() -> None:
    faults = "[{kind: leave, at: 1.0, agent: 1}, {kind: kill, at: 1.5, agent: 3}, {kind: freeze, at: 1.5, agent: 2}]"
    report = simulated(builtin("pd_het_4", "duration=4.0", f"faults={faults}"))
    first, second = sorted(report.losses, key=lambda loss: loss.time)
    assert (first.robots, first.change, first.time, first.simulated) == ((1,), "leave", 1.0, 0.5)
    assert (second.robots, second.change, second.time, second.simulated) == ((2, 3), "freeze/kill", 1.5, 2.5)
    names = {label: [condition.name for condition in group.conditions] for label, group in groups(report).items()}
    assert names == {
        "undisturbed": ["run", "reach", "law"],
        "leave_1": ["run", "reach", "speed"],
        "freeze_2_kill_3": ["run", "reach", "speed", "settled", "law"],
    }


def test_too_many_losses_are_sampled_by_their_effect_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(losses, "MOST_STATES", 2 * 2 * 100 * 4)
    scenario = builtin("pd_het_4", "duration=1.0")
    report = simulated(scenario, any_loss=True)
    notes = [note for note in report.notes if note.startswith("any_")]
    assert [note.split(" losses")[0] for note in notes] == ["any_robot: 2 of 4", "any_pair: 2 of 6"]
    heaviest = max(scenario.agents, key=lambda agent: agent.mass * abs(agent.position)).id
    assert (heaviest,) in {loss.robots for loss in report.losses}
    assert simulated(scenario, any_loss=True) == report


def test_of_two_robots_no_pair_is_lost() -> None:
    two = ", ".join(f"{{id: {n}, kind: single_integrator, mass: 0.5, position: {x}}}" for n, x in ((1, 0.1), (2, -0.1)))
    report = simulated(builtin("pd_si_4", "duration=0.1", f"swarm.agents=[{two}]"), any_loss=True)
    assert [(groups(report)[label].note) for label in ("any_robot", "any_pair")] == ["", "too few robots"]
    assert {loss.robots for loss in report.losses} == {(1,), (2,)}


@pytest.mark.usefixtures("systems")
def test_the_command_prints_losses_and_exits_by_them(tmp_path: Path) -> None:
    path = tmp_path / "lift.yaml"
    path.write_text(LIFT, encoding="utf-8")
    weak = [str(path), "--set", "swarm.agents.1.constants.top=14", "--strict"]
    weak += ["--set", "faults=[{kind: remove, at: 2.0, agent: 3}]", "--duration", "4"]
    done = CliRunner().invoke(command, weak, standalone_mode=False)
    assert done.return_value == 1
    assert "not covered: these conditions fail: remove_3: " in done.output
    assert "losses of robots, the worst of 1" in done.output
    document = json.loads(CliRunner().invoke(command, [*weak, "--json"], standalone_mode=False).output)
    assert not document["covered"]
    assert [group["label"] for group in document["simulated"]] == ["undisturbed", "remove_3"]
    (loss,) = document["losses"]
    assert set(loss) == set(Loss.document)
    assert {f"remove_3.{name}" for name in loss["failed"]} == set(document["failed"])

"""Whole runs on parent systems: the plane through the general path, limits, lost control, mixed swarms."""

from functools import cache

import numpy as np
import pytest
from tests.swarmabs_core.helpers import Array, Run, builtin
from tests.swarmabs_core.theory.test_systems import LIFT
from tests.systems import BEAM_SCENARIO

from swarmabs_config.configure import controller_settings
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    AgentState,
    EventKind,
    ParentState,
    PlaneState,
    RobotState,
    Status,
    SwarmAbstract,
    SwarmDesired,
)
from swarmabs_core.sensing import standard_normal
from swarmabs_run.simulation import simulate

pytestmark = pytest.mark.usefixtures("systems")


def ran(text: str, *overrides: str) -> Run:
    return Run(parse_scenario(text, overrides=overrides))


def vectors(run: Run, kind: type, field: str) -> Array:
    return np.array([getattr(message, field) for message in run.of(kind)])


@pytest.mark.parametrize("name", ["arise_si_4"])
def test_the_plane_through_the_general_path_is_the_plane_up_to_the_error_of_the_integrator(name: str) -> None:
    """The scenario loses broadcasts; only the law's parent differs, and steps of 1 ms err by 5e-9 rad/s near rest."""
    faults = "faults=[{kind: loss, probability: 0.2}]"
    scenario = builtin(name, "duration=6", faults, "controller.type=pd", "plane.disturbance.amplitude=0")
    agents = [
        f"    - {{id: {a.id}, kind: {a.kind}, coordinates: [{a.position!r}], constants: {{mass: {a.mass!r}}}}}"
        for a in scenario.agents
    ]
    k1, k2 = controller_settings(scenario)["gains"]  # type: ignore[misc]
    text = "\n".join(["schema: 1", "system: {type: tilting_plane}", "swarm:", "  agents:", *agents])
    settings = [f"system.k1={k1!r}", f"system.k2={k2!r}"]
    settings += [f"system.angle={scenario.plane.angle!r}", f"swarm.gains.k={list(scenario.swarm.gains.k)}"]
    plane, general = Run(scenario), ran(text, "duration=6", faults, f"seed={scenario.seed}", *settings)
    ours, theirs = vectors(general, ParentState, "state"), plane.of(PlaneState)
    assert len(ours) == 601
    expected = np.array([(state.angle, state.angular_velocity) for state in theirs])
    assert np.abs(ours - expected).max() < 1e-8
    assert np.abs(ours[300:]).max() < np.abs(ours[:100]).max() / 3.0, "something happens"
    positions = {(s.step, s.agent_id): s.position for s in plane.of(AgentState)}
    found = {(s.step, s.agent_id): s.coordinates[0] for s in general.of(RobotState)}
    assert found.keys() == positions.keys()
    assert max(abs(found[at] - positions[at]) for at in found) < 1e-9
    said = [[(e.step, e.agent_id, e.kind, e.detail) for e in run.events()] for run in (plane, general)]
    assert said[0] == said[1]


@pytest.mark.parametrize(
    ("fault", "problem"),
    [
        ("ask_late", r"step 5: ZeroDivisionError: float division by zero \(systems_of_tests\.py:\d+\)"),
        ("ask_late_number", r"step 5: the controller of faulty returned 1\.0; it must return torque"),
        ("derivative_late", r"step 5: ZeroDivisionError: float division by zero \(systems_of_tests\.py:\d+\)"),
        ("derivative_late_size", r"derivative\(\) returned \(0\.0,\) at 0\.05 s; it must return 2 numbers"),
        ("disturbed_late", r"step 4: ZeroDivisionError: float division by zero \(systems_of_tests\.py:\d+\)"),
        ("failed_late", r"step 1: KeyError: 'x' \(systems_of_tests\.py:\d+\)"),
    ],
)
def test_what_a_system_raises_in_the_middle_fails_the_run_in_one_line(fault: str, problem: str) -> None:
    with pytest.raises(RunError, match=f"^{problem}$"):
        ran(
            BEAM_SCENARIO.replace("beam", "faulty"),
            f"system.fault={fault}",
            "faults=[{kind: disturbance, at: 0.03, torque: 1}]" if fault == "disturbed_late" else "duration=1",
        )


def test_what_a_reference_raises_in_the_middle_fails_the_simulation_in_one_line() -> None:
    """The controller does not use it, but the figures of the run do."""
    scenario = parse_scenario(BEAM_SCENARIO.replace("beam", "faulty"), overrides=["system.fault=reference_late"])
    with pytest.raises(RunError, match=r"^step 5: ZeroDivisionError: .* \(systems_of_tests\.py:\d+\)$"):
        simulate(scenario)


def test_a_robot_that_dies_stays_in_the_sums_at_its_last_place_and_one_that_is_removed_does_not() -> None:
    run = ran(
        BEAM_SCENARIO, "duration=0.3", "faults=[{kind: kill, agent: 2, at: 0.1}, {kind: remove, agent: 3, at: 0.2}]"
    )
    contribution, places = parse_scenario(BEAM_SCENARIO).named.instance.contribution, dict[int, Array]()
    for abstract in run.of(SwarmAbstract):
        now = {
            s.agent_id: contribution(s.coordinates, s.constants) for s in run.of(RobotState) if s.step == abstract.step
        }
        assert (2 in now, 3 in now) == (abstract.step <= 10, abstract.step <= 20)
        places = {agent_id: place for agent_id, place in places.items() if agent_id == 2} | now
        assert abstract.agent_count == len(places)
        assert np.allclose(abstract.value, np.sum(list(places.values()), axis=0), rtol=1e-12, atol=0.0)


def test_the_parent_is_measured_with_the_noise_and_the_resolution_of_the_plane() -> None:
    """Without feedback the noise changes nothing else, so it is the difference of two runs."""
    overrides = ("duration=0.5", "system.added=0", "seed=4")
    sensor = "sensor={noise: [0.01, 0.0], resolution: [0.0, 0.25]}"
    true, measured = (vectors(ran(BEAM_SCENARIO, *overrides, *more), ParentState, "state") for more in ((), (sensor,)))
    draws = [standard_normal(f"4:{step}:parent:angle") for step in range(51)]
    assert np.allclose(measured[:, 0], true[:, 0] + 0.01 * np.array(draws), rtol=0.0, atol=1e-15)
    assert np.array_equal(measured[:, 1], 0.25 * np.round(true[:, 1] / 0.25))


def test_requests_are_limited_and_filtered_as_the_scenario_says() -> None:
    """What is requested follows from the measured rate by the discrete filter; it overshoots no limit."""
    overrides = ("duration=2", "system.added=20", "requests={bandwidth: 4.0, low: [-1.0], high: [0.5]}")
    run = ran(BEAM_SCENARIO, *overrides)
    torque, rate = (vectors(run, SwarmDesired, name)[:, 0] for name in ("value", "rate"))
    assert torque.min() >= -1.0 and torque.max() <= 0.5
    assert torque.min() < -0.5, "the lower limit is not that of the other side"
    asked = np.clip(20.0 * vectors(run, ParentState, "state")[:, 1], -1.0, 0.5)
    z = 4.0 * 0.01
    offset = torque - asked
    after = asked + np.exp(-z) * ((1.0 + z) * offset + 0.01 * rate)
    assert np.allclose(torque[1:], after[:-1], rtol=0.0, atol=1e-12)
    assert {e.detail for e in run.events() if e.kind == EventKind.LIMIT_HIT} == {"torque limited"}


def test_a_robot_at_its_limit_says_so_and_the_others_take_over() -> None:
    places = (0.6, -0.5, 0.3, -0.4, 0.5, -0.5)
    hovering = [
        f"{{id: {n}, kind: first_order_lag, coordinates: [4.9], constants: {{place: {place}, top: {top}}}}}"
        for n, place, top in zip(range(1, 7), places, (6.0, *[15.0] * 5), strict=True)
    ]
    run = ran(LIFT, "duration=5", f"swarm.agents=[{', '.join(hovering)}]")
    states = {s.step: s for s in run.of(RobotState) if s.agent_id == 1}
    limited = [s.step for s in states.values() if s.status == Status.LIMITED]
    assert 5 < len(limited) < 250
    assert limited == list(range(limited[0], limited[-1] + 1)), "it returns once"
    assert all(states[k].command == (6.0,) for k in limited)
    (event,) = [e for e in run.events() if e.kind == EventKind.LIMIT_HIT and e.agent_id == 1]
    assert event.step == limited[0]
    assert {s.status for s in run.of(RobotState) if s.agent_id > 1} == {Status.ACTIVE}
    abstract, wanted = (vectors(run, kind, "value") for kind in (SwarmAbstract, SwarmDesired))
    # a' = v all the same: e[k+1] = (1 - h K) e[k], exactly for a linear contribution
    error = wanted - abstract
    inside = np.array(limited[:-1])
    assert np.abs(error[inside + 1] - 0.8 * error[inside]).max() < 1e-10
    changes = np.array([limited[0] - 1, limited[-1]])
    assert np.abs(error[changes + 1] - 0.8 * error[changes]).max() > 1e-5, "the others hear of a change one step later"
    assert abs(vectors(run, ParentState, "state")[-1][0] - 1.0) < 0.1


def test_robots_that_lose_control_of_a_row_control_those_before_it() -> None:
    """Of two robots one leaves; the other controls the torque, but not the inertia as well."""
    run = ran(
        BEAM_SCENARIO, "duration=1", "faults=[{kind: leave, agent: 2, at: 0.5}, {kind: leave, agent: 3, at: 0.5}]"
    )
    assert not [e for e in run.events() if e.kind == EventKind.SAFE_STOP]
    all_but_one = "faults=[" + ", ".join(f"{{kind: leave, agent: {n}, at: 0.5}}" for n in (2, 3, 4)) + "]"
    run = ran(BEAM_SCENARIO, "duration=3", all_but_one)
    assert not [e for e in run.events() if e.kind in (EventKind.SAFE_STOP, EventKind.HELD)]
    abstract, wanted = (vectors(run, kind, "value") for kind in (SwarmAbstract, SwarmDesired))
    assert np.abs(wanted - abstract)[-1, 0] < 1e-3 * np.abs(wanted[:, 0]).max(), "the torque"
    assert np.abs(wanted - abstract)[-1, 1] > 1e-3, "not the inertia"


def test_a_completion_that_becomes_unreachable_is_held_or_slowed_by_the_effort_bound() -> None:
    """The inertia that is asked for becomes negative as the torque grows."""
    overrides = ("duration=2", "system.type=faulty", "system.fault=unreachable", "system.angle=0.8", "system.added=5")
    free = vectors(ran(BEAM_SCENARIO, *overrides), SwarmAbstract, "value")
    bounded = ran(BEAM_SCENARIO, *overrides, "swarm.effort=0.5")
    assert np.isfinite(free).all()
    masses = {1: 0.36, 2: 0.35, 3: 0.67, 4: 0.46}
    efforts = np.zeros(201)
    for state in bounded.of(RobotState):
        efforts[state.step] += masses[state.agent_id] * state.command[0] ** 2
    assert efforts.max() <= 0.5**2 * (1.0 + 1e-9)
    assert efforts.max() > 0.2


@cache
def alone() -> Array:
    """Return the states of the beam with single integrators."""
    return vectors(ran(BEAM_SCENARIO, "duration=4"), ParentState, "state")


@pytest.mark.parametrize("law", ["second_order", "velocity"])
@pytest.mark.parametrize("forces", [(0, 1, 2, 3), (1, 2)])
def test_every_mixture_of_robots_follows_the_request(law: str, forces: tuple[int, ...]) -> None:
    kinds = [f"swarm.agents.{n}.kind=double_integrator" for n in forces]
    damped = [f"swarm.agents.{n}.constants.damping=0.4" for n in forces]
    run = ran(BEAM_SCENARIO, "duration=4", f"swarm.force_law={law}", *kinds, *damped)
    abstract, wanted = (vectors(run, kind, "value") for kind in (SwarmAbstract, SwarmDesired))
    error = np.abs(wanted - abstract)
    assert error[150:].max() < 0.02
    assert np.abs(vectors(run, ParentState, "state") - alone()).max() < 0.06
    assert not [e for e in run.events() if e.kind == EventKind.SAFE_STOP]


@pytest.mark.parametrize(("fault", "end"), [("lane", "0.2 m"), ("none", "100 m, as assumed")])
def test_robots_that_leave_their_range_are_told_of_whether_its_ends_are_stated_or_assumed(fault: str, end: str) -> None:
    faulty = BEAM_SCENARIO.replace("beam", "faulty")
    gone = "[{id: 9, kind: double_integrator, coordinates: [0.19], velocities: [20000.0], constants: {mass: 0.001}}]"
    agents = faulty.partition("  agents:\n")[2]
    text = faulty.replace(agents, f"{agents.rstrip()}\n    - {gone[1:-1]}\n")
    run = ran(text, f"system.fault={fault}", "duration=0.1")
    found = [e for e in run.events() if e.agent_id == 9 and "range" in e.detail]
    (first, *_) = found
    places = {s.step: s.coordinates[0] for s in run.of(RobotState) if s.agent_id == 9}
    assert first.value == places[first.step]
    assert first.detail.endswith(f"out of range: position above {end}")
    assert all(abs(place) <= float(end.split(maxsplit=1)[0]) for step, place in places.items() if step < first.step)

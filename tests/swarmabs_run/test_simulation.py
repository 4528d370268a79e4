from __future__ import annotations

import subprocess
import sys

import pytest
from tests.swarmabs_core.helpers import Run, builtin, digest

from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    MAIN_TOPICS,
    PLANE_STATE,
    AbstractState,
    AuxiliaryState,
    DesiredAbstractState,
    PlaneState,
)
from swarmabs_run.simulation import Simulation

SHORT = "duration=2"


def listed(order: tuple[int, ...]) -> Scenario:
    robots = {
        1: "{id: 1, kind: single_integrator, mass: 0.3552, position: 0.125}",
        2: "{id: 2, kind: single_integrator, mass: 0.3532, position: -0.125}",
        3: "{id: 3, kind: double_integrator, mass: 0.6762, damping: 0.6524, position: 0.125}",
        4: "{id: 4, kind: double_integrator, mass: 0.4596, damping: 1.3258, position: -0.125}",
    }
    agents = ", ".join(robots[i] for i in order)
    return parse_scenario(
        f"schema: 1\nname: pd_het_4\nduration: 2\nswarm: {{agents: [{agents}]}}\n"
        "faults: [{kind: loss, probability: 0.1}, {at: 1, kind: kill, agent: 2}]"
    )


@pytest.mark.parametrize("name", ["pd_het_4", "arise_di_4", "arise_het_20"])
def test_two_runs_are_equal_to_the_bit(name: str) -> None:
    scenario = builtin(name, SHORT)
    first, second = Run(scenario), Run(scenario)
    assert first.steps == second.steps
    assert first.digest() == second.digest()


def test_order_in_the_file_changes_no_bit() -> None:
    expected = digest(Simulation(listed((1, 2, 3, 4))).steps())
    for order in ((4, 3, 2, 1), (3, 1, 4, 2)):
        assert digest(Simulation(listed(order)).steps()) == expected


@pytest.mark.parametrize("override", ["plane.angle=0.1000001", "swarm.agents.0.mass=0.3553", "seed=2"])
def test_digest_tells_runs_apart(override: str) -> None:
    faults = "faults=[{kind: loss, probability: 0.1}]"
    assert (
        Run(builtin("pd_het_4", SHORT, faults)).digest() != Run(builtin("pd_het_4", SHORT, faults, override)).digest()
    )


def test_every_message_of_the_main_topics_is_there_once() -> None:
    run = Run(builtin("pd_het_4", SHORT))
    assert [step.step for step in run.steps] == list(range(201))
    for step in run.steps:
        assert [(r.topic, r.agent_id) for r in step.records] == [
            *((MAIN_TOPICS[0], i) for i in (1, 2, 3, 4)),
            *((topic, 0) for topic in MAIN_TOPICS[1:]),
        ]
        assert {r.message.step for r in step.records} == {step.step}
        assert {r.message[0] for r in step.records} == {step.step * 10_000_000}


def test_first_messages_say_what_the_scenario_says() -> None:
    run = Run(builtin("pd_het_4", SHORT))
    assert run.one(PlaneState, 0)[2:] == (0.1, 0.0)
    assert [state.position for state in run.states(0)] == [0.125, -0.125, 0.125, -0.125]
    assert run.one(AbstractState, 0).agent_count == 4
    desired = run.one(DesiredAbstractState, 0)
    assert desired.torque == pytest.approx(0.31623, rel=1e-12)
    assert desired.inertia == pytest.approx(0.0125 * 0.31623**2 + 0.025, rel=1e-12)
    assert (desired.torque_rate, desired.inertia_rate) == (0.0, 0.0)


def test_command_of_a_robot_moves_it() -> None:
    """AgentState(k).command is u(k-1): single integrators have it as their velocity."""
    run = Run(builtin("pd_het_4", SHORT))
    states = run.agent(1)
    for k in range(1, 201):
        assert states[k].velocity == states[k].command
        assert states[k].position == pytest.approx(states[k - 1].position + 0.01 * states[k].command, rel=1e-14)
        assert states[k].broadcast_step == k - 1
    assert (states[0].command, states[0].velocity) == (0.0, 0.0)


def test_auxiliary_state_is_that_of_the_robots() -> None:
    run = Run(builtin("pd_het_4", SHORT))
    states, sums = run.states(100), run.one(AuxiliaryState, 100)
    assert sums.s2 == pytest.approx(sum((s.mass * s.position) ** 2 for s in states), rel=1e-14)
    damped = [s for s in states if s.agent_id in {3, 4}]
    assert sums.d1 == pytest.approx(sum(s.mass * (s.damping + 1.0) * s.position for s in damped), rel=1e-12)
    assert sums.q == pytest.approx(sum(s.mass * s.velocity**2 for s in states), rel=1e-14)


def test_plane_that_turns_over_fails_the_run() -> None:
    scenario = builtin("pd_si_4", "plane.angle=1.0", "controller.gains=[-3.0, 0.0]")
    with pytest.raises(RunError, match=r"step \d+: the plane's angle is -?1\.5\d* rad"):
        Run(scenario)


def test_gains_that_throw_the_swarm_apart_fail_the_run() -> None:
    with pytest.raises(RunError, match="not finite"):
        Run(builtin("pd_si_4", "swarm.gains.k=[300, 300]"))


def test_swarm_of_which_nobody_is_left_fails_the_run() -> None:
    faults = ", ".join(f"{{at: 0.5, kind: kill, agent: {i}}}" for i in (1, 2, 3, 4))
    with pytest.raises(RunError, match="step 51: no robot is left"):
        Run(builtin("pd_si_4", SHORT, f"faults=[{faults}]"))


def test_run_that_stalls_fails() -> None:
    simulation = Simulation(builtin("pd_si_4", SHORT))
    simulation._subscribers[PLANE_STATE] = ()
    with pytest.raises(RunError, match="stalls at step 0; missing: swarm/desired_abstract_state"):
        list(simulation.steps())


@pytest.mark.parametrize("name", ["pd_di_4", "arise_si_4"])
def test_gravity_along_the_plane_matters_to_double_integrators_only(name: str) -> None:
    without, with_gravity = Run(builtin(name, SHORT)), Run(builtin(name, SHORT, "plane.robot_gravity=true"))
    assert (without.digest() == with_gravity.digest()) is (name == "arise_si_4")


def test_robots_need_neither_numpy_nor_pydantic() -> None:
    """Each robot is a process of its own: what it imports, a swarm imports a hundred times."""
    heavy = "{'numpy', 'pydantic', 'yaml', 'scipy'}"
    code = f"import sys, swarmabs_core.behaviours, swarmabs_core.controllers; sys.exit(str({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "set()"

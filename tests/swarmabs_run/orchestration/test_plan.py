"""The processes of a scenario: what each is started with is what the scenario says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given as generated, settings as with_settings, strategies as st
from rclpy.parameter import Parameter as RosParameter
from tests.swarmabs_ros.nodes import declared_by, started_node

import abstraction_observer.node
import agent_node.node
import parent_controller.node
import plane_sim.node
import swarmabs_bag.recorder.node
from swarmabs_bag.run_folder import RunFolder
from swarmabs_config import configure
from swarmabs_config.graph import CONTROLLER, COORDINATORS, OBSERVER, PLANE, RECORDER, agent_name
from swarmabs_config.scenario import Scenario, load_scenario
from swarmabs_config.scenarios import builtin_scenarios
from swarmabs_core.behaviours import AgentConfig, ObserverConfig, PlaneConfig
from swarmabs_core.declaration import made_of
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BASIS,
    BROADCAST,
    BROADCASTS,
    EVENTS,
    MAIN_TOPICS,
    PLANE_STATE,
    RECORDING_PROGRESS,
    STEERING,
    TOPICS,
)
from swarmabs_core.parameters import Parameter, resolve
from swarmabs_ros.parameters import table_of
from swarmabs_ros.runner import COMMON, Settings
from swarmabs_ros.start import SwarmNode
from swarmabs_ros.status import StatusChannel
from swarmabs_run.orchestration.plan import ProcessPlan, plan
from swarmabs_run.run import RunOptions

FOLDER = RunFolder(Path("/runs/x"))

FAULTY = (
    (
        "faults=[{at: 0.5, kind: kill, agent: 1}, {at: 1.0, kind: leave, agent: 2}, {at: 0.2, kind: join, agent: 3},"
        " {at: 2, kind: freeze, agent: 4}, {kind: loss, probability: 0.125}, {kind: delay, steps: 3}]"
    ),
    "plane.robot_gravity=true",
    "limits={velocity: 0.75, force: 3.5}",
    "lockstep={on_stall: drop, stall_timeout: 2.5}",
    "plane.disturbance={amplitude: 0.1, angular_frequency: 1e-7}",
    "seed=9007199254740993",
    "step=0.005",
)
SCENARIOS = {
    **{name: (name, ()) for name in builtin_scenarios()},
    "faulty": ("pd_het_4", FAULTY),
    "lqr": ("pd_het_4", ("controller={type: lqr, q: [3, 0.1], r: 7}",)),
    "small": ("pd_het_4", ("plane.friction=[5e-324, 0, 1e-310, 1e12, 1, 2.2250738585072014e-308]",)),
}


def scenario_of(key: str) -> Scenario:
    name, overrides = SCENARIOS[key]
    return load_scenario(builtin_scenarios()[name], overrides).resolved()


def planned(scenario: Scenario) -> dict[str, ProcessPlan]:
    return {process.name: process for process in plan(scenario, FOLDER)}


def settings_of(process: ProcessPlan, table: tuple[Parameter | type, ...]) -> Settings:
    """Return what a node sees that is started by this plan, by way of ROS and its command line."""
    return declared_by(process.arguments("/")[1:], COMMON, table)


def content(thing: object) -> object:
    """Return all that makes up a control law, to compare two of them."""
    slots = [name for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ())]
    inside = {name: getattr(thing, name) for name in slots} | getattr(thing, "__dict__", {})
    if not type(thing).__module__.startswith("swarmabs_core"):
        return thing
    return type(thing), {name: content(value) for name, value in inside.items()}


scenarios = pytest.mark.parametrize("scenario", SCENARIOS)
with_ros = pytest.mark.usefixtures("ros")


@with_ros
@scenarios
def test_plane_and_observer_are_configured_as_the_scenario_says(scenario: str) -> None:
    loaded = scenario_of(scenario)
    processes = planned(loaded)
    plane = settings_of(processes[PLANE], plane_sim.node.PARAMETERS)
    expected = configure.plane_config(loaded)
    assert plane.made(PlaneConfig) == replace(expected, plane=replace(expected.plane, robot_gravity=False))
    observer = settings_of(processes[OBSERVER], abstraction_observer.node.PARAMETERS)
    assert observer.made(ObserverConfig) == configure.observer_config(loaded)
    assert observer.text("on_stall") == loaded.lockstep.on_stall
    assert observer.number("stall_timeout") == plane.number("stall_timeout") == loaded.lockstep.stall_timeout


@with_ros
@scenarios
def test_the_controller_is_configured_as_the_scenario_says(scenario: str, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = scenario_of(scenario)
    made = []
    real = parent_controller.node.Controller
    monkeypatch.setattr(
        parent_controller.node, "Controller", lambda *parts, **flags: made.append(parts) or real(*parts, **flags)
    )
    settings = settings_of(planned(loaded)[CONTROLLER], parent_controller.node.PARAMETERS)
    parent_controller.node.make(settings, StatusChannel(CONTROLLER))
    ((config, law),) = made
    expected = configure.controller_config(loaded, recording_window=configure.recording_window(loaded))
    assert config == replace(expected, law=config.law)
    assert content(law) == content(configure.parent_controller(loaded))


@with_ros
@scenarios
def test_robots_are_configured_as_the_scenario_says(scenario: str) -> None:
    loaded = scenario_of(scenario)
    processes = planned(loaded)
    configs = configure.agent_configs(loaded)
    for config in configs:
        given = processes[agent_name(config.agent_id)].parameters
        table = table_of(given, COMMON, agent_node.node.PARAMETERS)
        values = resolve(table, given, owner="agent")  # type: ignore[arg-type]
        assert made_of(AgentConfig, values) == config
    for config in {configs[0], configs[len(configs) // 2], configs[-1]}:  # by way of ROS, which takes longer
        settings = settings_of(processes[agent_name(config.agent_id)], agent_node.node.PARAMETERS)
        assert settings.made(AgentConfig) == config


@with_ros
def test_the_recorder_is_told_where_everything_is() -> None:
    loaded = scenario_of("pd_het_4")
    settings = settings_of(planned(loaded)[RECORDER], swarmabs_bag.recorder.node.PARAMETERS)
    found = [settings.text(name) for name in ("scenario_file", "bag", "logs")]
    assert found == ["/runs/x/scenario.yaml", "/runs/x/bag", "/runs/x/logs"]


@with_ros
def test_nodes_get_their_names_and_namespace() -> None:
    process = planned(scenario_of("pd_het_4"))["agent_003"]
    with started_node(*process.arguments("/north/swarm")[1:]) as node:
        assert node.get_fully_qualified_name() == "/north/swarm/agent_003"


@with_ros
@with_settings(max_examples=25, deadline=None)
@generated(
    number=st.floats(allow_nan=False, allow_infinity=False),
    numbers=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=3),
    integer=st.integers(-(2**63), 2**63 - 1),
    text=st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), min_size=1, max_size=12),
    flag=st.booleans(),
)
def test_every_value_survives_the_command_line(
    number: float,
    numbers: list[float],
    integer: int,
    text: str,
    flag: bool,  # noqa: FBT001
) -> None:
    given = {"number": number, "numbers": numbers, "integer": integer, "text": text, "flag": flag}
    process = ProcessPlan("probe", "nowhere", 0, dict(given), (), ())
    with started_node(*process.arguments("/")[1:]) as node:
        found = {name: value_of(node, name) for name in given}
    assert repr(found) == repr(given)


def value_of(node: SwarmNode, name: str) -> object:
    parameter: RosParameter = node._parameter_overrides[name]
    value = parameter.value
    return value if isinstance(value, (str, bool, int, float)) else list(value)


@scenarios
def test_participants_are_numbered_and_those_below_eight_kept_for_coordinators(scenario: str) -> None:
    loaded = scenario_of(scenario)
    processes = planned(loaded)
    coordinators = [processes[name].participant for name in (PLANE, OBSERVER, CONTROLLER, RECORDER)]
    assert coordinators == [0, 1, 2, 3]
    robots = [processes[agent_name(agent.id)].participant for agent in loaded.agents]
    assert robots == list(range(COORDINATORS, COORDINATORS + len(robots)))
    assert len(processes) == 4 + len(robots)


def test_robots_hear_the_three_broadcasts_and_say_their_state() -> None:
    for name, process in planned(scenario_of("arise_het_20")).items():
        if name.startswith("agent_"):
            assert set(process.subscriptions) == set(BROADCASTS)
            assert set(process.publications) == {AGENT_STATE, EVENTS}


def test_who_is_waited_for() -> None:
    processes = planned(scenario_of("pd_het_4"))
    expected = {
        PLANE: {"swarm/events": 2, "plane/state": 2, "swarm/agent_state": 4},
        OBSERVER: {
            "swarm/events": 2,
            "swarm/abstract_state": 5,
            "swarm/auxiliary_state": 5,
            "swarm/agent_state": 4,
        },
        CONTROLLER: {
            "swarm/events": 2,
            "swarm/desired_abstract_state": 5,
            "plane/state": 1,
            "recording/progress": 1,
        },
        RECORDER: {
            "recording/progress": 1,
            "swarm/agent_state": 4,
            "plane/state": 1,
            "swarm/abstract_state": 1,
            "swarm/auxiliary_state": 1,
            "swarm/desired_abstract_state": 1,
            "swarm/events": 7,
        },
        "agent_004": {
            "swarm/events": 2,
            "swarm/agent_state": 3,
            "swarm/abstract_state": 1,
            "swarm/auxiliary_state": 1,
            "swarm/desired_abstract_state": 1,
        },
    }
    for name, counterparts in expected.items():
        match = processes[name].parameters["match"]
        assert isinstance(match, list)
        assert dict(text.split() for text in match) == {k: str(v) for k, v in counterparts.items()}, name


@pytest.mark.parametrize("key", ["pd_het_4", "faulty"])
def test_everything_published_is_heard_and_everything_heard_is_published(key: str) -> None:
    processes = planned(scenario_of(key)).values()
    published = {topic for process in processes for topic in process.publications}
    heard = {topic for process in processes for topic in process.subscriptions}
    assert published == heard == set(TOPICS) - {BROADCAST, BASIS, STEERING}
    assert {*MAIN_TOPICS, EVENTS} <= set(planned(scenario_of(key))[RECORDER].subscriptions)
    assert RECORDING_PROGRESS in planned(scenario_of(key))[CONTROLLER].subscriptions


def steerable(*faults: str, agents_per_process: int = 1, steered: bool = True) -> dict[str, ProcessPlan]:
    scenario = load_scenario(builtin_scenarios()["pd_het_4"], [f"faults=[{', '.join(faults)}]"]).resolved()
    processes = plan(scenario, FOLDER, RunOptions(agents_per_process=agents_per_process, steered=steered))
    return {process.name: process for process in processes}


def test_orders_reach_whom_they_concern_and_no_robot_that_is_there() -> None:
    processes = steerable("{kind: join, at: null, agent: 3}", "{kind: join, at: 1, agent: 4}")
    assert [p.name for p in processes.values() if STEERING in p.publications] == ["steering"]
    hearing = {p.name for p in processes.values() if STEERING in p.subscriptions}
    assert hearing == {PLANE, OBSERVER, CONTROLLER, RECORDER, "agent_003"}
    assert {name for name, p in processes.items() if p.parameters.get("steered")} == hearing
    assert processes["steering"].parameters["folder"] == "/runs/x"
    participants = [p.participant for p in processes.values()]
    assert len(set(participants)) == len(participants)
    shared = steerable("{kind: join, at: null, agent: 3}", agents_per_process=2)
    assert {n for n, p in shared.items() if STEERING in p.subscriptions and p.agents} == {"agents_003_to_004"}


def test_who_can_only_be_added_has_no_process_where_nobody_is() -> None:
    processes = steerable("{kind: join, at: null, agent: 3}", steered=False)
    assert [p.agents for p in processes.values() if p.agents] == [(1,), (2,), (4,)]
    assert not any("steered" in p.parameters for p in processes.values())
    assert "steering" not in processes


@pytest.mark.parametrize("agents_per_process", [1, 3])
def test_packed_broadcasts_stand_between_controller_and_robots(agents_per_process: int) -> None:
    options = RunOptions(agents_per_process=agents_per_process, packed=True)
    processes = plan(scenario_of("faulty"), FOLDER, options)
    robots = [process for process in processes if process.agents]
    assert all({*process.subscriptions} - {PLANE_STATE} == {BROADCAST} for process in robots)
    assert {p.name for p in processes if BROADCAST in p.publications} == {CONTROLLER}
    controller = next(process for process in processes if process.name == CONTROLLER)
    assert {ABSTRACT_STATE, AUXILIARY_STATE} <= {*controller.subscriptions}
    told = [process.name for process in processes if process.parameters.get("packed")]
    assert told == [CONTROLLER, *(process.name for process in robots)]


def test_only_robots_that_feel_their_tilt_hear_the_plane() -> None:
    processes = planned(scenario_of("faulty"))
    hearing = {name for name, process in processes.items() if PLANE_STATE in process.subscriptions}
    assert hearing == {CONTROLLER, RECORDER, "agent_003", "agent_004"}


@pytest.mark.parametrize(("per_process", "groups"), [(3, [(1, 2, 3), (4,)]), (4, [(1, 2, 3, 4)]), (9, [(1, 2, 3, 4)])])
def test_robots_may_share_processes(per_process: int, groups: list[tuple[int, ...]]) -> None:
    options = RunOptions(record=False, agents_per_process=per_process)
    processes = plan(scenario_of("pd_het_4"), FOLDER, options)
    assert {process.name: process for process in processes}[RECORDER].parameters["bag"] == ""
    hosts = [process for process in processes if process.agents]
    assert [process.agents for process in hosts] == groups
    assert len({process.name for process in processes}) == len(processes)
    assert {process.module for process in hosts} == {"agent_node.group"}

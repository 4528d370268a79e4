"""The processes of a scenario: what each is started with is what the scenario says."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given as generated, settings as with_settings, strategies as st
from tests.swarmabs_core.helpers import builtin
from tests.swarmabs_ros.nodes import declared_by, started_node

from abstraction_observer.node import StallReaction
from swarmabs_bag.recorder.node import RecorderSettings
from swarmabs_bag.recorder.realtime import Clock
from swarmabs_bag.run_folder import RunFolder
from swarmabs_config import configure, realtime
from swarmabs_config.graph import (
    CONTROLLER,
    COORDINATORS,
    FIRST_TOOL,
    KEPT_STEPS,
    LOCKSTEP,
    OBSERVER,
    PLANE,
    REALTIME,
    RECORDER,
    Driver,
)
from swarmabs_config.scenario import Scenario
from swarmabs_config.scenarios import builtin_scenarios
from swarmabs_core.declaration import made_of
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BROADCAST,
    PLANE_STATE,
    STEERING,
    SWARM_STATES,
)
from swarmabs_core.models import AgentConfig, ObserverConfig, PlaneConfig
from swarmabs_core.nodes import agent_name
from swarmabs_core.parameters import resolve
from swarmabs_core.realtime.agent import RealtimeAgentConfig
from swarmabs_core.realtime.observer import RealtimeObserverConfig
from swarmabs_core.realtime.plane import RealtimePlaneConfig
from swarmabs_ros.lockstep import FIRST
from swarmabs_ros.parameters import table_of
from swarmabs_ros.realtime_runner import COMMON as REALTIME_COMMON
from swarmabs_ros.runner import COMMON, Settings
from swarmabs_ros.settings import LockstepSettings
from swarmabs_run.orchestration.plan import PATIENCE, ProcessPlan, partners, plan
from swarmabs_run.run import DEFAULTS, RunOptions

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
    "pid": ("pd_het_4", ("controller={type: pid, gains: [5, 3, 0.1], integral_limit: 0.7}",)),
    "small": ("pd_het_4", ("plane.friction=[5e-324, 0, 1e-310, 1e12, 1, 2.2250738585072014e-308]",)),
}


def scenario_of(key: str) -> Scenario:
    name, overrides = SCENARIOS[key]
    return builtin(name, *overrides).resolved()


def planned(scenario: Scenario, driver: Driver = LOCKSTEP, options: RunOptions = DEFAULTS) -> dict[str, ProcessPlan]:
    return {process.name: process for process in plan(scenario, FOLDER, options, driver=driver)}


def settings_of(process: ProcessPlan) -> Settings:
    """Return what a node sees that is started by this plan, by way of ROS and its command line."""
    in_real_time = () if process.name == RECORDER else REALTIME_COMMON  # a recorder has some of them in its table
    common = in_real_time if process.module.endswith(".realtime") else COMMON
    return declared_by(process.arguments("/")[1:], common, import_module(process.module).PARAMETERS)


def made_by(process: ProcessPlan, state_machine: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return configuration and law from which the controller's node makes its state machine."""
    module, parts_given = import_module(process.module), []
    real = getattr(module, state_machine)
    monkeypatch.setattr(
        module, state_machine, lambda *parts, **flags: parts_given.append(parts) or real(*parts, **flags)
    )
    module.make(settings_of(process), None)
    return parts_given[0]


def content(thing: object) -> object:
    """Return all that makes up a control law, to compare two of them."""
    slots = [name for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ())]
    inside = {name: getattr(thing, name) for name in slots} | getattr(thing, "__dict__", {})
    if not type(thing).__module__.startswith("swarmabs_core"):
        return thing
    return type(thing), {name: content(value) for name, value in inside.items()}


REALTIME_SCENARIOS = {
    "plain": ("pd_het_4",),
    "set": (
        "pd_het_4",
        "step=0.005",
        "limits={velocity: 0.75, force: 3.5}",
        "plane={end_stop: 0.4, length: 1.2, disturbance: {amplitude: 0.1, angular_frequency: 0.7}}",
        "plane.sensor={noise: [1.0e-4, 1.0e-3], resolution: [1.0e-5, 0]}",
        "realtime={broadcast_age_limit: 0.07, state_age_limit: 0.08, plane_age_limit: 0.09}",
        *("realtime.clock_tolerance=0.01", "realtime.lane_margin=0.03", "realtime.start=quorum", "realtime.quorum=3"),
    ),
    "adaptive": ("arise_het_4",),
}
with_ros = pytest.mark.usefixtures("ros")


@with_ros
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_nodes_are_configured_as_the_scenario_says(scenario: str, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = scenario_of(scenario)
    processes = planned(loaded)
    plane = settings_of(processes[PLANE])
    expected = configure.parent_config(loaded)
    assert plane.declared(PlaneConfig) == replace(expected, plane=replace(expected.plane, robot_gravity=False))
    observer = settings_of(processes[OBSERVER])
    assert observer.declared(ObserverConfig) == configure.observer_config(loaded)
    assert observer.declared(StallReaction).on_stall == loaded.lockstep.on_stall
    timeouts = [settings.declared(LockstepSettings).stall_timeout for settings in (observer, plane)]
    assert timeouts == [loaded.lockstep.stall_timeout] * 2
    (config,) = made_by(processes[CONTROLLER], "Controller", monkeypatch)
    law = config.law.make(loaded.period, loaded.manifold)
    window = configure.recording_window(loaded)
    assert config == replace(configure.controller_config(loaded, recording_window=window), law=config.law)
    assert content(law) == content(configure.parent_controller(loaded))
    configs = configure.agent_configs(loaded)
    for robot in configs:
        process = processes[agent_name(robot.agent_id)]
        table = table_of(process.parameters, COMMON, import_module(process.module).PARAMETERS)
        values = resolve(table, process.parameters, owner="agent")  # type: ignore[arg-type]
        assert made_of(AgentConfig, values) == robot
    for robot in {configs[0], configs[len(configs) // 2], configs[-1]}:  # by way of ROS, which takes longer
        assert settings_of(processes[agent_name(robot.agent_id)]).declared(AgentConfig) == robot


@with_ros
@pytest.mark.parametrize("scenario", REALTIME_SCENARIOS)
def test_nodes_in_real_time_are_configured_as_the_scenario_says(scenario: str, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = builtin(*REALTIME_SCENARIOS[scenario]).resolved()
    processes, clock = planned(loaded, REALTIME), realtime.schedule(loaded, 0)
    assert all(process.parameters["await_epoch"] is True for process in processes.values())
    assert settings_of(processes[PLANE]).declared(RealtimePlaneConfig) == realtime.plane_config(loaded, clock)
    assert settings_of(processes[OBSERVER]).declared(RealtimeObserverConfig) == realtime.observer_config(loaded, clock)
    for robot in realtime.agent_configs(loaded, clock):
        settings = settings_of(processes[agent_name(robot.agent_id)])
        assert settings.declared(RealtimeAgentConfig) == robot
    config, make_law = made_by(processes[CONTROLLER], "RealtimeController", monkeypatch)
    assert type(make_law()) is type(configure.parent_controller(loaded))
    assert config == replace(realtime.controller_config(loaded, clock), law=config.law)


@with_ros
@pytest.mark.parametrize("driver", [LOCKSTEP, REALTIME])
def test_the_recorder_is_told_where_everything_is(driver: Driver) -> None:
    loaded = scenario_of("pd_het_4")
    settings = settings_of(planned(loaded, driver)[RECORDER])
    recorder = settings.declared(RecorderSettings)
    assert (recorder.scenario_file, recorder.bag, recorder.logs) == (
        "/runs/x/scenario.yaml",
        "/runs/x/bag",
        "/runs/x/logs",
    )
    assert settings.declared(LockstepSettings if driver is LOCKSTEP else Clock).last_step == loaded.steps


@with_ros
def test_nodes_get_their_names_and_namespace_and_may_publish_rosout() -> None:
    process = planned(scenario_of("pd_het_4"))["agent_003"]
    assert "--disable-rosout-logs" not in process.arguments("/")
    with started_node(*process.arguments("/north/swarm")[1:]) as node:
        assert node.get_fully_qualified_name() == "/north/swarm/agent_003"


@with_ros
@with_settings(max_examples=10, deadline=None)
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
        values = {name: node.get_parameter(name).value for name in given}
    assert repr(values | {"numbers": [*values["numbers"]]}) == repr(given)


@pytest.mark.parametrize("driver", [LOCKSTEP, REALTIME])
def test_participants_are_numbered_and_those_below_eight_kept_for_coordinators(driver: Driver) -> None:
    loaded = scenario_of("arise_het_20")
    processes = planned(loaded, driver)
    coordinators = [processes[name].participant for name in (PLANE, OBSERVER, CONTROLLER, RECORDER)]
    assert coordinators == list(range(FIRST_TOOL))
    robots = [processes[agent_name(agent.id)].participant for agent in loaded.agents]
    assert robots == list(range(COORDINATORS, COORDINATORS + len(robots)))
    assert len(processes) == 4 + len(robots)


def test_who_is_waited_for_and_who_hears_the_plane() -> None:
    broadcasts = {"swarm/abstract_state 1", "swarm/auxiliary_state 1", "swarm/desired_abstract_state 1"}
    for name, counterparts in (
        (PLANE, {"swarm/events 2", "plane/state 2", "swarm/agent_state 4"}),
        ("agent_004", {"swarm/events 2", "swarm/agent_state 3"} | broadcasts),
    ):
        match = planned(scenario_of("pd_het_4"))[name].parameters["match"]
        assert isinstance(match, list) and set(match) == counterparts
    hearing = {n for n, process in planned(scenario_of("faulty")).items() if PLANE_STATE in process.subscriptions}
    assert hearing == {CONTROLLER, RECORDER, "agent_003", "agent_004"}, "of robots, those that feel their tilt"


def test_the_more_robots_the_later_a_node_repeats_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    for patience, seconds in ((PATIENCE, FIRST), (0.5, 2.0)):
        monkeypatch.setattr("swarmabs_run.orchestration.plan.PATIENCE", patience)
        parameters = planned(scenario_of("pd_het_4"))[PLANE].parameters
        assert (parameters["repeat_after"], parameters["repeat_steps"]) == (seconds, KEPT_STEPS)


def test_where_each_sums_up_the_swarm_a_node_waits_by_the_pairs_of_robots() -> None:
    for name, seconds in (("pd_het_4", FIRST), ("arise_het_200", 0.4)):
        processes = planned(builtin(name, "coordination=each_robot", "links.type=random"))
        assert {process.parameters["repeat_after"] for process in processes.values()} == {seconds}


@pytest.mark.parametrize(
    ("together", "expected"),
    [
        (1, {"agent_001": (9, 11), "agent_002": (8, 10), "agent_003": (9, 11), "agent_004": (8, 10)}),
        (2, {"agents_001_to_002": (9,), "agents_003_to_004": (8,)}),
        (4, {}),
    ],
)
def test_robots_discover_their_neighbours_only(together: int, expected: dict[str, tuple[int, ...]]) -> None:
    ring = builtin("pd_het_4", "coordination=each_robot", "links.type=ring")
    options = RunOptions(agents_per_process=together)
    assert partners([*planned(ring, options=options).values()]) == expected
    assert partners([*planned(builtin("pd_het_4"), options=options).values()]) == {}


def steerable(*faults: str, agents_per_process: int = 1, steered: bool = True) -> dict[str, ProcessPlan]:
    scenario = builtin("pd_het_4", f"faults=[{', '.join(faults)}]").resolved()
    return planned(scenario, options=RunOptions(agents_per_process=agents_per_process, steered=steered))


def test_orders_reach_whom_they_concern_and_no_robot_that_is_there() -> None:
    processes = steerable("{kind: join, at: null, agent: 3}", "{kind: join, at: 1, agent: 4}")
    assert [p.name for p in processes.values() if STEERING in p.publications] == ["steering"]
    hearing = {p.name for p in processes.values() if STEERING in p.subscriptions}
    assert hearing == {PLANE, OBSERVER, CONTROLLER, RECORDER, "agent_003"}
    assert {name for name, p in processes.items() if p.parameters.get("steered")} == hearing
    assert processes["steering"].parameters["folder"] == "/runs/x"
    participants = [p.participant for p in processes.values()]
    assert len(set(participants)) == len(participants)
    assert processes["steering"].participant == max(participants) == COORDINATORS + 4
    shared = steerable("{kind: join, at: null, agent: 3}", agents_per_process=2)
    assert {n for n, p in shared.items() if STEERING in p.subscriptions and p.agents} == {"agents_003_to_004"}
    # Who can only be added has no process where nobody steers.
    processes = steerable("{kind: join, at: null, agent: 3}", steered=False)
    assert [p.agents for p in processes.values() if p.agents] == [(1,), (2,), (4,)]
    assert not any(p.parameters.get("steered") for p in processes.values())
    assert "steering" not in processes


@pytest.mark.parametrize("agents_per_process", [1, 3])
def test_packed_messages_take_the_place_of_single_ones(agents_per_process: int) -> None:
    options = RunOptions(agents_per_process=agents_per_process, packed=True)
    named = planned(scenario_of("faulty"), options=options)
    processes, controller = named.values(), named[CONTROLLER]
    robots = [process for process in processes if process.agents]
    assert all({*process.subscriptions} - {PLANE_STATE} == {BROADCAST} for process in robots)
    assert {p.name for p in processes if BROADCAST in p.publications} == {CONTROLLER}
    assert {ABSTRACT_STATE, AUXILIARY_STATE} <= {*controller.subscriptions}
    assert [p.name for p in processes if AGENT_STATE in p.subscriptions] == [OBSERVER]
    assert [p.name for p in processes if SWARM_STATES in p.publications] == [OBSERVER]
    assert [p.name for p in processes if SWARM_STATES in p.subscriptions] == [PLANE, RECORDER]
    assert [process.name for process in processes if process.gathers] == [OBSERVER]
    told = [process.name for process in processes if process.parameters.get("packed")]
    assert told == [PLANE, OBSERVER, CONTROLLER, RECORDER, *(process.name for process in robots)]


@pytest.mark.parametrize(
    ("asked", "robots", "packed"), [(None, 7, False), (None, 8, True), (True, 2, True), (False, 9, False)]
)
def test_messages_are_packed_where_that_is_faster_or_as_asked(*, asked: bool | None, robots: int, packed: bool) -> None:
    agents = ", ".join(
        f"{{id: {i}, kind: single_integrator, mass: 0.5, position: {0.01 * i}}}" for i in range(1, robots + 1)
    )
    scenario = builtin("pd_het_4", f"swarm.agents=[{agents}]").resolved()
    processes = planned(scenario, options=RunOptions(packed=asked)).values()
    assert {process.parameters["packed"] for process in processes} == {packed}
    assert any(SWARM_STATES in process.publications for process in processes) == packed


@pytest.mark.parametrize(("per_process", "groups"), [(3, [(1, 2, 3), (4,)]), (4, [(1, 2, 3, 4)]), (9, [(1, 2, 3, 4)])])
def test_robots_may_share_processes(per_process: int, groups: list[tuple[int, ...]]) -> None:
    options = RunOptions(record=False, agents_per_process=per_process)
    processes = plan(scenario_of("pd_het_4"), FOLDER, options)
    named = {process.name: process for process in processes}
    assert len(named) == len(processes)
    assert named[RECORDER].parameters["bag"] == ""
    hosts = [process for process in processes if process.agents]
    assert [process.agents for process in hosts] == groups
    assert {process.module for process in hosts} == {"agent_node.group"}

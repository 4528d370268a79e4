"""The processes of a scenario in real time: each is configured as the check of its bag takes it to be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from tests.swarmabs_core.helpers import builtin
from tests.swarmabs_ros.nodes import declared_by

import abstraction_observer.realtime
import agent_node.realtime
import parent_controller.realtime
import plane_sim.realtime
import swarmabs_bag.recorder.realtime
from swarmabs_bag.run_folder import RunFolder
from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_config.graph import CONTROLLER, OBSERVER, OFFERED, PLANE, REALTIME, RECORDER, agent_name
from swarmabs_config.scenario import Scenario
from swarmabs_core.messages import BASIS, BROADCASTS, EVENTS, MAIN_TOPICS
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.agent import RealtimeAgentConfig
from swarmabs_core.realtime.observer import RealtimeObserverConfig
from swarmabs_core.realtime.plane import RealtimePlaneConfig
from swarmabs_ros.managed import RealtimeNode
from swarmabs_ros.realtime_runner import COMMON
from swarmabs_ros.runner import Settings
from swarmabs_run.orchestration.plan import ProcessPlan, plan

SCENARIOS = {
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
scenarios = pytest.mark.parametrize("scenario", SCENARIOS)


def planned(scenario: Scenario) -> dict[str, ProcessPlan]:
    processes = plan(scenario, RunFolder(Path("/runs/x")), driver=REALTIME)
    return {process.name: process for process in processes}


def settings_of(
    process: ProcessPlan, table: tuple[Parameter | type, ...], common: tuple[Parameter, ...] = COMMON
) -> Settings:
    """Return what a node sees that is started by this plan, by way of ROS and its command line."""
    return declared_by(process.arguments("/")[1:], common, table)


@pytest.mark.usefixtures("ros")
@scenarios
def test_nodes_are_configured_as_the_scenario_says(scenario: str, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = builtin(*SCENARIOS[scenario]).resolved()
    processes = planned(loaded)
    clock = configure.schedule(loaded, 0)
    plane = settings_of(processes[PLANE], plane_sim.realtime.PARAMETERS)
    assert plane.made(RealtimePlaneConfig) == configure.plane_config(loaded, clock)
    observer = settings_of(processes[OBSERVER], abstraction_observer.realtime.PARAMETERS)
    assert observer.made(RealtimeObserverConfig) == configure.observer_config(loaded, clock)
    for robot in configure.agent_configs(loaded, clock):
        settings = settings_of(processes[agent_name(robot.agent_id)], agent_node.realtime.PARAMETERS)
        assert settings.made(RealtimeAgentConfig) == robot
        assert settings.text("drive.type") == "simulated"
    made = []
    real = parent_controller.realtime.RealtimeController
    monkeypatch.setattr(
        parent_controller.realtime, "RealtimeController", lambda *parts: made.append(parts) or real(*parts)
    )
    controller = settings_of(processes[CONTROLLER], parent_controller.realtime.PARAMETERS)
    parent_controller.realtime.make(controller, RealtimeNode.__new__(RealtimeNode))
    ((config, make_law),) = made
    assert type(make_law()) is type(lockstep.parent_controller(loaded))
    assert config == replace(configure.controller_config(loaded, clock), law=config.law)


@pytest.mark.usefixtures("ros")
def test_all_are_told_the_epoch_and_the_recorder_where_everything_is() -> None:
    loaded = builtin("pd_het_4").resolved()
    processes = planned(loaded)
    assert all(process.parameters["await_epoch"] is True for process in processes.values())
    settings = settings_of(processes[RECORDER], swarmabs_bag.recorder.realtime.PARAMETERS, ())
    found = [settings.text(name) for name in ("scenario_file", "bag", "logs")]
    assert found == ["/runs/x/scenario.yaml", "/runs/x/bag", "/runs/x/logs"]
    assert settings.last_step() == loaded.steps


def test_everything_that_is_published_is_recorded() -> None:
    processes = planned(builtin("pd_het_4").resolved()).values()
    published = {topic for process in processes for topic in process.publications}
    (recorder,) = (process for process in processes if process.name == RECORDER)
    assert published == set(recorder.subscriptions) == {*MAIN_TOPICS, EVENTS, BASIS} == set(OFFERED[REALTIME])
    for process in processes:
        if process.agents:
            assert set(process.subscriptions) == set(BROADCASTS)


def test_the_plan_says_who_hears_events() -> None:
    hearing = {
        name for name, process in planned(builtin("pd_het_4").resolved()).items() if EVENTS in process.subscriptions
    }
    assert hearing == {OBSERVER, RECORDER}

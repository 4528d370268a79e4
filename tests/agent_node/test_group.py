"""Several robots in one process."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.swarmabs_ros.nodes import settings_from

from agent_node.group import PARAMETERS, make
from swarmabs_config.scenario import dump_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.messages import AGENT_STATE, BROADCASTS, EVENTS, PLANE_STATE, AgentState
from swarmabs_ros.status import StatusChannel

CHANNEL = StatusChannel("agents")


@pytest.fixture
def scenario_file(tmp_path: Path) -> str:
    file = tmp_path / "scenario.yaml"
    file.write_text(dump_scenario(find_scenario("pd_het_4").resolved()), encoding="utf-8")
    return str(file)


def test_it_speaks_for_its_robots_and_hears_what_a_robot_hears(scenario_file: str) -> None:
    spec = make(settings_from(PARAMETERS, scenario_file=scenario_file, agent_ids=(2, 4)), CHANNEL)
    assert spec.endpoints is not None
    assert set(spec.endpoints.publications) == {AGENT_STATE, EVENTS}
    assert set(spec.endpoints.subscriptions) == set(BROADCASTS)
    states = spec.behaviour.start()
    assert [state.agent_id for state in states if isinstance(state, AgentState)] == [2, 4]


def test_robots_that_feel_their_tilt_hear_the_plane(tmp_path: Path) -> None:
    file = tmp_path / "scenario.yaml"
    scenario = find_scenario("pd_het_4", ["plane.robot_gravity=true"]).resolved()
    file.write_text(dump_scenario(scenario), encoding="utf-8")
    spec = make(settings_from(PARAMETERS, scenario_file=str(file), agent_ids=(2, 4)), CHANNEL)
    assert spec.endpoints is not None
    assert set(spec.endpoints.subscriptions) == {*BROADCASTS, PLANE_STATE}


@pytest.mark.parametrize("ids", [(1, 9), (9,)])
def test_a_robot_that_the_scenario_does_not_have_is_refused(scenario_file: str, ids: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="no robot 9"):
        make(settings_from(PARAMETERS, scenario_file=scenario_file, agent_ids=ids), CHANNEL)


def test_a_scenario_is_needed() -> None:
    with pytest.raises(InputError, match="scenario_file"):
        make(settings_from(PARAMETERS), CHANNEL)

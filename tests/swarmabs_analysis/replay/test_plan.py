"""The processes of a live replay."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.swarmabs_analysis.replay.conftest import SETTINGS

from swarmabs_analysis.replay.run import ReplayRun
from swarmabs_analysis.replay.source import open_source
from swarmabs_bag.run_folder import RunFolder
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.publishers import NodeName
from swarmabs_run.orchestration.plan import ProcessPlan, plan


def planned(recorded: Path, *nodes: str) -> dict[str, ProcessPlan]:
    scenario = find_scenario("pd_het_4", SETTINGS).resolved()
    processes = plan(scenario, RunFolder(Path("run")))
    names = tuple(NodeName.parse(node) for node in nodes)
    made = ReplayRun(open_source(recorded), names, ("controller.gains=[it's]",), scenario).plan(processes)
    return {process.name: process for process in made}


def matches(process: ProcessPlan) -> dict[str, int]:
    texts = process.parameters["match"]
    assert isinstance(texts, list)
    return {name: int(number) for name, number in (text.split() for text in texts)}


@pytest.mark.parametrize(
    ("nodes", "names"),
    [
        (("controller",), ["replay_player", "parent_controller", "recorder"]),
        (("agent:3", "plane"), ["replay_player", "agent_003", "plane_sim", "recorder"]),
    ],
)
def test_there_are_the_player_the_nodes_under_test_and_the_recorder(
    recorded: Path, nodes: tuple[str, ...], names: list[str]
) -> None:
    processes = planned(recorded, *nodes)
    assert list(processes) == names
    assert len({process.participant for process in processes.values()}) == len(names)
    player = processes["replay_player"].parameters
    assert (player["nodes"], player["last_step"]) == (nodes, 60)
    assert player["bag"] == str(recorded / "bag" / "bag_0.mcap")
    told = json.loads(str(processes["recorder"].parameters["replay"]))
    assert (told["nodes"], told["overrides"]) == (list(nodes), ["controller.gains=[it's]"])


def test_each_waits_for_the_counterparts_that_there_are(recorded: Path) -> None:
    """Of the desired state, which the controller publishes, there is no second publisher."""
    processes = planned(recorded, "controller")
    assert matches(processes["parent_controller"]) == {
        "swarm/events": 1,  # the recorder
        "swarm/desired_abstract_state": 2,  # player and recorder
        "plane/state": 1,
        "recording/progress": 1,
    }
    assert matches(processes["recorder"])["swarm/desired_abstract_state"] == 1
    assert matches(processes["recorder"])["swarm/events"] == 2
    assert "swarm/desired_abstract_state" not in [t.name for t in processes["replay_player"].publications]


def test_robots_share_their_topic_with_the_player(recorded: Path) -> None:
    processes = planned(recorded, "agent:3")
    assert matches(processes["recorder"])["swarm/agent_state"] == 2
    assert matches(processes["agent_003"])["swarm/abstract_state"] == 1

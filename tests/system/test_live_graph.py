"""What every node of a run really publishes and hears, seen from outside by another process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from tests.system.helpers import COORDINATORS, named_processes, started_swarm, swarm, until_stepping

from swarmabs_run.orchestration.run_files import environment_of_run

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

BROADCASTS = ["/swarm/abstract_state", "/swarm/auxiliary_state", "/swarm/desired_abstract_state"]
ROBOT = {"publishes": ["/swarm/agent_state", "/swarm/events"], "hears": BROADCASTS, "serves": []}
OTHERS = {
    "plane_sim": {
        "publishes": ["/plane/state", "/swarm/events"],
        "hears": ["/swarm/agent_state", "/swarm/events"],
        "serves": [],
    },
    "abstraction_observer": {
        "publishes": ["/swarm/abstract_state", "/swarm/auxiliary_state", "/swarm/events"],
        "hears": ["/swarm/agent_state"],
        "serves": [],
    },
    "parent_controller": {
        "publishes": ["/swarm/desired_abstract_state", "/swarm/events"],
        "hears": ["/plane/state", "/recording/progress"],
        "serves": [],
    },
    "recorder": {
        "publishes": ["/recording/progress"],
        "hears": sorted(["/plane/state", "/swarm/agent_state", "/swarm/events", *BROADCASTS]),
        "serves": [],
    },
}


def seen_graph(folder: Path, nodes: int) -> object:
    """Look into a run that is going on."""
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("graph_probe.py"), str(nodes), "40"],
        env={**os.environ, **environment_of_run(folder)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize(("scenario", "robots"), [("pd_het_4", 4), ("arise_het_20", 20)])
def test_every_robot_is_a_process_that_hears_the_three_broadcasts_and_nothing_else(
    folder: Path, mark: str, scenario: str, robots: int
) -> None:
    with started_swarm("run", scenario, "--duration", 100_000, "-o", folder) as command:
        until_stepping(folder)
        names = [f"agent_{index:03d}" for index in range(1, robots + 1)]
        processes = named_processes(mark)
        assert sorted(processes) == sorted([*names, *COORDINATORS])
        assert len(set(processes.values())) == robots + 4
        for pid in processes.values():
            assert psutil.Process(pid).memory_info().rss > 0
        assert seen_graph(folder, robots + 4) == OTHERS | dict.fromkeys(names, ROBOT)
        command.process.terminate()
        assert command.wait().code == 1


def test_robots_with_packed_broadcasts_hear_these_and_nothing_else(folder: Path) -> None:
    with started_swarm("run", "pd_het_4", "--packed", "--duration", 100_000, "-o", folder) as command:
        until_stepping(folder)
        seen = seen_graph(folder, 8)
        command.process.terminate()
        command.wait()
    assert isinstance(seen, dict)
    controller, packed = OTHERS["parent_controller"], "/swarm/broadcast"
    assert seen == OTHERS | {
        "parent_controller": {
            "publishes": sorted([*controller["publishes"], packed]),
            "hears": sorted([*controller["hears"], *BROADCASTS[:2]]),
            "serves": [],
        },
        **{f"agent_{index:03d}": ROBOT | {"hears": [packed]} for index in range(1, 5)},
    }


def test_the_command_env_gives_the_same_view(folder: Path) -> None:
    with started_swarm("run", "--duration", 100_000, "-o", folder) as command:
        until_stepping(folder)
        shown = swarm("env", folder, "--json")
        assert shown.code == 0
        assert environment_of_run(folder).items() <= json.loads(shown.out).items()
        refused = swarm("remove", folder, 1)
        assert refused.code == 2
        assert "a run in lockstep has no operator" in refused.err
        command.process.terminate()
        command.wait()
    for words in (("env", folder), ("remove", folder, 1), ("stop", folder), ("view", "--live", folder)):
        over = swarm(*words)
        assert over.code == 2
        assert f"error: {folder}: this run is over" in over.err

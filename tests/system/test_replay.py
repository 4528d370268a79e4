"""Replays over DDS, node by node, and playback to a ROS node that knows nothing of it."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from tests.processes import marked_processes, until
from tests.system.helpers import (
    bag_digest,
    bag_file,
    bag_messages,
    seconds,
    signal_process,
    simulated_digest,
    started_swarm,
    swarm,
    until_stepping,
)
from tests.system.playback import TOPICS, assert_heard, listening

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

FAULTS = (
    "faults=[{at: 0.2, kind: join, agent: 4}, {at: 0.4, kind: kill, agent: 3}, {at: 0.8, kind: leave, agent: 2},"
    " {kind: loss, probability: 0.1}, {kind: delay, steps: 1}]"
)
NODES = ("controller", "observer", "plane", "agent:3", "agent:4")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a recorded run with every planned fault."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    assert swarm("simulate", "pd_het_4", "--set", seconds(1.5), "--set", FAULTS, "-o", folder).code == 0
    return folder


def provenance(bag: Path) -> dict[str, Any]:
    from swarmabs_bag.reader import open_bag  # noqa: PLC0415

    data = open_bag(bag).attachment("provenance.json")
    assert data is not None
    found = json.loads(data)
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize("node", NODES)
def test_a_live_node_gives_the_recorded_digest(recorded: Path, folder: Path, node: str) -> None:
    done = swarm("replay", recorded, "--node", node, "--expect-same", "-o", folder, "--json")
    assert done.code == 0, done.err
    digest = simulated_digest("pd_het_4", seconds(1.5), FAULTS)
    assert bag_digest(bag_messages(folder)) == done.summary()["digest"] == digest
    assert done.summary()["replay"]["same"]
    # The very same events too; over DDS one may stand after its step.
    assert sorted(m.payload for m in bag_messages(folder)) == sorted(m.payload for m in bag_messages(recorded))
    made = provenance(folder)
    assert made["replay"] == {"of": digest, "nodes": [node], "overrides": []}
    assert made["driver"] == "lockstep"
    logs = {path.stem for path in (folder / "logs").glob("*.log")}
    assert {"replay_player", "recorder"} < logs
    assert len(logs) == 5  # with those of launcher, orchestrator and the node under test


def test_a_player_that_nobody_waits_for_may_fall_behind(recorded: Path, folder: Path, mark: str) -> None:
    """With all nodes under test the loop is closed without it: it hears what is over, and not all of that."""
    nodes = ("controller", "observer", "plane", *(f"agent:{number}" for number in (1, 2, 3, 4)))
    words = [word for node in nodes for word in ("--node", node)]
    long = folder.with_name("long")
    assert swarm("simulate", "pd_het_4", "--duration", 60, "-o", long).code == 0
    with started_swarm("replay", long, *words, "--expect-same", "-o", folder, "--json") as command:
        until_stepping(folder)
        process = next(pid for pid, name in marked_processes(mark).items() if name == "replay_player")
        os.kill(process, signal.SIGSTOP)
        size = bag_file(folder).stat().st_size
        try:
            until(lambda: bag_file(folder).stat().st_size > size, "the nodes go on without the player")
        finally:
            os.kill(process, signal.SIGCONT)
        done = command.wait()
    assert done.code == 0, done.err
    assert done.summary()["replay"]["same"]


def test_changed_gains_are_compared_over_dds_as_in_one_process(recorded: Path, tmp_path: Path) -> None:
    words = ("replay", recorded, "--node", "agent:1", "--set", "swarm.gains.k=[20, 20]", "--json")
    live, alone = (swarm(*words, *more, "-o", tmp_path / name) for name, more in (("a", ()), ("b", ("--in-process",))))
    assert (live.code, alone.code) == (0, 0), live.err
    result = live.summary()["replay"]
    assert result == alone.summary()["replay"]
    assert live.summary()["digest"] == alone.summary()["digest"]
    assert not result["same"]
    first = result["first_difference"]
    assert (first["step"], first["topic"], first["agent"]) == (
        2,
        "swarm/agent_state",
        1,
    )  # 1 step of delay, 1 to answer
    assert {row["field"] for row in result["deviations"]} == {"position", "velocity", "command"}


def test_a_run_that_dropped_a_robot_is_replayed(folder: Path, tmp_path: Path, mark: str) -> None:
    drop = "lockstep={on_stall: drop, stall_timeout: 0.5}"
    with started_swarm("run", "pd_het_4", "--set", drop, "--duration", 30, "-o", folder, "--json") as command:
        until_stepping(folder)
        signal_process(mark, "agent_003", signal.SIGKILL)
        run = command.wait()
    assert run.code == 0, run.err
    for node, where in (("observer", ()), ("plane", ("--in-process",)), ("agent:3", ("--in-process",))):
        done = swarm("replay", folder, "--node", node, *where, "--expect-same", "-o", tmp_path / node, "--json")
        assert done.code == 0, (node, done.err)
        assert done.summary()["digest"] == run.summary()["digest"]


def test_a_replay_that_is_interrupted_leaves_a_readable_bag(recorded: Path, folder: Path, tmp_path: Path) -> None:
    assert swarm("simulate", "--duration", 60, "-o", tmp_path / "long").code == 0
    with started_swarm("replay", tmp_path / "long", "--node", "plane", "-o", folder) as command:
        until_stepping(folder)
        os.kill(command.pid, signal.SIGINT)
        done = command.wait()
    assert done.code == 1
    assert "interrupted" in done.err
    assert len(bag_messages(folder)) > 0


def test_playback_reaches_a_stock_node_in_order_with_the_recorded_qos(
    recorded: Path, tmp_path: Path, ros_network: dict[str, str]
) -> None:
    with listening(tmp_path / "heard.json", ros_network) as listener:
        part = ("--rate", 100, "--duration", 0.9, "--topics", ",".join(TOPICS))
        environment = {**os.environ, **ros_network}
        with started_swarm("replay", recorded, "--wait", *part, "--json", env=environment) as command:
            done = command.wait()
        assert done.code == 0, done.err
        assert listener.wait(60) == 0
    heard = assert_heard(tmp_path / "heard.json", [m for m in bag_messages(recorded) if m.step <= 90])
    assert done.summary()["messages"] == heard


def test_playback_in_a_loop_ends_with_ctrl_c(recorded: Path, ros_network: dict[str, str]) -> None:
    environment = {**os.environ, **ros_network}
    with started_swarm("replay", recorded, "--loop", "--rate", 50, env=environment) as command:
        assert command.process.stderr is not None
        until(lambda: "playing" in command.process.stderr.readline(), "the playback begins", 60.0)  # type: ignore[union-attr]
        os.kill(command.pid, signal.SIGINT)
        done = command.wait()
    assert done.code == 0, done.err
    assert done.out.endswith(" messages published\n")

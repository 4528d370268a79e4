"""Runs in real time as a command: real processes, real DDS, real bags; what dies, and that nothing stays behind."""

from __future__ import annotations

import os
import re
import signal
import struct
from pathlib import Path
from typing import Any

import pytest
from tests.processes import marked_processes, until
from tests.system.helpers import (
    BagMessage,
    bag_messages,
    run_log,
    signal_process,
    started_swarm,
    summary_of,
    swarm,
)

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

NODES = {"plane_sim", "abstraction_observer", "parent_controller", *(f"agent_00{i}" for i in range(1, 5))}
FOREVER = ("--duration", 1000)


def until_moving(folder: Path) -> None:
    """Wait until the recorder has written some of the run: the bag is begun when step 0 is near."""
    bag = folder / "bag" / "bag_0.mcap"
    until(lambda: bag.is_file() and bag.stat().st_size > 0, f"{bag} is begun", 60.0)
    for _ in range(2):
        size = bag.stat().st_size
        until(lambda size=size: bag.stat().st_size > size + 5000, f"{bag} grows", 60.0)  # type: ignore[misc]


def states_of(messages: list[BagMessage], agent_id: int) -> list[BagMessage]:
    return [m for m in messages if m.topic == "swarm/agent_state" and m.agent_id == agent_id]


def verdict(folder: Path, code: int = 0) -> dict[str, Any]:
    done = swarm("verify", folder, "--json")
    assert done.code == code, done.err
    return done.summary()


def test_a_run_is_recorded_and_verified(folder: Path) -> None:
    with started_swarm("run", "--realtime", "--duration", 4, "-o", folder, "--json") as command:
        done = command.wait()
    assert done.code == 0, done.err
    summary = done.summary()
    assert summary == summary_of(folder)
    assert (summary["status"], summary["digest"], summary["steps"]) == ("ok", None, 400)
    realtime = summary["realtime"]
    assert set(realtime["missed_periods"]) == set(realtime["lateness_us"]) == NODES
    made = {name: sum(bins.values()) for name, bins in realtime["lateness_us"].items()}
    assert all(made[name] + realtime["missed_periods"][name] >= 400 for name in NODES)
    assert realtime["died"] == {}
    assert min(map(int, realtime["broadcast_ages"])) >= 1
    messages = bag_messages(folder)
    assert len(messages) == summary["messages"]
    assert max(m.step for m in messages if m.topic == "plane/state") <= 400
    received = {name: loss["received"] for name, loss in realtime["losses"].items()}
    assert received == {name: sum(m.topic == name for m in messages) for name in received}
    # Each was received after it was made, by the same clock.
    assert all(m.publish_time == m.stamp <= m.log_time for m in messages)
    found = verdict(folder)
    assert found["ok"]
    assert found["complete"]
    assert found["messages"] + sum(found["not_checkable"].values()) == sum(received.values())
    assert found["messages"] > 0.5 * sum(received.values())

    file = folder / "bag" / "bag_0.mcap"
    assert swarm("info", file).code == 0
    refused = swarm("run", folder, "-o", folder.with_name("again"))
    assert refused.code == 2
    assert "recorded in real time" in refused.err
    assert not folder.with_name("again").exists()


def test_a_robot_that_dies_is_reported_and_the_swarm_goes_on(folder: Path, mark: str) -> None:
    with started_swarm("run", "--realtime", "--duration", 7, "-o", folder, "--json") as command:
        until_moving(folder)
        pid = signal_process(mark, "agent_003", signal.SIGKILL)
        done = command.wait()
    assert done.code == 0, done.err
    assert "warning: agent_003 was killed by SIGKILL; the swarm went on without it" in done.err
    assert f"agent_003 (process {pid}) was killed by SIGKILL" in run_log(folder)
    summary = done.summary()
    assert summary["realtime"]["died"] == {"agent_003": "was killed by SIGKILL"}
    messages = bag_messages(folder)
    last = states_of(messages, 3)[-1].step
    assert last < states_of(messages, 1)[-1].step
    counts = {m.step: struct.unpack_from("<H", m.payload, 36)[0] for m in messages if m.topic == "swarm/abstract_state"}
    assert counts[max(counts)] == 4, "its weight stays on the plane"
    found = verdict(folder)
    assert found["ok"], found["first_difference"]


@pytest.mark.parametrize("name", ["parent_controller", "plane_sim"])
def test_without_a_coordinator_the_robots_stop_and_then_the_run_fails(folder: Path, mark: str, name: str) -> None:
    with started_swarm("run", "--realtime", *FOREVER, "-o", folder) as command:
        until_moving(folder)
        signal_process(mark, name, signal.SIGKILL)
        done = command.wait()
    assert done.code == 1
    assert f"{name} (process" in done.err
    assert "was killed by SIGKILL" in done.err
    assert summary_of(folder)["status"] == "failed"
    messages = bag_messages(folder)
    for agent_id in range(1, 5):
        *_, status = struct.unpack_from("<HBB", states_of(messages, agent_id)[-1].payload, 44)
        assert status == 2, "the bag shows that the robots have stopped"
    found = verdict(folder)
    assert found["ok"]
    assert not found["complete"]


def test_who_hangs_to_the_end_is_named_and_a_coordinator_fails_the_run(folder: Path, mark: str) -> None:
    with started_swarm("run", "--realtime", "--duration", 4, "-o", folder, "--json") as command:
        until_moving(folder)
        for name in ("plane_sim", "agent_002"):
            pid = signal_process(mark, name, signal.SIGSTOP)
        done = command.wait()
    assert done.code == 1
    assert "plane_sim (process" in done.err
    assert "is stopped) did not end when it was told to; what it did before is not known" in done.err
    assert f"(process {pid}" not in done.err
    assert done.summary()["realtime"]["died"] == {"agent_002": "did not end (it is stopped)"}
    assert verdict(folder)["ok"]


FALLING = ("--set", "plane.disturbance.amplitude=20")


def test_a_run_whose_plane_falls_fails_and_says_when(folder: Path) -> None:
    with started_swarm("run", "--realtime", *FALLING, "--duration", 60, "-o", folder, "--json") as command:
        done = command.wait()
    assert done.code == 1, done.err
    summary = done.summary()
    assert summary["status"] == "failed"
    found = re.match(r"recorder: t = ([\d.]+) s, step (\d+): the plane's angle is -1\.5 rad and", summary["reason"])
    assert found, summary["reason"]
    assert "plane.end_stop" in summary["reason"]
    states = [m for m in bag_messages(folder) if m.topic == "plane/state"]
    angles = {m.step: struct.unpack_from("<d", m.payload, -16)[0] for m in states}
    fallen = min(step for step, angle in angles.items() if abs(angle) >= 1.5)
    assert (int(found[2]), float(found[1])) == (fallen, fallen / 100)
    assert max(angles) < 6000
    assert verdict(folder)["ok"]


def test_a_plane_that_may_rest_at_its_end_stop_has_not_fallen(folder: Path) -> None:
    words = (*FALLING, "--set", "plane.end_stop=1.2")
    with started_swarm("run", "--realtime", *words, "--duration", 5, "-o", folder, "--json") as command:
        done = command.wait()
    assert done.code == 0, done.err
    assert done.summary()["status"] == "ok"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_completes_the_bag(folder: Path, number: signal.Signals) -> None:
    with started_swarm("run", "--realtime", *FOREVER, "-o", folder) as command:
        until_moving(folder)
        os.kill(command.pid, number)
        done = command.wait()
    assert done.code == 1
    assert "error: interrupted" in done.err
    assert "Traceback" not in done.err
    assert summary_of(folder)["status"] == "interrupted"
    assert len(bag_messages(folder)) == summary_of(folder)["messages"] > 0
    assert verdict(folder)["ended_early"] == "interrupted"


def test_a_killed_orchestrator_leaves_nothing_and_its_bag_is_readable(folder: Path, mark: str) -> None:
    with started_swarm("run", "--realtime", *FOREVER, "-o", folder) as command:
        until_moving(folder)
        os.kill(command.pid, signal.SIGKILL)
        command.wait()
    until(lambda: not marked_processes(mark), "all processes have ended", 20.0)
    found = verdict(folder, code=1)
    assert found["first_difference"] is None
    assert found["messages"] > 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--set", "faults=[{at: 1, kind: kill, agent: 1}]"), "faults: there is none in real time"),
        (("--set", "swarm.actuator_lag=0.1"), "swarm.actuator_lag: there is none in real time"),
        (("--packed",), "--packed is for runs in lockstep"),
        (("--agents-per-process", "2"), "--agents-per-process is for runs in lockstep"),
    ],
)
def test_what_is_for_lockstep_only_is_refused(folder: Path, words: tuple[str, ...], said: str) -> None:
    done = swarm("run", "--realtime", *words, "-o", folder)
    assert done.code == 2
    assert said in done.err
    assert not folder.exists()


def test_without_a_bag_there_are_figures_all_the_same(folder: Path) -> None:
    done = swarm("run", "--realtime", "--duration", 2, "--no-bag", "-o", folder, "--json")
    assert done.code == 0, done.err
    assert done.summary()["messages"] > 0
    assert not (folder / "bag").exists()

"""What every change is tried with: real processes that meet over DDS, step, fail, are ended, and leave a bag."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import sin
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from tests.processes import MARK, marked_processes, until
from tests.system import helpers as runs

from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair import repair_bag
from swarmabs_config.realtime import schedule
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import AGENT_STATE, BROADCASTS, EVENTS, PLANE_STATE, TOPICS, AgentState, EventKind, Status
from swarmabs_run.orchestration.network import claimed_domain
from swarmabs_run.orchestration.plan import ProcessPlan
from swarmabs_run.orchestration.run_files import is_running, read_processes, read_progress
from swarmabs_run.steering.client import SteeringClient

pytestmark = [pytest.mark.smoke, pytest.mark.timeout(300)]

AGENTS = (1, 2, 3, 4)
STEPS = 150


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, runs.Finished]:
    """Return the folder of a run by the command, and how the command has ended."""
    folder = tmp_path_factory.mktemp("smoke") / "run"
    with runs.started_swarm("run", "arise_het_4", "--set", runs.seconds(1.5), "-o", folder, "--json") as command:
        return folder, command.wait()


def test_the_command_run_has_the_bits_of_the_simulation(finished: tuple[Path, runs.Finished]) -> None:
    folder, done = finished
    assert done.code == 0, done.err
    summary = done.summary()
    assert summary == runs.summary_of(folder)
    assert (summary["status"], summary["steps"]) == ("ok", STEPS)
    assert summary["digest"] == runs.simulated_digest("arise_het_4", runs.seconds(1.5))
    assert 0.0 < summary["startup_time"] < summary["wall_time"]
    assert {path.name for path in folder.iterdir()} == {"bag", "logs", "scenario.yaml", "summary.json"}
    assert (folder / "logs" / "launcher.log").read_bytes() == b""
    told = read_progress(folder / "logs")
    assert told is not None and (told.phase, told.steps) == ("over", STEPS)
    assert not is_running(folder)
    assert re.search(r"ROS domain \d+.*start", runs.run_log(folder), re.DOTALL)


def test_the_bag_of_a_run_holds_every_message_once_in_canonical_bytes_for_other_readers(
    finished: tuple[Path, runs.Finished],
) -> None:
    folder, done = finished
    messages, summary = runs.bag_messages(folder), done.summary()
    recorded = Counter((m.topic, m.step, m.agent_id) for m in messages if m.topic in runs.MAIN_TOPICS)
    assert recorded == {
        (topic, step, agent): 1
        for topic in runs.MAIN_TOPICS
        for step in range(STEPS + 1)
        for agent in (AGENTS if topic == "swarm/agent_state" else (0,))
    }
    assert (runs.bag_digest(messages), len(messages)) == (summary["digest"], summary["messages"])
    assert all(m.stamp == m.log_time == m.publish_time == m.step * 10_000_000 for m in messages)
    order = [topic.name for topic in (AGENT_STATE, PLANE_STATE, *BROADCASTS, EVENTS)]
    keys = [(m.step, order.index(m.topic), m.agent_id if m.topic != "swarm/events" else 0) for m in messages]
    assert keys == sorted(keys)
    types = {topic.name: topic.message for topic in TOPICS}
    assert all(encode(decode(types[m.topic], m.payload)) == m.payload for m in messages)
    largest = angle = 0.0
    with AnyReader([folder / "bag"]) as reader:
        for connection, time, data in reader.messages():
            message: Any = reader.deserialize(data, connection.msgtype)
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
            assert message.header.frame_id == "plane"
            largest = max(largest, abs(getattr(message, "position", 0.0)))
            angle = getattr(message, "angle", angle)
    assert largest == summary["max_abs_position"]
    assert 0.7 * sin(0.0471238898038469 * 1.5) - angle == pytest.approx(summary["final_error"], abs=1e-9)


def test_the_bag_says_where_it_comes_from_and_can_run_again(finished: tuple[Path, runs.Finished]) -> None:
    folder, done = finished
    with runs.bag_file(folder).open("rb") as stream:
        attached = {attachment.name: attachment.data for attachment in make_reader(stream).iter_attachments()}
    scenario = attached["scenario.yaml"].decode()
    assert scenario == (folder / "scenario.yaml").read_text(encoding="utf-8")
    assert parse_scenario(scenario).steps == STEPS
    provenance = json.loads(attached["provenance.json"])
    assert provenance["driver"] == "lockstep" and provenance["arithmetic"] == 2
    log = attached["run.log"].decode()
    assert all(name in log for name in ("orchestrator.log", "plane_sim.log", "agent_004.log"))
    metadata = yaml.safe_load((folder / "bag" / "metadata.yaml").read_text(encoding="utf-8"))
    information = metadata["rosbag2_bagfile_information"]
    assert information["storage_identifier"] == "mcap"
    assert information["message_count"] == done.summary()["messages"]
    assert information["duration"]["nanoseconds"] == 1_500_000_000
    assert str(done.summary()["messages"]) in runs.swarm("info", folder, "--json").out


def test_a_run_verifies(finished: tuple[Path, runs.Finished]) -> None:
    folder, done = finished
    verdict = runs.swarm("verify", folder, "--json")
    assert (verdict.code, verdict.summary()["complete"]) == (0, True), verdict.out
    assert verdict.summary()["digest"] == done.summary()["digest"]


FAULTS = "faults=[{at: 0.2, kind: kill, agent: 3}, {at: 0.3, kind: freeze, agent: 2}, {at: 0.4, kind: leave, agent: 1}]"
MULTICAST = "<defaultMulticastLocatorList>"
LOG = ("SIGKILL to process", "SIGSTOP to process", "SIGTERM to process")


@pytest.mark.system
def test_robots_end_as_their_faults_say_and_the_others_go_on(folder: Path, mark: str) -> None:
    seen: list[set[str]] = []

    def look() -> None:
        until(lambda: not {"agent_001", "agent_003"} & runs.named_processes(mark).keys(), "robots 1 and 3 are gone")
        seen.append(set(runs.named_processes(mark)))

    outcome = runs.lockstep(folder, "pd_het_4", runs.seconds(8.0), FAULTS, on_progress=runs.at({50: look}))
    assert outcome.status == "ok", outcome.reason
    assert outcome.figures["digest"] == runs.simulated_digest("pd_het_4", runs.seconds(8.0), FAULTS)
    assert seen == [{*runs.COORDINATORS, "agent_002", "agent_004"}]
    recorded = [(event.step, event.agent_id, event.kind) for event in runs.events(folder)]
    ended = [event for event in recorded if event[2] in {EventKind.DEAD, EventKind.LEFT}]
    assert ended == [(21, 3, EventKind.DEAD), (31, 2, EventKind.DEAD), (41, 1, EventKind.LEFT)]
    assert all(text in runs.run_log(folder) for text in LOG)
    assert MULTICAST in (folder / "logs" / "fastdds.xml").read_text(encoding="utf-8")


def late(processes: Sequence[ProcessPlan]) -> Sequence[ProcessPlan]:
    return [replace(p, module="tests.system.late_node") if 4 in p.agents else p for p in processes]


@pytest.mark.usefixtures("own_modules")
def test_packed_grouped_and_late_robots_change_no_bit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor does a machine without multicast."""
    monkeypatch.setattr("swarmabs_run.orchestration.process_run.multicast_works", lambda: False)
    options = {"packed": True, "agents_per_process": 3, "namespace": "/somewhere"}
    outcome = runs.lockstep(folder, "pd_het_4", runs.seconds(1.0), arrange=late, **options)
    assert (outcome.status, outcome.packed) == ("ok", True), outcome.reason
    assert outcome.figures["digest"] == runs.simulated_digest("pd_het_4", runs.seconds(1.0))
    log = runs.run_log(folder)
    assert re.search(r"agents_004\w* \(process \d+\) did not come up: again", log), log
    assert MULTICAST not in (folder / "logs" / "fastdds.xml").read_text(encoding="utf-8")


@pytest.mark.system
def test_a_robot_that_does_not_answer_fails_the_run_or_is_dropped(tmp_path: Path, mark: str) -> None:
    for on_stall in ("fail", "drop"):
        folder = tmp_path / on_stall
        rule = f"lockstep={{on_stall: {on_stall}, stall_timeout: 0.5}}"
        pids: list[int] = []

        def stop(pids: list[int] = pids) -> None:
            pids.append(runs.signal_process(mark, "agent_002", signal.SIGSTOP))

        outcome = runs.lockstep(folder, "pd_het_4", runs.seconds(10.0), rule, on_progress=runs.at({1: stop}))
        if on_stall == "fail":
            assert outcome.status == "failed"
            assert f"agent 002 (process {pids[0]} is stopped) has not answered step " in str(outcome.reason)
            assert str(outcome.reason) in runs.run_log(folder)
            assert open_bag(folder).aborted() is not None
        else:
            assert outcome.status == "ok", outcome.reason
            assert [(event.agent_id, event.kind) for event in runs.events(folder)] == [(2, EventKind.DEAD)]


def test_a_process_that_is_killed_is_named_and_what_it_wrote_is_there(folder: Path, mark: str) -> None:
    pids: list[int] = []

    def kill() -> None:
        # It may be in the middle of the first chunk.
        until(lambda: open_bag(folder, damaged=True).message_count > 0, "a chunk is written")
        pids.append(runs.signal_process(mark, "recorder", signal.SIGKILL))

    outcome = runs.lockstep(folder, "pd_het_4", runs.FOREVER, on_progress=runs.at({1: kill}))
    assert outcome.status == "failed"
    assert str(outcome.reason).startswith(f"recorder (process {pids[0]}) was killed by SIGKILL")
    assert repair_bag(folder, folder / "repaired").last_complete_step is not None, "the file has no end"
    verdict = runs.swarm("verify", folder / "repaired", "--json").summary()
    assert (verdict["first_difference"], verdict["messages"] > 0) == (None, True)


def test_a_run_that_cannot_go_on_fails_with_the_reason_of_the_node(folder: Path) -> None:
    """Of a plane that no robots could hold."""
    push = "plane.disturbance={amplitude: 500.0, angular_frequency: 1.0}"
    done = runs.swarm("run", "pd_si_4", "--duration", 30, "--set", push, "-o", folder, "--json")
    assert done.code == 1
    summary = runs.summary_of(folder)
    assert summary == done.summary()
    assert summary["status"] == "failed"
    assert f"error: {summary['reason']}" in done.err
    assert re.match("parent_controller: .*the plane's angle is", summary["reason"])
    assert summary["reason"] in runs.run_log(folder)
    assert open_bag(folder).aborted() is not None


def test_an_interrupt_completes_the_bag_and_a_kill_ends_everything(tmp_path: Path, mark: str) -> None:
    with runs.started_swarm("run", "--set", runs.FOREVER, "-o", tmp_path / "run", "--json") as command:
        runs.until_stepping(tmp_path / "run")
        written = read_processes(tmp_path / "run")
        assert written is not None and written.items() >= runs.named_processes(mark).items()
        assert written["orchestrator"] == command.process.pid and is_running(tmp_path / "run")
        os.kill(command.process.pid, signal.SIGINT)
        done = command.wait()
    assert done.code == 1
    assert "error: interrupted" in done.err and "Traceback" not in done.err
    assert done.summary() == runs.summary_of(tmp_path / "run")
    assert done.summary()["status"] == "interrupted" == open_bag(tmp_path / "run").aborted()
    assert len(runs.bag_messages(tmp_path / "run")) == done.summary()["messages"] > 0
    with runs.started_swarm("run", "--set", runs.FOREVER, "-o", tmp_path / "killed", "--view") as command:
        with urllib.request.urlopen(runs.view_address(command), timeout=60.0) as page:
            assert b"<title>" in page.read()
        runs.until_stepping(tmp_path / "killed")
        command.process.kill()
        command.process.wait()
        until(lambda: not marked_processes(mark), "everything of the run has ended")
    assert not is_running(tmp_path / "killed")


def test_a_run_is_steered(folder: Path) -> None:
    asked: list[int] = []

    def steer() -> None:
        with SteeringClient(folder) as client:
            for request in ({"action": "reference", "value": 0.05}, {"action": "kill", "agent": 3}):
                answer = client.ask(request)
                assert answer["ok"], answer
                asked.append(answer["step"])

    outcome = runs.lockstep(folder, "pd_het_4", runs.seconds(8.0), steered=True, on_progress=runs.at({1: steer}))
    assert outcome.status == "ok", outcome.reason
    assert not (folder / "steer.sock").exists()
    recorded = {(event.step, event.agent_id, event.kind, event.detail) for event in runs.events(folder)}
    assert recorded >= {(asked[0], 0, EventKind.STEERING, "reference"), (asked[1], 3, EventKind.DEAD, "kill")}
    assert runs.run_log(folder).count("steered: ") == 2
    assert "SIGKILL to process" in runs.run_log(folder)


def test_a_run_in_real_time_starts_steps_stops_and_verifies(folder: Path) -> None:
    done = runs.swarm("run", "--realtime", "--set", runs.seconds(1.0), "-o", folder, "--json")
    assert done.code == 0, done.err
    summary = done.summary()
    assert (summary["status"], summary["digest"], summary["steps"]) == ("ok", None, 100)
    timing = summary["realtime"]
    steps = {name: sum(bins.values()) for name, bins in timing["lateness_us"].items()}
    nodes = {*runs.COORDINATORS[:3], *(f"agent_00{robot}" for robot in AGENTS)}
    assert steps.keys() == timing["longest_us"].keys() == nodes
    assert all(steps[name] + timing["missed_periods"][name] >= 100 for name in steps)
    assert timing["died"] == {}
    scenario = parse_scenario((folder / "scenario.yaml").read_text(encoding="utf-8"))
    clock, realtime = schedule(scenario, 0), scenario.realtime
    # A state reports the decision of the step before, which may rest on broadcasts as new as other clocks may be ahead.
    youngest = 1 - clock.ahead(realtime.clock_tolerance)
    oldest = 1 + clock.steps(realtime.broadcast_age_limit)
    assert {int(age) for age in timing["broadcast_ages"]} <= {*range(youngest, oldest + 1)}
    messages = runs.bag_messages(folder)
    assert len(messages) == summary["messages"]
    assert max(m.step for m in messages if m.topic == "plane/state") <= 100
    assert all(m.publish_time == m.stamp <= m.log_time for m in messages)
    received = {name: loss["received"] for name, loss in timing["losses"].items()}
    assert received == {name: sum(m.topic == name for m in messages) for name in received}
    verdict = runs.swarm("verify", folder, "--json").summary()
    assert (verdict["ok"], verdict["complete"]) == (True, True)
    divided = sum(m.topic == "swarm/standing" for m in messages)
    assert verdict["messages"] + sum(verdict["not_checkable"].values()) == sum(received.values()) + divided


@pytest.mark.system
def test_robots_in_real_time_that_compute_the_swarm_by_themselves_verify(folder: Path) -> None:
    words = ("--set", "coordination=each_robot", "--set", runs.seconds(1.0))
    done = runs.swarm("run", "--realtime", *words, "-o", folder, "--json")
    assert done.code == 0, done.err
    messages = runs.bag_messages(folder)
    assert {f"agent_00{robot}/relay" for robot in AGENTS} <= {message.topic for message in messages}
    verified = runs.swarm("verify", folder, "--json")
    verdict = verified.summary()
    assert (verified.code, verdict["ok"], verdict["complete"], verdict["notes"][1:]) == (0, True, True, [])
    assert sum(verdict["not_checkable"].values()) < verdict["messages"]


DYING = {1: "agent_003", 30: "plane_sim"}
"""By the step from which on it may happen."""


@pytest.mark.system
def test_in_real_time_a_robot_may_die_and_the_plane_may_not(folder: Path, mark: str) -> None:
    deaths = {step: partial(runs.signal_process, mark, name, signal.SIGKILL) for step, name in DYING.items()}
    outcome = runs.realtime(folder, runs.FOREVER, on_progress=runs.at(deaths))
    assert outcome.status == "failed"
    assert re.match(r"plane_sim \(process \d+\) was killed by SIGKILL", str(outcome.reason))
    assert outcome.figures["realtime"]["died"] == {"agent_003": "was killed by SIGKILL"}
    assert outcome.warnings == ("agent_003 was killed by SIGKILL; the swarm continued without it",)
    assert re.search(r"agent_003 \(process \d+\) was killed by SIGKILL", runs.run_log(folder))
    last = {message.agent_id: message for message in runs.bag_messages(folder) if message.topic == "swarm/agent_state"}
    states = {robot: decode(AgentState, message.payload) for robot, message in last.items()}
    assert {states[robot].status for robot in (1, 2, 4)} == {Status.SAFE_STOP}
    assert states[3].step < min(states[robot].step for robot in (1, 2, 4))
    assert runs.swarm("verify", folder, "--json").summary()["ended_early"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--realtime", "--set", "faults=[{at: 1, kind: kill, agent: 1}]"), "faults: not supported in real time"),
        (("--realtime", "--packed"), "--packed cannot be combined with --realtime"),
        (("--realtime", "--agents-per-process", "2"), "--agents-per-process cannot be combined"),
        (("--steer", "--no-bag"), "--steer cannot be combined with --no-bag"),
        (("--view", "--view-port", "TAKEN"), "of 127.0.0.1: Address already in use"),
        (("--foxglove", "--foxglove-port", "TAKEN"), "of 127.0.0.1: Address already in use"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_starts(folder: Path, words: tuple[str, ...], said: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = runs.swarm("run", *(word.replace("TAKEN", port) for word in words), "-o", folder)
    assert (done.code, said in done.err) == (2, True), done.err
    assert not folder.exists()


def test_a_node_that_is_interrupted_twice_ends_well(nothing_survives: str, tmp_path: Path) -> None:
    """Ctrl-C reaches a node of a launch file from the terminal and from the launch, at any time until it has ended."""
    with claimed_domain() as domain:
        network = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        environment = {**os.environ, **network, "ROS_LOG_DIR": str(tmp_path), MARK: nothing_survives}
        command = [sys.executable, "-m", "plane_sim.node"]
        with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as node:
            assert node.stderr is not None
            assert any("ready" in line for line in node.stderr)
            while node.poll() is None:
                node.send_signal(signal.SIGINT)
            assert node.stderr.read() == ""
    assert node.returncode == 0

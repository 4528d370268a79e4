"""Runs that are steered while they go: real processes, the real socket, and the same run again from its bag."""

from __future__ import annotations

import json
import os
import signal
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.processes import marked_processes, until
from tests.system.helpers import (
    bag_messages,
    run_log,
    signal_process,
    simulated_digest,
    started_swarm,
    summary_of,
    swarm,
)

from swarmabs_bag.attached import attached_scenario
from swarmabs_bag.reader import open_bag
from swarmabs_core.cdr import decode
from swarmabs_core.errors import InputError
from swarmabs_core.faults import MembershipFault
from swarmabs_core.messages import EventKind, SwarmEvent
from swarmabs_run.steering.client import SteeringClient

pytestmark = [pytest.mark.system, pytest.mark.timeout(400)]

DURATION = 30
SEVEN = (
    *("--set", "swarm.agents=null", "--set", "swarm.generate={single_integrator: 3, double_integrator: 4}"),
    *("--set", "faults=[{kind: join, at: null, agent: 7}, {kind: disturbance, at: 0, torque: 0.1, until: 0.01}]"),
)


@contextmanager
def steered(folder: Path, *words: object, to_the_end: bool = True) -> Iterator[SteeringClient]:
    """Start a run that can be steered, and connect to it as soon as it steps; it goes on to its end, or is ended."""
    with started_swarm("run", *words, "--steer", "-o", folder, "--json") as command:
        until((folder / "steer.sock").exists, "there is a socket", 60.0)
        with SteeringClient(folder) as client:
            until(lambda: client.ask({"action": "status"})["step"] > 0, "the run steps", 60.0)
            yield client
        if not to_the_end:
            command.process.terminate()
        done = command.wait()
        assert done.code == (0 if to_the_end else 1), done.err
        assert not (folder / "steer.sock").exists()


def later(client: SteeringClient, steps: int) -> None:
    """Let some steps pass."""
    wanted = client.ask({"action": "status"})["step"] + steps
    until(lambda: client.ask({"action": "status"})["step"] >= wanted, f"step {wanted}", 60.0)


def events(folder: Path) -> list[tuple[int, int, int, str]]:
    found = []
    for message in bag_messages(folder):
        if message.topic == "swarm/events":
            event = decode(SwarmEvent, message.payload)
            assert isinstance(event, SwarmEvent)
            found.append((event.step, event.agent_id, event.kind, event.detail))
    return sorted(found)


@pytest.mark.parametrize(
    "words",
    [("pd_het_4",), pytest.param(("arise_het_4", "--packed", "--agents-per-process", 3), marks=pytest.mark.full)],
    ids=["a process per robot", "packed, and robots that share processes"],
)
def test_a_steered_run_can_be_repeated(tmp_path: Path, words: tuple[object, ...]) -> None:
    folder = tmp_path / "run"
    asked: list[tuple[dict[str, Any], int]] = []
    with steered(folder, *words, "--duration", DURATION, *SEVEN) as client:
        for request in (
            {"action": "reference", "value": 0.05},
            {"action": "disturbance", "value": -0.1},
            {"action": "add", "agent": 7},
            {"action": "kill", "agent": 3},
            {"action": "reference", "value": -0.05},
            {"action": "freeze", "agent": 5},
            {"action": "leave", "agent": 2},
        ):
            answer = client.ask(request)
            assert answer["ok"], (request, answer)
            asked.append((request, answer["step"]))
            later(client, 37)
        held = client.ask({"action": "status"})
        assert (held["members"], held["absent"], held["reference"], held["disturbance"]) == (
            [1, 4, 6, 7],
            [],
            -0.05,
            -0.1,
        )
    steps = [step for _, step in asked]
    assert len(set(steps)) == len(steps)
    assert events(folder)[-1][0] <= DURATION * 100
    found = [event for event in events(folder) if event[2] not in (EventKind.LIMIT_HIT, EventKind.SAFE_STOP)]
    planned = {(step, 0, EventKind.STEERING, "disturbance") for step in (0, 1)}
    assert sorted(set(found) - planned) == sorted(
        {
            (steps[0], 0, EventKind.STEERING, "reference"),
            (steps[1], 0, EventKind.STEERING, "disturbance"),
            (steps[2], 7, EventKind.JOINED, ""),
            (steps[3], 3, EventKind.DEAD, "kill"),
            (steps[4], 0, EventKind.STEERING, "reference"),
            (steps[5], 5, EventKind.DEAD, "freeze"),
            (steps[6], 2, EventKind.LEFT, "remove"),
        }
    )
    assert run_log(folder).count("steered: ") == 7

    verdict = swarm("verify", folder, "--json")
    assert verdict.code == 0, verdict.out
    assert verdict.summary()["complete"] is True
    assert "from outside" in verdict.summary()["notes"][0]
    digest = summary_of(folder)["digest"]
    for command in ("run", "simulate"):
        again = swarm(command, folder, "-o", tmp_path / f"{command}-again", "--json")
        assert again.code == 0, again.err
        assert again.summary()["digest"] == digest
        assert again.summary()["rerun_of"]["same"] is True
        figures = ("settled_at", "final_error", "rms_error", "max_abs_position", "messages")
        assert {name: again.summary()[name] for name in figures} == {name: summary_of(folder)[name] for name in figures}
    for node in ("observer", "agent:7") if "--packed" in words else ():
        replayed = swarm("replay", folder, "--node", node, "--in-process", "--expect-same", "-o", tmp_path / node[:5])
        assert replayed.code == 0, replayed.err
    planned_robots = {fault.agent for fault in attached_scenario(open_bag(folder)).faults_of(MembershipFault)}
    assert planned_robots == {2, 3, 5, 7}


def test_a_run_that_could_be_steered_and_was_not(tmp_path: Path) -> None:
    with steered(tmp_path / "run", "pd_het_4", "--duration", 20) as client:
        mode = (tmp_path / "run" / "steer.sock").stat().st_mode
        assert stat.S_IMODE(mode) == 0o600
        assert client.ask({"action": "status"})["members"] == [1, 2, 3, 4]
    assert summary_of(tmp_path / "run")["digest"] == simulated_digest("pd_het_4", "duration=20.0")


def test_what_is_refused_changes_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with steered(folder, "pd_het_4", "--duration", 100_000, to_the_end=False) as client:
        for request, reason in (
            ({"action": "kill", "agent": 9}, "there is no robot 9; there are 1, 2, 3, 4"),
            ({"action": "kill"}, "kill needs 'agent'"),
            ({"action": "reference", "value": 0.1, "agent": 1}, "reference takes no 'agent'"),
            ({"action": "reference", "value": True}, "value: Input should be a valid number"),
            ({"action": "reference", "value": 1.2}, "1.2 rad is out of range"),
            ({"action": "explode"}, "action: Input should be 'reference'"),
            ({"action": "add", "agent": 2}, "robot 2 is there by the scenario"),
            ({"action": "status", "shell": "true"}, "shell: Extra inputs are not permitted"),
        ):
            answer = client.ask(request)
            assert answer["ok"] is False
            assert reason in answer["reason"]
        for line in (
            b"\n",
            b"{\n",
            b"[]\n",
            b'{"action": "reference", "value": NaN}\n',
            b"\xff\n",
            b"{" * 5000 + b"\n",
        ):
            assert b'"ok": false' in raw(folder, line)
        refused = swarm("steer", folder, "kill", "9")
        assert (refused.code, refused.out) == (2, "")
        assert refused.err == "error: there is no robot 9; there are 1, 2, 3, 4\n"
    assert events(folder) == []
    assert swarm("verify", folder).code == 0


def raw(folder: Path, line: bytes) -> bytes:
    """Send bytes to a run, and return what it answers first."""
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(20.0)
        client.connect(str(folder / "steer.sock"))
        client.sendall(line)
        return client.makefile("rb").readline()


def test_a_request_that_is_repeated_is_done_once(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    request = {"action": "disturbance", "value": 0.1, "request": "page-1"}
    with steered(folder, "pd_het_4", "--duration", 100_000, "--rate", 2, to_the_end=False) as client:
        first = client.ask(request)
        later(client, 20)
        assert client.ask(request) == first
        with SteeringClient(folder) as other:
            assert other.ask(request) == first
            assert "was something else" in other.ask({**request, "value": 0.2})["reason"]
        by_command = swarm("steer", folder, "disturbance", "-0.1", "--json")
        assert by_command.summary()["step"] > first["step"]
        said = swarm("steer", folder, "status")
        assert "disturbance -0.1 N m" in said.out
    assert [event[0] for event in events(folder)] == [first["step"], by_command.summary()["step"]]


def test_a_folder_whose_path_is_longer_than_that_of_a_socket_may_be(tmp_path: Path) -> None:
    folder = tmp_path / ("long" * 30) / "run"
    folder.parent.mkdir()
    with steered(folder, "pd_het_4", "--duration", 20) as client:
        assert client.ask({"action": "reference", "value": 0.1})["ok"]
    assert swarm("verify", folder).code == 0


def test_the_end_of_what_steers_is_named(tmp_path: Path, mark: str) -> None:
    folder = tmp_path / "run"
    with started_swarm("run", "--steer", "--duration", 600, "-o", folder, "--json") as command:
        until((folder / "steer.sock").exists, "there is a socket", 60.0)
        with SteeringClient(folder) as client:
            until(lambda: client.ask({"action": "status"})["step"] > 0, "the run steps", 60.0)
        pid = next(pid for pid, name in marked_processes(mark).items() if name == "steering")
        os.kill(pid, signal.SIGKILL)
        done = command.wait()
    assert done.code == 1
    assert f"steering (process {pid}) was killed by SIGKILL" in done.err
    assert not (folder / "steer.sock").exists()
    with pytest.raises(InputError, match="start one with run --steer"):
        SteeringClient(folder)
    assert swarm("verify", folder).code == 0


def test_without_a_bag_nothing_can_be_steered(tmp_path: Path) -> None:
    done = swarm("run", "--steer", "--no-bag", "-o", tmp_path / "run")
    assert done.code == 2
    assert "--no-bag" in done.err
    assert not (tmp_path / "run").exists()
    for words in (("kill", "x"), ("kill",), ("reference", "left"), ("status", "1"), ("kill", "1")):
        assert swarm("steer", tmp_path, *words).code == 2


def test_a_robot_that_fell_silent_is_killed_when_the_bag_runs_again(tmp_path: Path, mark: str) -> None:
    folder = tmp_path / "run"
    words = ("--set", "lockstep={on_stall: drop, stall_timeout: 1.0}", "--duration", DURATION)
    with steered(folder, "pd_het_4", *words) as client:
        signal_process(mark, "agent_002", signal.SIGKILL)
        until(lambda: 2 not in client.ask({"action": "status"})["members"], "robot 2 is out", 60.0)
        assert client.ask({"action": "reference", "value": 0.1})["ok"]
        assert "does not take part" in client.ask({"action": "kill", "agent": 2})["reason"]
    assert swarm("verify", folder).code == 0
    again = swarm("simulate", folder, "-o", tmp_path / "again", "--json")
    assert again.code == 0, again.err
    assert "robot 2 fell silent" in again.err
    assert json.loads(again.out)["rerun_of"]["same"] is True

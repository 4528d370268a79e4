"""Markers beside a run: what they show is what is recorded, and no run needs or notices them."""

from __future__ import annotations

import asyncio
import cmath
import json
import os
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests.processes import ROOT, SEARCH_PATH, until
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

from swarmabs_bag.arrays import load_arrays
from swarmabs_cli import main
from swarmabs_run.orchestration.run_files import environment_of_run, read_progress

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]
SWARM = [sys.executable, "-m", "swarmabs_cli"]
DURATION = "100"
HALF_THICKNESS = 0.01


@pytest.fixture(scope="module")
def digest(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("alone") / "run"
    assert main(["simulate", "--duration", DURATION, "--no-bag", "-o", str(folder), "--json"]) == 0
    return str(json.loads((folder / "summary.json").read_text())["digest"])


@contextmanager
def running(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], psutil.Process]]:
    """Start a run and yield it with the process of its markers when it has begun."""
    words = [*SWARM, "run", "--duration", DURATION, "-o", str(folder), "--json", *options]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        try:
            log = folder / "logs" / "markers.log"
            until(lambda: log.exists() and shows(folder), "the markers are there", 60.0)
            children = psutil.Process(run.pid).children(recursive=True)
            (markers,) = (child for child in children if "swarmabs_view.visualization.run_markers" in child.cmdline())
            yield run, markers
        finally:
            if run.poll() is None:
                run.send_signal(signal.SIGINT)
            run.communicate(timeout=60)


def shows(folder: Path) -> bool:
    told = read_progress(folder / "logs")
    return told is not None and told.phase == "running"


def ended(run: subprocess.Popen[str]) -> tuple[dict[str, Any], str]:
    out, err = run.communicate(timeout=200)
    assert run.returncode == 0, err
    return json.loads(out), err


def test_a_ros_node_sees_what_is_recorded(tmp_path: Path, digest: str, nothing_survives: str) -> None:
    folder, file = tmp_path / "run", tmp_path / "heard.json"
    with running(folder, "--markers") as (run, _):
        environment = os.environ | SEARCH_PATH | environment_of_run(folder) | {"ROS_LOG_DIR": str(tmp_path / "log")}
        listener = [sys.executable, str(ROOT / "tests" / "system" / "marker_listener.py"), str(file), "5"]
        subprocess.run(listener, env=environment, check=True, timeout=120)
        summary, _ = ended(run)
    assert summary["digest"] == digest
    assert (folder / "logs" / "markers.log").read_text() == ""
    recorded, heard = load_arrays(folder), json.loads(file.read_text())
    ids = list(recorded.agents.ids)
    assert len(heard["joints"]) >= 5 and len(heard["markers"]) >= 5
    for stamp, joint, angle in heard["joints"]:
        assert joint == "plane_tilt"
        assert angle == recorded.angle[stamp // 10_000_000]
    stood = 0
    for stamp, places in heard["markers"]:
        step = stamp // 10_000_000
        turn = cmath.exp(1j * recorded.angle[step])
        for agent_id, (x, z) in places.items():
            along = ((x + 1j * z) / turn).real
            assert abs(along - recorded.agents.position[step, ids.index(int(agent_id))]) < 1e-9
            stood += 1
    assert stood >= 4 * 5
    assert heard["description"][0].startswith("<?xml")


@pytest.mark.parametrize("number", [signal.SIGSTOP, pytest.param(signal.SIGKILL, marks=pytest.mark.full)])
def test_no_run_waits_for_its_markers(
    tmp_path: Path, digest: str, nothing_survives: str, number: signal.Signals
) -> None:
    with running(tmp_path / "run", "--markers") as (run, markers):
        markers.send_signal(number)
        summary, err = ended(run)
    assert (summary["status"], summary["digest"]) == ("ok", digest)
    assert "warning: the markers" not in err  # killed is not failed


def test_markers_end_with_a_run_that_is_killed(tmp_path: Path, nothing_survives: str) -> None:
    with running(tmp_path / "run", "--markers") as (run, markers):
        markers.send_signal(signal.SIGSTOP)
        run.kill()
        run.wait(30)
        until(lambda: not markers.is_running() or markers.status() == psutil.STATUS_ZOMBIE, "the markers have ended")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_foxglove_is_served_on_this_machine_alone(tmp_path: Path, digest: str, nothing_survives: str) -> None:
    port = free_port()
    with running(tmp_path / "run", "--foxglove", "--foxglove-port", str(port)) as (run, markers):
        until(lambda: listening(markers), "the port", 30.0)
        assert listening(markers) == {("127.0.0.1", port)}
        channels, messages = asyncio.run(asyncio.wait_for(looked(port), 60.0))
        summary, err = ended(run)
    assert summary["digest"] == digest
    assert f"ws://127.0.0.1:{port}" in err
    types = {topic: channel["schemaName"] for topic, channel in channels.items()}
    assert types["/swarm/markers"] == "visualization_msgs/msg/MarkerArray"
    assert types["/plane/state"] == "swarmabs_msgs/msg/PlaneState"
    assert all(channel["encoding"] == "cdr" for channel in channels.values())
    assert all(channel["schemaEncoding"] == "ros2msg" for channel in channels.values())
    recorded = load_arrays(tmp_path / "run")
    for payload in messages["/plane/state"]:
        step, angle = struct.unpack_from("<Qd", payload, 28)  # behind encapsulation, header and its padding
        assert angle == recorded.angle[step]
    assert b"plane_tilt" in messages["/plane/joint_states"][0]
    assert b"<robot name=" in messages["/robot_description"][0]


def listening(process: psutil.Process) -> set[tuple[str, int]]:
    found = process.net_connections("tcp")
    return {(each.laddr.ip, each.laddr.port) for each in found if each.status == psutil.CONN_LISTEN}


async def looked(port: int) -> tuple[dict[str, Any], dict[str, list[bytes]]]:
    """Do as Foxglove does: take what is advertised, subscribe to some of it, and wait for messages of each."""
    wanted = ("/plane/state", "/plane/joint_states", "/swarm/markers", "/robot_description")
    channels: dict[str, Any] = {}
    messages: dict[str, list[bytes]] = {topic: [] for topic in wanted}
    async with connect(f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None) as link:
        async for frame in link:
            if isinstance(frame, str):
                document = json.loads(frame)
                if document["op"] == "advertise":
                    new = {channel["topic"]: channel for channel in document["channels"]}
                    channels |= new
                    asked = [
                        {"id": number, "channelId": new[topic]["id"]}
                        for number, topic in enumerate(wanted)
                        if topic in new
                    ]
                    await link.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
            elif frame[0] == 1:  # a message: subscription, time, payload
                subscription = struct.unpack_from("<I", frame, 1)[0]
                messages[wanted[subscription]].append(frame[13:])
                if all(messages.values()):
                    break
    return channels, messages


def test_a_taken_port_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        words = ["run", "--foxglove", "--foxglove-port", str(port), "-o", str(tmp_path / "run")]
        assert main(words) == 2
    assert f"error: port {port} of 127.0.0.1: Address already in use" in capfd.readouterr().err
    assert not (tmp_path / "run").exists()

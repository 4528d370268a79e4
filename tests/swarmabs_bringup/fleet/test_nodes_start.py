"""The nodes of a bundle start as their units start them: command, environment files, parameters, word to systemd."""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.swarmabs_bringup.fleet.fleets import ONE_HOST, deployed, edited

from swarmabs_bringup.fleet.loader import load_fleet
from swarmabs_bringup.orchestration.domain import claimed_domain


def command_of(unit: Path) -> list[str]:
    """Return what a unit starts, with the interpreter of the tests."""
    found = re.search(r"^ExecStart=(\S+) (.*)$", unit.read_text(), re.MULTILINE)
    assert found and found[1] == "/nowhere/swarmabs/.venv/bin/python"
    return [sys.executable, *shlex.split(found[2])]


def environment_of(unit: Path) -> dict[str, str]:
    """Return what a unit adds to the environment of the workspace, in which the tests run."""
    files = re.findall(r"^EnvironmentFile=(\S+)$", unit.read_text(), re.MULTILINE)
    lines = [
        line for file in files if not file.endswith("workspace.env") for line in Path(file).read_text().splitlines()
    ]
    return dict(line.split("=", 1) for line in lines)


@pytest.mark.system
@pytest.mark.timeout(120)
@pytest.mark.parametrize("plane", ["simulated", "driver"])
def test_every_node_takes_its_parameters_and_says_that_it_is_ready(
    plane: str, tmp_path: Path, nothing_survives: str
) -> None:
    with claimed_domain() as domain, ExitStack() as stack:
        prefix = tmp_path / "etc"
        topic = "drive: {type: topic, topic: /odom, command_topic: /force}}"
        changes = [("domain: 7", f"domain: {domain}"), ("/etc/swarmabs", str(prefix)), (", recorder: {host: base}", "")]
        if plane == "driver":
            changes.append(("plane: {host", "plane: {type: driver, topic: /encoder, host"))
            changes.append(("drive: {type: simulated, position: -0.1}}", topic))
        output = deployed(load_fleet(edited(tmp_path / "one.yaml", ONE_HOST, *changes)), tmp_path / "out")
        prefix.mkdir()
        bundle = (output / "base").rename(prefix / "one")
        units = sorted((bundle / "systemd").glob("*.service"))
        assert len(units) == 5
        started = {}
        for number, unit in enumerate(units):
            command = command_of(unit)
            module = command[2]
            parent = module.partition(".")[0]
            if importlib.util.find_spec(parent) is None or importlib.util.find_spec(module) is None:
                pytest.skip(f"there is no {module} in this version")
            channel = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            channel.bind(str(tmp_path / f"notify{number}"))
            channel.settimeout(60.0)
            own = {"NOTIFY_SOCKET": channel.getsockname(), "WATCHDOG_USEC": "2000000", "ROS_LOG_DIR": str(tmp_path)}
            environment = {**os.environ, **environment_of(unit), "PYTHONSAFEPATH": "", **own}
            process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
            stack.callback(process.communicate)
            stack.callback(process.kill)
            started[unit.stem] = (process, channel)
        for name, (process, channel) in started.items():
            words: set[bytes] = set()
            while process.poll() is None and not {b"READY=1", b"WATCHDOG=1"} <= words:
                words |= set(channel.recv(200).split(b"\n"))
            assert process.poll() is None, f"{name}: {process.stderr.read() if process.stderr else ''}"
        for process, _ in started.values():
            process.send_signal(signal.SIGTERM)
        assert [process.wait(timeout=30) for process, _ in started.values()] == [0] * 5

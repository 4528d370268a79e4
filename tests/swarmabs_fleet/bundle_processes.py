"""The nodes of a bundle as processes, started as their units start them."""

from __future__ import annotations

import os
import re
import shlex
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


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


def write_below(bundle: Path, folder: Path) -> None:
    """Let the nodes of a bundle write below a folder what they would write below /var/lib."""
    for file in (bundle / "nodes").glob("*.yaml"):
        text = file.read_text()
        file.write_text(re.sub(r"/var/lib/swarmabs-[a-z0-9_-]+", str(folder), text))


@dataclass(slots=True)
class Unit:
    """A running node, and the socket on which it speaks to its service manager."""

    name: str
    process: subprocess.Popen[str]
    channel: socket.socket

    def said(self, *words: bytes) -> bool:
        """Wait until the node has said all of these words; False if it has ended before."""
        heard: set[bytes] = set()
        while self.process.poll() is None and not set(words) <= heard:
            heard |= set(self.channel.recv(200).split(b"\n"))
        return self.process.poll() is None

    def complaint(self) -> str:
        """Return what a node that has ended wrote."""
        return self.process.stderr.read() if self.process.stderr else ""


@contextmanager
def running(bundle: Path, folder: Path) -> Iterator[dict[str, Unit]]:
    """Start all nodes of a bundle, by the part of their units' names behind the fleet; they end with the block."""
    with ExitStack() as stack:
        units = {}
        for number, path in enumerate(sorted((bundle / "systemd").glob("*.service"))):
            channel = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            channel.bind(str(folder / f"notify{number}"))
            channel.settimeout(60.0)
            own = {
                "NOTIFY_SOCKET": channel.getsockname(),
                "WATCHDOG_USEC": "2000000",
                "ROS_LOG_DIR": str(folder / "ros"),
            }
            environment = {**os.environ, **environment_of(path), "PYTHONSAFEPATH": "", **own}
            process = subprocess.Popen(command_of(path), env=environment, stderr=subprocess.PIPE, text=True)
            stack.callback(process.communicate)
            stack.callback(process.kill)
            name = path.stem.split("-", 2)[2]
            units[name] = Unit(name, process, channel)
        yield units


def ended(units: dict[str, Unit]) -> list[int]:
    """Ask all nodes to end, and return their exit codes."""
    for unit in units.values():
        unit.process.send_signal(signal.SIGTERM)
    return [unit.process.wait(timeout=30) for unit in units.values()]

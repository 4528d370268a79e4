"""The nodes of a bundle as processes, started as their units start them."""

import os
import re
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.swarmabs_fleet.fleets import deployed

from swarmabs_config.fleet.loader import LoadedFleet


def variables(file: Path) -> dict[str, str]:
    """Return the environment that a file of a bundle says."""
    return dict(line.split("=", 1) for line in file.read_text().splitlines())


def installed(loaded: LoadedFleet, folder: Path) -> Path:
    """Deploy a fleet of one host whose prefix is `etc` in a folder, below which its nodes write, not below /var/lib.

    Its nodes start without DDS Security, for which the Fast DDS of the tests is not built.
    """
    (folder / "etc").mkdir()
    keys = folder / "keys" if loaded.fleet.security.level == "sros2" else None
    bundle = (deployed(loaded, folder / "out", keys) / "base").rename(folder / "etc" / "one")
    for file in (bundle / "nodes").glob("*.env"):
        file.write_text(re.sub(r"ROS_SECURITY_.*\n", "", file.read_text()))
    for file in (bundle / "nodes").glob("*.yaml"):
        file.write_text(re.sub(r"/var/lib/swarmabs-[a-z0-9_-]+", str(folder), file.read_text()))
    return bundle


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
            unit = path.read_text()
            environment = {**os.environ, "PYTHONSAFEPATH": "", "ROS_LOG_DIR": str(folder / "ros")}
            environment |= {"NOTIFY_SOCKET": channel.getsockname(), "WATCHDOG_USEC": "2000000"}
            for file in re.findall(r"^EnvironmentFile=(\S+)$", unit, re.MULTILINE):
                # The tests run in the environment of the workspace.
                environment |= {} if file.endswith("workspace.env") else variables(Path(file))
            ((python, words),) = re.findall(r"^ExecStart=(\S+) (.*)$", unit, re.MULTILINE)
            assert python in {"/nowhere/swarmabs/.venv/bin/python", "/usr/bin/python3"}
            command = [sys.executable, *shlex.split(words)]
            process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
            stack.callback(process.communicate)
            stack.callback(process.kill)
            name = path.stem.split("-", 2)[2]
            units[name] = Unit(name, process, channel)
        yield units


def ended(units: dict[str, Unit]) -> list[int]:
    for unit in units.values():
        unit.process.send_signal(signal.SIGTERM)
    return [unit.process.wait(timeout=30) for unit in units.values()]

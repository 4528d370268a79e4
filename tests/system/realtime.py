"""Nodes in real time as processes in a ROS domain of their own, and a client that looks at them and operates them."""

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from tests.processes import SEARCH_PATH, until
from tests.system.helpers import LONGEST

from swarmabs_ros.status import REPORT_FD
from swarmabs_run.orchestration.network import FIRST_FREE, claimed_domain, dds_environment, profile_xml

PATIENCE = 60.0
"""Time, s, within which something must happen that takes far less on a machine that is not busy."""


class Client:
    """Speaks with the process of `realtime_client`."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def __getattr__(self, name: str) -> Any:
        def ask(*arguments: object) -> Any:
            stdin, stdout = self._process.stdin, self._process.stdout
            assert stdin is not None and stdout is not None
            stdin.write(json.dumps([name, *arguments]) + "\n")
            stdin.flush()
            ready, _, _ = select.select([stdout], [], [], LONGEST)
            assert ready, f"the client does not answer {name}"
            line = stdout.readline()
            assert line, f"the client has died over {name}"
            return json.loads(line)

        return ask

    def health(self, node: str) -> dict[str, Any]:
        """Return the newest diagnostics of a node, empty if there are none."""
        newest: dict[str, Any] = self.look()["diagnostics"].get(node, {})
        return newest

    def is_healthy(self, node: str, level: int = 0) -> bool:
        """Tell whether a node reports a level; that periods were missed is the busy machine's matter."""
        health = self.health(node)
        return bool(health) and (health["level"] == level or (not level and "periods missed" in health["message"]))

    def until_healthy(self, *nodes: str, level: int = 0) -> None:
        def what() -> str:
            others = {node: self.health(node) for node in nodes if not self.is_healthy(node, level)}
            return f"all report level {level}, others are {others}"

        until(lambda: all(self.is_healthy(node, level) for node in nodes), what, PATIENCE)


@contextmanager
def started_client(environment: Mapping[str, str], module: str = "realtime_client") -> Iterator[Client]:
    """Start the process of a client, such as `stock_node`, in the environment of those who take part in a network."""
    process = subprocess.Popen(
        [sys.executable, Path(__file__).with_name(f"{module}.py")],
        env={**os.environ, **SEARCH_PATH, **environment},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield Client(process)
    finally:
        _end(process)


class Network:
    """A ROS domain on loopback with a profile for real time."""

    def __init__(self, folder: Path, domain: int, stack: ExitStack) -> None:
        self._folder = folder
        self._stack = stack
        profile = folder / "fastdds.xml"
        text = profile_xml(domain, participant=FIRST_FREE, peers=range(20), realtime=True)
        profile.write_text(text, encoding="utf-8")
        self._read, self._write = os.pipe()
        stack.callback(os.close, self._read)
        stack.callback(os.close, self._write)
        self._environment = {
            **dds_environment(domain, str(profile)),
            "ROS_LOG_DIR": str(folder / "ros"),
            REPORT_FD: str(self._write),
        }
        self._epoch_ns = time.time_ns()
        self._reports: list[dict[str, Any]] = []

    def start(self, module: str, name: str, **parameters: object) -> "Process":
        given = {"epoch_ns": self._epoch_ns, **parameters}
        words = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
        log = self._folder / f"{name}.log"
        with log.open("a") as stream:
            process = subprocess.Popen(
                [sys.executable, "-m", module, "--ros-args", "-r", f"__node:={name}", *words],
                env={**os.environ, **SEARCH_PATH, **self._environment},
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream,
                pass_fds=(self._write,),
            )
        self._stack.callback(_end, process)
        return Process(process, log)

    def client(self) -> Client:
        return self._stack.enter_context(started_client(self._environment))

    def read_reports(self) -> list[dict[str, Any]]:
        """Return what the nodes have reported so far on their status channel."""
        while select.select([self._read], [], [], 0.0)[0]:
            self._reports += map(json.loads, os.read(self._read, 1 << 20).decode().splitlines())
        return self._reports


class Process:
    def __init__(self, process: subprocess.Popen[bytes], log: Path) -> None:
        self._process, self._log = process, log
        self.pid = process.pid

    def log(self) -> str:
        return self._log.read_text(encoding="utf-8")

    def terminate(self) -> int:
        """Tell it to end, and return its exit code."""
        self._process.terminate()
        return self._process.wait(LONGEST)


def _end(process: subprocess.Popen[Any]) -> None:
    process.kill()
    process.wait(LONGEST)
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()


@contextmanager
def realtime_network(folder: Path) -> Iterator[Network]:
    """Claim a domain; at the end every process is killed."""
    with claimed_domain() as domain, ExitStack() as stack:
        yield Network(folder, domain, stack)


def start_swarm(network: Network) -> dict[str, Process]:
    """Start a plane, its observer and controller, and three robots of both kinds."""
    members: dict[str, object] = {"members": [1, 2, 3]}
    mass, damped = {"swarm_mass": 1.5}, {"kind": "double_integrator", "damping": 0.7}
    given = {"plane_sim": members, "abstraction_observer": {**members, **mass}, "parent_controller": {}}
    nodes = {name: network.start(f"{name}.realtime", name, **own) for name, own in given.items()}
    for robot, position, kind in ((1, -0.1, {}), (2, 0.2, damped), (3, -0.3, {})):
        own = {"agent_id": robot, "position": position, **mass, **kind}
        nodes[f"agent_{robot:03d}"] = network.start("agent_node.realtime", f"agent_{robot:03d}", **own)
    return nodes

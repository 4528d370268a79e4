"""Nodes in real time as processes in a ROS domain of their own, and a client that looks at them and operates them."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from tests.processes import SEARCH_PATH, until
from tests.system.helpers import LONGEST

from swarmabs_ros.status import REPORT_FD
from swarmabs_run.orchestration.network import FIRST_FREE, claimed_domain, dds_environment, profile_xml

PATIENCE = 40.0
"""Time, s, within which something must happen that takes far less on a machine that is not busy."""


class Client:
    """Speaks with the process of `realtime_client`."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def __getattr__(self, name: str) -> Any:
        def ask(*arguments: object) -> Any:
            stdin, stdout = self._process.stdin, self._process.stdout
            assert stdin is not None
            assert stdout is not None
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
        found: dict[str, Any] = self.look()["diagnostics"].get(node, {})
        return found

    def is_healthy(self, node: str, level: int = 0) -> bool:
        """Tell whether a node reports a level; that periods were missed is the busy machine's matter."""
        health = self.health(node)
        return bool(health) and (health["level"] == level or (not level and "periods missed" in health["message"]))

    def until_healthy(self, *nodes: str, level: int = 0) -> None:
        """Wait until nodes report a level."""
        for node in nodes:
            until(
                lambda node=node: self.is_healthy(node, level),  # type: ignore[misc]
                f"{node} reports level {level}",
                PATIENCE,
            )


class Network:
    """A ROS domain on loopback with a profile for real time.

    Attributes
    ----------
    reports : list of dict
        What the nodes have reported on their status channel; see `read_reports`.
    """

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
            **os.environ,
            **SEARCH_PATH,
            **dds_environment(domain, str(profile)),
            "ROS_LOG_DIR": str(folder / "ros"),
            REPORT_FD: str(self._write),
        }
        self.epoch_ns = time.time_ns()
        self.reports: list[dict[str, Any]] = []

    def start(self, module: str, name: str, environment: dict[str, str] | None = None, **parameters: object) -> Process:
        """Start a node; double underscores in the names of parameters stand for dots."""
        parameters = {"epoch_ns": self.epoch_ns, **parameters}
        words = [word for key, value in parameters.items() for word in ("-p", f"{key.replace('__', '.')}:={value}")]
        log = self._folder / f"{name}.log"
        with log.open("a") as stream:
            process = subprocess.Popen(
                [sys.executable, "-m", module, "--ros-args", "-r", f"__node:={name}", *words],
                env={**self._environment, **(environment or {})},
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream,
                pass_fds=(self._write,),
            )
        self._stack.callback(_end, process)
        return Process(process, log)

    def client(self) -> Client:
        """Start a client."""
        process = subprocess.Popen(
            [sys.executable, Path(__file__).with_name("realtime_client.py")],
            env=self._environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._stack.callback(_end, process)
        return Client(process)

    def read_reports(self) -> list[dict[str, Any]]:
        """Return what the nodes have reported so far."""
        while select.select([self._read], [], [], 0.0)[0]:
            self.reports += map(json.loads, os.read(self._read, 1 << 20).decode().splitlines())
        return self.reports


class Process:
    """The process of a node."""

    def __init__(self, process: subprocess.Popen[bytes], log: Path) -> None:
        self._process, self._log = process, log
        self.pid = process.pid

    def log(self) -> str:
        """Return what it has written."""
        return self._log.read_text(encoding="utf-8")

    def terminate(self) -> int:
        """Tell it to end, and return its exit code."""
        self._process.terminate()
        return self.wait()

    def wait(self) -> int:
        """Return its exit code once it has ended."""
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


def start_swarm(network: Network, *, robots: int = 3, **controller: object) -> dict[str, Process]:
    """Start a plane, its observer and controller, and robots of both kinds."""
    members = list(range(1, robots + 1))
    nodes = {
        "plane_sim": network.start("plane_sim.realtime", "plane_sim", members=members),
        "abstraction_observer": network.start(
            "abstraction_observer.realtime", "abstraction_observer", members=members, swarm_mass=0.5 * robots
        ),
        "parent_controller": network.start("parent_controller.realtime", "parent_controller", **controller),
    }
    for agent_id in members:
        name = f"agent_{agent_id:03d}"
        kind: dict[str, object] = {"kind": "double_integrator", "damping": 0.7} if agent_id % 2 == 0 else {}
        nodes[name] = network.start(
            "agent_node.realtime",
            name,
            agent_id=agent_id,
            position=0.1 * agent_id * (-1) ** agent_id,
            swarm_mass=0.5 * robots,
            **kind,
        )
    return nodes

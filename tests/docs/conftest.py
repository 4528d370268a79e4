"""Nodes that a test starts by hand, as a reader of the documentation would."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from swarmabs_run.orchestration.network import FIRST_FREE, claimed_domain, dds_environment, profile_xml


class NodesByHand:
    """Starts nodes as modules of their own processes."""

    def __init__(self, environment: dict[str, str], logs: Path) -> None:
        self.environment = environment
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._logs = logs

    def start(self, module: str, *arguments: str, name: str) -> None:
        """Start a node."""
        with (self._logs / f"{name}.txt").open("wb") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, "-m", module, *arguments], env=self.environment, stdout=log, stderr=log
            )

    def end(self) -> dict[str, int]:
        """Ask all to end, and return their exit codes."""
        for process in self.processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        try:
            return {name: process.wait(timeout=15) for name, process in self.processes.items()}
        finally:
            for process in self.processes.values():
                process.kill()


@pytest.fixture
def by_hand(nothing_survives: str, tmp_path: Path) -> Iterator[NodesByHand]:
    """Nodes in a claimed ROS domain on loopback."""
    with claimed_domain() as domain:
        profile = tmp_path / "fastdds.xml"
        profile.write_text(profile_xml(domain, peers=range(16), participant=FIRST_FREE), encoding="utf-8")
        nodes = NodesByHand(
            {**os.environ, **dds_environment(domain, str(profile)), "ROS_LOG_DIR": str(tmp_path / "ros")}, tmp_path
        )
        try:
            yield nodes
        finally:
            codes = nodes.end()
        assert set(codes.values()) == {0}, codes

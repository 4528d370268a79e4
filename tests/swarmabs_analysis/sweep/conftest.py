"""Small sweeps, and the command as a process of its own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from pathlib import Path

import pytest

from swarmabs_analysis.sweep.study import Study, load_sweep

SMALL = """\
schema: 1
scenario: pd_het_4
set: {duration: 0.2}
grid:
  plane.angle: {from: -0.2, to: 0.3, count: 6}
  plane.angular_velocity: [0.0, 1.5, 200]
random:
  swarm.agents.0.mass: {uniform: [0.25, 0.75]}
samples: 2
seed: 7
"""
"""36 cases of some milliseconds each; those with 200 rad/s fail."""

Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture(scope="session", autouse=True)
def _resource_tracker() -> None:
    """Start what multiprocessing starts once in a process and leaves running until it ends."""
    resource_tracker.ensure_running()


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    return path


@pytest.fixture
def study(small: Path) -> Study:
    return load_sweep(small)


@pytest.fixture
def start(nothing_survives: str, tmp_path: Path) -> Iterator[Start]:
    """Start ``swarm sweep`` with arguments; what still runs at the end is killed."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: object) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "swarmabs_cli", "sweep", *map(str, arguments)]
        pipe = subprocess.PIPE
        process = subprocess.Popen(command, cwd=tmp_path, stdout=pipe, stderr=pipe, text=True, start_new_session=True)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def sweep(start: Start) -> Callable[..., tuple[int, str, str]]:
    """Run ``swarm sweep`` with arguments to its end; returns exit code, standard output and standard error."""

    def sweep(*arguments: object) -> tuple[int, str, str]:
        process = start(*arguments)
        out, err = process.communicate()
        return process.returncode, out, err

    return sweep

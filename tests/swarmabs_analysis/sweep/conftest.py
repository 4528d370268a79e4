"""Small sweeps, the command as a process of its own, and what tests look at in the folder of a sweep."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import psutil
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


def finished(folder: Path) -> int:
    """Return how many cases of a sweep that goes on are finished."""
    try:
        return (folder / "cases.jsonl").read_bytes().count(b"\n")
    except FileNotFoundError:
        return 0


def summary(folder: Path) -> Any:
    return json.loads((folder / "summary.json").read_text())


def workers(pid: int) -> list[psutil.Process]:
    """Return the worker processes of a local sweep."""
    children = psutil.Process(pid).children()
    return [child for child in children if any("spawn_main" in part for part in child.cmdline())]

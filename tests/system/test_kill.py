"""A run that is killed at any moment leaves a bag that is, when repaired, the beginning of the run."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import chain
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from tests.processes import marked_processes, until
from tests.system.helpers import LONGEST, named_processes, seconds

from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair import repair_bag
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.simulation import simulated_steps

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

DURATION = 150.0
CREDIT = 100
"""Steps that may be missing however long they took."""
MESSAGES = 8
"""Messages of a step of the scenario."""


@cache
def written() -> tuple[bytes, ...]:
    """Return the payloads of the whole run, as it is without a kill, in the order of a bag."""
    steps = simulated_steps(find_scenario("pd_het_4", [seconds(DURATION)]).resolved())
    return tuple(payload for _, _, payload in chain.from_iterable(step.stored() for step in steps))


def reports(file: Path) -> list[tuple[float, int]]:
    """Return time and step of every report of the recorder that came through."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    return [(float(moment), int(step)) for moment, step in map(str.split, lines)]


def killed(folder: Path, mark: str, whom: str, delay: float) -> tuple[float, list[tuple[int, float]]]:
    """Run, kill the recorder or all processes some time after the first step, and return when, and the reports."""
    steps = folder.with_suffix(".steps")
    script = Path(__file__).with_name("observed_run.py")
    command = [sys.executable, str(script), str(folder), str(steps), seconds(DURATION)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            until(lambda: reports(steps), "the run steps", 60.0)
            time.sleep(delay)
            if whom == "recorder":
                targets = [named_processes(mark)["recorder"]]
            elif whom == "orchestrator":
                targets = [process.pid]
            else:
                targets = list(marked_processes(mark))
            moment = time.monotonic()
            for pid in targets:
                kill_if_there(pid)
            process.wait(LONGEST)
        finally:
            process.kill()
    until(lambda: not marked_processes(mark), "all processes have ended", 20.0)
    return moment, [(step, at) for at, step in reports(steps) if at <= moment]


def kill_if_there(pid: int) -> None:
    """Kill a process, which may just have ended."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def check(folder: Path, moment: float, seen: Sequence[tuple[int, float]]) -> int:
    """Check what a kill has left behind; return the number of steps."""
    report = repair_bag(folder, folder / "new")
    found = [payload for _, _, payload in open_bag(folder / "new").messages()]
    assert tuple(found) == written()[: len(found)], "not the beginning of the run"
    open_bag(folder / "new").check()
    assert sum(indexed(folder / "new")) == len(found)
    with Reader(folder / "new") as other:
        assert sum(1 for _ in other.messages()) == len(found)
    assert repair_bag(folder / "new").output is None
    # What was recorded a second before the kill is there, or all but the last 100 steps.
    newest = seen[-1][0]
    second_ago = max((step for step, at in seen if at <= moment - 1.0), default=-1)
    assert report.last_complete_step is not None
    assert report.last_complete_step >= min(newest - CREDIT, second_ago), (
        report.last_complete_step,
        seen[-15:],
        moment,
    )
    assert report.last_complete_step == len(found) // MESSAGES - 1
    return len(found) // MESSAGES


def indexed(folder: Path) -> Iterator[int]:
    """Yield how many messages a reader that needs the index finds in each file."""
    for file in sorted(folder.glob("*.mcap")):
        with file.open("rb") as stream:
            yield sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())


WHOM = ("recorder", "orchestrator", "everything")


@pytest.mark.parametrize("whom", WHOM)
def test_a_run_that_is_killed_loses_no_more_than_a_second(folder: Path, mark: str, whom: str) -> None:
    moment, seen = killed(folder, mark, whom, 1.5)
    assert check(folder, moment, seen) > 0


@pytest.mark.full
@pytest.mark.timeout(1500)
def test_a_run_that_is_killed_at_fifty_moments(tmp_path: Path, mark: str) -> None:
    draw = random.Random(1702)
    steps = []
    for number in range(50):
        folder = tmp_path / str(number)
        moment, seen = killed(folder, mark, WHOM[number % len(WHOM)], draw.uniform(0.0, 3.5))
        steps.append(check(folder, moment, seen))
    assert len(set(steps)) > 5

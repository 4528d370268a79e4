"""A long run needs no more than a short one: memory and file descriptors of every process stay flat."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import psutil
import pytest
from tests.processes import marked_processes
from tests.system.helpers import COORDINATORS, lockstep, seconds

from swarmabs_run.run import Progress

pytestmark = [pytest.mark.system, pytest.mark.full, pytest.mark.timeout(900)]

STEPS, EARLY, LATE = 20_000, range(2_000, 5_000), range(16_500, 19_500)
"""Late is before the end: there processes end."""
GROWTH = 2**20
"""Of the resident memory of a process between early and late, bytes: 75 bytes a step would show."""
LOOKS = 3
"""How often each process is looked at, early and late at least."""


class Needs(NamedTuple):
    """What a process holds: resident memory, bytes, and open file descriptors."""

    memory: int
    descriptors: int


def needs(mark: str) -> dict[str, Needs]:
    """Return what every process of a run holds: the nodes by their names, and the launcher by that of Python."""
    found = {}
    for pid, name in marked_processes(mark).items():
        process = psutil.Process(pid)
        found[name] = Needs(process.memory_info().rss, process.num_fds())
    return found


def least(looks: list[dict[str, Needs]]) -> dict[str, Needs]:
    """Return the least that every process held: what it takes for a moment, as to compress a chunk, does not count."""
    assert len(looks) >= LOOKS
    return {name: Needs(*map(min, zip(*(look[name] for look in looks), strict=True))) for name in looks[0]}


def test_memory_and_descriptors_stay_flat_over_20000_steps(folder: Path, mark: str) -> None:
    seen: dict[range, list[dict[str, Needs]]] = {EARLY: [], LATE: []}

    def watch(progress: Progress) -> None:
        for steps, looks in seen.items():
            if progress.phase == "running" and progress.step in steps:
                looks.append(needs(mark))

    outcome = lockstep(folder, "pd_het_4", seconds(STEPS / 100), on_progress=watch)
    assert outcome.status == "ok", outcome.reason
    early, late = least(seen[EARLY]), least(seen[LATE])
    assert len(early) == len(COORDINATORS) + 4 + 1
    assert late.keys() == early.keys()
    grown = {name: late[name].memory - early[name].memory for name in early}
    assert max(grown.values()) < GROWTH, grown
    opened = {name: late[name].descriptors - early[name].descriptors for name in early}
    assert set(opened.values()) == {0}, opened

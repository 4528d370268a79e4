"""Bags, servers of them as real processes, and a real browser."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.swarmabs_bringup.figures.conftest import record

COMMAND = (sys.executable, "-m", "swarmabs_bringup.cli", "view")
CHANGES = (
    "duration=4.0",
    "faults=[{at: 1.0, kind: kill, agent: 1}, {at: 2.0, kind: leave, agent: 2}]",
)


@dataclass
class Served:
    """A view that is served by a process."""

    url: str
    run: Path
    process: subprocess.Popen[str]

    @property
    def port(self) -> int:
        """Port of the server."""
        return int(self.url.rstrip("/").rpartition(":")[2])


@contextmanager
def serving(run: Path, port: int = 0) -> Iterator[Served]:
    """Serve a bag, as a user would, until the end of the block."""
    with subprocess.Popen(
        [*COMMAND, str(run), "--port", str(port)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().strip()
            assert url.startswith("http://127.0.0.1:"), f"no address but {url!r}"
            yield Served(url, run, process)
        finally:
            process.kill()


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a short run in which robots die and leave; not to be changed."""
    return record(tmp_path_factory.mktemp("view") / "run", "pd_het_4", *CHANGES)


@pytest.fixture(scope="session")
def served(run: Path) -> Iterator[Served]:
    """Serve that run."""
    with serving(run) as view:
        yield view


def chromium() -> str:
    """Return the browser's program; skip, and say so, where there is none."""
    for name in ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"):
        found = shutil.which(name)
        if found:
            return found
    pytest.skip("no Chromium on this machine: apt-get install chromium")


def browser_arguments() -> list[str]:
    """Return what Chromium needs here: root has no sandbox."""
    return ["--no-sandbox"] if os.geteuid() == 0 else []

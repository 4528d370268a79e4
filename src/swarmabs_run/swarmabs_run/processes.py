"""The processes of a run in progress, as the operating system sees them, and its progress.

None of this joins the run's network: the run's folder identifies the process that started it, the kernel lists the
descendants of that process, and a node is identified by the log to which its output goes.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import psutil

from swarmabs_config.graph import SILENCE
from swarmabs_core.errors import InputError
from swarmabs_run.orchestration.run_files import NETWORK_FILE, RunOverError, is_running, orchestrator_of, read_progress

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_run.orchestration.run_files import ProgressReport

ORCHESTRATOR = "orchestrator"
SHARES = 16
"""Processes whose PSS a snapshot reads, in turn: the kernel sums it page by page, which blocks the process."""


class Row(NamedTuple):
    """A process: name, id, share of a core since the previous snapshot (%), memory (bytes), state.

    ``pss`` divides shared memory among the processes that share it, so it adds up; ``rss`` counts it in full for each.
    None marks values that the kernel does not provide.
    """

    name: str
    pid: int
    cpu: float | None
    pss: int | None
    rss: int | None
    state: str


class Snapshot(NamedTuple):
    """A run at one moment: its processes, the orchestrator first, and its progress."""

    rows: tuple[Row, ...]
    progress: ProgressReport | None
    age: float
    """Age of the progress report, s."""

    @property
    def step_rate(self) -> float | None:
        """Steps per second of wall time; None if unknown, 0 if the run makes no progress."""
        if self.progress is None or self.progress.step_rate is None:
            return None
        return self.progress.step_rate if self.age < SILENCE else None


class RunProcesses:
    """Monitors the processes of the run in a folder; raises `InputError` if the run is not in progress."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._logs = (folder / "logs").resolve()
        self._orchestrator = orchestrator_of(folder)
        self._watched: dict[psutil.Process, str] = {}
        self._pss: dict[psutil.Process, int | None] = {}
        if not self.running():
            raise RunOverError(folder)

    def running(self) -> bool:
        """Return whether the run is still in progress."""
        return is_running(self.folder)

    def snapshot(self, now: float, shares: int | None = SHARES) -> Snapshot:
        """Return a snapshot at a time (s, monotonic); CPU time counts from the previous snapshot.

        Reads the PSS of the next `shares` processes in turn, or of all processes if `shares` is None.
        """
        progress = read_progress(self._logs)
        found = {process: self._watched.get(process) or self._name(process) for process in self._family()}
        # Keep the objects: they hold the processor time of the previous snapshot.
        known = {process: process for process in self._watched}
        self._watched = {known.get(process, process): name for process, name in found.items()}
        # The processes whose PSS is oldest come first.
        turn = [*(p for p in self._watched if p not in self._pss), *(p for p in self._pss if p in self._watched)]
        asked = set(turn[:shares])
        self._pss = {p: self._pss[p] for p in turn if p in self._pss and p not in asked} | {p: _pss(p) for p in asked}
        watched = self._watched.items()
        rows = [row for p, name in watched if (row := _row(p, name, self._pss.get(p))) is not None]
        first = [row for row in rows if row.name == ORCHESTRATOR]
        others = sorted((row for row in rows if row.name != ORCHESTRATOR), key=lambda row: row.name)
        return Snapshot((*first, *others), progress, 0.0 if progress is None else now - progress.told_at)

    def _family(self) -> Iterable[psutil.Process]:
        if self._orchestrator is None:
            return ()
        try:
            return (self._orchestrator, *self._orchestrator.children(recursive=True))
        except psutil.Error:
            return ()

    def _name(self, process: psutil.Process) -> str:
        """Return the name of a process: for a node the name of its log, for others that of the program."""
        if process == self._orchestrator:
            return ORCHESTRATOR
        try:
            output = Path(f"/proc/{process.pid}/fd/1").readlink()
            if output.parent == self._logs and output.suffix == ".log":
                return output.stem
            words = process.cmdline()
            if "-m" in words[:-1]:
                return words[words.index("-m") + 1].removeprefix("swarmabs_")
            return process.name()
        except (OSError, psutil.Error):
            return "?"


def newest_run(runs: Path) -> Path:
    """Return the folder of the newest run in progress in a folder of runs.

    Raises `InputError` if no run is in progress.
    """
    found = sorted(runs.glob(f"*/logs/{NETWORK_FILE}"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in found:
        folder = path.parent.parent
        try:
            RunProcesses(folder)
        except InputError:
            continue
        return folder
    raise InputError(f"no run in {runs}/ is running; start one, or give the folder of a run elsewhere")


def document(folder: Path, snapshot: Snapshot) -> dict[str, Any]:
    """Return a snapshot as JSON values."""
    progress = snapshot.progress
    return {
        "run": str(folder),
        "phase": None if progress is None else progress.phase,
        "step": None if progress is None else progress.step,
        "steps": None if progress is None else progress.steps,
        "step_rate": snapshot.step_rate,
        "processes": [row._asdict() for row in snapshot.rows],
    }


def _row(process: psutil.Process, name: str, pss: int | None) -> Row | None:
    try:
        with process.oneshot():
            cpu, rss = float(process.cpu_percent(None)), int(process.memory_info().rss)
            return Row(name, process.pid, cpu, pss, rss, str(process.status()))
    except psutil.AccessDenied:
        return Row(name, process.pid, None, None, None, "?")
    except psutil.Error:
        return None


def _pss(process: psutil.Process) -> int | None:
    try:
        return int(process.memory_full_info().pss)
    except psutil.Error:
        return None

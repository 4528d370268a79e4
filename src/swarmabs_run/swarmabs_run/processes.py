"""The processes of a run that is going on, as the operating system sees them, and how far the run is.

Nothing of this joins the run's network: its folder says who started it, the kernel who descends from that process, and
a node's output goes to a log in the folder that has its name.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import psutil

from swarmabs_core.errors import InputError
from swarmabs_run.orchestration.run_files import NETWORK_FILE, RunOverError, is_running, orchestrator_of, read_progress

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_run.orchestration.run_files import Told

ORCHESTRATOR = "orchestrator"
SHARES = 16
"""Processes whose PSS a snapshot asks for, in turn: the kernel adds it up page by page, which blocks the process."""
SILENCE = 3.0
"""Age, s, from which a report of the run's progress no longer tells its speed."""


class Row(NamedTuple):
    """A process: name, id, share of a core since the snapshot before (%), memory (bytes), what the kernel says it does.

    ``pss`` shares what several processes have in common among them, so it adds up; ``rss`` counts it for each. None is
    what the kernel does not tell.
    """

    name: str
    pid: int
    cpu: float | None
    pss: int | None
    rss: int | None
    state: str


class Snapshot(NamedTuple):
    """A run at one moment: its processes, the orchestrator first, and how far it is."""

    rows: tuple[Row, ...]
    told: Told | None
    age: float
    """Of what is told, s."""

    @property
    def step_rate(self) -> float | None:
        """Steps per second of wall time; None if it is not known, 0 if the run stands still."""
        if self.told is None or self.told.step_rate is None:
            return None
        return self.told.step_rate if self.age < SILENCE else None


class RunProcesses:
    """Watches the processes of a run in a folder; raises `InputError` if no run goes on there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._logs = (folder / "logs").resolve()
        self._orchestrator = orchestrator_of(folder)
        self._watched: dict[psutil.Process, str] = {}
        self._pss: dict[psutil.Process, int | None] = {}
        if not self.running():
            raise RunOverError(folder)

    def running(self) -> bool:
        """Tell whether the run goes on."""
        return is_running(self.folder)

    def snapshot(self, now: float, shares: int | None = SHARES) -> Snapshot:
        """Return how the processes are doing at a time (s, monotonic); CPU time counts since the snapshot before.

        Of so many processes, those whose turn it is, the PSS is asked for anew; with None of all.
        """
        told = read_progress(self._logs)
        found = {process: self._watched.get(process) or self._name(process) for process in self._family()}
        # The same objects as before: they know the processor time of the snapshot before.
        known = {process: process for process in self._watched}
        self._watched = {known.get(process, process): name for process, name in found.items()}
        # Those that were asked longest ago stand first.
        turn = [*(p for p in self._watched if p not in self._pss), *(p for p in self._pss if p in self._watched)]
        asked = set(turn[:shares])
        self._pss = {p: self._pss[p] for p in turn if p in self._pss and p not in asked} | {p: _pss(p) for p in asked}
        watched = self._watched.items()
        rows = [row for p, name in watched if (row := _row(p, name, self._pss.get(p))) is not None]
        first = [row for row in rows if row.name == ORCHESTRATOR]
        others = sorted((row for row in rows if row.name != ORCHESTRATOR), key=lambda row: row.name)
        return Snapshot((*first, *others), told, 0.0 if told is None else now - told.told_at)

    def _family(self) -> Iterable[psutil.Process]:
        if self._orchestrator is None:
            return ()
        try:
            return (self._orchestrator, *self._orchestrator.children(recursive=True))
        except psutil.Error:
            return ()

    def _name(self, process: psutil.Process) -> str:
        """Return the name of a process: of a node that of its log, of others what was started."""
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
    """Return the folder of the run in a folder of runs that was begun last and goes on.

    Raises `InputError` if none goes on.
    """
    found = sorted(runs.glob(f"*/logs/{NETWORK_FILE}"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in found:
        folder = path.parent.parent
        try:
            RunProcesses(folder)
        except InputError:
            continue
        return folder
    raise InputError(f"no run in {runs}/ is running; start one, or name the folder of a run elsewhere")


def document(folder: Path, snapshot: Snapshot) -> dict[str, Any]:
    """Return a snapshot as JSON takes it."""
    told = snapshot.told
    return {
        "run": str(folder),
        "phase": None if told is None else told.phase,
        "step": None if told is None else told.step,
        "steps": None if told is None else told.steps,
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

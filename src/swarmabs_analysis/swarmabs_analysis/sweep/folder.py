"""The folder of a sweep: a journal of finished cases that becomes one Parquet file at the end.

During the sweep ``cases.jsonl`` gets one line per finished case, in any order. The next start removes a line that a
crash left incomplete. Tables, pictures and ``summary.json`` appear complete or not at all.
"""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from itertools import zip_longest
from typing import TYPE_CHECKING, TypedDict

from swarmabs_analysis.sweep.study import SCENARIO_FILE, Study
from swarmabs_bag.run_folder import new_run_folder, next_run_folder
from swarmabs_config.files import write_whole
from swarmabs_core.errors import InputError, RunError

try:
    import fcntl
except ModuleNotFoundError:  # on Windows, where nothing notices two sweeps in one folder
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from pathlib import Path

    from typing_extensions import Self

    from swarmabs_analysis.sweep.evaluate import Row

SWEEP_FILE, RESULTS_FILE = "sweep.yaml", "results.parquet"
_SYNC_EVERY = 1.0
"""Time whose results a power failure may lose, s; a crash of this process loses none."""


class Summary(TypedDict):
    """The content of ``summary.json``; times in s."""

    sweep: str
    cases: int
    finished: int
    outcomes: dict[str, int]
    engine: str
    wall_time: float
    computed: int
    cases_per_second: float | None
    status: str
    reason: str | None


class SweepFolder:
    """A folder of a sweep, written by one process at a time; use it as a context manager."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.results, self.summary = path / RESULTS_FILE, path / "summary.json"
        self.journal = path / "cases.jsonl"
        """The finished cases of an incomplete sweep."""
        self.rows: dict[int, Row] = {}
        """The finished cases by index."""
        self.outcomes: Counter[str] = Counter()
        """Number of finished cases by outcome."""
        self._journal = -1
        self._synced = time.monotonic()

    def complete(self) -> Summary | None:
        """Return the summary of a complete sweep, otherwise None."""
        try:
            summary: Summary = json.loads(self.summary.read_bytes())
        except (OSError, ValueError):
            return None
        return summary if self.results.exists() and summary.get("status") == "ok" else None

    def __enter__(self) -> Self:
        """Lock the folder, and read the finished cases.

        Raises
        ------
        InputError
            If another process has locked it, or it cannot be written.
        """
        try:
            self._journal = os.open(self.journal, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
            if fcntl is not None:
                fcntl.flock(self._journal, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.read()
        except BlockingIOError:
            self._close()
            raise InputError(
                f"{self.path} is in use by another sweep; wait until it ends, or name another folder"
            ) from None
        except OSError as error:
            self._close()
            raise InputError(f"{self.path} cannot be written: {error.strerror}; choose another with -o") from error
        return self

    def __exit__(self, *_: object) -> None:
        """Unlock the folder."""
        self._close()

    def read(self) -> None:
        """Read the finished cases, and remove an incomplete line after them."""
        os.lseek(self._journal, 0, os.SEEK_SET)
        self.rows.clear()
        self.outcomes.clear()
        good = 0
        with open(self._journal, "rb", closefd=False) as file:
            for line in file:
                try:
                    row = json.loads(line)
                    index, outcome = row["case"], row["outcome"]
                except (ValueError, TypeError, KeyError):
                    break
                if not line.endswith(b"\n"):
                    break
                self.rows[index] = row
                self.outcomes[outcome] += 1
                good += len(line)
        os.ftruncate(self._journal, good)
        os.lseek(self._journal, good, os.SEEK_SET)

    def add(self, line: str) -> None:
        """Append the row of a finished case to the journal.

        Raises
        ------
        RunError
            If the disk is full or fails.
        """
        row = json.loads(line)
        try:
            _write_all(self._journal, f"{line}\n".encode())
            now = time.monotonic()
            if now - self._synced >= _SYNC_EVERY:
                os.fsync(self._journal)
                self._synced = now
        except OSError as error:
            raise RunError(f"{self.journal}: {error.strerror}; free space, then continue with --resume") from error
        self.rows[row["case"]] = row
        self.outcomes[row["outcome"]] += 1

    def write_whole(self, path: Path, content: bytes) -> None:
        """Write a file of the folder completely or not at all."""
        try:
            write_whole(path, content, sync=True)
        except OSError as error:
            raise RunError(f"{path}: {error.strerror}; free space, then continue with --resume") from error

    def _close(self) -> None:
        if self._journal >= 0:
            os.close(self._journal)
            self._journal = -1


def make_folder(study: Study, path: Path | None, parent: Path) -> SweepFolder:
    """Create the folder of a new sweep: the one named by the user, or the next free one below a parent.

    Raises
    ------
    InputError
        If it cannot be created, or is not empty.
    """
    if path is not None and (path / SWEEP_FILE).is_file():
        raise InputError(f"{path} already contains a sweep; continue it with --resume, or name another folder")
    run_folder = new_run_folder(path) if path is not None else next_run_folder(parent, study.sweep.name)
    folder = SweepFolder(run_folder.path)
    # The file of the sweep comes last: without it there is nothing to resume.
    for name, text in _files(study):
        folder.write_whole(folder.path / name, text.encode())
    return folder


def find_folder(study: Study, path: Path) -> SweepFolder:
    """Return the folder of a started sweep after checking that it is the same sweep.

    Raises
    ------
    InputError
        If it contains another sweep.
    """
    for name, text in _files(study):
        try:
            content = (path / name).read_bytes()
        except OSError as error:
            raise InputError(
                f"{path / name} cannot be read: {error.strerror}; start again in another folder"
            ) from error
        if content != text.encode():
            pairs = zip_longest(
                content.decode(errors="replace").splitlines(keepends=True), text.splitlines(keepends=True)
            )
            line = next((number for number, (one, other) in enumerate(pairs, 1) if one != other), 1)
            raise InputError(
                f"{path} contains another sweep: {name} differs from line {line} on; "
                "continue with the files it was started with, or start again in another folder"
            )
    return SweepFolder(path)


def _files(study: Study) -> tuple[tuple[str, str], ...]:
    """Return names and texts of the files that define the sweep."""
    return (SCENARIO_FILE, study.scenario), (SWEEP_FILE, study.sweep_text)


def _write_all(descriptor: int, content: bytes) -> None:
    written = 0
    while written < len(content):
        written += os.write(descriptor, content[written:])

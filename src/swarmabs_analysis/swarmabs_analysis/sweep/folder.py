"""The folder of a sweep: what is finished is kept case by case, and becomes one Parquet file at the end.

While the sweep goes on ``cases.jsonl`` gets one line per finished case, in any order. A line that a crash has torn is
cut off by the next start. ``results.parquet`` and ``summary.json`` appear whole or not at all.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections import Counter
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.sweep.study import SCENARIO_FILE, Study
from swarmabs_bag.run_folder import new_run_folder, next_run_folder, write_whole
from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from pathlib import Path

    from typing_extensions import Self

SWEEP_FILE = "sweep.yaml"
_SYNC_EVERY = 1.0
"""Time, s, of which a power failure may cost the results; a crash of this process costs none."""


class SweepFolder:
    """A folder of a sweep that only one process writes; use it as a context manager."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.results, self.summary = path / "results.parquet", path / "summary.json"
        self.journal = path / "cases.jsonl"
        """The finished cases of a sweep that is not complete."""
        self.rows: dict[int, dict[str, Any]] = {}
        """The finished cases by index."""
        self.outcomes: Counter[str] = Counter()
        """How many of them have ended how."""
        self._journal = -1
        self._synced = time.monotonic()

    def complete(self) -> dict[str, Any] | None:
        """Return the summary of a sweep that is complete, else None."""
        try:
            summary = json.loads(self.summary.read_bytes())
        except (OSError, ValueError):
            return None
        return summary if self.results.exists() and summary.get("status") == "ok" else None

    def __enter__(self) -> Self:
        """Take the folder, and read what is finished.

        Raises
        ------
        InputError
            If another process has it, or it cannot be written.
        """
        try:
            self._journal = os.open(self.journal, os.O_RDWR | os.O_CREAT, 0o666)
            fcntl.flock(self._journal, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.read()
        except BlockingIOError:
            self._close()
            raise InputError(f"{self.path} is being written by another sweep; wait for it, or name another") from None
        except OSError as error:
            self._close()
            raise InputError(f"{self.path} cannot be written: {error.strerror}; choose another with -o") from error
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the folder to others."""
        self._close()

    def read(self) -> None:
        """Read the finished cases, and cut off what a crash has left after them."""
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
        """Keep the row of a finished case.

        Raises
        ------
        RunError
            If the disk is full or fails.
        """
        row: dict[str, Any] = json.loads(line)
        try:
            _write_all(self._journal, f"{line}\n".encode())
            now = time.monotonic()
            if now - self._synced >= _SYNC_EVERY:
                os.fsync(self._journal)
                self._synced = now
        except OSError as error:
            raise RunError(f"{self.journal}: {error.strerror}; free space, then go on with --resume") from error
        self.rows[row["case"]] = row
        self.outcomes[row["outcome"]] += 1

    def write_whole(self, path: Path, content: bytes) -> None:
        """Write a file of the folder, whole or not at all."""
        try:
            write_whole(path, content, sync=True)
        except OSError as error:
            raise RunError(f"{path}: {error.strerror}; free space, then go on with --resume") from error

    def _close(self) -> None:
        if self._journal >= 0:
            os.close(self._journal)
            self._journal = -1


def make_folder(study: Study, path: Path | None, parent: Path) -> SweepFolder:
    """Make the folder of a new sweep: the one that the user has named, or the next free one below a parent.

    Raises
    ------
    InputError
        If it cannot be made, or is not empty.
    """
    if path is not None and (path / SWEEP_FILE).is_file():
        raise InputError(f"{path} holds a sweep already; go on with it with --resume, or name another folder")
    made = new_run_folder(path) if path is not None else next_run_folder(parent, study.sweep.name)
    folder = SweepFolder(made.path)
    # The sweep's own file comes last: without it there is nothing to resume.
    for name, text in _files(study):
        folder.write_whole(folder.path / name, text.encode())
    return folder


def find_folder(study: Study, path: Path) -> SweepFolder:
    """Return the folder of a sweep that was begun, checked to be the same sweep.

    Raises
    ------
    InputError
        If it is the folder of another sweep.
    """
    for name, text in _files(study):
        try:
            found = (path / name).read_bytes()
        except OSError as error:
            raise InputError(
                f"{path / name} cannot be read: {error.strerror}; start again in another folder"
            ) from error
        if found != text.encode():
            pairs = zip_longest(
                found.decode(errors="replace").splitlines(keepends=True), text.splitlines(keepends=True)
            )
            line = next((number for number, (one, other) in enumerate(pairs, 1) if one != other), 1)
            raise InputError(
                f"{path} holds another sweep: {name} differs from line {line} on; "
                "continue with the files that it was started with, or start again in another folder"
            )
    return SweepFolder(path)


def _files(study: Study) -> tuple[tuple[str, str], ...]:
    """Return the names and texts of the files that say what the sweep is."""
    return (SCENARIO_FILE, study.scenario), (SWEEP_FILE, study.sweep_text)


def _write_all(descriptor: int, content: bytes) -> None:
    written = 0
    while written < len(content):
        written += os.write(descriptor, content[written:])

"""The folder of a run: ``bag/``, ``logs/``, ``scenario.yaml`` and ``summary.json``; finding a bag and its files."""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

from swarmabs_bag.errors import CONVERT, NotABagError
from swarmabs_config.files import write_whole
from swarmabs_config.scenario import dump_scenario
from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from swarmabs_config.scenario import Scenario

SUFFIX = ".mcap"
_MOST_NAMED = 3
_OTHER_STORAGE = {
    ".mcap.zstd": "a bag that rosbag2 has compressed file by file",
    ".db3.zstd": "an SQLite bag that rosbag2 has compressed file by file",
    ".db3": "a bag of rosbag2 in SQLite",
}


@dataclass(frozen=True, slots=True)
class Split:
    """When a bag continues in a new file, between two steps: at a size, bytes, or after a log time, ns; 0: never."""

    bytes: int = 0
    nanoseconds: int = 0


ONE_FILE = Split()
"""The bag is a single file."""


class RunFolder:
    """Paths of the results of a run: bag, logs, resolved scenario and summary."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.bag = path / "bag"
        self.logs = path / "logs"
        self.scenario = path / "scenario.yaml"
        self.summary = path / "summary.json"

    def fill(self, scenario: Scenario) -> None:
        """Write the resolved scenario and create the folder for the logs."""
        self.logs.mkdir()
        self.scenario.write_text(dump_scenario(scenario), encoding="utf-8")

    def write_summary(self, summary: Mapping[str, object]) -> None:
        """Write ``summary.json`` completely or not at all."""
        write_whole(self.summary, (json.dumps(summary, indent=2, allow_nan=False) + "\n").encode())


def new_run_folder(path: Path) -> RunFolder:
    """Create the folder named by the user; raise `InputError` if it is not empty or cannot be created."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise InputError(f"output folder {path} is not empty; name another with -o, or remove it")
        if not os.access(path, os.W_OK | os.X_OK):
            raise InputError(f"output folder {path} cannot be written; choose another with -o")
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"output folder {path} is not a folder; name another with -o") from None
    except OSError as error:
        raise InputError(f"output folder {path} cannot be used: {error.strerror}; choose another with -o") from error
    return RunFolder(path)


def next_run_folder(parent: Path, name: str) -> RunFolder:
    """Create the next free folder ``NAME-NNN`` in a parent; raise `InputError` if that fails."""
    try:
        parent.mkdir(parents=True, exist_ok=True)
        taken = {path.name for path in parent.iterdir()}
        number = 1
        while True:
            path = parent / f"{name}-{number:03d}"
            if path.name not in taken:
                with suppress(FileExistsError):
                    path.mkdir()
                    return RunFolder(path)
            number += 1
    except OSError as error:
        raise InputError(f"cannot create a run folder in {parent}: {error.strerror}; name one with -o") from error


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yield a folder to fill, which becomes `folder` at the end of the block, or is removed if the block fails."""
    place = folder.absolute()
    part = place.with_name(f".{place.name}.part")
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder} exists; name another folder with -o, or remove it")
        folder.parent.mkdir(parents=True, exist_ok=True)
        part.mkdir()
    except FileExistsError:
        raise InputError(f"{part} exists: an export is running or was killed; wait, or remove it") from None
    except OSError as error:
        raise InputError(f"{folder} cannot be created: {error.strerror}; name another with -o") from error
    try:
        yield part
        part.replace(place)
    except OSError as error:
        raise RunError(f"cannot write {folder}: {error.strerror or error}; export to another disk with -o") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def find_bag(path: Path) -> Path:
    """Return the MCAP file of a run folder or a bag folder, or the file itself; for a split bag, its folder.

    Raises
    ------
    NotABagError
        If there is none, or several that do not belong together.
    """
    try:
        mode = path.stat().st_mode
        if stat.S_ISREG(mode):
            check_storage(path)
            return path
        if not stat.S_ISDIR(mode):
            raise _neither(path)
        for folder in (path / "bag", path):
            files = sorted(folder.glob(f"*{SUFFIX}"))
            if len(files) > 1:
                if split_files(files) is not None:
                    return folder
                raise NotABagError(f"{folder} contains {len(files)} .mcap files: name one of them")
            if files:
                mode = files[0].stat().st_mode
                if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                    raise _neither(files[0])
                return files[0]
            for file in sorted(folder.iterdir()) if folder.is_dir() else ():
                check_storage(file)
    except (OSError, ValueError) as error:  # ValueError: NUL in the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise NotABagError(f"cannot read {path}: {reason}; name a run folder, its bag/, or an .mcap file") from error
    raise NotABagError(f"{path} contains no bag: name a run folder, its bag/, or an .mcap file")


def check_storage(file: Path) -> None:
    """Raise `NotABagError` if a file is a bag in another rosbag2 storage, with the command to convert it."""
    for ending, storage in _OTHER_STORAGE.items():
        if file.name.endswith(ending):
            raise NotABagError(f"{file} is {storage}; {CONVERT}")


def split_files(files: Iterable[Path]) -> dict[int, Path] | None:
    """Return the files of a split bag by number, None unless they are named ``NAME_0.mcap``, ``NAME_1.mcap``..."""
    numbered: dict[int, Path] = {}
    names = set()
    for file in files:
        match = re.fullmatch(r"(.*)_(0|[1-9]\d{0,8})", file.stem, re.ASCII)
        if match is None:
            return None
        names.add(match[1])
        numbered[int(match[2])] = file
    return dict(sorted(numbered.items())) if len(names) == 1 else None


def missing_files(files: dict[int, Path]) -> list[str]:
    """Return messages on missing files of a split bag, at most the first few."""
    name = next(iter(files.values())).stem.rpartition("_")[0]
    missing = (number for number in range(max(files)) if number not in files)
    return [f"{name}_{number}.mcap is missing" for number in islice(missing, _MOST_NAMED)]


def _neither(path: Path) -> NotABagError:
    return NotABagError(f"{path} is neither a folder nor a file: name a run folder, its bag/, or an .mcap file")

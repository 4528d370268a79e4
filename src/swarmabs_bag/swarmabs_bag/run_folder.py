"""The folder of a run: ``bag/``, ``logs/``, ``scenario.yaml`` and ``summary.json``."""

from __future__ import annotations

import json
import os
import shutil
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_config.scenario import dump_scenario
from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from swarmabs_config.scenario import Scenario


@dataclass(frozen=True, slots=True)
class RunFolder:
    """Where a run's results go."""

    path: Path

    @property
    def bag(self) -> Path:
        """Folder of the bag."""
        return self.path / "bag"

    @property
    def logs(self) -> Path:
        """Folder of the processes' logs."""
        return self.path / "logs"

    @property
    def scenario(self) -> Path:
        """File of the resolved scenario."""
        return self.path / "scenario.yaml"

    @property
    def summary(self) -> Path:
        """File of the run's figures."""
        return self.path / "summary.json"

    def fill(self, scenario: Scenario) -> None:
        """Write the resolved scenario and make the folder of the logs."""
        self.logs.mkdir()
        self.scenario.write_text(dump_scenario(scenario), encoding="utf-8")

    def write_summary(self, summary: Mapping[str, object]) -> None:
        """Write ``summary.json``, whole or not at all."""
        part = self.summary.with_suffix(".json.part")
        try:
            part.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
            part.replace(self.summary)
        except OSError:
            with suppress(OSError):
                part.unlink()
            raise


def new_run_folder(path: Path) -> RunFolder:
    """Make the folder that the user has named.

    Raises
    ------
    InputError
        If it exists and is not empty, or cannot be made; nothing is left behind.
    """
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
    """Make the next free folder ``NAME-NNN`` under a parent.

    Raises
    ------
    InputError
        If it cannot be made.
    """
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
        raise InputError(f"cannot make a run's folder in {parent}: {error.strerror}; name one with -o") from error


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yield a folder to fill that becomes `folder` at the end of the block, and is removed if it fails."""
    place = folder.absolute()
    part = place.with_name(f".{place.name}.part")
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder} is there already; name another with -o, or remove it")
        folder.parent.mkdir(parents=True, exist_ok=True)
        part.mkdir()
    except FileExistsError:
        raise InputError(f"{part} is left of an export that was killed, or goes on; wait or remove it") from None
    except OSError as error:
        raise InputError(f"{folder} cannot be made: {error.strerror}; name another with -o") from error
    try:
        yield part
        part.replace(place)
    except OSError as error:
        raise RunError(f"cannot write {folder}: {error.strerror or error}; export to another disk with -o") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)

"""The report of a run: one self-contained HTML page and an overview as PNG, made from a bag."""

from __future__ import annotations

import os
from dataclasses import asdict
from functools import cached_property
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.report.page import GENERATOR, lowest, page
from swarmabs_analysis.report.panels import panels
from swarmabs_analysis.report.pictures import PNG_MARK, overview
from swarmabs_analysis.report.record import read_recorded
from swarmabs_bag.run_folder import find_bag
from swarmabs_config.files import write_whole
from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from pathlib import Path

    from swarmabs_analysis.report.panels import Panel
    from swarmabs_analysis.report.record import Recorded


_HEAD = 2048
"""Bytes at the beginning of a file that contain the mark of a report."""
_MARKS = (f'content="{GENERATOR}"'.encode(), PNG_MARK.encode())


class Report:
    """A report that is not written yet. Each part is drawn once, on first access.

    Attributes
    ----------
    bag : Path
        The bag it describes.
    numbers : dict
        The figures of the page, for JSON.
    """

    def __init__(self, recorded: Recorded) -> None:
        self.bag: Path = recorded.swarm.bag
        self.numbers = _numbers(recorded)
        self._recorded = recorded

    @cached_property
    def html(self) -> str:
        """The page."""
        return page(self._recorded, self._panels)

    @cached_property
    def png(self) -> bytes:
        """The overview."""
        return overview(self._recorded, {panel.key: panel for panel in self._panels})

    @cached_property
    def _panels(self) -> list[Panel]:
        return list(panels(self._recorded)) if self._recorded.drawable else []


def make_report(path: Path, *, namespace: str | None = None, scenario: str | None = None) -> Report:
    """Make the report of a bag: a run folder, its ``bag/``, or an MCAP file.

    `namespace` selects a swarm if the bag contains several; `scenario` supplies the one that a bag lacks.

    Raises
    ------
    InputError
        If it is not the bag of a swarm, or contains no valid scenario.
    DamagedBagError
        If it cannot be read.
    """
    return Report(read_recorded(path, namespace=namespace, scenario=scenario))


def _numbers(recorded: Recorded) -> dict[str, Any]:
    if recorded.plane is None:
        margins = {"gram": recorded.rank_margin}
    else:
        margin = recorded.margins
        margins = {"end": margin.end, "abstract_state": margin.actual, "desired_abstract_state": margin.desired}
        margins["spread"] = margin.spread
    return {
        "scenario": recorded.scenario.name,
        "status": recorded.swarm.status,
        "reason": recorded.swarm.reason,
        "agents": len(recorded.arrays.agents.ids),
        "steps": recorded.steps,
        **recorded.metrics,
        "step_response": None if recorded.step_response is None else asdict(recorded.step_response),
        "events": len(recorded.swarm.events),
        "margins": {name: lowest(values) for name, values in margins.items()},
    }


def default_folder(bag: Path) -> Path:
    """Return the run folder of a bag, or the folder that contains a single MCAP file.

    Raises `NotABagError` if there is no bag.
    """
    folder = find_bag(bag).parent
    return folder.parent if folder.name == "bag" else folder


def check_target(path: Path) -> None:
    """Raise `InputError` for a file that is not an earlier report or cannot be written, before anything is computed."""
    try:
        if path.exists() and not _is_report(path):
            raise InputError(
                f"{path} exists and is not a report; name another file with --html or --png, or a folder with -o"
            )
        folder = next(parent for parent in path.absolute().parents if parent.exists())
        if not folder.is_dir():
            raise InputError(f"{folder} is not a folder; name another one with -o")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(f"{folder} cannot be written; choose another folder with -o")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path} cannot be written: {reason}; name another file") from error


def write_file(path: Path, content: bytes) -> bool:
    """Write a file of a report completely or not at all (`RunError`); return whether it replaced an earlier one."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replaced = path.exists()
        write_whole(path, content)
    except OSError as error:
        raise RunError(f"{path}: {error.strerror or error}; free space or choose another folder with -o") from error
    return replaced


def _is_report(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    return any(mark in head for mark in _MARKS)

"""How far a run is, in a small file beside its logs: for those who look in without joining its network."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pathlib import Path

    from swarmabs_run.orchestration.progress import Phase

PROGRESS_FILE = "progress.json"
INTERVAL = 0.5
"""Time, s, between two versions of the file."""
OVER = "over"
"""The phase of a run that has ended, however."""


class Told(NamedTuple):
    """What the file says.

    Parameters
    ----------
    phase : str
        ``starting``, ``running``, ``closing`` or ``over``.
    step, steps : int
        Steps recorded, and steps in all.
    step_rate : float, optional
        Steps per second of wall time since the version before; None if there was no other.
    told_at : float
        When it was written, s on the machine's monotonic clock.
    """

    phase: str
    step: int
    steps: int
    step_rate: float | None
    told_at: float


class ProgressFile:
    """Keeps the file of a run.

    Parameters
    ----------
    logs : Path
        Folder of the run's logs.
    """

    def __init__(self, logs: Path) -> None:
        self._path = logs / PROGRESS_FILE
        self._last: Told | None = None

    def tell(self, phase: Phase, step: int, steps: int, now: float) -> None:
        """Note how far the run is at a time (s, monotonic); the file is written when it is old or the phase changes."""
        last = self._last
        if last is not None and last.phase == phase and now - last.told_at < INTERVAL:
            return
        going = last is not None and last.phase == "running" and now > last.told_at
        rate = (step - last.step) / (now - last.told_at) if last is not None and going else None
        self._write(Told(phase, step, steps, rate, now))

    def over(self) -> None:
        """Note that the run has ended."""
        step, steps = (0, 0) if self._last is None else self._last[1:3]
        self._write(Told(OVER, step, steps, None, time.monotonic()))

    def _write(self, told: Told) -> None:
        self._last = told
        part = self._path.with_suffix(".json.part")
        with suppress(OSError):  # a full disk is the recorder's to report
            part.write_text(json.dumps(told._asdict()) + "\n", encoding="utf-8")
            part.replace(self._path)


def read_progress(logs: Path) -> Told | None:
    """Return what the file of a run says, None if there is none."""
    try:
        return Told(**json.loads((logs / PROGRESS_FILE).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None

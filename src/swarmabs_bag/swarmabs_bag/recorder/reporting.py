"""What recorder nodes have in common, in lockstep and in real time: parameters, what they report, what they leave."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_bag.splitting import Split
from swarmabs_config.scenario import load_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter
from swarmabs_ros.runner import INTERRUPTED

if TYPE_CHECKING:
    from swarmabs_bag.recorder.recording import RealtimeRecording, Recording
    from swarmabs_config.scenario import Scenario
    from swarmabs_ros.runner import Settings
    from swarmabs_ros.status import StatusChannel

PARAMETERS = (
    Parameter("scenario_file", "", "file of the resolved scenario"),
    Parameter("bag", "", "folder of the bag; empty: nothing is written, digest and figures are computed"),
    Parameter("max_bag_size", 0, "size in bytes after which the bag goes on in a new file; 0: never", minimum=0),
    Parameter("max_bag_duration_ns", 0, "simulated time in ns that a file of the bag spans; 0: all", minimum=0),
    Parameter("logs", "", "folder whose log files are attached at the end"),
)

REPORT_SECONDS = 0.1
"""Time between two reports to the orchestrator, s."""
GATHER_SECONDS = 0.005
"""Time for which messages gather, s: waking up for each costs more than recording it, and the run waits for nothing
here as long as the credit of 100 steps lasts."""


def scenario_of(settings: Settings) -> Scenario:
    """Return the scenario that is recorded.

    Raises
    ------
    InputError
        If there is none, or it is not valid.
    """
    if not settings.text("scenario_file"):
        raise InputError("parameter scenario_file: give the file of the resolved scenario")
    return load_scenario(Path(settings.text("scenario_file")))


def split_of(settings: Settings) -> Split:
    """Return when the bag goes on in a new file."""
    return Split(settings.integer("max_bag_size"), settings.integer("max_bag_duration_ns"))


def log_text(folder: str) -> bytes:
    """Return all log files of the run, one after the other."""
    if not folder:
        return b""
    parts = []
    for path in sorted(Path(folder).glob("*.log")):
        text = path.read_bytes()
        if text:
            parts.append(b"==> %b <==\n%b\n" % (path.name.encode(), text))
    return b"".join(parts)


class Reporter:
    """Tells the orchestrator how a recording goes, and what has come of it.

    Parameters
    ----------
    recording : Recording or RealtimeRecording
        The recording.
    status : StatusChannel
        Where it is told.
    logs : str
        Folder whose log files are attached at the end.
    """

    def __init__(self, recording: Recording | RealtimeRecording, status: StatusChannel, logs: str) -> None:
        self._recording = recording
        self._status = status
        self._logs = logs
        self._reported = 0.0

    def progress(self, *, at_once: bool = False) -> bool:
        """Report how far it is, now and then or at once; return whether it was reported."""
        recording, now = self._recording, time.monotonic()
        if recording.newest < 0 or (now - self._reported < REPORT_SECONDS and not at_once):
            return False
        self._reported = now
        latest, seen = recording.latest, recording.summary()
        angle, error = (None, None) if latest is None else (latest.angle, latest.error)
        told = None if seen is None else seen.report()
        self._status.send("progress", step=recording.newest, angle=angle, error=error, robots=told)
        return True

    def done(self, problem: str | None, *, complete: bool) -> None:
        """Complete the bag and report the figures; `problem` says what went wrong, or `INTERRUPTED`."""
        log = {"run.log": log_text(self._logs)}
        complete = complete and problem in {None, INTERRUPTED}
        recording = self._recording
        figures = recording.close(log) if complete else recording.abort(problem or "stopped before the end", log)
        told = None if problem == INTERRUPTED else problem
        self._status.send("done", complete=complete, problem=told, figures=figures)

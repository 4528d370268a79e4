"""What a run writes beside its logs for those who look in from outside, and how it is read.

Stock ROS tools and late joiners need the file of the network, which the ordinary settings do not show them. The network
of a run is for as long as the run lasts. Then another run may get the same ROS domain, so nobody may speak into it by
the files of the one before. How far a run is stands in a file that is read without joining the network.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import psutil

from swarmabs_core.errors import InputError
from swarmabs_run.orchestration.network import FIRST_FREE, dds_environment, profile_xml

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_run.run import Phase

NETWORK_FILE = "network.json"
PROCESSES_FILE = "processes.json"
TOOL_PROFILE = "fastdds_tool.xml"
PROGRESS_FILE = "progress.json"
PROGRESS_INTERVAL = 0.5
"""Time, s, between two versions of the file."""
OVER = "over"
"""The phase of a run that has ended, however."""
_START = 19
"""Place of the start in /proc/PID/stat behind the name (proc_pid_stat(5): field 22)."""


class RunOverError(InputError):
    """The run whose folder is named does not go on any more."""

    def __init__(self, run: Path) -> None:
        super().__init__(f"{run}: this run is over")


def write_network(logs: Path, domain: int, participants: int, *, realtime: bool = False) -> None:
    """Write down, beside the logs, in which domain a run lives, and a profile for those who want to look in."""
    profile = logs / TOOL_PROFILE
    # Without a participant id of its own a tool takes the first free one: a spare coordinator's.
    profile.write_text(profile_xml(domain, peers=range(participants), participant=FIRST_FREE), encoding="utf-8")
    pid = os.getpid()
    network = {
        "domain": domain,
        "participants": participants,
        "realtime": realtime,
        "orchestrator": pid,
        "started": start_of(pid),
    }
    (logs / NETWORK_FILE).write_text(json.dumps(network) + "\n", encoding="utf-8")


class Told(NamedTuple):
    """What the file of a run's progress says: the phase is that of `Progress`, or `OVER`.

    The step rate counts per second of wall time since the version before; None if there was no other. It was told at a
    time, s, on the machine's monotonic clock.
    """

    phase: str
    step: int
    steps: int
    step_rate: float | None
    told_at: float


class ProgressFile:
    """Keeps the file that says how far a run is."""

    def __init__(self, logs: Path) -> None:
        self._path = logs / PROGRESS_FILE
        self._last: Told | None = None

    def tell(self, phase: Phase, step: int, steps: int, now: float) -> None:
        """Note how far the run is at a time (s, monotonic); the file is written when it is old or the phase changes."""
        last = self._last
        if last is not None and last.phase == phase and now - last.told_at < PROGRESS_INTERVAL:
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
        with suppress(OSError):  # a full disk is the recorder's to report
            _replace(self._path, told._asdict())


def read_progress(logs: Path) -> Told | None:
    """Return what the file of a run says, None if there is none."""
    try:
        return Told(**json.loads((logs / PROGRESS_FILE).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def write_processes(logs: Path, processes: Mapping[str, int]) -> None:
    """Write down the ids of a run's processes by name when all have met: whoever finds them finds the run going on."""
    _replace(logs / PROCESSES_FILE, {"orchestrator": os.getpid(), **processes})


def read_processes(run: Path) -> dict[str, int] | None:
    """Return the ids of a run's processes by name, that of the command first; None before all have met."""
    try:
        found = json.loads((run / "logs" / PROCESSES_FILE).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    return {str(name): int(pid) for name, pid in found.items()}


def start_of(pid: int) -> int | None:
    """Return when a process has started, in clock ticks since boot, which no setting of the clock changes.

    None if there is no such process. With the id it names one process, also when the id is given to another later.
    """
    try:
        told = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    return int(told.rpartition(")")[2].split()[_START])


def orchestrator_of(run: Path) -> psutil.Process | None:
    """Return the process that has started a run, None if it is gone.

    Raises `InputError` if this is not the folder of a run with processes, as do all functions that follow.
    """
    network = _network(run)
    pid = network["orchestrator"]
    try:
        process = psutil.Process(pid)
        lives = process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return None
    return process if lives and start_of(pid) == network["started"] else None


def is_running(run: Path) -> bool:
    """Tell whether a run goes on: the process that has started it lives, and does not say that it is over."""
    told = read_progress(run / "logs")
    return (told is None or told.phase != OVER) and orchestrator_of(run) is not None


def is_realtime(run: Path) -> bool:
    """Tell whether a run is one in real time."""
    return bool(_network(run)["realtime"])


def environment_of_run(run: Path) -> dict[str, str]:
    """Return the environment variables with which a tool sees the nodes of a run; a `RunOverError` if it is over."""
    if not is_running(run):
        raise RunOverError(run)
    return dds_environment(_network(run)["domain"], str((run / "logs" / TOOL_PROFILE).resolve()))


def _replace(file: Path, document: Mapping[str, object]) -> None:
    """Write a file atomically, so that readers never see a part of it."""
    part = file.with_suffix(".json.part")
    part.write_text(json.dumps(document) + "\n", encoding="utf-8")
    part.replace(file)


def _network(run: Path) -> dict[str, int]:
    """Return what a run has written about its network."""
    file = run / "logs" / NETWORK_FILE
    try:
        network = json.loads(file.read_text(encoding="utf-8"))
        return {name: int(network[name]) for name in ("domain", "realtime", "orchestrator", "started")}
    except OSError as error:
        raise InputError(
            f"{run} is not the folder of a run with processes ({error.strerror}: logs/{NETWORK_FILE})"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: not what a run writes there ({error!r})") from None

"""Files that a run writes next to its logs for external tools, and their readers.

Stock ROS tools and late joiners need the network file: with default settings they cannot see the run. The file is valid
only while the run lasts. Afterwards another run may use the same ROS domain, and no tool may join it with the files of
an earlier run. The progress of a run is in a file, so that it can be read without joining the network.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import psutil

from swarmabs_config.files import write_whole
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
"""Shortest time, s, between two updates of the file within a phase."""
OVER = "over"
"""The phase of a run that has ended, for whatever reason."""
_START = 19
"""Index of the start time in /proc/PID/stat, counted after the name (proc_pid_stat(5): field 22)."""


class RunOverError(InputError):
    """The run in the given folder has ended."""

    def __init__(self, run: Path) -> None:
        super().__init__(f"{run}: this run is over", f"view its bag with ./scripts/swarm view {run}")


def write_network(logs: Path, domain: int, participants: int, *, realtime: bool = False) -> None:
    """Write the ROS domain of a run and a profile for external tools next to the logs."""
    profile = logs / TOOL_PROFILE
    # A tool has no assigned participant id and takes the first free one: a spare coordinator's.
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


def write_epoch(logs: Path, epoch_ns: int) -> None:
    """Add the time of step 0 of a real-time run, ns since 1970, to its network file."""
    file = logs / NETWORK_FILE
    _replace(file, {**json.loads(file.read_text(encoding="utf-8")), "epoch": epoch_ns})


class ProgressReport(NamedTuple):
    """Content of the progress file: the phase is that of `Progress`, or `OVER`.

    The step rate is per second of wall time since the previous update; None if there was none. `told_at` is the time of
    the update, s on the machine's monotonic clock.
    """

    phase: str
    step: int
    steps: int
    step_rate: float | None
    told_at: float


class ProgressFile:
    """Keeps the progress file of a run up to date."""

    def __init__(self, logs: Path) -> None:
        self._path = logs / PROGRESS_FILE
        self._last: ProgressReport | None = None

    def update(self, phase: Phase, step: int, steps: int, now: float) -> None:
        """Update the progress at a time (s, monotonic); the file is written if it is old or the phase has changed."""
        last = self._last
        if last is not None and last.phase == phase and now - last.told_at < PROGRESS_INTERVAL:
            return
        going = last is not None and last.phase == "running" and now > last.told_at
        rate = (step - last.step) / (now - last.told_at) if last is not None and going else None
        self._write(ProgressReport(phase, step, steps, rate, now))

    def over(self) -> None:
        """Write that the run has ended."""
        step, steps = (0, 0) if self._last is None else self._last[1:3]
        self._write(ProgressReport(OVER, step, steps, None, time.monotonic()))

    def _write(self, report: ProgressReport) -> None:
        self._last = report
        with suppress(OSError):  # the recorder reports a full disk
            _replace(self._path, report._asdict())


def read_progress(logs: Path) -> ProgressReport | None:
    """Return the content of a run's progress file, None if there is no valid one."""
    try:
        return ProgressReport(**json.loads((logs / PROGRESS_FILE).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def write_processes(logs: Path, processes: Mapping[str, int]) -> None:
    """Write the ids of a run's processes by name once all are ready; the file shows that the run has started."""
    _replace(logs / PROCESSES_FILE, {"orchestrator": os.getpid(), **processes})


def read_processes(run: Path) -> dict[str, int] | None:
    """Return the ids of a run's processes by name, the command's first; None before all are ready."""
    try:
        pids = json.loads((run / "logs" / PROCESSES_FILE).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    return {str(name): int(pid) for name, pid in pids.items()}


def start_of(pid: int) -> int | None:
    """Return the start time of a process in clock ticks since boot, which setting the clock does not change.

    None if there is no such process. Together with the id it identifies the process even if the id is reused later.
    """
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    return int(stat.rpartition(")")[2].split()[_START])


def since_start() -> float:
    """Return the wall time since this process, and with it the user's command, was started, s."""
    if (ticks := start_of(os.getpid())) is None:  # not Linux
        return time.time() - psutil.Process().create_time()
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")


def orchestrator_of(run: Path) -> psutil.Process | None:
    """Return the process that started a run, None if it has ended.

    Like the functions below, raises `InputError` if this is not the folder of a run with processes.
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
    """Return whether a run is in progress: the process that started it is alive and has not reported its end."""
    last = read_progress(run / "logs")
    return (last is None or last.phase != OVER) and orchestrator_of(run) is not None


def is_realtime(run: Path) -> bool:
    """Return whether a run is in real time."""
    return bool(_network(run)["realtime"])


def epoch_of(run: Path) -> int | None:
    """Return the time of step 0 of a real-time run, ns since 1970; None while its processes are starting."""
    epoch = json.loads((run / "logs" / NETWORK_FILE).read_text(encoding="utf-8")).get("epoch")
    return None if epoch is None else int(epoch)


def environment_of_run(run: Path) -> dict[str, str]:
    """Return the environment variables for tools to see a run's nodes; raises `RunOverError` if the run is over."""
    if not is_running(run):
        raise RunOverError(run)
    return dds_environment(_network(run)["domain"], str((run / "logs" / TOOL_PROFILE).resolve()))


def _replace(file: Path, document: Mapping[str, object]) -> None:
    write_whole(file, f"{json.dumps(document)}\n".encode())


def _network(run: Path) -> dict[str, int]:
    """Return the content of a run's network file."""
    file = run / "logs" / NETWORK_FILE
    try:
        network = json.loads(file.read_text(encoding="utf-8"))
        return {name: int(network[name]) for name in ("domain", "realtime", "orchestrator", "started")}
    except OSError as error:
        raise InputError(
            f"{run} is not the folder of a run with processes ({error.strerror}: logs/{NETWORK_FILE})"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: damaged, or not written by a run ({error!r}); name another folder") from None

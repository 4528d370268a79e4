"""How stock ROS tools and late joiners get into a run's network, which the ordinary settings do not show them.

The network of a run is for as long as the run goes on. Then another run may get the same ROS domain, so nobody may
speak into it by the files of the one before.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from swarmabs_core.errors import InputError
from swarmabs_run.orchestration.dds_environment import dds_environment
from swarmabs_run.orchestration.dds_profile import FIRST_FREE, profile_xml
from swarmabs_run.orchestration.progress_file import OVER, read_progress

if TYPE_CHECKING:
    from collections.abc import Mapping

NETWORK_FILE = "network.json"
PROCESSES_FILE = "processes.json"
TOOL_PROFILE = "fastdds_tool.xml"
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


def write_processes(logs: Path, processes: Mapping[str, int]) -> None:
    """Write down the ids of a run's processes by name when all have met: whoever finds them finds the run going on."""
    part = logs / f"{PROCESSES_FILE}.part"
    part.write_text(json.dumps({"orchestrator": os.getpid(), **processes}) + "\n", encoding="utf-8")
    part.replace(logs / PROCESSES_FILE)


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

    Raises
    ------
    InputError
        If this is not the folder of a run with processes.
    """
    network = _network(run)
    pid = network["orchestrator"]
    try:
        process = psutil.Process(pid)
        lives = process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return None
    return process if lives and start_of(pid) == network["started"] else None


def goes_on(run: Path) -> bool:
    """Tell whether a run goes on: the process that has started it lives, and does not say that it is over.

    Raises
    ------
    InputError
        If this is not the folder of a run with processes.
    """
    told = read_progress(run / "logs")
    return (told is None or told.phase != OVER) and orchestrator_of(run) is not None


def is_realtime(run: Path) -> bool:
    """Tell whether a run is one in real time.

    Raises
    ------
    InputError
        If this is not the folder of a run with processes.
    """
    return bool(_network(run)["realtime"])


def environment_of_run(run: Path) -> dict[str, str]:
    """Return the environment variables with which a tool sees the nodes of a run.

    Parameters
    ----------
    run : Path
        Folder of a run that is going on.

    Raises
    ------
    RunOverError
        If the run is over.
    InputError
        If this is not the folder of a run with processes.
    """
    if not goes_on(run):
        raise RunOverError(run)
    return dds_environment(_network(run)["domain"], str((run / "logs" / TOOL_PROFILE).resolve()))


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

"""How stock ROS tools and late joiners get into a run's network, which the ordinary settings do not show them."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, cast

from swarmabs_bringup.orchestration.dds_profile import FIRST_FREE, dds_environment, profile_xml
from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

NETWORK_FILE = "network.json"
PROCESSES_FILE = "processes.json"
TOOL_PROFILE = "fastdds_tool.xml"


def write_network(logs: Path, domain: int, participants: int) -> None:
    """Write down, beside the logs, in which domain a run lives, and a profile for those who want to look in."""
    profile = logs / TOOL_PROFILE
    # Without a participant id of its own a tool takes the first free one: a spare coordinator's.
    profile.write_text(profile_xml(domain, peers=range(participants), participant=FIRST_FREE), encoding="utf-8")
    network = {"domain": domain, "participants": participants, "orchestrator": os.getpid()}
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


def environment_of_run(run: Path) -> dict[str, str]:
    """Return the environment variables with which a tool sees the nodes of a run.

    Parameters
    ----------
    run : Path
        Folder of a run that is going on.

    Raises
    ------
    InputError
        If this is no run's folder.
    """
    logs = run / "logs"
    return dds_environment(_domain(run), str((logs / TOOL_PROFILE).resolve()))


def _domain(run: Path) -> int:
    try:
        network = json.loads((run / "logs" / NETWORK_FILE).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{run} is not the folder of a run ({error.strerror}: {NETWORK_FILE})") from None
    return cast("int", network["domain"])

"""Processor time, context switches and memory of the measured processes, from the operating system."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import psutil

_PROC = Path("/proc")
_TICK = 1.0 / os.sysconf("SC_CLK_TCK")
_COMM = 15
"""Length, characters, to which Linux truncates process names."""
_ROLES = {
    "plane_sim": "plane",
    "abstraction_observer"[:_COMM]: "observer",
    "parent_controller"[:_COMM]: "controller",
    "recorder": "recorder",
}
AGENTS = "agents"
_AGENT_NAMES = ("agent_", "agents_")


def role_of(name: str) -> str | None:
    """Return the role of a process of a run or baseline from its name in Linux, None for other processes."""
    return AGENTS if name.startswith(_AGENT_NAMES) else _ROLES.get(name)


def workers_of(root: int) -> dict[int, str]:
    """Return the roles of all descendants of a process that belong to a run, by process id."""
    found = {}
    with suppress(psutil.NoSuchProcess):
        for child in psutil.Process(root).children(recursive=True):
            with suppress(OSError):
                role = role_of((_PROC / str(child.pid) / "comm").read_text(encoding="utf-8").strip())
                if role is not None:
                    found[child.pid] = role
    return found


@dataclass(frozen=True, slots=True)
class Usage:
    """Processor time (s) and context switches of all threads of a process since its start."""

    cpu: float
    switches: int


def usage(pid: int) -> Usage | None:
    """Return the usage of a process, None if it has ended."""
    folder = _PROC / str(pid)
    try:
        # The process name is in parentheses and may contain any character.
        fields = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        switches = 0
        for task in (folder / "task").iterdir():
            with suppress(FileNotFoundError, ProcessLookupError):
                lines = (task / "status").read_text(encoding="utf-8").splitlines()
                switches += sum(int(line.split()[1]) for line in lines if "voluntary_ctxt_switches" in line)
    except (FileNotFoundError, ProcessLookupError):
        return None
    return Usage((int(fields[11]) + int(fields[12])) * _TICK, switches)


def proportional_memory(pid: int) -> int | None:
    """Return the proportional set size (PSS) of a process, bytes; None if it has ended."""
    try:
        text = (_PROC / str(pid) / "smaps_rollup").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return None
    kilobytes = [int(line.split()[1]) for line in text.splitlines() if line.startswith("Pss:")]
    return 1024 * kilobytes[0] if kilobytes else None


def machine_busy() -> float:
    """Return the processor time, s, that all processes and the hypervisor have used since the machine booted."""
    times = psutil.cpu_times()
    return float(sum(times) - times.idle - getattr(times, "iowait", 0.0) - times.guest - times.guest_nice)


@dataclass(frozen=True, slots=True)
class Sample:
    """The step of a run at a time (s), and the usage of its processes until then."""

    time: float
    step: int
    usages: dict[int, Usage]
    busy: float


def sample(workers: dict[int, str], step: int, when: float | None = None) -> Sample:
    """Take a sample of these processes; `when` is the time of the step, by default now."""
    when = time.monotonic() if when is None else when
    used = {pid: found for pid in workers if (found := usage(pid)) is not None}
    return Sample(when, step, used, machine_busy())


@dataclass(frozen=True, slots=True)
class Load:
    """The load of a run between two samples.

    Parameters
    ----------
    seconds, steps : float, int
        Time and steps between the samples.
    cpu_share : dict
        Share of one core by role; for agents the sum over all.
    cpu_ms_per_step : float
        Total processor time of all processes, ms per step.
    switches_per_agent_step : float
        Context switches of all threads of a robot's process per step.
    other_load : float
        Share of the whole machine used by everything else, including the measurement itself.
    """

    seconds: float
    steps: int
    cpu_share: dict[str, float]
    cpu_ms_per_step: float
    switches_per_agent_step: float
    other_load: float


def load_between(first: Sample, last: Sample, workers: dict[int, str]) -> Load | None:
    """Return the load between two samples, None if no time or no step is between them."""
    seconds, steps = last.time - first.time, last.step - first.step
    if seconds <= 0.0 or steps <= 0:
        return None
    share: dict[str, float] = {}
    switches = agents = 0
    for pid, before in first.usages.items():
        after = last.usages.get(pid)
        if after is None:
            continue
        role = workers[pid]
        share[role] = share.get(role, 0.0) + (after.cpu - before.cpu) / seconds
        if role == AGENTS:
            agents += 1
            switches += after.switches - before.switches
    own = sum(share.values())
    machine = (last.busy - first.busy) / seconds
    cores = os.cpu_count() or 1
    return Load(
        seconds,
        steps,
        share,
        1000.0 * own * seconds / steps,
        switches / (agents * steps) if agents else 0.0,
        max(0.0, machine - own) / cores,
    )


@dataclass(frozen=True, slots=True)
class Memory:
    """Memory of the processes of a run, bytes: per robot, per coordinator, and in total."""

    agent_median: int
    agent_largest: int
    coordinators: dict[str, int]
    total: int


def memory_of(workers: dict[int, str]) -> Memory | None:
    """Measure the memory of a run's processes; None without robots."""
    found = [(role, size) for pid, role in workers.items() if (size := proportional_memory(pid)) is not None]
    agents = [size for role, size in found if role == AGENTS]
    if not agents:
        return None
    coordinators = {role: size for role, size in found if role != AGENTS}
    return Memory(int(median(agents)), max(agents), coordinators, sum(size for _, size in found))

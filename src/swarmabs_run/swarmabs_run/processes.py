"""The processes of a run, as the operating system sees them."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, NamedTuple

import psutil

if TYPE_CHECKING:
    from collections.abc import Mapping

GONE = "gone"
"""State of a process that has ended."""


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class ProcessState(NamedTuple):
    """A process: name, id, state, share of a core since the previous query (%), and resident memory (bytes).

    Share and memory are None where the kernel does not provide them.
    """

    name: str
    pid: int
    state: str
    cpu: float | None = None
    memory: int | None = None


class ProcessMonitor:
    """Monitors processes by name; a process id that is reused by another process counts as gone."""

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._pids = dict(pids)
        self._processes: dict[str, psutil.Process] = {}
        for name, pid in self._pids.items():
            try:
                process = psutil.Process(pid)
                process.cpu_percent(None)  # the first call starts the measurement
            except psutil.Error:
                continue
            self._processes[name] = process

    def states(self) -> list[ProcessState]:
        """Return the states of the processes, with the processor time since the last call."""
        return [self._state(name, pid) for name, pid in self._pids.items()]

    def _state(self, name: str, pid: int) -> ProcessState:
        process = self._processes.get(name)
        if process is None or not process.is_running():
            return ProcessState(name, pid, GONE)
        try:
            with process.oneshot():
                return ProcessState(
                    name, pid, str(process.status()), process.cpu_percent(None), process.memory_info().rss
                )
        except psutil.Error:
            return ProcessState(name, pid, GONE)

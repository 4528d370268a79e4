"""How the processes of a run are doing, as the operating system sees them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import psutil

from swarmabs_view.protocol import Health, Process

if TYPE_CHECKING:
    from collections.abc import Mapping


class ProcessWatch:
    """Watches processes by their ids.

    Parameters
    ----------
    processes : mapping
        Process ids by name. An id that another process has got meanwhile does not count as the one meant.
    """

    def __init__(self, processes: Mapping[str, int]) -> None:
        self._pids = dict(processes)
        self._watched: dict[str, psutil.Process] = {}
        for name, pid in self._pids.items():
            try:
                watched = psutil.Process(pid)
                watched.cpu_percent(None)  # the first call begins to count
            except psutil.Error:
                continue
            self._watched[name] = watched

    def look(self) -> Health:
        """Return how they are doing, the processor time since the last look."""
        return Health(processes=[self._one(name, pid) for name, pid in self._pids.items()])

    def _one(self, name: str, pid: int) -> Process:
        watched = self._watched.get(name)
        try:
            if watched is not None and watched.is_running():
                with watched.oneshot():
                    state, cpu, memory = watched.status(), watched.cpu_percent(None), watched.memory_info().rss
                return Process(name=name, pid=pid, state=str(state), cpu=cpu, memory=memory)
        except psutil.Error:
            self._watched.pop(name, None)
        return Process(name=name, pid=pid, state="gone", cpu=None, memory=None)

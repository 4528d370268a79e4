"""The interface of a run to the machine: processes, their reports, clocks, and termination requests."""

from __future__ import annotations

import os
import select
import signal
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import psutil

from swarmabs_run.orchestration.network import held_port

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from pathlib import Path

    from swarmabs_run.orchestration.launcher_client import LauncherClient
    from swarmabs_run.orchestration.plan import ProcessPlan

POLL = 0.1
"""Longest time, s, that `Machine.listen` waits."""


class Machine(Protocol):
    """Operations of a run on its processes; a launcher forks the nodes, which are identified by name."""

    @property
    def launcher(self) -> int:
        """Process id of the launcher."""

    def alive(self) -> bool:
        """Return whether the launcher is running."""

    def spawn(self, process: ProcessPlan, arguments: list[str], log: Path) -> None:
        """Start a node with a command line and a file for its output."""

    def signal(self, name: str, number: int) -> None:
        """Send a signal to a node; does nothing if the node has ended."""

    def start_all(self, data: bytes = b"") -> None:
        """Send all nodes the start signal, preceded by `data` for them to read."""

    def listen(self) -> list[dict[str, Any]]:
        """Return the reports that have arrived; wait briefly if there are none."""

    def end_asked(self) -> bool:
        """Return whether the end of the run has been requested."""

    def now(self) -> float:
        """Return the time of the steady clock, s."""

    def time_ns(self) -> int:
        """Return the time since 1970, ns."""

    def state_of(self, pid: int) -> str:
        """Return the state of a process, such as ``stopped``; ``dead`` if it does not exist."""

    def held_port(self, udp: Collection[int], own: Collection[int]) -> str:
        """Return one of these UDP ports that none of the `own` processes holds, with its holder; empty if none is."""


class ThisMachine:
    """The real machine, with a running launcher and the read end of a pipe to which every signal writes a byte."""

    now = staticmethod(time.monotonic)
    time_ns = staticmethod(time.time_ns)
    held_port = staticmethod(held_port)

    def __init__(self, launcher: LauncherClient, wake: int, end_asked: Callable[[], bool]) -> None:
        self._launcher = launcher
        self._wake = wake
        self.launcher = launcher.pid
        self.alive = launcher.alive
        self.spawn = launcher.spawn
        self.signal = launcher.signal
        self.start_all = launcher.start_all
        self.end_asked = end_asked

    def listen(self) -> list[dict[str, Any]]:
        """Return the reports that have arrived; if there are none, wait briefly for reports or a signal."""
        ready, _, _ = select.select([self._launcher.reports, self._wake], [], [], POLL)
        if self._wake in ready:
            os.read(self._wake, 4096)
        return self._launcher.read() if self._launcher.reports in ready else []

    @staticmethod
    def state_of(pid: int) -> str:
        """Return the state of a process according to the kernel."""
        try:
            return str(psutil.Process(pid).status())
        except psutil.Error:
            return "dead"


@contextmanager
def woken_by_signals() -> Iterator[int]:
    """Yield the read end of a pipe to which every signal writes a byte."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    main = threading.current_thread() is threading.main_thread()
    if main:
        signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    try:
        yield read
    finally:
        if main:
            signal.set_wakeup_fd(-1)
        os.close(read)
        os.close(write)

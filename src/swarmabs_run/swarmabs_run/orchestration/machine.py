"""What a run of processes needs of the machine: processes, their reports, clocks, and whether an end was asked for."""

from __future__ import annotations

import os
import select
import signal
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import psutil

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from swarmabs_run.orchestration.launcher_client import LauncherClient
    from swarmabs_run.orchestration.plan import ProcessPlan

POLL = 0.1
"""Longest time, s, that `Machine.listen` waits."""


class Machine(Protocol):
    """What a run does with processes; the nodes are named, and forked by a launcher."""

    @property
    def launcher(self) -> int:
        """Process id of the launcher."""

    def alive(self) -> bool:
        """Tell whether the launcher is running."""

    def spawn(self, process: ProcessPlan, arguments: list[str], log: Path) -> None:
        """Start a node with a command line and a file for what it prints."""

    def signal(self, name: str, number: int) -> None:
        """Send a signal to a node; nothing happens if it has ended."""

    def start_all(self, told: bytes = b"") -> None:
        """Give all nodes the start signal, and before it what they may read from it."""

    def listen(self) -> list[dict[str, Any]]:
        """Return the reports that have arrived; wait a little if there is none."""

    def end_asked(self) -> bool:
        """Tell whether somebody wants the run to end."""

    def now(self) -> float:
        """Return the time of the steady clock, s."""

    def time_ns(self) -> int:
        """Return the time since 1970, ns."""

    def state_of(self, pid: int) -> str:
        """Return what a process does, such as ``stopped``; ``dead`` if there is none."""


class ThisMachine:
    """The real machine, with a launcher that runs and the read end of a pipe to which every signal writes a byte."""

    now = staticmethod(time.monotonic)
    time_ns = staticmethod(time.time_ns)

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
        """Return the reports that have arrived; wait a little if there is none and no signal comes."""
        ready, _, _ = select.select([self._launcher.reports, self._wake], [], [], POLL)
        if self._wake in ready:
            os.read(self._wake, 4096)
        return self._launcher.read() if self._launcher.reports in ready else []

    @staticmethod
    def state_of(pid: int) -> str:
        """Return what the kernel says that a process does."""
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

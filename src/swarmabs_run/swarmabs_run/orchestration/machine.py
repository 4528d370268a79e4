"""What a run uses of its machine: a launcher and the nodes that it forks, with their reports, and the clocks."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import threading
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, cast

import psutil

from swarmabs_config.graph import LOCKSTEP, Driver
from swarmabs_run.orchestration.launcher_process import LauncherProcess
from swarmabs_run.orchestration.network import (
    GROUP_VARIABLE,
    PARTICIPANT_VARIABLE,
    held_port,
    multicast_group,
    profile_environment,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from typing_extensions import Self

    from swarmabs_ros.status import Report
    from swarmabs_run.orchestration.launcher_process import Order
    from swarmabs_run.orchestration.plan import ProcessPlan

END_SECONDS = 10.0
"""Longest time, s, for the launcher to end its children; then it is killed, and the kernel kills them."""
POLL = 0.1
"""Longest time, s, that `Machine.listen` waits by default."""


class Machine:
    """Starts the launcher, exchanges messages with it, and cleans up after it; nodes are identified by name.

    Parameters
    ----------
    environment : mapping
        Environment variables to add for the launcher and the nodes.
    log : Path
        File for the output of the launcher itself.
    processes : int
        Number of nodes.
    plugins : iterable of str
        Parts of packages that the launcher loads before it forks, each ``GROUP:NAME``.
    modules : iterable of str
        Modules that it loads before.
    profiles : mapping of str to Path
        Fast DDS profiles of nodes that have one of their own, by name.
    started : LauncherProcess, optional
        The launcher, if it has been started ahead for this driver.
    wake : int, optional
        File descriptor of a pipe; a byte in it ends `listen`.
    """

    now = staticmethod(time.monotonic)
    time_ns = staticmethod(time.time_ns)
    held_port = staticmethod(held_port)

    def __init__(
        self,
        environment: Mapping[str, str],
        log: Path,
        *,
        processes: int,
        plugins: Iterable[str] = (),
        modules: Iterable[str] = (),
        profiles: Mapping[str, Path] | None = None,
        driver: Driver = LOCKSTEP,
        started: LauncherProcess | None = None,
        wake: int | None = None,
    ) -> None:
        started = started or LauncherProcess(driver.value, environment)
        started.taken = True
        self._reports, self._start, self._process = started.reports, started.start, started.process
        self._wake = wake
        self._profiles = profiles or {}
        self._pending = b""
        self._send(
            {
                "command": "begin",
                "environment": {**environment},
                "log": str(log),
                "processes": processes,
                "plugins": [*plugins],
                "modules": sorted(modules),
            }
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def launcher(self) -> int:
        """Process id of the launcher."""
        return self._process.pid

    def alive(self) -> bool:
        """Return whether the launcher is running."""
        return self._process.poll() is None

    def spawn(self, process: ProcessPlan, arguments: list[str], log: Path) -> None:
        """Fork a node with a command line and a file for its output."""
        group = multicast_group(process.participant, gathers=process.gathers, robot=bool(process.agents))
        environment = {PARTICIPANT_VARIABLE: str(process.participant), GROUP_VARIABLE: group}
        if (profile := self._profiles.get(process.name)) is not None:
            environment |= profile_environment(str(profile.resolve()))
        self._send(
            {
                "command": "spawn",
                "name": process.name,
                "module": process.module,
                "environment": environment,
                "arguments": arguments,
                "log": str(log),
            }
        )

    def signal(self, name: str, number: int) -> None:
        """Send a signal to a node; does nothing if the node has ended."""
        self._send({"command": "signal", "name": name, "signal": int(number)})

    def start_all(self, data: bytes = b"") -> None:
        """Send all nodes the start signal, preceded by `data` for them to read."""
        if self._start >= 0:
            with suppress(BrokenPipeError):  # `alive` detects a dead launcher
                os.write(self._start, data)
            os.close(self._start)
            self._start = -1

    def listen(self, seconds: float = POLL) -> list[Report]:
        """Return the reports that have arrived; if there are none, wait for some, but no longer than `seconds`."""
        wake = () if self._wake is None else (self._wake,)
        ready, _, _ = select.select([self._reports, *wake], [], [], seconds)
        for woken in set(wake).intersection(ready):
            os.read(woken, 4096)
        chunks = []
        with suppress(BlockingIOError):
            while data := os.read(self._reports, 65536):
                chunks.append(data)
        *lines, self._pending = (self._pending + b"".join(chunks)).split(b"\n")
        return [cast("Report", json.loads(line)) for line in lines]

    @staticmethod
    def state_of(pid: int) -> str:
        """Return the state of a process, such as ``stopped``; ``dead`` if it does not exist."""
        try:
            return str(psutil.Process(pid).status())
        except psutil.Error:
            return "dead"

    def close(self) -> None:
        """End the launcher and the nodes, and wait until they are gone."""
        stdin = self._process.stdin
        if stdin is not None:
            with suppress(BrokenPipeError):
                stdin.close()
        try:
            self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self.start_all()
        if self._reports >= 0:
            os.close(self._reports)
            self._reports = -1

    def _send(self, order: Order) -> None:
        stdin = self._process.stdin
        if stdin is None or stdin.closed:
            return
        with suppress(BrokenPipeError):  # `alive` detects a dead launcher
            stdin.write(json.dumps(order).encode() + b"\n")
            stdin.flush()


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

"""The orchestrator's side of the launcher."""

from __future__ import annotations

import json
import os
import subprocess
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from swarmabs_config.graph import LOCKSTEP, Driver
from swarmabs_run.orchestration.launcher_process import LauncherProcess
from swarmabs_run.orchestration.network import GROUP_VARIABLE, PARTICIPANT_VARIABLE, multicast_group

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path
    from types import TracebackType

    from typing_extensions import Self

    from swarmabs_run.orchestration.plan import ProcessPlan

END_SECONDS = 10.0
"""Longest time, s, for the launcher to end its children; then it is killed, and the kernel kills them."""


class LauncherClient:
    """Starts the launcher, exchanges messages with it, and cleans up after it.

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
    started : LauncherProcess, optional
        The launcher, if it has been started ahead for this driver.

    Attributes
    ----------
    reports : int
        File descriptor from which to read the reports of the launcher and the nodes.
    """

    def __init__(
        self,
        environment: Mapping[str, str],
        log: Path,
        *,
        processes: int,
        plugins: Iterable[str] = (),
        driver: Driver = LOCKSTEP,
        started: LauncherProcess | None = None,
    ) -> None:
        started = started or LauncherProcess(driver.value, environment)
        started.taken = True
        self.reports, self._start, self._process = started.reports, started.start, started.process
        self._pending = b""
        self._command(
            command="begin",
            environment={**environment},
            log=str(log),
            processes=processes,
            plugins=[*plugins],
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """Process id of the launcher."""
        return self._process.pid

    def spawn(self, process: ProcessPlan, arguments: list[str], log: Path) -> None:
        """Fork a node."""
        self._command(
            command="spawn",
            name=process.name,
            module=process.module,
            environment={
                PARTICIPANT_VARIABLE: str(process.participant),
                GROUP_VARIABLE: multicast_group(
                    process.participant, gathers=process.gathers, robot=bool(process.agents)
                ),
            },
            arguments=arguments,
            log=str(log),
        )

    def signal(self, name: str, number: int) -> None:
        """Send a signal to a node; does nothing if the node has ended."""
        self._command(command="signal", name=name, signal=int(number))

    def start_all(self, data: bytes = b"") -> None:
        """Send all nodes the start signal, preceded by `data` for them to read."""
        if self._start >= 0:
            with suppress(BrokenPipeError):  # `alive` detects a dead launcher
                os.write(self._start, data)
            os.close(self._start)
            self._start = -1

    def read(self) -> list[dict[str, Any]]:
        """Return the reports that have arrived."""
        chunks = []
        with suppress(BlockingIOError):
            while data := os.read(self.reports, 65536):
                chunks.append(data)
        *lines, self._pending = (self._pending + b"".join(chunks)).split(b"\n")
        return [json.loads(line) for line in lines]

    def alive(self) -> bool:
        """Return whether the launcher is running."""
        return self._process.poll() is None

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
        if self.reports >= 0:
            os.close(self.reports)
            self.reports = -1

    def _command(self, **command: object) -> None:
        stdin = self._process.stdin
        if stdin is None or stdin.closed:
            return
        with suppress(BrokenPipeError):  # `alive` detects a dead launcher
            stdin.write(json.dumps(command).encode() + b"\n")
            stdin.flush()

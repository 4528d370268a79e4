"""The process of the launcher, started ahead of the run: it loads its modules while a command loads the scenario.

Therefore this module itself loads next to nothing.
"""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING, Literal, TypedDict

from swarmabs_ros.status import REPORT_FD, START_FD

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType

    from typing_extensions import Self


class Order(TypedDict, total=False):
    """A line for the launcher; which of these entries it has depends on its command."""

    command: Literal["begin", "spawn", "signal"]
    environment: dict[str, str]
    """Variables to add, for all nodes (``begin``) or for this one."""
    log: str
    """File for the output of the launcher (``begin``) or the node."""
    processes: int
    plugins: list[str]
    modules: list[str]
    name: str
    module: str
    arguments: list[str]
    signal: int


class LauncherProcess:
    """A launcher that loads the modules of the nodes and waits for the order to begin.

    Used with `with`, it is killed at the end of the block unless a `Machine` has taken it over.

    Parameters
    ----------
    driver : str
        Value of the nodes' `swarmabs_config.graph.Driver`.
    environment : mapping
        Environment variables to add.

    Attributes
    ----------
    reports : int
        File descriptor from which to read the reports of the launcher and the nodes.
    start : int
        File descriptor whose end is the start signal of the nodes.
    taken : bool
        Whether it belongs to a `Machine`, which ends it and closes the descriptors.
    """

    def __init__(self, driver: str, environment: Mapping[str, str] | None = None) -> None:
        self.taken = False
        self.reports, report_write = os.pipe()
        start_read, self.start = os.pipe()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "swarmabs_run.orchestration.launcher", driver],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=(report_write, start_read),
            env={
                **os.environ,
                **(environment or {}),
                REPORT_FD: str(report_write),
                START_FD: str(start_read),
                "OPENBLAS_NUM_THREADS": "1",  # a process with threads must not be forked
            },
            start_new_session=True,  # Ctrl-C in a terminal reaches the orchestrator only
        )
        os.close(report_write)
        os.close(start_read)
        os.set_blocking(self.reports, False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self.taken:  # it has not forked anything
            self.process.kill()
            self.process.communicate()
            os.close(self.reports)
            os.close(self.start)

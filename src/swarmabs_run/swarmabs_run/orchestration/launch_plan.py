"""The processes of a run that the launch files of `swarmabs_bringup` start, by package and executable."""

from __future__ import annotations

import atexit
import json
import os
import shutil
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_bag.attached import scenario_of
from swarmabs_bag.run_folder import new_run_folder, next_run_folder
from swarmabs_config.graph import REALTIME, Driver
from swarmabs_config.realtime import check_realtime
from swarmabs_config.scenario import warnings_of
from swarmabs_core.errors import InputError
from swarmabs_ros.status import REPORT_FD, START_FD, epoch_records
from swarmabs_run.orchestration.plan import plan
from swarmabs_run.orchestration.realtime_run import lead

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_run.orchestration.plan import ProcessPlan

REPORTED_WITHIN = 2.0
"""Longest time, s, to wait for the last report of a process that has ended."""


@dataclass(frozen=True, slots=True)
class LaunchPlan:
    """A run that a launch file starts; its folder already holds the input files."""

    folder: RunFolder
    processes: tuple[ProcessPlan, ...]
    warnings: tuple[str, ...]


class Starter(threading.Thread):
    """Starts step 0 of a real-time run under `ros2 launch`: once all processes are ready, it sends them the epoch.

    It reads their reports for as long as this process lives.

    Attributes
    ----------
    environment : dict
        Environment variables to add for the processes.
    begun : bool
        Whether all processes are ready and have received the epoch.
    """

    def __init__(self, processes: Collection[ProcessPlan]) -> None:
        super().__init__(name="starter", daemon=True)
        self._waited = {process.name for process in processes}
        self._processes = len(processes)
        self._pipes = Path(tempfile.mkdtemp(prefix="swarmabs-"))
        atexit.register(self.forget)
        self.environment = {name: str(self._pipes / name) for name in (REPORT_FD, START_FD)}
        for path in self.environment.values():
            os.mkfifo(path, 0o600)
        # Opened in both directions, so that neither opening nor writing waits for the processes.
        self._reports, self._start = (os.open(path, os.O_RDWR | os.O_CLOEXEC) for path in self.environment.values())
        self.begun = False
        self._over = threading.Event()
        self._problem = ""

    def run(self) -> None:
        """Process reports."""
        with os.fdopen(self._reports, encoding="utf-8") as reports:
            for line in reports:
                report = json.loads(line)
                if report["event"] == "ready" and not self.begun:
                    self._waited.discard(report["node"])
                    if not self._waited:
                        self._begin()
                elif report["event"] == "done":
                    self._problem = report["problem"] or ""
                    self._over.set()

    def _begin(self) -> None:
        epoch_ns = time.time_ns() + round(lead(self._processes) * 1e9)
        os.write(self._start, epoch_records(epoch_ns, self._processes))
        self.begun = True
        self.forget()

    def forget(self) -> None:
        """Remove the pipes from the file system; processes that have opened them can still use them."""
        shutil.rmtree(self._pipes, ignore_errors=True)

    def problem(self) -> str:
        """Return the reason for which the recorder, which has ended, reported a failed run; empty if it did not."""
        self._over.wait(REPORTED_WITHIN)
        return self._problem


def launch_plan(named: str, out: str, driver: Driver, overrides: Sequence[str] = ()) -> LaunchPlan:
    """Plan the named scenario and fill the folder ``out``; if it is empty, the next free folder in ``runs``.

    Raises
    ------
    InputError
        If the scenario does not exist or does not support this driver, or if the folder is in use.
    """
    scenario = scenario_of(named, overrides)
    warnings = warnings_of(scenario)
    scenario = scenario.resolved()
    if driver is REALTIME:
        check_realtime(scenario)
    try:
        folder = new_run_folder(Path(out)) if out else next_run_folder(Path("runs"), scenario.name)
    except InputError as error:
        raise InputError(str(error).replace("with -o", "with out:=")) from error
    folder.fill(scenario)
    processes = plan(scenario, folder, driver=driver)
    begun = f"{scenario.name}: {len(processes)} processes started by ros2 launch"
    (folder.logs / "orchestrator.log").write_text(f"{begun}\n", encoding="utf-8")
    return LaunchPlan(folder, processes, warnings)


def executable(process: ProcessPlan) -> tuple[str, str]:
    """Return package and executable of a process, such as ``recorder`` for ``swarmabs_bag.recorder.node``."""
    *_, name, kind = process.module.split(".")
    return process.module.partition(".")[0], name if kind == "node" else f"{name}_{kind}"

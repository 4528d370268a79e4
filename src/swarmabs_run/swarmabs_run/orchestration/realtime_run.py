"""One run in real time on this machine, for demonstrations: the processes of a fleet with simulated bodies."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

from swarmabs_config.graph import REALTIME, RECORDER
from swarmabs_config.realtime import check_realtime
from swarmabs_ros.status import epoch_records
from swarmabs_run.orchestration.process_run import ProcessRun
from swarmabs_run.orchestration.run_files import write_epoch
from swarmabs_run.orchestration.supervision import Failure, how_it_ended
from swarmabs_run.run import DEFAULTS, RunOptions

if TYPE_CHECKING:
    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import Scenario
    from swarmabs_run.orchestration.plan import Arrange
    from swarmabs_run.run import Figures

LEAD, LEAD_PER_PROCESS = 1.0, 0.02
"""Parts of the time, s, from the start signal to step 0: see `lead`."""
OVERTIME = 10.0
"""Longest delay, s, of the recorder at the end before the run counts as hung."""
GRACE = 1.0
"""Time, s, beyond the age limits for which a failed run continues, so that its bag shows how the robots stop."""
ENDING_SECONDS = 10.0
"""Longest time, s, for the nodes to report their timing and exit."""


def lead(processes: int) -> float:
    """Return the time, s, from the start signal to step 0, for nodes to create endpoints and discover each other."""
    return LEAD + LEAD_PER_PROCESS * processes


class RealtimeRun(ProcessRun):
    """A run in real time: its processes receive the start time of step 0, and are ended after the last step.

    A robot's process that dies is not restarted: the swarm continues without it, as a fleet does. If a coordinator dies
    or the swarm loses the plane, the swarm stops, and the run fails shortly afterwards. If the recorder dies, the run
    fails at once. Raises `InputError` if only lockstep supports the scenario.
    """

    _driver = REALTIME

    def __init__(
        self, scenario: Scenario, folder: RunFolder, options: RunOptions = DEFAULTS, arrange: Arrange = tuple
    ) -> None:
        self._limits = check_realtime(scenario).realtime
        super().__init__(scenario, folder, options, arrange)
        self._died: dict[str, str] = {}
        self._failed_at: float | None = None

    def _start(self, now: float) -> float:
        seconds = lead(len(self._plan))
        epoch_ns = self._machine.time_ns() + round(seconds * 1e9)
        self._note(f"all processes are ready: start, with step 0 at {epoch_ns} ns since 1970")
        write_epoch(self._folder.logs, epoch_ns)
        self._machine.start_all(epoch_records(epoch_ns, len(self._plan)))
        return now + seconds

    def _watch(self, now: float) -> Failure | None:
        for name, code in self._supervision.exited.items():
            if name in self._supervision.dispensable and name not in self._died:
                self._died[name] = how_it_ended(code)
                self._note(f"{name} (process {self._supervision.pids.get(name)}) {self._died[name]}")
        begun = self._started or now
        if now > begun + self._scenario.duration_ns / 1e9 + OVERTIME:
            return Failure(f"the recorder has not ended {OVERTIME:g} s after the last step", (RECORDER,))
        return None

    def _failure(self, now: float) -> Failure | None:
        state, limits = self._supervision, self._limits
        failure = state.failure
        if failure is None or not state.started or state.done is not None or RECORDER in failure.culprits:
            return failure
        if self._failed_at is None:
            self._failed_at = now
        grace = GRACE + max(limits.broadcast_age_limit, limits.state_age_limit, limits.plane_age_limit)
        return failure if now - self._failed_at >= grace else None

    def _end(self) -> Failure | None:
        """Ask the nodes to exit, so that they report their timing; a robot that does not exit counts as dead."""
        state = self._supervision
        running = [name for name in state.pids if name not in state.exited]
        for name in running:
            state.expect_end(name)
            self._machine.signal(name, signal.SIGTERM)
        self._listen_until(lambda: state.exited.keys() >= set(running), ENDING_SECONDS)
        hung = {name: self._machine.state_of(state.pids[name]) for name in running if name not in state.exited}
        self._died |= {name: f"did not end (it is {hung[name]})" for name in hung if name in state.dispensable}
        culprits = tuple(name for name in hung if name not in state.dispensable)
        if not culprits or not self._machine.alive():
            return None
        shown = ", ".join(f"{name} (process {state.pids[name]} is {hung[name]})" for name in culprits)
        return Failure(f"{shown} did not exit on SIGTERM and sent no timing report", culprits[:2])

    def _figures(self, recorded: Figures) -> Figures:
        timing = self._supervision.timing
        realtime = {
            "missed_periods": {name: report["missed"] for name, report in sorted(timing.items())},
            "lateness_us": {name: report["lateness_us"] for name, report in sorted(timing.items())},
            "longest_us": {name: report["longest_us"] for name, report in sorted(timing.items())},
            "clock_jumps": {name: report["clock_jumps"] for name, report in sorted(timing.items())},
            "died": dict(sorted(self._died.items())),
        }
        return {**recorded, "realtime": {**recorded.get("realtime", {}), **realtime}}

    def _warnings(self) -> tuple[str, ...]:
        return tuple(f"{name} {how}; the swarm continued without it" for name, how in sorted(self._died.items()))

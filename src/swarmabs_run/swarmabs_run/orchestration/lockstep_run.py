"""One run in lockstep, from starting its processes to ending them."""

from __future__ import annotations

import signal
from dataclasses import replace
from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_ros.lockstep import silence_limit
from swarmabs_run.orchestration.process_run import ProcessRun
from swarmabs_run.orchestration.supervision import Failure
from swarmabs_run.run import DEFAULTS, RunOptions
from swarmabs_run.steering.client import SOCKET

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import Scenario
    from swarmabs_run.orchestration.machine import Machine
    from swarmabs_run.orchestration.plan import Arrange
    from swarmabs_run.run import Outcome

STALL_GRACE = 1.0
"""Time, s, for which reports of a stall are collected before they are evaluated."""

_SIGNALS = {
    ChangeKind.KILL: signal.SIGKILL,
    ChangeKind.FREEZE: signal.SIGSTOP,
    ChangeKind.LEAVE: signal.SIGTERM,
    ChangeKind.REMOVE: signal.SIGTERM,
}


class LockstepRun(ProcessRun):
    """A run in lockstep: messages alone advance its steps; processes end or stop where the scenario has faults."""

    def __init__(
        self, scenario: Scenario, folder: RunFolder, options: RunOptions = DEFAULTS, arrange: Arrange = tuple
    ) -> None:
        super().__init__(scenario, folder, options, arrange)
        self._own_process = {process.agents[0]: process.name for process in self._plan if len(process.agents) == 1}
        self._faults: list[Change] = [c for c in configure.schedule(scenario) if c.kind in _SIGNALS]
        self._stalled_since: float | None = None
        self._stalled_at = -1
        self._recovery = 0.0

    def drive(self, machine: Machine, end_asked: Callable[[], bool], domain: int, begun: float) -> Outcome:
        """Drive the processes to their end; afterwards the run can no longer be steered."""
        try:
            outcome = super().drive(machine, end_asked, domain, begun)
            return replace(outcome, packed=self._options.packs(self._scenario))
        finally:
            (self._folder.path / SOCKET).unlink(missing_ok=True)

    def _start(self, now: float) -> float:
        self._note("all processes have met their counterparts: start")
        self._machine.start_all()
        return now

    def _watch(self, now: float) -> Failure | None:
        self._inject_faults()
        return self._check_stalls(now)

    def _apply_steering(self) -> None:
        """Log the steering that was applied, and schedule the ends of processes that follow from it."""
        for text, of_robot in self._supervision.steered:
            self._note(f"steered: {text}")
            if of_robot:
                change = Change.parse(of_robot)
                later = (fault for fault in self._faults if fault.agent_id != change.agent_id)
                self._faults = sorted((change, *later))
        self._supervision.steered.clear()

    def _inject_faults(self) -> None:
        """End or stop the processes of faulty robots once their last state is recorded; no node uses them later."""
        self._apply_steering()
        while self._faults and self._faults[0].step <= self._recorded():
            fault = self._faults.pop(0)
            name = self._own_process.get(fault.agent_id)
            if name is None:  # its state machine falls silent; the others in the process continue
                continue
            self._supervision.expect_end(name)
            self._note(f"fault '{fault}': {_SIGNALS[fault.kind].name} to process {self._supervision.pids[name]}")
            self._machine.signal(name, _SIGNALS[fault.kind])

    def _recorded(self) -> int:
        """Return the last step known to be recorded, -1 for none."""
        return -1 if self._supervision.progress is None else int(self._supervision.progress["step"])

    def _check_stalls(self, now: float) -> Failure | None:
        state, lockstep, decentralised = self._supervision, self._scenario.lockstep, self._scenario.decentralised
        recorded = self._recorded()
        # Nodes that wait during a pause report a stall. Afterwards they recover when they have read what others have
        # repeated meanwhile, which takes large swarms seconds.
        if state.paused or not state.stalls:
            self._recovery = 2.0 * lockstep.stall_timeout if state.paused else 0.0
        # A robot that reports a stall, and is stopped before it reports its recovery, does not stall the run.
        if not state.stalls or state.paused or self._finished is not None or recorded > self._stalled_at:
            self._stalled_at, self._stalled_since = recorded, None
            return None
        if self._stalled_since is None:
            self._stalled_since = now
        # Where silent robots are dropped, allow the time that this takes, and fail only if the run still stalls.
        grace = STALL_GRACE
        if lockstep.on_stall == "drop":
            # Without an observer, robots may first notice who is silent, and then that the plane still waits.
            grace += 3.0 * silence_limit(lockstep.stall_timeout) if decentralised else 2.0 * lockstep.stall_timeout
        if now - self._stalled_since < grace + self._recovery:
            return None
        failure = state.diagnose({name: self._machine.state_of(pid) for name, pid in state.pids.items()})
        taken = self._taken_port(state.names)
        return replace(failure, reason=f"{failure.reason}; {taken}") if taken else failure

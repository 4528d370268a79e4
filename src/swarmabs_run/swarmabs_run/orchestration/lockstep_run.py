"""One run in lockstep, from starting its processes to ending them."""

from __future__ import annotations

import signal
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_config import configure
from swarmabs_config.graph import RECORDER, standby_name
from swarmabs_core.errors import InputError
from swarmabs_core.faults import NodeFault, NodeFreezeFault
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_run.orchestration.process_run import ProcessRun
from swarmabs_run.orchestration.supervision import Failure
from swarmabs_run.roles import LEADS, SILENT, STANDS_BY, Roles, write_roles
from swarmabs_run.run import DEFAULTS, RunOptions
from swarmabs_run.steering.client import SOCKET

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import AnyScenario
    from swarmabs_run.orchestration.machine import Machine
    from swarmabs_run.orchestration.plan import Arrange
    from swarmabs_run.roles import Role
    from swarmabs_run.run import Outcome

STALL_GRACE = 1.0
"""Time, s, for which reports of a stall are collected before they are evaluated."""

_SIGNALS = {
    ChangeKind.KILL: signal.SIGKILL,
    ChangeKind.FREEZE: signal.SIGSTOP,
    ChangeKind.LEAVE: signal.SIGTERM,
    ChangeKind.REMOVE: signal.SIGTERM,
}


class NodeSignal(NamedTuple):
    """A signal that a coordinator's process gets once a step is recorded."""

    step: int
    node: str
    number: signal.Signals


def node_signals(scenario: AnyScenario) -> list[NodeSignal]:
    """Return the signals that follow from the faults of coordinators, by step."""
    found = []
    for fault in scenario.faults_of(NodeFault):
        begin, end = scenario.fault_steps(fault)
        freezes = isinstance(fault, NodeFreezeFault)
        found.append(NodeSignal(begin, fault.node, signal.SIGSTOP if freezes else signal.SIGKILL))
        if end is not None:
            found.append(NodeSignal(end, fault.node, signal.SIGCONT))
    return sorted(found)


def check_standby(scenario: AnyScenario, *, standby: bool) -> None:
    """Raise `InputError` if a scenario needs standby coordinators, or does not allow them."""
    if standby and scenario.lockstep.on_stall == "drop":
        raise InputError(
            "lockstep.on_stall: with --standby it cannot be 'drop', since two observers might drop different robots; "
            "set it to 'fail', or remove --standby"
        )
    faults = scenario.faults_of(NodeFault)
    if faults and not standby:
        raise InputError(
            f"faults: a run does not survive '{faults[0].kind}' of {faults[0].node} without standbys; run with "
            "--standby, or remove the fault"
        )


class LockstepRun(ProcessRun):
    """A run in lockstep: messages alone advance its steps; processes end or stop where the scenario has faults."""

    def __init__(
        self, scenario: AnyScenario, folder: RunFolder, options: RunOptions = DEFAULTS, arrange: Arrange = tuple
    ) -> None:
        super().__init__(scenario, folder, options, arrange)
        self._own_process = {process.agents[0]: process.name for process in self._plan if len(process.agents) == 1}
        self._faults: list[Change] = [c for c in configure.schedule(scenario) if c.kind in _SIGNALS]
        self._node_signals = node_signals(scenario) if options.standby else []
        self._roles = Roles(self._supervision.pairs)
        self._stalled_since: float | None = None
        self._stalled_at = -1

    def drive(self, machine: Machine, domain: int, begun: float) -> Outcome:
        """Drive the processes to their end; afterwards the run can no longer be steered."""
        try:
            outcome = super().drive(machine, domain, begun)
            packed = self._options.packs(len(self._scenario.agents))
            return replace(outcome, packed=packed, standby=self._standby() if self._options.standby else None)
        finally:
            (self._folder.path / SOCKET).unlink(missing_ok=True)

    def _start(self, now: float) -> float:
        self._note("all processes have met their counterparts: start")
        if self._options.standby:
            self._write_roles()
        self._machine.start_all()
        return now

    def _watch(self, now: float) -> Failure | None:
        for name in self._supervision.left_alone():
            peer = self._supervision.pairs[name]
            how = self._supervision.gone.get(peer, "has ended")
            self._note(f"{peer} {how}; {name} is told")
            self._machine.signal(name, signal.SIGUSR1)
            self._tell(self._roles.lose(peer, max(0, self._recorded()), how))
        self._follow_roles()
        self._inject_faults()
        self._signal_nodes()
        return self._check_stalls(now)

    def _apply_steering(self) -> None:
        """Log the steering that was applied, and schedule the ends of processes that follow from it."""
        for report in self._supervision.steered:
            self._note(f"steered: {report['text']}")
            if report["change"]:
                change = Change.parse(report["change"])
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

    def _signal_nodes(self) -> None:
        """End, stop or continue the coordinators with a fault at a recorded step."""
        while self._node_signals and self._node_signals[0].step <= self._recorded():
            _, name, number = self._node_signals.pop(0)
            self._note(f"fault: {number.name} to {name} (process {self._supervision.pids[name]})")
            self._machine.signal(name, number)

    def _follow_roles(self) -> None:
        """Tell which standbys lead in place of a lost or stopped primary, and which primaries lead again.

        On a busy machine a standby also leads for moments in which its primary is only late; these are not told.
        """
        state, lost = self._supervision, self._lost() if self._supervision.leading else {}
        for node, step in state.leading.items():
            peer = state.pairs[node]
            if peer in lost:
                self._tell(self._roles.lead(node, step, f"{peer} {lost[peer]}", peer=SILENT))
        for node, step in state.yielded.items():
            if self._roles.now[node] == LEADS:
                self._tell(self._roles.lead(state.pairs[node], step, "publishes again", peer=STANDS_BY))
        state.yielded.clear()

    def _tell(self, changes: Iterable[Role]) -> None:
        """Log takeovers and losses, and let others know the roles."""
        if changes := list(changes):
            for role in changes:
                if role.is_news:
                    self._note(role.text)
            self._write_roles()

    def _write_roles(self) -> None:
        with suppress(OSError):  # the recorder reports a full disk
            write_roles(self._folder.logs, self._roles.all)

    def _lost(self) -> dict[str, str]:
        """Return the coordinators that have ended or are stopped, and how."""
        state = self._supervision
        stopped = {name: "was stopped" for name in state.names if name in state.pairs and self._is_stopped(name)}
        return state.gone | stopped

    def _standby(self) -> dict[str, Any]:
        """Return `Outcome.standby`."""
        self._follow_roles()
        state, changes = self._supervision, [role._asdict() for role in self._roles.changes]
        recorder = standby_name(RECORDER) if [*state.whole] == [standby_name(RECORDER)] else RECORDER
        return {"lost": self._lost(), "roles": changes, "recorder": recorder}

    def _end(self) -> Failure | None:
        """Compare what two recorders have recorded."""
        digests = {figures["digest"] for figures in self._supervision.whole.values()}
        return Failure("the two recorders have recorded different runs") if len(digests) > 1 else None

    def _warnings(self) -> tuple[str, ...]:
        pairs, lost = self._supervision.pairs, self._lost()
        order = [*lost]
        return tuple(
            f"{name} {how}; the run continued with {pairs[name]}"
            for number, (name, how) in enumerate(lost.items())
            if pairs[name] not in order[:number]
        )

    def _recorded(self) -> int:
        """Return the last step known to be recorded, -1 for none."""
        return -1 if self._supervision.progress is None else int(self._supervision.progress["step"])

    def _check_stalls(self, now: float) -> Failure | None:
        state, lockstep = self._supervision, self._scenario.lockstep
        recorded = self._recorded()
        # A robot that reports a stall, and is stopped before it reports its recovery, does not stall the run.
        if not state.stalls or self._finished is not None or recorded > self._stalled_at:
            self._stalled_at, self._stalled_since = recorded, None
            return None
        if self._stalled_since is None:
            self._stalled_since = now
        # Where silent robots are dropped, allow the time that this takes, and fail only if the run still stalls.
        grace = STALL_GRACE if lockstep.on_stall == "fail" else STALL_GRACE + 2.0 * lockstep.stall_timeout
        if now - self._stalled_since < grace:
            return None
        failure = state.diagnose({name: self._machine.state_of(pid) for name, pid in state.pids.items()})
        taken = self._taken_port(state.names)
        return replace(failure, reason=f"{failure.reason}; {taken}") if taken else failure

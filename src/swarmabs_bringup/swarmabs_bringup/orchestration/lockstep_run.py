"""One run in lockstep, from the first process to the last."""

from __future__ import annotations

import os
import select
import signal
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING

import psutil

from swarmabs_bringup.orchestration.dds_profile import dds_environment, multicast_works, profile_xml
from swarmabs_bringup.orchestration.domain import claimed_domain, domains_spanned
from swarmabs_bringup.orchestration.launcher_client import LauncherClient
from swarmabs_bringup.orchestration.looking_in import write_network
from swarmabs_bringup.orchestration.plan import RECORDER, ProcessPlan, agent_name, plan
from swarmabs_bringup.orchestration.progress import Outcome, Progress
from swarmabs_bringup.orchestration.supervision import Failure, Supervision, last_lines
from swarmabs_bringup.orchestration.tracing_files import tracing_files_removed
from swarmabs_bringup.splitting import ONE_FILE, Split
from swarmabs_bringup.steering.protocol import SOCKET
from swarmabs_core import configure
from swarmabs_core.membership import Change, ChangeKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from swarmabs_bringup.orchestration.progress import Phase
    from swarmabs_bringup.run_folder import RunFolder
    from swarmabs_core.scenario import Scenario

START_SILENCE = 30.0
"""Time, s, in which at least one more process must be forked or become ready."""
STALL_GRACE = 1.0
"""Time, s, for which reports of a stall are gathered before they are judged."""
CLOSING_SECONDS = 20.0
"""Time, s, that the recorder has to complete the bag."""
POLL = 0.1
STARTED_AGAIN = "did not come up: again"
"""What the orchestrator's log says of a process that it starts once more."""

_SIGNALS = {
    ChangeKind.KILL: signal.SIGKILL,
    ChangeKind.FREEZE: signal.SIGSTOP,
    ChangeKind.LEAVE: signal.SIGTERM,
    ChangeKind.REMOVE: signal.SIGTERM,
}


class LockstepRun:
    """Starts a scenario's processes, waits until they have met, lets them run, and ends them all.

    Parameters
    ----------
    scenario : Scenario
        The scenario; generated robots are listed.
    folder : RunFolder
        An empty folder for the results.
    record : bool
        Whether to write a bag.
    on_progress : callable, optional
        Told how the run goes, some ten times a second.
    namespace : str
        ROS namespace of the swarm.
    arrange : callable, optional
        Changes the processes before any is started, such as their order or parameters.
    agents_per_process : int
        How many robots share a process.
    packed : bool
        Whether the robots hear the three broadcasts as one message, which costs less where they are many.
    split : Split
        When the bag goes on in a new file, by default never.
    steered : bool
        Whether the run can be steered, by a socket in its folder.
    step_seconds : float
        Shortest wall time, s, of a step of such a run; 0: as fast as possible.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: RunFolder,
        *,
        record: bool = True,
        on_progress: Callable[[Progress], None] | None = None,
        namespace: str = "/",
        arrange: Callable[[Sequence[ProcessPlan]], Sequence[ProcessPlan]] = tuple,
        agents_per_process: int = 1,
        packed: bool = False,
        split: Split = ONE_FILE,
        steered: bool = False,
        step_seconds: float = 0.0,
    ) -> None:
        self._scenario = scenario
        self._folder = folder
        self._namespace = namespace
        self._on_progress = on_progress
        bag = folder.bag if record else None
        planned = plan(
            scenario,
            scenario_file=folder.scenario,
            bag=bag,
            logs=folder.logs,
            agents_per_process=agents_per_process,
            packed=packed,
            split=split,
            steered=steered,
            step_seconds=step_seconds,
        )
        self._plan = tuple(arrange(planned))
        hosts = {agent_id: process.name for process in self._plan for agent_id in process.agents}
        self._own_process = {
            agent_id for process in self._plan if len(process.agents) == 1 for agent_id in process.agents
        }
        self._supervision = Supervision(
            tuple(process.name for process in self._plan),
            dispensable=frozenset(hosts.values()) if scenario.lockstep.on_stall == "drop" else frozenset(),
            hosts=hosts,
        )
        self._interrupted = False
        self._faults: list[Change] = [c for c in configure.schedule(scenario) if c.kind in _SIGNALS]
        self._begun = time.monotonic()
        self._started: float | None = None
        self._finished: float | None = None
        self._stalled_since: float | None = None
        self._stalled_at = -1

    def run(self) -> Outcome:
        """Run to the end, whatever it is; afterwards no process, port or shared memory of the run is left.

        Raises
        ------
        RunError
            If the run cannot even be begun, such as when no ROS domain is free.
        """
        participants = 1 + max(process.participant for process in self._plan)
        self._folder.fill(self._scenario)
        profile = self._folder.logs / "fastdds.xml"
        with ExitStack() as stack:
            stack.enter_context(tracing_files_removed())
            stack.callback((self._folder.path / SOCKET).unlink, missing_ok=True)
            domain = stack.enter_context(claimed_domain(domains_spanned(participants)))
            self._note(f"{self._scenario.name}: {len(self._plan)} processes in ROS domain {domain}")
            profile.write_text(profile_xml(domain, multicast=multicast_works()), encoding="utf-8")
            write_network(self._folder.logs, domain, participants)
            wake = stack.enter_context(self._interruptible())
            environment = dds_environment(domain, str(profile.resolve()))
            client = LauncherClient(
                environment,
                self._folder.logs / "launcher.log",
                processes=len(self._plan),
                controller=self._scenario.controller.type,
                law=self._scenario.swarm.law.type,
            )
            launcher = stack.enter_context(client)
            failure = self._supervise(launcher, wake)
            return self._conclude(launcher, wake, failure)

    @contextmanager
    def _interruptible(self) -> Iterator[int]:
        """Turn SIGINT and SIGTERM into a flag and a byte on a pipe, whose read end is yielded."""
        read, write = os.pipe()
        os.set_blocking(write, False)
        main = threading.current_thread() is threading.main_thread()
        previous = {}
        if main:
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                previous[number] = signal.signal(number, self._interrupt)
            signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        try:
            yield read
        finally:
            if main:
                signal.set_wakeup_fd(-1)
                for number, handler in previous.items():
                    signal.signal(number, handler)
            os.close(read)
            os.close(write)

    def _interrupt(self, *_: object) -> None:
        self._interrupted = True

    def _supervise(self, launcher: LauncherClient, wake: int) -> Failure | None:
        """Drive the run until it is complete, fails or is interrupted."""
        state = self._supervision
        self._spawn(launcher, self._plan)
        news = time.monotonic()
        known = 0
        while not self._interrupted:
            self._listen(launcher, wake)
            now = time.monotonic()
            if state.failure is not None:
                return state.failure
            if not launcher.alive():
                return Failure("the launcher has died", ("launcher",))
            if state.done is not None:
                return None
            if self._started is None:
                come = len(state.pids) + len(state.ready)
                if come > known or self._restart_lost(launcher):
                    known, news = come, now
                if state.all_ready():
                    self._started = now
                    state.started = True
                    self._note("all processes have met their counterparts: start")
                    launcher.start_all()
                elif now - news > START_SILENCE:
                    if not state.hanging():
                        return self._not_started()
                    news = now
                    for name in state.hanging():
                        launcher.signal(name, signal.SIGKILL)
            else:
                self._inject_faults(launcher)
                failure = self._check_stalls(now)
                if failure is not None:
                    return failure
            self._tell("starting" if self._started is None else "running")
        return None

    def _spawn(self, launcher: LauncherClient, processes: Iterable[ProcessPlan]) -> None:
        for process in processes:
            launcher.spawn(process, process.arguments(self._namespace), self._folder.logs / f"{process.name}.log")

    def _restart_lost(self, launcher: LauncherClient) -> bool:
        """Start again the robots' processes that have ended before the run began; tell whether there were any."""
        names = self._supervision.to_restart()
        for name in names:
            self._note(f"{name} (process {self._supervision.pids[name]}) {STARTED_AGAIN}")
        self._spawn(launcher, (process for process in self._plan if process.name in names))
        return bool(names)

    def _listen(self, launcher: LauncherClient, wake: int) -> None:
        ready, _, _ = select.select([launcher.reports, wake], [], [], POLL)
        if wake in ready:
            os.read(wake, 4096)
        if launcher.reports in ready:
            for report in launcher.read():
                self._supervision.take(report)
        progress = self._supervision.progress
        if self._finished is None and progress is not None and progress["step"] >= self._scenario.steps:
            self._finished = time.monotonic()

    def _not_started(self) -> Failure:
        missing = self._supervision.not_ready()
        shown = ", ".join(missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
        return Failure(f"not all processes have met within {START_SILENCE:g} s without news: {shown}", missing[:2])

    def _take_orders(self) -> None:
        """Note what was done from outside, and plan the ends of processes that follow from it."""
        for order in self._supervision.orders:
            self._note(f"steered: {order['text']}")
            if order["change"]:
                change = Change.parse(order["change"])
                later = (fault for fault in self._faults if fault.agent_id != change.agent_id)
                self._faults = sorted((change, *later))
        self._supervision.orders.clear()

    def _inject_faults(self, launcher: LauncherClient) -> None:
        """End or stop the processes whose last state is recorded; from then on nobody listens to them any more."""
        self._take_orders()
        while self._faults and self._faults[0].step <= self._recorded():
            fault = self._faults.pop(0)
            if fault.agent_id not in self._own_process:  # its state machine is silent, its neighbours go on
                continue
            name = agent_name(fault.agent_id)
            self._supervision.expect_end(name)
            self._note(f"fault '{fault}': {_SIGNALS[fault.kind].name} to process {self._supervision.pids[name]}")
            launcher.signal(name, _SIGNALS[fault.kind])

    def _recorded(self) -> int:
        """Return the last step that is known to be recorded, -1 for none."""
        return -1 if self._supervision.progress is None else int(self._supervision.progress["step"])

    def _check_stalls(self, now: float) -> Failure | None:
        state, lockstep = self._supervision, self._scenario.lockstep
        recorded = self._recorded()
        # A robot that says it waits, and is stopped before it says that it waits no more, does not hold up the run.
        if not state.stalls or self._finished is not None or recorded > self._stalled_at:
            self._stalled_at, self._stalled_since = recorded, None
            return None
        if self._stalled_since is None:
            self._stalled_since = now
        # Where robots are dropped, the run gets the time that this takes, and fails only if it does not help.
        grace = STALL_GRACE if lockstep.on_stall == "fail" else STALL_GRACE + 2.0 * lockstep.stall_timeout
        if now - self._stalled_since < grace:
            return None
        return state.diagnose({name: _process_state(pid) for name, pid in state.pids.items()})

    def _conclude(self, launcher: LauncherClient, wake: int, failure: Failure | None) -> Outcome:
        """Let the recorder complete the bag of a run that did not finish, and sum up."""
        state = self._supervision
        reason = self._describe(failure)
        if reason is None and self._interrupted:
            reason = "interrupted"
        if reason is not None:
            self._note(reason)
        if RECORDER in state.pids and not (failure is not None and RECORDER in failure.culprits):
            launcher.signal(RECORDER, signal.SIGTERM)
            deadline = time.monotonic() + CLOSING_SECONDS
            while self._recorder_works(launcher) and time.monotonic() < deadline:
                self._listen(launcher, wake)
                self._tell("closing")
        done = state.done or {"complete": False, "figures": {}}
        complete = done["complete"] and failure is None
        return Outcome(
            "ok" if complete else "interrupted" if self._interrupted and failure is None else "failed",
            None if complete else reason or "the recorder could not complete the recording",
            dict(done["figures"]),
            None if self._started is None else self._started - self._begun,
            None if self._started is None else (self._finished or time.monotonic()) - self._started,
        )

    def _recorder_works(self, launcher: LauncherClient) -> bool:
        state = self._supervision
        return state.done is None and RECORDER not in state.exited and launcher.alive()

    def _note(self, text: str) -> None:
        """Write a line to the orchestrator's log, which becomes a part of the bag."""
        path = self._folder.logs / "orchestrator.log"
        with suppress(OSError), path.open("a", encoding="utf-8") as stream:  # a full disk is the recorder's to report
            stream.write(f"[{time.monotonic() - self._begun:9.3f}] {text}\n")

    def _describe(self, failure: Failure | None) -> str | None:
        if failure is None:
            return None
        texts = []
        for name in failure.culprits[:3]:
            with suppress(OSError):
                texts.append((name, (self._folder.logs / f"{name}.log").read_text(encoding="utf-8", errors="replace")))
        return "\n".join(part for part in (failure.reason, last_lines(texts)) if part)

    def _tell(self, phase: Phase) -> None:
        if self._on_progress is None:
            return
        state = self._supervision
        progress = state.progress or {}
        step = progress.get("step", 0)
        elapsed = 0.0 if self._started is None else (self._finished or time.monotonic()) - self._started
        self._on_progress(
            Progress(
                phase,
                len(state.ready),
                len(state.names),
                step,
                self._scenario.steps,
                step / elapsed if elapsed > 0.0 else 0.0,
                progress.get("angle"),
                progress.get("error"),
            )
        )


def _process_state(pid: int) -> str:
    try:
        return str(psutil.Process(pid).status())
    except psutil.Error:
        return "dead"

"""The common part of all runs of processes: start, reports, end and cleanup."""

from __future__ import annotations

import signal
import time
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING

from swarmabs_bag.recorder.swarm_summary import SwarmSummary
from swarmabs_config.configure import plugins
from swarmabs_config.graph import LOCKSTEP, REALTIME, RECORDER, Driver
from swarmabs_run.ending import end_asked, end_grace
from swarmabs_run.orchestration.machine import Machine, woken_by_signals
from swarmabs_run.orchestration.network import (
    claimed_domain,
    dds_environment,
    multicast_works,
    profile_xml,
    udp_ports,
)
from swarmabs_run.orchestration.plan import Arrange, ProcessPlan, announced_to, partners, plan
from swarmabs_run.orchestration.run_files import ProgressFile, write_network, write_processes
from swarmabs_run.orchestration.supervision import Failure, Supervision, last_lines
from swarmabs_run.run import DEFAULTS, Outcome, Progress, RunOptions
from swarmabs_run.tracing_files import tracing_files_removed

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable
    from typing import ClassVar

    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import Scenario
    from swarmabs_run.orchestration.launcher_process import LauncherProcess
    from swarmabs_run.run import Figures, Phase

START_SILENCE = 30.0
"""Time, s, within which at least one more process must be forked or become ready."""
CLOSING_SECONDS = 20.0
"""Longest time, s, for the recorder to complete the bag."""
STARTED_AGAIN = "did not come up: again"
"""Entry in the orchestrator's log for a process that it starts again."""


class ProcessRun:
    """Starts a scenario's processes, waits until all are ready, runs them as the subclass defines, and ends them all.

    The scenario lists its generated robots, and the folder is empty. Raises `InputError` as `end_grace` does.
    """

    _driver: ClassVar[Driver] = LOCKSTEP

    def __init__(
        self, scenario: Scenario, folder: RunFolder, options: RunOptions = DEFAULTS, arrange: Arrange = tuple
    ) -> None:
        end_grace()  # checked here, because the launcher reads it only after the run has started
        self._scenario = scenario
        self._folder = folder
        self._options = options
        self._plan = tuple(arrange(plan(scenario, folder, options, self._driver)))
        self._progress_file = ProgressFile(folder.logs)
        hosts = {agent_id: process.name for process in self._plan for agent_id in process.agents}
        survives = self._driver is REALTIME or scenario.lockstep.on_stall == "drop"
        self._supervision = Supervision(
            tuple(process.name for process in self._plan),
            dispensable=frozenset(hosts.values()) if survives else frozenset(),
            hosts=hosts,
        )
        self._machine: Machine
        self._end_asked: Callable[[], bool]
        self._begun: float
        self._domain: int
        self._started: float | None = None
        self._finished: float | None = None

    def run(self, launcher: LauncherProcess | None = None) -> Outcome:
        """Run until completion, failure or interruption; no process, port or shared memory of the run remains.

        The `launcher` may have been started ahead for the driver of this run.

        Raises `RunError` if the run cannot be started, such as when no ROS domain is free.
        """
        begun = time.monotonic()
        participants = 1 + max(process.participant for process in self._plan)
        self._folder.fill(self._scenario)
        profile, realtime = self._folder.logs / "fastdds.xml", self._driver is REALTIME
        with ExitStack() as stack:
            asked = stack.enter_context(end_asked())
            stack.enter_context(tracing_files_removed())
            domain = stack.enter_context(claimed_domain(participants))
            of_robots, announced = partners(self._plan), announced_to(self._plan)
            multicast = not of_robots and multicast_works()
            profiles = {name: self._folder.logs / f"{name}.xml" for name in of_robots}
            alone = next(process.name for process in self._plan if process.name not in of_robots)
            for path, name in ((profile, alone), *((path, name) for name, path in profiles.items())):
                text = profile_xml(domain, peers=announced[name], multicast=multicast, realtime=realtime)
                path.write_text(text, encoding="utf-8")
            write_network(self._folder.logs, domain, participants, realtime=realtime)
            stack.callback(self._progress_file.over)
            wake = stack.enter_context(woken_by_signals())
            machine = Machine(
                dds_environment(domain, str(profile.resolve())),
                self._folder.logs / "launcher.log",
                processes=len(self._plan),
                plugins=[f"{registry.group}:{name}" for registry, name in plugins(self._scenario)],
                modules={process.module for process in self._plan if process.agents},
                profiles=profiles,
                driver=self._driver,
                started=launcher,
                wake=wake,
            )
            return self.drive(stack.enter_context(machine), asked, domain, begun)

    def drive(self, machine: Machine, end_asked: Callable[[], bool], domain: int, begun: float) -> Outcome:
        """Start the processes on a machine, in a ROS domain, and drive them to their end, or until it is asked for.

        The run's folder already holds the input files; `begun` is the time of the request, s on the steady clock, from
        which the log counts.
        """
        self._machine, self._end_asked, self._begun, self._domain = machine, end_asked, begun, domain
        self._note(f"{self._scenario.name}: {len(self._plan)} processes in ROS domain {domain}")
        return self._conclude(self._supervise())

    def _supervise(self) -> Failure | None:
        """Drive the run until it is complete, fails or is interrupted."""
        state = self._supervision
        self._spawn(self._plan)
        news = self._machine.now()
        counted = 0
        while not (self._end_asked() or state.restart):
            self._listen()
            now = self._machine.now()
            failure = self._failure(now)
            if failure is not None:
                return failure
            if not self._machine.alive():
                return Failure("the launcher has died", ("launcher",))
            if state.done is not None:
                return None
            if self._started is None:
                count = len(state.pids) + len(state.ready)
                if count != counted or self._restart_lost():
                    counted, news = count, now
                if state.all_ready():
                    state.started = True
                    write_processes(self._folder.logs, {"launcher": self._machine.launcher, **state.pids})
                    self._started = self._start(now)
                elif now - news > START_SILENCE:
                    if not state.hanging():
                        return self._not_started()
                    news = now
                    for name in state.hanging():
                        self._machine.signal(name, signal.SIGKILL)
            else:
                failure = self._watch(now)
                if failure is not None:
                    return failure
            going: Phase = "paused" if state.paused else "running"
            self._report_progress("starting" if self._started is None else going)
        return None

    def _start(self, now: float) -> float:
        """Start the processes, all of which are ready; return the time of the first step, s on the steady clock."""
        raise NotImplementedError

    def _watch(self, now: float) -> Failure | None:
        """Supervise the run, about ten times a second; return the failure, if any."""
        raise NotImplementedError

    def _failure(self, now: float) -> Failure | None:  # noqa: ARG002 - for subclasses that delay the failure
        """Return the failure that ends the run."""
        return self._supervision.failure

    def _end(self) -> Failure | None:
        """Finish after the recording is complete, while the processes are still running; return the failure, if any."""
        return None

    def _spawn(self, processes: Iterable[ProcessPlan]) -> None:
        for process in processes:
            log = self._folder.logs / f"{process.name}.log"
            self._machine.spawn(process, process.arguments(self._options.namespace), log)

    def _restart_lost(self) -> bool:
        """Restart the robots' processes that ended before the run started; return whether there were any."""
        names = self._supervision.to_restart()
        for name in names:
            self._note(f"{name} (process {self._supervision.pids[name]}) {STARTED_AGAIN}")
        self._spawn(process for process in self._plan if process.name in names)
        return bool(names)

    def _listen(self) -> None:
        for report in self._machine.listen():
            self._supervision.take(report)
        progress = self._supervision.progress
        if self._finished is None and progress is not None and progress["step"] >= self._scenario.steps:
            self._finished = self._machine.now()

    def _listen_until(self, enough: Callable[[], bool], seconds: float) -> None:
        """Listen while the run is closing until `enough` holds, but no longer than `seconds`."""
        deadline = self._machine.now() + seconds
        while not enough() and self._machine.alive() and self._machine.now() < deadline:
            self._listen()
            self._report_progress("closing")

    def _not_started(self) -> Failure:
        missing = self._supervision.not_ready()
        shown = ", ".join(missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
        why = self._taken_port(missing) or "counterparts not found"
        return Failure(f"{shown}: {why}; no progress for {START_SILENCE:g} s", missing[:2])

    def _taken_port(self, names: Collection[str]) -> str:
        """Return which UDP port of these processes another one holds, and the remedy; empty if there is none."""
        ids = (process.participant for process in self._plan if process.name in names)
        taken = self._machine.held_port(udp_ports(self._domain, ids), set(self._supervision.pids.values()))
        return f"UDP port {taken} is not free; end that process" if taken else ""

    def _conclude(self, failure: Failure | None) -> Outcome:
        """Let the recorder complete the bag if the run did not finish, and return the outcome."""
        state = self._supervision
        interrupted = failure is None and (self._end_asked() or state.restart is not None)
        reason = self._describe(failure)
        if interrupted:
            reason = "interrupted" if state.restart is None else "ended to start again"
        if reason is not None:
            self._note(reason)
        if RECORDER in state.pids and (failure is None or RECORDER not in failure.culprits):
            # The signal tells the recorder which reason to write into the bag.
            state.expect_end(RECORDER)
            self._machine.signal(RECORDER, signal.SIGINT if interrupted else signal.SIGTERM)
            self._listen_until(lambda: state.done is not None or RECORDER in state.exited, CLOSING_SECONDS)
        ended_badly = self._end()
        if failure is None and ended_badly is not None:
            failure, reason = ended_badly, self._describe(ended_badly)
            self._note(ended_badly.reason)
        complete = failure is None and state.done is not None and state.done["complete"]
        if not complete and reason is None:
            reason = "the recorder could not complete the recording"
            self._note(reason)
        return Outcome(
            "ok" if complete else "interrupted" if interrupted and failure is None else "failed",
            None if complete else reason,
            self._figures({} if state.done is None else state.done["figures"]),
            None if self._started is None else self._started - self._begun,
            None if self._started is None else (self._finished or self._machine.now()) - self._started,
            self._warnings(),
            restart=None if self._end_asked() else state.restart,
        )

    def _figures(self, recorded: Figures) -> Figures:
        """Return the digest and the figures, given what the recorder has reported."""
        return recorded

    def _warnings(self) -> tuple[str, ...]:
        """Return the warnings of a run that did not fail."""
        return ()

    def _note(self, text: str) -> None:
        """Write a line to the orchestrator's log, which becomes part of the bag."""
        path = self._folder.logs / "orchestrator.log"
        with suppress(OSError), path.open("a", encoding="utf-8") as stream:  # the recorder reports a full disk
            stream.write(f"[{self._machine.now() - self._begun:9.3f}] {text}\n")

    def _describe(self, failure: Failure | None) -> str | None:
        if failure is None:
            return None
        texts = []
        for name in failure.culprits[:3]:
            with suppress(OSError):
                texts.append((name, (self._folder.logs / f"{name}.log").read_text(encoding="utf-8", errors="replace")))
        return "\n".join(part for part in (failure.reason, last_lines(texts)) if part)

    def _report_progress(self, phase: Phase) -> None:
        state = self._supervision
        step, angle, error, seen = 0, None, None, None
        if (latest := state.progress) is not None:
            step, angle, error, seen = latest["step"], latest["angle"], latest["error"], latest["robots"]
        self._progress_file.update(phase, step, self._scenario.steps, self._machine.now())
        if self._options.on_progress is None:
            return
        elapsed = 0.0 if self._started is None else (self._finished or self._machine.now()) - self._started
        self._options.on_progress(
            Progress(
                phase,
                len(state.ready),
                len(state.names),
                step,
                self._scenario.steps,
                step / elapsed if elapsed > 0.0 else 0.0,
                angle,
                error,
                None if seen is None else SwarmSummary(**seen),
            )
        )

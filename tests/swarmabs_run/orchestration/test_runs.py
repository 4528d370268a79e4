"""The course of a run and how it ends, on a machine whose processes and clocks are made up."""

import os
import re
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from signal import SIGINT, SIGKILL, SIGSEGV, SIGSTOP, SIGTERM
from typing import Any, NamedTuple

import pytest
from tests.frozen.command import swarm

from swarmabs_bag.recorder.swarm_summary import SwarmSummary
from swarmabs_bag.run_folder import RunFolder, new_run_folder
from swarmabs_config import ports
from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, RECORDER
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError
from swarmabs_run.ending import GRACE as TO_END
from swarmabs_run.orchestration.lockstep_run import STALL_GRACE, LockstepRun
from swarmabs_run.orchestration.machine import POLL
from swarmabs_run.orchestration.plan import ProcessPlan
from swarmabs_run.orchestration.process_run import CLOSING_SECONDS, START_SILENCE, ProcessRun
from swarmabs_run.orchestration.realtime_run import ENDING_SECONDS, GRACE, LEAD, LEAD_PER_PROCESS, OVERTIME, RealtimeRun
from swarmabs_run.orchestration.run_files import read_processes, read_progress, write_network
from swarmabs_run.orchestration.supervision import RESTARTS
from swarmabs_run.run import Outcome, Progress, RunOptions
from swarmabs_run.steering.client import SOCKET

CALLED, BEGUN, READY = 998.0, 1000.0, 0.5
"""Times, s, at which the run was asked for and its processes are started; and how long one takes to be ready."""
EPOCH = 5_000_000_000
ROBOTS = ("agent_001", "agent_002", "agent_003", "agent_004")
FAULTS = "faults=[{at: 0.3, kind: kill, agent: 1}, {at: 0.5, kind: freeze, agent: 2}, {at: 0.7, kind: leave, agent: 3}]"
NAMES = (PLANE, OBSERVER, CONTROLLER, RECORDER, *ROBOTS)
ROBOTS_SEEN = SwarmSummary({"A": 4}, "AAAA", [0] * 4, [])
TIMING = {"missed": 1, "lateness_us": (1, 2), "longest_us": 3, "clock_jumps": 4}

Report = dict[str, Any]
Happening = tuple[float, Report | Callable[["FakeMachine"], None]]
"""What happens so many s after the first step: a report, or something else."""


def report(seconds: float, node: str, event: str, **details: object) -> Happening:
    return seconds, {"node": node, "event": event, **details}


def exited(seconds: float, name: str, code: int) -> Happening:
    return report(seconds, "launcher", "exited", name=name, code=code)


def done(seconds: float, *, complete: bool = True, problem: str | None = None) -> Happening:
    figures = {"digest": "abc" if complete else None}
    return report(seconds, RECORDER, "done", complete=complete, problem=problem, figures=figures)


def recorded(seconds: float, step: int) -> Happening:
    seen = ROBOTS_SEEN._asdict()
    return report(seconds, RECORDER, "progress", step=step, angle=0.1, error=-0.2, robots=seen)


def stalled(seconds: float, *missing: str) -> Happening:
    return report(seconds, OBSERVER, "stalled", step=30, missing=missing, silence=0.5)


def paused(seconds: float, *, paused: bool) -> Happening:
    return report(seconds, "steering", "paused", paused=paused, step=30)


def end_asked(seconds: float) -> Happening:
    return seconds, lambda machine: setattr(machine, "asked", True)


A_SECOND = (*(recorded(step / 100, step) for step in range(0, 101, 10)), done(1.05))
"""What happens in a run of a second."""


@dataclass
class FakeMachine:
    """Processes that come up, do what happens and end when told to. Time passes only while somebody listens."""

    happens: tuple[Happening, ...] = A_SECOND
    ready_after: dict[str, float] = field(default_factory=dict)
    hangs: Counter[str] = field(default_factory=Counter)
    crashes: Counter[str] = field(default_factory=Counter)
    deaf: tuple[str, ...] = ()
    launcher: int = 99
    clock: float = BEGUN
    first_step: float = BEGUN
    dead: bool = False
    asked: bool = False
    taken: tuple[int, ...] = ()
    recorded: bool = False
    spawned: list[str] = field(default_factory=list)
    logs: set[Path] = field(default_factory=set)
    pids: dict[str, int] = field(default_factory=dict)
    signals: list[tuple[str, int]] = field(default_factory=list)
    told: list[bytes] = field(default_factory=list)
    due: list[Happening] = field(default_factory=list)

    def die(self) -> None:
        self.dead = True
        self.due.clear()

    def expect(self, *happenings: Happening, since: float | None = None) -> None:
        begin = self.clock if since is None else since
        self.due += [(begin + seconds, what) for seconds, what in happenings]

    def now(self) -> float:
        return self.clock

    def time_ns(self) -> int:
        return EPOCH

    def alive(self) -> bool:
        return not self.dead

    def end_asked(self) -> bool:
        return self.asked

    def state_of(self, pid: int) -> str:
        return f"{pid} stopped"

    def held_port(self, udp: Collection[int], own: Collection[int]) -> str:
        assert set(own) == set(self.pids.values())
        return next((f"{port} of process 4711 (daemon)" for port in self.taken if port in udp), "")

    def listen(self, seconds: float = POLL) -> list[Report]:
        self.clock = min([self.clock + seconds, *(max(time, self.clock) for time, _ in self.due)]) + 1e-6
        come = sorted((item for item in self.due if item[0] <= self.clock), key=lambda item: item[0])
        self.due = [item for item in self.due if item[0] > self.clock]
        for _, what in come:
            if not isinstance(what, dict):
                what(self)
        reports = [what for _, what in come if isinstance(what, dict)]
        self.recorded |= any(what["event"] == "done" for what in reports)
        return reports

    def spawn(self, process: ProcessPlan, arguments: list[str], log: Path) -> None:
        assert arguments == process.arguments("/north")
        name = process.name
        self.pids[name] = 101 + len(self.spawned)
        self.spawned.append(name)
        self.logs.add(log)
        self.expect(report(0.0, "launcher", "spawned", name=name, child=self.pids[name]))
        if self.crashes[name]:
            self.crashes[name] -= 1
            self.expect(exited(0.2, name, -SIGSEGV))
        elif self.hangs[name]:
            self.hangs[name] -= 1
        else:
            self.expect(report(self.ready_after.get(name, READY), name, "ready"))

    def start_all(self, data: bytes = b"") -> None:
        self.told.append(data)
        self.first_step = self.clock + ((int(data[:20]) - EPOCH) / 1e9 if data else 0.0)
        self.expect(*self.happens, since=self.first_step)

    def signal(self, name: str, number: int) -> None:
        self.signals.append((name, number))
        if number == SIGKILL:
            self.expect(exited(0.05, name, -number))
        elif number != SIGSTOP and name not in self.deaf:
            self.expect(report(0.1, name, "timing", pid=self.pids[name], **TIMING), exited(0.2, name, 0))
            if name == RECORDER and not self.recorded:
                self.expect(done(0.1, complete=False))


def drive(
    machine: FakeMachine, path: Path, *overrides: str, kind: type[ProcessRun] = LockstepRun, **options: Any
) -> Outcome:
    """Drive a run of a second with four robots; each process has said something in its log."""
    folder = new_run_folder(path / "run")
    scenario = find_scenario("pd_het_4", ["duration=1", *overrides]).resolved()
    folder.fill(scenario)
    write_network(folder.logs, 5, len(NAMES), realtime=kind is RealtimeRun)
    for name in (*NAMES, "launcher"):
        (folder.logs / f"{name}.log").write_text(f"{name} says so\n")
    return kind(scenario, folder, RunOptions(namespace="/north", **options)).drive(
        machine, machine.end_asked, 5, CALLED
    )


def noted(path: Path) -> str:
    return (path / "run" / "logs" / "orchestrator.log").read_text(encoding="utf-8")


def test_a_run_in_lockstep_from_the_first_process_to_the_last_step(tmp_path: Path) -> None:
    shown: list[Progress] = []
    machine = FakeMachine()
    outcome = drive(machine, tmp_path, on_progress=shown.append)
    assert (outcome.status, outcome.reason, outcome.figures, outcome.warnings) == ("ok", None, {"digest": "abc"}, ())
    assert outcome.start_seconds == pytest.approx(2.0 + READY, abs=1e-3)
    assert outcome.stepping_seconds == pytest.approx(1.0, abs=1e-3)
    logs = RunFolder(tmp_path / "run").logs
    assert (tuple(machine.spawned), machine.told) == (NAMES, [b""])
    assert machine.logs == {logs / f"{name}.log" for name in NAMES}
    first, last = shown[0], shown[-1]
    assert (first.phase, first.ready, first.processes, first.step, first.steps) == ("starting", 0, 8, 0, 100)
    assert (first.step_rate, first.angle, first.error, first.robots) == (0.0, None, None, None)
    assert (last.phase, last.ready, last.step, last.angle, last.error) == ("running", 8, 100, 0.1, -0.2)
    assert last.robots == ROBOTS_SEEN
    assert [progress.step_rate for progress in shown if progress.step > 0] == pytest.approx([100.0] * 10, rel=1e-3)
    assert read_processes(tmp_path / "run") == {"orchestrator": os.getpid(), "launcher": 99, **machine.pids}
    told = read_progress(logs)
    assert told is not None and (told.phase, told.steps) == ("running", 100)
    assert noted(tmp_path) == (
        "[    2.000] pd_het_4: 8 processes in ROS domain 5\n"
        "[    2.500] all processes have met their counterparts: start\n"
    )


class Ending(NamedTuple):
    """What happens after the first step, and how many s later the run ends; well, if there is no reason."""

    seconds: float
    reason: str
    happens: tuple[Happening, ...]
    overrides: tuple[str, ...] = ()
    deaf: tuple[str, ...] = ()


def log_of(name: str) -> str:
    return f"\nlast lines of {name}.log:\n  {name} says so"


COMPLETE: list[tuple[str, int]] = [(RECORDER, SIGTERM)]
"""What the recorder is told so that it completes its bag."""
DROP = ("lockstep={on_stall: drop, stall_timeout: 2.5}",)
LAUNCHER_DIES: Happening = (0.3, FakeMachine.die)
KILLED = exited(0.3, "agent_003", -9)
ROBOT_LOST = "agent_003 (process 107) was killed by SIGKILL" + log_of("agent_003")
OBSERVER_LOST = "abstraction_observer (process 102) was killed by SIGKILL" + log_of(OBSERVER)
RECORDER_LOST = "recorder (process 104) ended with exit code 1" + log_of(RECORDER)
SILENT = "agent 003 (process 107 is 107 stopped) has not answered step 30 for 0.5 s" + log_of("agent_003")
FAILS = report(0.3, CONTROLLER, "failed", reason="steep")
WAITED_FOR = (recorded(0.3, 30), stalled(0.4, "agent 3"))
PAUSED = (*WAITED_FOR, paused(0.2, paused=True), paused(30.0, paused=False))
SLOW = tuple(recorded(0.9 * n, n) for n in range(10))
LOCKSTEP = {
    "a robot is killed": Ending(0.4, ROBOT_LOST, (KILLED,)),
    "a robot is killed that may be missing": Ending(1.05, "", (KILLED, *A_SECOND), DROP),
    "the recorder is killed": Ending(0.3, RECORDER_LOST, (exited(0.3, RECORDER, 1),)),
    "a node fails by its own words": Ending(0.4, f"{CONTROLLER}: steep", (FAILS, exited(0.3, CONTROLLER, 1))),
    "a robot fails that may be missing": Ending(1.05, "", (report(0.3, "agent_003", "failed"), *A_SECOND), DROP),
    "the launcher dies": Ending(0.3, "the launcher has died" + log_of("launcher"), (LAUNCHER_DIES,)),
    "an end is asked for": Ending(0.4, "interrupted", (end_asked(0.3),)),
    "an end is asked for and the recorder hangs": Ending(
        0.3 + CLOSING_SECONDS, "interrupted", (end_asked(0.3),), deaf=(RECORDER,)
    ),
    "an end is asked for and the recorder ends without a word": Ending(
        1.3, "interrupted", (end_asked(0.3), exited(1.3, RECORDER, -9)), deaf=(RECORDER,)
    ),
    "the disk is full": Ending(0.3, "recorder: disk full", (done(0.3, complete=False, problem="disk full"),)),
    "the recorder gives up": Ending(0.3, "the recorder could not complete the recording", (done(0.3, complete=False),)),
    "a robot does not answer": Ending(0.5 + STALL_GRACE, SILENT, WAITED_FOR),
    "a robot does not answer that may be missing, and that does not help": Ending(
        0.5 + STALL_GRACE + 2 * 2.5, SILENT, WAITED_FOR, DROP
    ),
    "robots are slow but the run goes on": Ending(9.0, "", (stalled(0.4, "agent 3"), done(9.0), *SLOW)),
    "a robot waits no more": Ending(4.0, "", (stalled(0.4, "agent 3"), report(1.0, OBSERVER, "recovered"), done(4.0))),
    "a run is paused for long": Ending(37.0, "", (*PAUSED, report(36.0, OBSERVER, "recovered"), done(37.0))),
    "a robot does not answer after a pause": Ending(30.1 + STALL_GRACE + 2 * 5.0, SILENT, PAUSED),
    "a robot does not answer long after a pause": Ending(
        32.5 + STALL_GRACE,
        SILENT,
        (*PAUSED, report(31.0, OBSERVER, "recovered"), recorded(31.5, 40), stalled(32.4, "agent 3")),
    ),
    "a robot says that it waits when all is recorded": Ending(
        4.0, "", (recorded(0.3, 100), stalled(0.4, "agent 3"), done(4.0))
    ),
}
LATE = "the recorder has not ended 10 s after the last step" + log_of(RECORDER)
HUNG = "plane_sim (process 101 is 101 stopped) did not exit on SIGTERM and sent no timing report"
AGES = ("realtime={broadcast_age_limit: 0.1, state_age_limit: 0.6, plane_age_limit: 0.2}",)
REALTIME = {
    "a robot is killed": Ending(1.25, "", (KILLED, *A_SECOND)),
    "all end": Ending(1.25, "", A_SECOND),
    "a robot does not end": Ending(1.05 + ENDING_SECONDS, "", A_SECOND, deaf=("agent_002",)),
    "the plane does not end": Ending(1.05 + ENDING_SECONDS, HUNG + log_of(PLANE), A_SECOND, deaf=(PLANE, "agent_002")),
    "the observer is killed": Ending(0.6 + GRACE + 0.6, OBSERVER_LOST, (exited(0.3, OBSERVER, -9),), AGES),
    "the observer is killed at the end": Ending(1.25, OBSERVER_LOST, (exited(0.9, OBSERVER, -9), *A_SECOND)),
    "the recorder is killed": Ending(0.5, RECORDER_LOST, (exited(0.3, RECORDER, 1),)),
    "the recorder hangs": Ending(1.0 + OVERTIME + ENDING_SECONDS, LATE, (recorded(0.5, 50),), deaf=(RECORDER,)),
}


@pytest.mark.parametrize(
    ("kind", "name"), [*((LockstepRun, name) for name in LOCKSTEP), *((RealtimeRun, name) for name in REALTIME)]
)
def test_how_a_run_ends(tmp_path: Path, kind: type[ProcessRun], name: str) -> None:
    seconds, reason, happens, overrides, deaf = (LOCKSTEP if kind is LockstepRun else REALTIME)[name]
    machine = FakeMachine(happens, deaf=deaf)
    outcome = drive(machine, tmp_path, *overrides, kind=kind)
    status = {"": "ok", "interrupted": "interrupted"}.get(reason, "failed")
    assert (outcome.status, outcome.reason or "") == (status, reason)
    assert machine.clock - machine.first_step == pytest.approx(seconds, abs=1.1 * POLL)
    ended = {what["name"] for _, what in happens if isinstance(what, dict) and what["event"] == "exited"}
    told = [(RECORDER, SIGINT)] if status == "interrupted" else [] if log_of(RECORDER) in reason else COMPLETE
    told_in_the_end = [(name, SIGTERM) for name in NAMES if kind is RealtimeRun and name not in ended]
    assert machine.signals == [*told, *told_in_the_end]
    assert outcome.figures.get("digest") == ("abc" if not reason or A_SECOND[-1] in happens else None)
    assert not reason or f"] {reason.splitlines()[0]}\n" in noted(tmp_path)


def test_a_port_that_another_process_has_taken_since_the_claim_is_named_where_the_run_stalls(tmp_path: Path) -> None:
    outcome = drive(FakeMachine(WAITED_FOR, taken=(ports.multicast_port(5),)), tmp_path)
    assert outcome.reason is not None
    held = "; UDP port 7505 of process 4711 (daemon) is not free; end that process\n"
    assert SILENT.partition("\n")[0] + held in outcome.reason


@pytest.mark.parametrize("text", ["soon", "-1", "nan", "inf"])
def test_a_bad_time_to_end_is_refused(tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TO_END, text)
    refusal = f"{TO_END}: '{text}' is not a time in seconds; give a number such as 2.5, or unset the variable"
    with pytest.raises(InputError, match=re.escape(refusal)):
        drive(FakeMachine(), tmp_path)
    assert swarm(["run", "pd_het_4"], tmp_path) == (2, "", f"error: {refusal}\n")
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("machine", "spawned", "seconds"),
    [
        (FakeMachine(crashes=Counter(agent_002=RESTARTS)), ["agent_002"] * 2, 0.9),
        (FakeMachine(hangs=Counter(agent_002=1)), ["agent_002"], READY + START_SILENCE + 0.6),
        (
            FakeMachine(ready_after={RECORDER: 1.2}, due=[(BEGUN + 1.0, exited(0.0, "agent_002", -SIGSEGV)[1])]),
            ["agent_002"],
            1.0 + READY,
        ),
        (FakeMachine(ready_after={name: 20.0 * n for n, name in enumerate(NAMES)}), [], 140.0),
    ],
    ids=["crashes", "hangs", "crashes when ready", "one by one"],
)
def test_a_late_robot_is_restarted(tmp_path: Path, machine: FakeMachine, spawned: list[str], seconds: float) -> None:
    assert drive(machine, tmp_path).status == "ok"
    assert machine.spawned == [*NAMES, *spawned]
    assert machine.first_step - BEGUN == pytest.approx(seconds, abs=1.1 * POLL)
    assert noted(tmp_path).count("agent_002 (process 106) did not come up: again") == (1 if spawned else 0)


def test_a_robot_that_is_restarted_and_ready_again_is_progress(tmp_path: Path) -> None:
    """It ends after 1 s, is ready 25 s later, and 28 s after that the recorder is, which is the last one."""
    machine = FakeMachine(ready_after={RECORDER: 55.0}, due=[(BEGUN + 1.0, exited(0.0, "agent_002", -SIGSEGV)[1])])
    machine.due.append((BEGUN + 0.6, lambda machine: machine.ready_after.update(agent_002=25.0)))
    assert drive(machine, tmp_path).status == "ok"


@pytest.mark.parametrize("kind", [LockstepRun, RealtimeRun])
def test_a_robot_that_may_be_missing_later_may_not_be_at_the_start(tmp_path: Path, kind: type[ProcessRun]) -> None:
    machine = FakeMachine(crashes=Counter(agent_002=9), ready_after={RECORDER: 5.0})
    outcome = drive(machine, tmp_path, *(DROP if kind is LockstepRun else ()), kind=kind)
    assert (outcome.status, machine.told) == ("failed", [])
    assert outcome.reason is not None and outcome.reason.startswith("agent_002 (process 110) was killed by SIGSEGV")
    assert machine.clock - BEGUN < 2.0


@pytest.mark.parametrize(
    ("machine", "reason", "seconds"),
    [
        (FakeMachine(crashes=Counter(agent_002=9)), r"agent_002 \(process 110\) was killed by SIGSEGV", 0.8),
        (FakeMachine(crashes=Counter(recorder=9)), r"recorder \(process 104\) was killed by SIGSEGV", 0.2),
        (
            FakeMachine(hangs=Counter(agent_001=9)),
            r"agent_001: counterparts not found; no progress for 30 s\nlast lines of agent_001",
            READY + 3 * START_SILENCE + 0.1,
        ),
        (FakeMachine(hangs=Counter(recorder=9)), "recorder: counterparts not found; .*\nlast", READY + START_SILENCE),
        (
            FakeMachine(hangs=Counter(NAMES)),
            f"{', '.join(NAMES[:5])} and 3 more: counterparts not found; .*{log_of(PLANE)}{log_of(OBSERVER)}$",
            START_SILENCE,
        ),
        (
            FakeMachine(hangs=Counter(recorder=9), taken=(7512, 7517)),  # that of the observer, and of the recorder
            r"recorder: UDP port 7517 of process 4711 \(daemon\) is not free; end that process; no progress",
            READY + START_SILENCE,
        ),
        (FakeMachine(hangs=Counter(NAMES[:5] * 9)), "recorder, agent_001: .*\nlast", READY + 3 * START_SILENCE + 0.1),
        (FakeMachine(due=[(BEGUN + 0.2, end_asked(0.0)[1])]), "interrupted", 0.3),
    ],
)
def test_a_run_that_does_not_begin(tmp_path: Path, machine: FakeMachine, reason: str, seconds: float) -> None:
    outcome = drive(machine, tmp_path)
    assert (outcome.start_seconds, outcome.stepping_seconds, machine.told) == (None, None, [])
    assert outcome.status == ("interrupted" if machine.asked else "failed")
    assert (machine.signals == [(RECORDER, SIGINT)]) is machine.asked
    assert read_processes(tmp_path / "run") is None
    assert outcome.reason is not None and re.search(reason, outcome.reason)
    assert machine.clock - BEGUN == pytest.approx(seconds, abs=0.1 + 1.1 * POLL)


def test_processes_end_as_the_scenario_says_once_their_last_step_is_recorded(tmp_path: Path) -> None:
    machine = FakeMachine((*A_SECOND, exited(0.35, "agent_001", -9), exited(0.75, "agent_003", 0)))
    assert drive(machine, tmp_path, FAULTS).status == "ok"
    assert machine.signals == [("agent_001", SIGKILL), ("agent_002", SIGSTOP), ("agent_003", SIGTERM), *COMPLETE]
    notes = [line.lstrip("[") for line in noted(tmp_path).splitlines()[2:]]
    assert [float(line.partition("]")[0]) - 2.0 - READY for line in notes] == pytest.approx([0.3, 0.5, 0.7], abs=0.01)
    assert notes[0].endswith("fault 'kill 1 30': SIGKILL to process 105")
    machine = FakeMachine()
    assert drive(machine, tmp_path / "shared", FAULTS, agents_per_process=2).status == "ok"
    assert machine.signals == COMPLETE, "whoever shares a process is not ended by a signal"


def test_what_is_ordered_from_outside_is_noted_and_comes_before_what_was_planned(tmp_path: Path) -> None:
    def order(seconds: float, text: str, change: str = "") -> Happening:
        return report(seconds, "steering", "steered", text=text, change=change)

    reference, kill = order(0.05, "reference 0.1 from step 6 on"), order(0.1, "kill 3 from step 61 on", "kill 3 60")
    orders = (reference, kill, order(0.15, "remove 4 from step 21 on", "remove 4 20"))
    socket = tmp_path / "run" / SOCKET
    machine = FakeMachine((*A_SECOND, *orders, (0.2, lambda _: socket.touch())))
    assert drive(machine, tmp_path, FAULTS, steered=True).status == "ok"
    assert not socket.exists(), "a run that is over cannot be steered"
    ends = [("agent_004", SIGTERM), ("agent_001", SIGKILL), ("agent_002", SIGSTOP), ("agent_003", SIGKILL)]
    assert machine.signals == [*ends, *COMPLETE]
    assert noted(tmp_path).count("steered: ") == 3
    assert "steered: reference 0.1 from step 6 on" in noted(tmp_path)


def test_a_run_that_is_asked_to_start_again_ends_as_one_that_is_interrupted(tmp_path: Path) -> None:
    machine = FakeMachine((recorded(0.2, 20), report(0.3, "steering", "restart", action="restart_beside")))
    outcome = drive(machine, tmp_path, steered=True)
    assert (outcome.status, outcome.reason, outcome.restart) == (
        "interrupted",
        "ended to start again",
        "restart_beside",
    )
    assert machine.signals == [(RECORDER, SIGINT)]


@pytest.mark.parametrize("seconds", [0.2, 0.4])
def test_no_run_follows_one_that_was_interrupted_when_it_had_been_asked_to_start_again(
    tmp_path: Path, seconds: float
) -> None:
    asked = report(0.3, "steering", "restart", action="restart")
    machine = FakeMachine((recorded(0.1, 20), asked, end_asked(seconds)), deaf=(RECORDER,))
    outcome = drive(machine, tmp_path, steered=True)
    assert (outcome.status, outcome.restart) == ("interrupted", None)


def test_a_run_in_real_time_is_told_when_it_begins_and_tells_its_timing(tmp_path: Path) -> None:
    machine = FakeMachine((exited(0.3, "agent_003", -9), *A_SECOND), deaf=("agent_004",))
    outcome = drive(machine, tmp_path, kind=RealtimeRun)
    lead = LEAD + LEAD_PER_PROCESS * len(NAMES)
    assert machine.told == [b"%020d" % (EPOCH + round(lead * 1e9)) * len(NAMES)]
    assert outcome.start_seconds == pytest.approx(2.0 + READY + lead, abs=1e-3)
    died = {"agent_003": "was killed by SIGKILL", "agent_004": "did not end (it is 108 stopped)"}
    assert outcome.warnings == tuple(f"{name} {how}; the swarm continued without it" for name, how in died.items())
    told = sorted({*NAMES} - died.keys())
    timing = {"missed_periods": 1, "lateness_us": (1, 2), "longest_us": 3, "clock_jumps": 4}
    figures = {name: dict.fromkeys(told, value) for name, value in timing.items()}
    assert outcome.figures == {"digest": "abc", "realtime": {**figures, "died": died}}
    assert list(outcome.figures["realtime"]["missed_periods"]) == told
    assert "agent_003 (process 107) was killed by SIGKILL\n" in noted(tmp_path)
    assert f"all processes are ready: start, with step 0 at {int(machine.told[0][:20])} ns since 1970" in noted(
        tmp_path
    )

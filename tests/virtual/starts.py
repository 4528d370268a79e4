# ruff: noqa: SLF001 - the launcher is driven where its own loop would wait
"""Cases of starts: the orchestrator, its launcher and the start of each node, on a machine that is simulated.

The course of a run, the supervision, the reports, the forking, signalling and reaping of processes, and how nodes wait
for their counterparts are those of the product. Simulated are the operating system, the discovery, which may be late or
one-sided, and what the nodes do once they have started.
"""

from __future__ import annotations

import ast
import errno
import heapq
import json
import os
import re
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from math import inf
from pathlib import Path
from random import Random
from signal import SIGCONT, SIGINT, SIGKILL, SIGSTOP, SIGTERM, Signals
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import pytest
from tests.swarmabs_core.helpers import builtin
from tests.transport.swarm import AGENTS
from tests.virtual.properties import BrokenError
from tests.virtual.schedule import Tell, number_of, numbered, time_of, untold

from swarmabs_bag.run_folder import RunFolder
from swarmabs_config.graph import CONTROLLER, LOCKSTEP, OBSERVER, OFFERED, PLANE, RECORDER, usual_topic
from swarmabs_config.scenario import Scenario
from swarmabs_core.messages import Topic
from swarmabs_core.nodes import ROBOT_PREFIX
from swarmabs_ros.runner import expected_counterparts, meeting
from swarmabs_ros.status import EPOCH_RECORD
from swarmabs_run.orchestration import launcher as launcher_module, machine as machine_module
from swarmabs_run.orchestration.launcher import Launcher
from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.orchestration.machine import POLL, Machine
from swarmabs_run.orchestration.plan import ProcessPlan, announced_to
from swarmabs_run.orchestration.process_run import START_SILENCE, ProcessRun
from swarmabs_run.orchestration.realtime_run import ENDING_SECONDS, RealtimeRun
from swarmabs_run.orchestration.run_files import write_network
from swarmabs_run.orchestration.supervision import RESTARTS
from swarmabs_run.run import Outcome, RunOptions

LAUNCHER, FIRST_PID = 99, 101
EPOCH = 5_000_000_000
LONGEST = 400.0
"""Time, s, after which a run that has not ended never does."""
STALLED = 5.0
"""Time, s, after which nodes in lockstep report that they wait; the default of scenarios."""
_USUAL_PACE = 0.02
"""Time, s, that a step takes in most runs."""
SLACK = 3.0 * POLL
"""Time, s, that the orchestrator has for noticing something."""
FOR_EVER = 1e6
REFUSED = "told what cannot be"
"""Why a node refuses to start."""
_TOPIC_OF = {OBSERVER: "swarm/abstract_state", CONTROLLER: "swarm/desired_abstract_state", PLANE: "plane/state"}


class Trouble(NamedTuple):
    """What happens to `who` at a time (s) and lasts for a while (s), to the first so many processes of its name.

    A node is late, dies while it starts, refuses what it is told, never comes up, says everything twice or does not end
    when told to; one does not hear of another one (``who>whom``); later a process is killed or stopped. The launcher
    dies; a user interrupts; the recorder gives up; somebody else subscribes to all topics. These times count from the
    moment at which all may run if it has `begun`.
    """

    at: float
    kind: str
    who: str
    lasting: float = 0.0
    times: int = 1
    begun: bool = False

    def __str__(self) -> str:
        end = inf if self.lasting >= FOR_EVER else self.at + self.lasting
        often, since = f", {self.times} times" if self.times > 1 else "", " after all may run" if self.begun else ""
        return f"{time_of(self.at, end)}{since}: {self.kind}, {self.who}{often}"


@dataclass(frozen=True)
class StartCase:
    """A run of processes and what happens to them; one in lockstep takes a `pace` (s) for a step."""

    seed: int
    realtime: bool = False
    each_robot: bool = False
    drops: bool = False
    robots: int = 3
    per_process: int = 1
    pace: float = _USUAL_PACE
    faults: tuple[Trouble, ...] = ()
    numbers: tuple[int, ...] | None = None

    @property
    def steps(self) -> int:
        """The last step."""
        return 50

    def only(self, numbers: Iterable[int]) -> StartCase:
        """Return the case with some of its faults only."""
        return replace(self, faults=tuple(self.faults[number] for number in numbers), numbers=tuple(numbers))

    def __str__(self) -> str:
        words = [
            f"start of {self.robots} robots {'in real time' if self.realtime else 'in lockstep'}",
            *(["each robot coordinates"] if self.each_robot else []),
            *(["silent robots are dropped"] if self.drops else []),
            *([f"{self.per_process} robots per process"] if self.per_process > 1 else []),
            *([f"{self.pace:g} s for a step"] if self.pace > _USUAL_PACE else []),
        ]
        return "\n".join([f"seed {self.seed}: {'; '.join(words)}", *numbered(self.faults, self.numbers)])


def start_case(seed: int) -> StartCase:
    """Draw a case."""
    draw = Random(f"virtual starts:{seed}")
    realtime = draw.random() < 0.4
    case = StartCase(
        seed,
        realtime,
        draw.random() < 0.3,
        not realtime and draw.random() < 0.3,
        draw.choice((3, 3, 5)),
        1 if realtime else draw.choice((1, 1, 2)),
    )
    names = [process.name for process in _run_of(case, Path("/nowhere"))._plan]
    kinds = draw.sample(_KINDS, draw.choice((1, 1, 2, 3)))
    faults = [_trouble(draw, draw.choice(kinds), names) for _ in range(draw.choice((0, 1, 1, 2, 3, 5)))]
    if case.drops and draw.random() < 0.5:
        faults, case = _silences(draw, names), replace(case, pace=draw.choice((_USUAL_PACE, 0.4, 0.4)))
    return replace(case, faults=tuple(sorted(faults)))


_OF_NODES = (
    "late",
    "late",
    "dies",
    "dies",
    "refuses",
    "hangs",
    "deaf",
    "deaf",
    "twice",
    "ignores",
    "killed",
    "stopped",
)
_KINDS = (*_OF_NODES, "launcher dies", "interrupt", "gives up", "viewer")
_SURPRISES = {"killed", "stopped", "launcher dies", "interrupt", "gives up", "viewer"}
_NOBODY = {"launcher dies": "the launcher", "interrupt": "the user", "gives up": RECORDER, "viewer": "a stranger"}


def _trouble(draw: Random, kind: str, names: list[str]) -> Trouble:
    robots = [name for name in names if name.startswith(ROBOT_PREFIX[:5])]
    others = [name for name in names if name not in robots]
    who = _NOBODY.get(kind) or draw.choice((draw.choice(names), draw.choice(robots), draw.choice(others)))
    times = draw.choice((1, 1, 2, 3))
    if kind == "late":
        return Trouble(0.0, kind, who, draw.choice((draw.uniform(0.5, 5.0), draw.uniform(5.0, 28.0), 45.0)), times)
    if kind in {"dies", "refuses"}:
        return Trouble(draw.choice((0.0, draw.uniform(0.0, 2.0))), kind, who, 0.0, times)
    if kind == "hangs":
        return Trouble(0.0, kind, who, 0.0, times)
    if kind == "deaf":
        other = draw.choice([name for name in names if name != who])
        return Trouble(0.0, kind, f"{who}>{other}", draw.choice((draw.uniform(1.0, 25.0), FOR_EVER)))
    if kind == "ignores":
        return Trouble(0.0, kind, who, draw.choice((draw.uniform(1.0, 8.0), 15.0, FOR_EVER)))
    begun = draw.random() < 0.5
    return Trouble(draw.choice((draw.uniform(0.0, 1.0), draw.uniform(0.0, 4.0))), kind, who, begun=begun)


def _silences(draw: Random, names: list[str]) -> list[Trouble]:
    """Let a robot fall silent, and perhaps others while all report that they wait for it."""
    robots = [name for name in names if name.startswith(ROBOT_PREFIX[:5])]
    at, faults = draw.uniform(0.0, 4.0), []
    for name in draw.sample(robots, draw.randint(1, len(robots) - 1)):
        faults.append(Trouble(at, draw.choice(("killed", "stopped", "stopped")), name, begun=True))
        at += draw.choice((draw.uniform(0.0, 1.0), STALLED + draw.uniform(0.0, 1.0), STALLED + draw.uniform(0.0, 2.0)))
    return faults


@cache
def _scenario(*, each_robot: bool, drops: bool, robots: int) -> Scenario:
    agents = [*AGENTS, *(AGENTS[0].replace("id: 1", f"id: {number}") for number in range(4, robots + 1))]
    more = ["coordination=each_robot"] if each_robot else []
    more += ["lockstep.on_stall=drop"] if drops else []
    return builtin("pd_het_4", f"swarm.agents=[{', '.join(agents[:robots])}]", "duration=0.5", *more).resolved()


def _run_of(case: StartCase, folder: Path) -> ProcessRun:
    scenario = _scenario(each_robot=case.each_robot, drops=case.drops, robots=case.robots)
    kind = RealtimeRun if case.realtime else LockstepRun
    return kind(scenario, RunFolder(folder), RunOptions(namespace="/north", agents_per_process=case.per_process))


@dataclass(eq=False)
class Process:
    """A process of the simulated machine; `number` counts those of its name, `known` are those that it knows.

    `viewers` are not of the run, and subscribe to everything.
    """

    pid: int
    plan: ProcessPlan
    number: int
    wants: dict[Topic, int]
    known: set[Process] = field(default_factory=set)
    up: bool = False
    ready: bool = False
    running: bool = False
    stopped: bool = False
    alive: bool = True
    ended: float = inf
    status: int | None = None
    viewers: list[str] = field(default_factory=list)
    told: bool = False
    done: bool = False
    stalled: bool = False

    @property
    def name(self) -> str:
        """The name of its node."""
        return self.plan.name

    def get_subscription_count(self, topic: Topic) -> int:
        """Return how many readers of a topic it knows."""
        return sum(topic in other.plan.subscriptions for other in self.known) + len(self.viewers)

    def publisher_count(self, topic: Topic) -> int:
        """Return how many writers of a topic it knows, as a receiver does."""
        return sum(topic in other.plan.publications for other in self.known)

    @property
    def publishers(self) -> dict[Topic, Any]:
        """Its publishers."""
        return {
            topic: SimpleNamespace(get_subscription_count=partial(self.get_subscription_count, topic))
            for topic in self.plan.publications
        }


class Host:
    """The machine: clock, processes, pipes and the network between the nodes."""

    def __init__(self, case: StartCase, plan: Iterable[ProcessPlan], tell: Tell) -> None:
        self.case, self.plan, self.tell = case, {process.name: process for process in plan}, tell
        self.draw = Random(f"virtual starts:{case.seed}:host")
        self.now = 0.0
        self.asked = False
        self.processes: dict[int, Process] = {}
        self.reaped: list[int] = []
        self.began: float | None = None
        self.records = b""
        self.step = -1.0
        self.step_zero = inf
        self.code: int | None = None
        self.signals: list[tuple[float, str, int]] = []
        self.reports: list[tuple[float, dict[str, Any]]] = []
        self.open = {"reports", "start", "stdin"}
        self.launcher: Launcher
        self._spawns: Counter[str] = Counter()
        self._next: dict[str, Any] = {}
        self._buffer = b""
        self._pending = b""
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._sequence = 0
        self._blocked: float | None = None
        self._dropped: set[str] = set()
        self.refused = inf
        self.viewers: list[str] = []
        self._announced = announced_to([*self.plan.values()])
        self._surprise(begun=False)
        self.after(case.pace, self._go_on)

    # Time

    def after(self, seconds: float, do: Callable[[], None]) -> None:
        """Let something happen later."""
        self._sequence += 1
        heapq.heappush(self._events, (self.now + seconds, self._sequence, do))

    def run_until(self, end: float, enough: Callable[[], bool] = lambda: False) -> None:
        """Let everything happen up to a time, or until it is enough."""
        while not enough() and self._events and self._events[0][0] <= end:
            time, _, do = heapq.heappop(self._events)
            self.now = max(self.now, time)
            do()
        if not enough():
            self.now = max(self.now, end)
        if self.now > LONGEST:
            raise BrokenError("a start ends", "the orchestrator", f"is not done after {LONGEST:g} s")

    def clock(self) -> float:
        """Return the time, s."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.run_until(self.now + seconds)

    def _surprise(self, *, begun: bool) -> None:
        """Let what the case has for the time before or after the begin happen."""
        for trouble in self.case.faults:
            if trouble.kind in _SURPRISES and trouble.begun is begun:
                self.after(trouble.at, partial(self._happen, trouble))

    # What the launcher asks of the operating system

    def fork(self) -> int:
        """Make the process of the next order."""
        name = self._next["name"]
        self._spawns[name] += 1
        self.tell(self.now, name, "is started" if self._spawns[name] == 1 else "is started again", done=False)
        pid = FIRST_PID + len(self.processes)
        plan = self.plan[name]
        given = next((word for word in self._next["arguments"] if word.startswith("match:=")), "match:=[]")
        used = (*plan.publications, *plan.subscriptions)
        wants = expected_counterparts(ast.literal_eval(given.partition(":=")[2]), used)
        process = self.processes[pid] = Process(pid, plan, self._spawns[name], wants, viewers=self.viewers)
        process.known.add(process)
        self._begin(process)
        return pid

    def kill(self, pid: int, number: int) -> None:
        """Send a signal; one to a process that has been reaped is an error of the product."""
        process = self.processes[pid]
        if pid in self.reaped:
            raise ProcessLookupError(errno.ESRCH, "No such process")
        self.signals.append((self.now, process.name, number))
        self.tell(self.now, process.name, f"gets {Signals(number).name}", done=False)
        if number == SIGKILL:
            self._die(process, number)
        elif number == SIGSTOP:
            process.stopped = True
        elif number == SIGCONT:
            process.stopped = False
        elif process.alive and not process.told and not self._hangs(process):
            process.told = True
            self.after(0.05 + self._ignores(process), partial(self._end, process, number))

    def waitpid(self, _: int, options: int) -> tuple[int, int]:
        """Reap a process that has ended; wait for one without `os.WNOHANG`."""
        while True:
            for pid, process in self.processes.items():
                if not process.alive and pid not in self.reaped:
                    self.reaped.append(pid)
                    assert process.status is not None
                    return pid, process.status
            if options == os.WNOHANG:
                return 0, 0
            self.sleep(0.01)

    def report(self, data: bytes) -> int:
        """Take a report, which the orchestrator can read from now on."""
        self._buffer += data
        self.reports.append((self.now, json.loads(data)))
        return len(data)

    # What the orchestrator asks of it

    def read(self, size: int) -> bytes:
        """Read reports as from a pipe."""
        if not self._buffer:
            raise BlockingIOError
        data, self._buffer = self._buffer[:size], self._buffer[size:]
        return data

    def select(
        self, read: list[Any], _: list[Any], __: list[Any], seconds: float
    ) -> tuple[list[Any], list[Any], list[Any]]:
        """Wait until there is a report, but no longer than some time."""
        self.run_until(self.now + seconds, lambda: bool(self._buffer))
        self.now += 1e-6
        return (read[:1] if self._buffer else []), [], []

    def write(self, data: bytes) -> int:
        """Take an order."""
        self._pending += data
        return len(data)

    def flush(self) -> None:
        """Pass the orders on to the launcher."""
        *lines, self._pending = self._pending.split(b"\n")
        for line in lines:
            self.after(1e-4, partial(self._obey, json.loads(line)))

    def close_stdin(self) -> None:
        """Tell the launcher that it is over."""
        if "stdin" in self.open:
            self.open.discard("stdin")
            self.after(1e-4, self._launcher_ends)

    def wait(self, seconds: float | None = None) -> int:
        """Wait for the end of the launcher."""
        self.run_until(self.now + (LONGEST if seconds is None else seconds), lambda: self.code is not None)
        if self.code is None:
            raise subprocess.TimeoutExpired("launcher", seconds or LONGEST)
        return self.code

    def launcher_killed(self) -> None:
        """Let the launcher die; the kernel kills its children."""
        if self.code is None:
            self.code = -9
            for process in self.processes.values():
                process.alive = False
            self.reaped = [*self.processes]

    def start(self, data: bytes) -> int:
        """Take what the nodes read at the start."""
        self.records += data
        return len(data)

    def close(self, name: str) -> None:
        """Close a pipe; that of the start is the signal for all nodes."""
        self.open.remove(name)
        if name == "start" and self.code is None:
            self.began = self.now
            self.tell(self.now, "the orchestrator", "lets all run", done=False)
            self._surprise(begun=True)
            for process in self.processes.values():
                self.after(self.draw.uniform(1e-3, 0.1), partial(self._started, process))

    # What the launcher and the nodes do

    def _obey(self, order: dict[str, Any]) -> None:
        if self.code is None and order["command"] != "begin":
            self._next = order
            self.launcher._obey(cast("Any", order))

    def _launcher_ends(self) -> None:
        if self.code is None:
            self.launcher._end()
            self.code = 0

    def _die(self, process: Process, status: int) -> None:
        if not process.alive:
            return
        process.alive, process.status, process.ended = False, status, self.now
        self.tell(self.now, process.name, _ending(status), done=False)
        lease = self.draw.choice((0.01, 3.0, LONGEST))
        self.after(1e-3, self._child_ended)
        for other in self.processes.values():
            self.after(lease, partial(other.known.discard, process))

    def _child_ended(self) -> None:
        if self.code is None and "stdin" in self.open:
            self.launcher._reap(os.WNOHANG)

    def _of(self, process: Process, kind: str) -> list[Trouble]:
        return [t for t in self.case.faults if t.kind == kind and t.who == process.name]

    def _ignores(self, process: Process) -> float:
        return max((trouble.lasting for trouble in self._of(process, "ignores")), default=0.0)

    def _hangs(self, process: Process) -> bool:
        """Return whether a process never comes up, and bears all signals but SIGKILL."""
        return any(process.number <= trouble.times for trouble in self._of(process, "hangs"))

    def _begin(self, process: Process) -> None:
        for trouble in self._of(process, "dies"):
            if process.number <= trouble.times:
                self.after(0.05 + trouble.at, partial(self._fails, process))
        for trouble in self._of(process, "refuses"):
            self.after(0.05 + trouble.at, partial(self._refuses, process))
        if self._hangs(process):
            self.tell(self.now, process.name, "begins, and never comes up", done=False)
            return
        late = max((t.lasting for t in self._of(process, "late") if process.number in {1, t.times}), default=0.0)
        self.after(self.draw.uniform(0.1, 0.5) + late, partial(self._up, process))

    def _fails(self, process: Process) -> None:
        if process.alive and self.began is None:
            self._die(process, self.draw.choice((11, 9, 1 << 8, 2 << 8)))

    def _refuses(self, process: Process) -> None:
        if process.alive and self.began is None:
            self._say(process, "failed", reason=REFUSED)
            self.refused = min(self.refused, self.now)
            self._die(process, 2 << 8)

    def _up(self, process: Process) -> None:
        if not process.alive:
            return
        self.tell(self.now, process.name, "is up", done=False)
        process.up = True
        for other in self.processes.values():
            if other is not process and other.up and other.alive and self._announces(process, other):
                for one, another in ((process, other), (other, process)):
                    self.after(self._delay(one.name, another.name), partial(self._discover, one, another))
        if self.case.realtime:
            self._ready(process)
        else:
            begun = self.now
            waits = meeting(
                process.wants, cast("Any", process.publishers), cast("Any", process), lambda: self.now - begun
            )
            self._meet(process, waits)

    def _announces(self, one: Process, other: Process) -> bool:
        return any(a.plan.participant in self._announced[b.name] for a, b in ((one, other), (other, one)))

    def _delay(self, name: str, of: str) -> float:
        deaf = [
            trouble.lasting for trouble in self.case.faults if trouble.kind == "deaf" and trouble.who == f"{name}>{of}"
        ]
        return self.draw.uniform(0.01, 0.2) + max(deaf, default=0.0)

    def _discover(self, process: Process, other: Process) -> None:
        if process.alive and other.alive:
            process.known.add(other)

    def _meet(self, process: Process, waits: Iterator[float]) -> None:
        """Let a node look for its counterparts until it has met them."""
        if not process.alive:
            return
        seconds = next(waits, None)
        if seconds is None:
            self._ready(process)
        else:
            self.after(max(seconds, 1e-4), partial(self._meet, process, waits))

    def _ready(self, process: Process) -> None:
        process.ready = True
        what = "is ready" if self.case.realtime else "has met its counterparts, and is ready"
        self.tell(self.now, process.name, what, done=False)
        for _ in range(2 if self._of(process, "twice") else 1):
            self._say(process, "ready")
        if self.began is not None:
            self._started(process)

    def _say(self, process: Process, event: str, **details: Any) -> None:
        self.report(json.dumps({"node": process.name, "pid": process.pid, "event": event, **details}).encode() + b"\n")

    def _started(self, process: Process) -> None:
        """Let a node that is ready notice the start."""
        if not process.alive or not process.ready or process.running:
            return
        if self.case.realtime:
            record, self.records = self.records[:EPOCH_RECORD], self.records[EPOCH_RECORD:]
            if len(record) < EPOCH_RECORD:
                self._die(process, 1 << 8)
                return
            self.step_zero = (int(record) - EPOCH) / 1e9
        process.running = True
        self.tell(self.now, process.name, "runs", done=False)

    def _end(self, process: Process, number: int) -> None:
        """Let a node end because of a signal."""
        if not process.alive or process.stopped:
            return
        if process.name == RECORDER:
            if not process.done:
                self._done(process, complete=False, problem=None if number == SIGINT else "stopped")
        elif self.case.realtime and process.running:
            self._say(process, "timing", missed=0, lateness_us=[0, 0], longest_us=0, clock_jumps=0)
        self._die(process, 0)

    def _done(self, recorder: Process, *, complete: bool, problem: str | None) -> None:
        recorder.done = True
        self._say(recorder, "done", complete=complete, problem=problem, figures={"digest": "abc"})
        if complete:
            self.after(0.01, partial(self._die, recorder, 0))

    def current(self) -> dict[str, Process]:
        """Return the last process of each name."""
        return {process.name: process for process in self.processes.values()}

    def _go_on(self) -> None:
        """Let a run that has begun go on, or stall."""
        self.after(self.case.pace, self._go_on)
        current = self.current()
        if self.began is None or self.code is not None or len(current) < len(self.plan):
            return
        needed = {name: process for name, process in current.items() if name not in self._dropped}
        if self.case.realtime:
            self.step = (self.now - self.step_zero) / 0.01
        elif all(process.running and process.alive and not process.stopped for process in needed.values()):
            self.step = min(self.step + 1.0, self.case.steps)
            self._blocked = None
        elif self.step < self.case.steps and any(not p.alive or p.stopped for p in needed.values()):
            self._stall(needed)
        recorder = current[RECORDER]
        if recorder.alive and recorder.running and not recorder.stopped and self.step >= 0 and not recorder.done:
            step = min(int(self.step), self.case.steps)
            if self.step >= self.case.steps + (50 if self.case.realtime else 0):
                self._done(recorder, complete=True, problem=None)
            elif step % 5 == 0:
                self._say(recorder, "progress", step=step, angle=0.0, error=0.0, robots=None)

    def _stall(self, needed: dict[str, Process]) -> None:
        if self._blocked is None:
            self._blocked = self.now
        if self.now - self._blocked < STALLED:
            return
        silent = {name: process for name, process in needed.items() if not process.alive or process.stopped}
        waiting = [process for name, process in needed.items() if name not in silent and process.running]
        agreed = self.now - self._blocked > STALLED + 1.0
        if self.case.drops and agreed and all(process.plan.agents for process in silent.values()):
            self._dropped |= silent.keys()
            for process in waiting:
                if process.stalled:
                    process.stalled = False
                    self._say(process, "recovered")
            return
        missing = [
            item
            for process in silent.values()
            for item in ([f"agent {i}" for i in process.plan.agents] or [_TOPIC_OF.get(process.name, process.name)])
        ]
        for process in waiting:
            if not process.stalled:
                process.stalled = True
                self._say(process, "stalled", step=int(self.step), missing=missing, silence=STALLED)

    def _happen(self, trouble: Trouble) -> None:
        number = number_of(trouble, self.case.faults, self.case.numbers)
        self.tell(self.now, trouble.who, f"{trouble.kind} {number}")
        if trouble.kind == "interrupt":
            self.asked = True
        elif trouble.kind == "viewer":
            self.viewers.append(trouble.who)
        elif trouble.kind == "launcher dies":
            self.launcher_killed()
        elif (process := self.current().get(trouble.who)) is None or not process.alive:
            return
        elif trouble.kind == "killed":
            self._die(process, SIGKILL)
        elif trouble.kind == "stopped":
            process.stopped = True
        elif not process.done and process.running:
            self._done(process, complete=False, problem="the disk is full")


class VirtualMachine(Machine):
    """The machine of a run, whose pipes, processes and clocks are those of a host."""

    def __init__(self, host: Host, log: Path) -> None:
        self._host = host
        process = SimpleNamespace(
            pid=LAUNCHER,
            stdin=SimpleNamespace(write=host.write, flush=host.flush, close=host.close_stdin, closed=False),
            poll=lambda: host.code,
            wait=host.wait,
            kill=host.launcher_killed,
        )
        started = SimpleNamespace(reports=3, start=4, process=process, taken=False)
        super().__init__({}, log, processes=len(host.plan), started=cast("Any", started))

    def now(self) -> float:  # type: ignore[override]
        return self._host.now

    def time_ns(self) -> int:  # type: ignore[override]
        return EPOCH + round(self._host.now * 1e9)

    def held_port(self, *_: object) -> str:  # type: ignore[override]
        return ""

    def state_of(self, pid: int) -> str:  # type: ignore[override]
        process = self._host.processes[pid]
        return "dead" if not process.alive else "stopped" if process.stopped else "sleeping"


@contextmanager
def simulated(host: Host) -> Iterator[None]:
    """Let launcher and orchestrator use a host instead of the operating system."""
    names = {3: "reports", 4: "start"}
    of_launcher = SimpleNamespace(
        fork=host.fork,
        kill=host.kill,
        waitpid=host.waitpid,
        waitstatus_to_exitcode=os.waitstatus_to_exitcode,
        WNOHANG=os.WNOHANG,
        write=lambda _, data: host.report(data),
        getpid=lambda: LAUNCHER,
        pipe=lambda: (5, 6),
    )
    of_machine = SimpleNamespace(
        read=lambda _, size: host.read(size),
        write=lambda _, data: host.start(data),
        close=lambda number: host.close(names[number]),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(launcher_module, "os", of_launcher)
        patch.setattr(launcher_module, "time", SimpleNamespace(monotonic=host.clock, sleep=host.sleep))
        patch.setattr(machine_module, "os", of_machine)
        patch.setattr(machine_module, "select", SimpleNamespace(select=host.select))
        host.launcher = Launcher(0)
        yield


class StartStory:
    """Lets a case happen; as `tests.virtual.story.Story`."""

    def __init__(self, case: StartCase, tell: Tell = untold) -> None:
        self.case = case
        self._folder = Path(tempfile.mkdtemp(prefix="start-"))
        self._run = _run_of(case, self._folder)
        self.host = Host(case, self._run._plan, tell)
        self._tell = tell

    @property
    def time(self) -> float:
        """The time since the beginning, s."""
        return self.host.now

    def said(self) -> str:
        """Return all reports and signals, line by line."""
        host = self.host
        reports = (f"{time:.6f} {json.dumps(report)}\n" for time, report in host.reports)
        return "".join([*reports, *(f"{time:.6f} {name} {number}\n" for time, name, number in host.signals)])

    def check(self) -> None:
        """Let everything happen; raise an error if a property does not hold."""
        host, logs = self.host, self._folder / "logs"
        try:
            logs.mkdir()
            write_network(logs, 5, len(host.plan), realtime=self.case.realtime)
            with simulated(host):
                machine = VirtualMachine(host, logs / "launcher.log")
                at_start = machine.start_all
                machine.start_all = partial(self._starting, at_start)  # type: ignore[method-assign]
                outcome = self._run.drive(machine, lambda: host.asked, 5, 0.0)
                self._tell(host.now, "the orchestrator", _told(outcome), done=False)
                decided = host.now
                machine.close()
            self._is_clean()
            self._is_right(outcome, decided)
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _starting(self, start: Callable[[bytes], None], data: bytes = b"") -> None:
        """Check what must hold when all are started: each process lives, is ready and has met its counterparts."""
        host = self.host
        if "stdin" in host.open:
            current = host.current()
            # A dead process still counts as a counterpart for a while, and so does somebody else who listens.
            restarted = len(host.processes) > len(current) or bool(host.viewers)
            for name in host.plan:
                process = current.get(name)
                if process is None or not process.ready or process.ended < host.now - SLACK:
                    raise BrokenError("a start is complete", name, "is started, but is not ready")
                strangers = (
                    [] if self.case.realtime or restarted else [o for o in current.values() if _talk(process, o)]
                )
                if unmet := [o.name for o in strangers if o not in process.known and o.alive]:
                    raise BrokenError("a start is complete", name, f"is started, but has not discovered {unmet[0]}")
        start(data)

    def _is_clean(self) -> None:
        """Raise an error unless everything that was started has been ended and reaped."""
        host = self.host
        if host.code is None or host.open:
            raise BrokenError("nothing remains", "the orchestrator", f"leaves open: {sorted(host.open) or 'launcher'}")
        left = [process.name for process in host.processes.values() if process.alive]
        if left or sorted(host.reaped) != [*host.processes]:
            raise BrokenError("nothing remains", "the launcher", f"leaves alive {left}, reaped {host.reaped}")

    def _is_right(self, outcome: Outcome, decided: float) -> None:
        """Raise an error if an outcome is not what has happened."""
        host = self.host
        whole = any(report["event"] == "done" and report["complete"] for _, report in host.reports)
        text = _told(outcome)
        if outcome.status == "ok" and not (whole and outcome.start_seconds is not None and outcome.reason is None):
            raise _wrong(f"says {text}, but the recording is not complete")
        if outcome.status != "ok" and not outcome.reason:
            raise _wrong(f"says {text}, and not why")
        if outcome.status == "interrupted" and not host.asked:
            raise _wrong(f"says {text}, but nobody has interrupted it")
        if outcome.status != "ok" and all(self._is_mild(trouble) for trouble in self.case.faults):
            raise _wrong(f"says {text}, although the swarm could go on")
        recorder, ends = host.current().get(RECORDER), {SIGINT, SIGTERM}
        told = [number for _, name, number in host.signals if name == RECORDER and number in ends]
        lives = recorder is not None and recorder.ended >= decided and host.code != -9
        if outcome.status != "ok" and lives and not told and RECORDER not in (outcome.reason or ""):
            raise _wrong(f"says {text}, but does not tell the recorder to end")
        acted = min((time for time, _, _ in host.signals if time >= host.refused), default=decided)
        if acted > host.refused + 2.0 * SLACK and not host.asked and host.code != -9:
            raise _wrong(f"does nothing for {acted - host.refused:.1f} s after a process has said that it is {REFUSED}")
        wrong = {SIGTERM} if outcome.status == "interrupted" else set() if host.asked else {SIGINT}
        if wrong.intersection(told[:1]):
            raise _wrong(f"says {text}, but tells the recorder so by {Signals(told[0]).name}")
        for name, plan in host.plan.items():
            spawned = sum(process.name == name for process in host.processes.values())
            if spawned > (1 + RESTARTS if plan.agents else 1):
                raise _wrong(f"has started {name} {spawned} times")
        if outcome.status == "failed" and host.code != -9:
            self._names_culprits(outcome.reason or "", decided)
        if self.case.realtime and outcome.status == "ok":
            self._names_dead(outcome, decided)

    def _names_culprits(self, reason: str, decided: float) -> None:
        """Raise an error if a failure names processes that have not failed, or nobody, or comes too early."""
        host, current = self.host, self.host.current()
        first = reason.partition("\n")[0]
        named = {name for name in host.plan if re.search(rf"\b{name.replace('agent_', 'agent[ _]')}\b", first)}
        guilty = {name for name, p in current.items() if not p.alive or p.stopped or not p.ready}
        guilty |= {trouble.who for trouble in self.case.faults if trouble.kind in {"gives up", "ignores", "killed"}}
        if not named or not named <= guilty:
            raise _wrong(f"says: {first}; but at fault are {sorted(guilty)}")
        if "counterparts not found" in first:
            news = [time for time, report in host.reports if report["event"] in _NEWS and time < decided]
            if decided - max(news) < START_SILENCE - SLACK and not any(p.told for p in host.processes.values()):
                raise _wrong(f"gives up {decided - max(news):.1f} s after the last news")

    def _names_dead(self, outcome: Outcome, decided: float) -> None:
        """Raise an error if the warnings of a run in real time do not name the robots that have died."""
        host = self.host
        if untold := [p.name for p in host.current().values() if p.ended >= decided and not p.told and not p.done]:
            raise _wrong(f"does not tell {untold[0]} to end")
        dead = {p.name for p in host.processes.values() if p.plan.agents and p.number == self._spawned(p.name)}
        dead = {name for name in dead if not any(_timing(report, name) for _, report in host.reports)}
        dead -= {p.name for p in host.processes.values() if p.told and p.ended < decided}  # they were to end
        named = {warning.partition(" ")[0] for warning in outcome.warnings}
        if named != dead:
            raise _wrong(f"names {sorted(named)} as dead, but these are {sorted(dead)}")

    def _spawned(self, name: str) -> int:
        return sum(process.name == name for process in self.host.processes.values())

    def _is_silence(self, trouble: Trouble) -> bool:
        """Return whether a robot falls silent in the run."""
        plan = self.host.plan.get(trouble.who)
        return trouble.begun and trouble.kind in {"killed", "stopped"} and plan is not None and bool(plan.agents)

    def _is_mild(self, trouble: Trouble) -> bool:
        """Return whether a run goes on in spite of this."""
        case, plan = self.case, self.host.plan.get(trouble.who)
        robot = plan is not None and bool(plan.agents)
        others = [other for other in case.faults if other is not trouble and other.kind in {"dies", "hangs", "killed"}]
        if trouble.kind == "late":
            return trouble.lasting < START_SILENCE - 1.5
        if trouble.kind == "deaf":
            return case.realtime or trouble.lasting < START_SILENCE - 1.5
        if trouble.kind == "dies":
            return robot and trouble.times <= RESTARTS and not others
        if trouble.kind == "hangs":
            robots = sum(bool(process.agents) for process in self.host.plan.values())
            alone = not others and len(case.faults) == 1
            return (
                robot
                and trouble.times <= RESTARTS
                and alone
                and robots > 2
                and not (case.each_robot and not case.realtime)
            )
        if trouble.kind == "ignores":
            return not case.realtime or robot or trouble.who == RECORDER or trouble.lasting < ENDING_SECONDS - 1.0
        killed = trouble.kind == "killed" and robot and (case.realtime or case.drops) and not others
        if case.drops and not case.each_robot and all(map(self._is_silence, case.faults)):
            robots = sum(bool(process.agents) for process in self.host.plan.values())
            return len({other.who for other in case.faults}) < robots
        return killed or trouble.kind in {"twice", "viewer"}


_NEWS = {"spawned", "ready", "exited"}
"""Reports by which a start makes progress."""


def _told(outcome: Outcome) -> str:
    """Return the status of a run, and the first line of its reason."""
    reason, _, _ = (outcome.reason or "").partition("\n")
    return f"{outcome.status}: {reason}" if reason else outcome.status


def _ending(status: int) -> str:
    """Return the words for how a process has ended."""
    code = os.waitstatus_to_exitcode(status)
    return f"ends with exit code {code}" if code >= 0 else f"ends by {Signals(-code).name}"


def _wrong(text: str) -> BrokenError:
    return BrokenError("an outcome is right", "the orchestrator", text)


def _talk(one: Process, other: Process) -> bool:
    """Return whether two processes share a topic whose messages are not kept for those who come late."""
    return one is not other and any(
        topic in b.plan.subscriptions and OFFERED[LOCKSTEP][usual_topic(topic)].durability != "transient_local"
        for a, b in ((one, other), (other, one))
        for topic in a.plan.publications
    )


def _timing(report: dict[str, Any], name: str) -> bool:
    return bool(report["node"] == name and report["event"] == "timing")

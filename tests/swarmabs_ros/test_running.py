"""Whole nodes in this process: what they report and to whom, ask of the kernel, and how they live and end."""

import ctypes
import json
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial, partialmethod
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import Trigger
from tests.swarmabs_ros.nodes import COMMAND_LINE, given

from swarmabs_config.graph import DIAGNOSTICS, PLANE, REALTIME, endpoints
from swarmabs_core.declaration import parameters_of, part, setting
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import EVENTS, Message, Messages, Topic
from swarmabs_core.realtime.base import UNKNOWN, Health, Level, Schedule, Sender
from swarmabs_core.swarm_law import SwarmGains
from swarmabs_ros import managed as managed_module, realtime_runner, status
from swarmabs_ros.lockstep import INTERRUPTED, NodeSpec
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec, diagnostic_array, one_line
from swarmabs_ros.parameters import declare_values
from swarmabs_ros.realtime import RealtimeLoop
from swarmabs_ros.realtime_runner import SWITCH_INTERVAL, RealtimeProgram, Server, lock_memory, schedule_threads
from swarmabs_ros.runner import LockstepProgram, Settings
from swarmabs_ros.status import REPORT_FD, START_FD, Heartbeat, StatusChannel, epoch_records, notify
from swarmabs_ros.tuning import Tuning, gains_among

LOCKS = "from swarmabs_ros.realtime_runner import lock_memory; lock_memory(); print(open('/proc/self/status').read())"


class Told:
    """What a node reports to the orchestrator and to systemd; something may be done when it has said something."""

    def __init__(self) -> None:
        self.reports: list[tuple[str, dict[str, Any]]] = []
        self.notices: list[str] = []
        self.active = threading.Event()
        self.then: dict[str, Callable[[], object]] = {"READY=1\nSTATUS=active": self.active.set}

    def report(self, event: str, **details: object) -> None:
        self.reports.append((event, details))
        self.then.get(event, tuple)()

    def notice(self, text: str) -> None:
        self.notices.append(text)
        self.then.get(text, tuple)()

    def events(self) -> list[str]:
        return [event for event, _ in self.reports]


@pytest.fixture
def told(ros: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[Told]:
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    interval = sys.getswitchinterval()
    listener = Told()
    monkeypatch.setattr(StatusChannel, "send", lambda _, event, **details: listener.report(event, **details))
    for module in (managed_module, realtime_runner):
        monkeypatch.setattr(module, "notify", listener.notice)
    yield listener
    sys.setswitchinterval(interval)
    for number, handler in handlers.items():
        signal.signal(number, handler)


def terminate() -> None:
    os.kill(os.getpid(), signal.SIGTERM)  # of the process that runs the test, which may be a fork


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def fail() -> None:
    raise RunError("the plane turns over")


class Ticking:
    """A node in real time that does something in some of its steps; the first lasts until it is said to be active.

    It notes the interval between switches of threads.
    """

    def __init__(self, told: Told, **at: Callable[[], object]) -> None:
        self._active = told.active
        self._at = at
        self.ticks = self.halts = 0
        self.interval = 0.0

    def hear(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Messages:
        return ()

    def tick(self, now: int) -> Messages:
        self.ticks += 1
        self.interval = sys.getswitchinterval()
        assert self._active.wait(10.0)
        self._at.get(f"tick_{self.ticks}", tuple)()
        return ()

    def halt(self) -> None:
        self.halts += 1

    def health(self, now: int) -> Health:
        return Health(Level.OK, "fine")


def realtime(behaviour: Ticking, **parameters: str) -> int:
    words = given(period_ns="2000000", **parameters)
    return RealtimeProgram(PLANE, (), lambda *_: RealtimeSpec(behaviour, 0.0))([*COMMAND_LINE, *words])


def test_a_node_in_real_time_ticks_until_it_is_told_to_stop(told: Told) -> None:
    node = Ticking(told, tick_5=terminate)
    assert realtime(node) == 0
    assert (node.ticks, node.halts, node.interval) == (5, 1, SWITCH_INTERVAL)
    assert told.events() == ["ready", "timing"]
    assert told.reports[1][1]["steps"] == 5
    assert told.notices == ["READY=1\nSTATUS=active", "STOPPING=1"]


def test_systemd_waits_for_a_node_until_it_has_settled(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(managed_module, "DIAGNOSTICS_PERIOD", 0.05)
    waits = "STATUS=waiting until it leads or stands by"
    told.then |= {waits: told.active.set, "READY=1\nSTATUS=active": terminate}
    node, asked = Ticking(told), list[int]()

    def settled() -> bool:
        asked.append(node.ticks)
        return len(asked) == 3

    words = given(period_ns="2000000")
    spec = RealtimeSpec(node, 0.0, settled=settled)
    assert RealtimeProgram(PLANE, (), lambda *_: spec)([*COMMAND_LINE, *words]) == 0
    assert told.notices == [waits, waits, "READY=1\nSTATUS=active", "STOPPING=1"]
    assert told.events() == ["ready", "timing"], "a run does not wait for that"


def test_a_node_that_fails_is_halted_and_says_why(told: Told, capfd: pytest.CaptureFixture[str]) -> None:
    told.then["timing"] = terminate  # it has left the active state
    node = Ticking(told, tick_3=fail)
    assert realtime(node) == 1
    assert (node.ticks, node.halts) == (3, 1)
    assert told.events() == ["ready", "failed", "timing", "failed"]
    assert told.reports[1][1]["reason"] == "the plane turns over"
    assert "error: the plane turns over" in capfd.readouterr().err
    assert "STATUS=inactive" in told.notices


def test_a_process_whose_node_does_not_halt_says_so_and_ends(
    told: Told, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    released, exits = threading.Event(), list[int]()
    monkeypatch.setattr(realtime_runner, "RealtimeLoop", partial(RealtimeLoop, halts_within=0.3))
    monkeypatch.setattr(os, "_exit", lambda code: (exits.append(code), released.set()))
    node = Ticking(told, tick_3=terminate)
    monkeypatch.setattr(node, "halt", lambda: released.wait(10.0))
    assert realtime(node) == 1
    assert exits == [1]
    reason = "halting has not ended within 0.3 s: a drive's stop() hangs, or a step before it; this process ends"
    reasons = {details["reason"] for event, details in told.reports if event == "failed"}
    assert [text.startswith(reason) for text in reasons] == [True]
    assert any(text.startswith(f"STATUS={reason}") for text in told.notices)
    assert capfd.readouterr().err.count(f"error: {reason}") == 2, "of the watchdog, and of what lives on here"


@pytest.mark.parametrize("named", ["drive", "use_sim_time", "await_epoch"])
def test_what_cannot_be_made_or_done_in_real_time_is_refused(
    named: str, told: Told, capfd: pytest.CaptureFixture[str]
) -> None:
    def make(*_: object) -> RealtimeSpec:
        raise InputError("parameter drive: there is none")

    if named == "drive":
        assert RealtimeProgram(PLANE, (), make)(COMMAND_LINE) == 2
        assert told.events() == ["failed"]
    else:
        assert realtime(Ticking(told), **{named: "true"}) == 2
    assert f"error: parameter {named}: " in capfd.readouterr().err


def test_a_node_that_is_not_to_start_by_itself_waits(told: Told) -> None:
    told.then["READY=1\nSTATUS=waiting for configuration"] = terminate
    node = Ticking(told)
    assert realtime(node, autostart="false") == 0
    assert (node.ticks, node.halts) == (0, 0)


def test_a_priority_is_asked_for_if_it_is_wanted(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda _, policy, parameters: asked.append(parameters.sched_priority))
    assert realtime(Ticking(told, tick_1=terminate), scheduling="fifo", priority="2") == 0
    assert {1, 2} == set(asked)


class Stepping:
    """A node in lockstep that does something at its start, and then waits for events, or has finished."""

    def __init__(self, at_start: Callable[[], object] = tuple, *, waits: bool = True) -> None:
        self._at_start = at_start
        self._topics: tuple[Topic, ...] = (EVENTS,) if waits else ()

    def start(self) -> Messages:
        self._at_start()
        return ()

    def handle(self, message: Message) -> Messages:
        return ()

    def awaits(self) -> tuple[Topic, ...]:
        return self._topics

    def missing(self) -> tuple[int, tuple[str, ...]]:
        return 0, ()


@pytest.mark.parametrize(
    ("behaviour", "code", "why", "said"),
    [
        (Stepping(waits=False), 0, None, ["ready"]),
        (Stepping(terminate), 0, None, ["ready"]),
        (Stepping(interrupt), 0, INTERRUPTED, ["ready"]),
        (Stepping(fail), 1, "the plane turns over", ["ready", "failed"]),
    ],
    ids=["finished", "terminated", "interrupted", "failed"],
)
def test_a_node_in_lockstep_is_told_how_it_ends(
    behaviour: Stepping, code: int, why: str | None, said: list[str], told: Told
) -> None:
    exits: list[str | None] = []
    spec = NodeSpec(behaviour, on_exit=exits.append, lingers=False)
    # Its own events are heard by itself, so it has met the counterpart for which it waits.
    words = given(match="['swarm/events 1']")
    assert LockstepProgram(PLANE, (), lambda *_: spec)([*COMMAND_LINE, *words]) == code
    assert (exits, told.events()) == ([why], said)


def test_a_node_in_lockstep_follows_no_ros_clock(told: Told, capfd: pytest.CaptureFixture[str]) -> None:
    assert (
        LockstepProgram(PLANE, (), lambda *_: NodeSpec(Stepping()))([*COMMAND_LINE, *given(use_sim_time="true")]) == 2
    )
    assert "error: parameter use_sim_time: no ROS clock determines the steps" in capfd.readouterr().err
    assert told.events() == ["failed"]


@pytest.mark.parametrize("match", ["['swarm/events 2']", "['swarm/events 1', 'plane/state 1']"])
def test_who_waits_for_others_may_be_told_to_stop(match: str, told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(time, "sleep", lambda seconds: (waits.append(seconds), terminate()))
    words = [*COMMAND_LINE, *given(match=match)]
    assert LockstepProgram(PLANE, (), lambda *_: NodeSpec(Stepping(), lingers=False))(words) == 0
    assert len(waits) == 1
    spec = NodeSpec(Stepping(), lingers=False, on_idle=lambda _: terminate())
    assert LockstepProgram(PLANE, (), lambda *_: spec)(COMMAND_LINE) == 0, "nor does it wait for messages then"


@pytest.mark.parametrize(("name", "policy"), [("fifo", os.SCHED_FIFO), ("rr", os.SCHED_RR)])
def test_all_threads_get_the_class_and_this_one_comes_first(
    name: str, policy: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[int, tuple[int, int]] = {}
    gone: list[int] = []

    def note(thread: int, its_policy: int, parameters: os.sched_param) -> None:
        if thread in gone:
            raise ProcessLookupError(3, "No such process")
        asked[thread] = (its_policy, parameters.sched_priority)

    monkeypatch.setattr(os, "sched_setscheduler", note)
    ending, begun = threading.Event(), threading.Event()
    others = [threading.Thread(target=lambda: (begun.set(), ending.wait(10.0))) for _ in range(2)]
    for other in others:
        other.start()
    assert begun.wait(10.0)
    ids = [other.native_id for other in others]
    gone += [ids[0] or 0]
    try:
        schedule_threads(name, 42)
    finally:
        ending.set()
        for other in others:
            other.join()
    assert asked[threading.get_native_id()] == (policy, 42)
    assert asked[ids[1] or 0] == (policy, 41)
    assert ids[0] not in asked


def test_what_is_refused_is_named_with_the_way_out_and_nothing_is_asked_for_unless_it_is_wanted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    def no_memory(_: int) -> int:
        ctypes.set_errno(12)
        return -1

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    schedule_threads("other", 50)
    with pytest.raises(InputError, match=r"parameter scheduling: .*fifo priority 42.*LimitRTPRIO=42.*'other'"):
        schedule_threads("fifo", 42)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: SimpleNamespace(mlockall=no_memory))
    with pytest.raises(InputError, match=r"parameter lock_memory: .*Cannot allocate memory.*LimitMEMLOCK=infinity"):
        lock_memory()


def test_locked_memory_is_locked() -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if os.geteuid() and hard != resource.RLIM_INFINITY:
        pytest.skip("this user may not lock memory: RLIMIT_MEMLOCK is limited")
    done = subprocess.run([sys.executable, "-c", LOCKS], capture_output=True, text=True, timeout=20, check=False)
    assert done.returncode == 0, done.stderr
    (locked,) = (int(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("VmLck:"))
    assert locked > 1000, "kB"


def test_a_request_that_fails_is_logged_and_the_next_one_is_served() -> None:
    served, ending, errors = threading.Event(), threading.Event(), list[str]()

    def spin_once() -> None:
        if not errors:
            raise ValueError("no such state")
        served.set()
        ending.wait(10.0)

    notes, context = SimpleNamespace(error=errors.append), SimpleNamespace(ok=lambda: True)
    executor = SimpleNamespace(spin_once=spin_once, create_task=lambda _: ending.set())
    server = Server(cast("Any", SimpleNamespace(notes=notes, context=context)), cast("Any", executor))
    server.start()
    assert served.wait(10.0)
    server.end()
    assert errors == ["a request failed: ValueError: no such state"]


@pytest.mark.usefixtures("ros")
def test_a_server_ends_although_nothing_more_happens() -> None:
    """An executor that is only woken waits on, and with it the end of each node for its next diagnostics."""
    rclpy.init()
    executor = SingleThreadedExecutor()
    waiting = threading.Event()
    server = Server(cast("Any", SimpleNamespace(context=SimpleNamespace(ok=lambda: waiting.set() or True))), executor)
    server.start()
    assert waiting.wait(10.0)
    server.end()
    executor.shutdown()


SUCCESS = TransitionCallbackReturn.SUCCESS
HUNG = "the drive hangs"
FORBIDDEN = 13.0


@dataclass(frozen=True, slots=True)
class Gains:
    gains: SwarmGains = part(SwarmGains)
    mass: float = setting(0.5, "mass", unit="kg")


class Loop:
    """What is asked of a loop, and what it raises."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.error: Exception | None = None

    def _ask(self, what: str) -> None:
        self.asked.append(what)
        if self.error is not None:
            raise self.error

    activate, deactivate = partialmethod(_ask, "activate"), partialmethod(_ask, "deactivate")

    def attach(self, engine: object) -> None:
        self._ask("take back" if engine is None else "attach")

    def command(self, work: object) -> None:
        self._ask("command")

    def call(self, work: Callable[[], object]) -> None:
        work()

    def health(self, _: float) -> Health:
        return Health(Level.OK, "fine", (("age", "3"),))


class Managed:
    def __init__(self, node: RealtimeNode) -> None:
        self.node, self.loop = node, Loop()
        self.sent: list[str] = []
        status = SimpleNamespace(send=lambda event, **_: self.sent.append(event))
        table = parameters_of(Gains)
        values = {parameter.name: parameter.default for parameter in table}
        gains = gains_among(table, ("gains",))
        declare_values(node, table, values, gains)
        self.tuning = Tuning(Settings(values), gains)
        spec = RealtimeSpec(cast("Any", None), 0.5, services={"~/stop": lambda _: ()}, tune=self._tune)
        parts: tuple[Any, ...] = (self.loop, None, status, self.tuning)
        node.prepare(lambda: spec, endpoints(PLANE, REALTIME, robots=4), Schedule(10_000_000), *parts)

    def _tune(self, settings: Settings) -> Callable[[], None]:
        ksd = settings.declared(Gains).gains.ksd
        if ksd == FORBIDDEN:
            raise InputError("the law cannot have it")
        return lambda: self.loop.asked.append(f"ksd {ksd}")

    def set(self, name: str, value: object) -> str:
        """Set a parameter, and return why that was refused, "" if it was not."""
        (result,) = self.node.set_parameters([RosParameter(name, value=value)])
        assert result.successful == (not result.reason)
        return str(result.reason)

    def entities(self) -> list[list[object]]:
        return [list(kind) for kind in (self.node.services, self.node.subscriptions, self.node.publishers)]

    def trigger(self, *names: str) -> list[TransitionCallbackReturn]:
        return [getattr(self.node, f"trigger_{name}")() for name in names]

    def stop(self) -> Any:
        (service,) = (service for service in self.node.services if service.srv_name.endswith("/stop"))
        return service.callback(Trigger.Request(), Trigger.Response())


@pytest.fixture
def managed(ros: None) -> Iterator[Managed]:
    rclpy.init()
    managed = Managed(RealtimeNode("probe"))
    yield managed
    managed.node.destroy_node()
    vars(managed).clear()  # the lifecycle of a node keeps it in the network until it is collected


def test_a_life_from_the_configuration_to_the_end(managed: Managed) -> None:
    node, before = managed.node, managed.entities()
    assert node.health() == Health(Level.WARN, "unconfigured: fine", (("state", "unconfigured"), ("age", "3")))
    assert f"/{DIAGNOSTICS.lstrip('/')}" in {publisher.topic_name for publisher in node.publishers}
    assert node.bring_up()
    assert node.health() == Health(Level.OK, "fine", (("state", "active"), ("age", "3")))
    assert [len(now) - len(then) for now, then in zip(managed.entities(), before, strict=True)] == [1, 1, 3]
    assert managed.stop().success
    managed.loop.error = RunError(HUNG)
    answer = managed.stop()
    assert (answer.success, answer.message) == (False, "probe: the drive hangs")
    managed.loop.error = None
    assert managed.trigger("deactivate") == [SUCCESS]
    assert node.health()[:2] == (Level.WARN, "inactive: fine")
    assert managed.trigger("cleanup") == [SUCCESS]
    assert managed.entities() == before
    node.end()
    node.end()
    assert node.state == "finalized"
    assert managed.loop.asked == ["attach", "activate", "command", "command", "deactivate", "take back", "take back"]
    assert managed.sent == ["ready", "timing"]


@pytest.mark.parametrize(
    ("going", "failing", "state", "told"),
    [
        ((), "configure", "unconfigured", ["attach", "take back"]),
        (("configure",), "activate", "inactive", ["activate"]),
        (("configure", "activate"), "deactivate", "finalized", ["deactivate", "take back"]),
        (("configure", "activate"), "shutdown", "finalized", ["take back", "take back"]),
    ],
)
def test_what_fails_is_told_and_leaves_a_state_that_is_known(
    managed: Managed, going: tuple[str, ...], failing: str, state: str, told: list[str]
) -> None:
    managed.trigger(*going)
    managed.loop.asked.clear()
    managed.loop.error = hung = RunError(HUNG)
    assert managed.trigger(failing) != [SUCCESS]
    assert (managed.node.state, managed.node.failure) == (state, hung)
    assert managed.loop.asked == told
    assert managed.node.health()[:2] == (Level.ERROR, f"{state} after an error: the drive hangs")
    managed.loop.error = None
    if state == "unconfigured":
        assert managed.node.bring_up() and managed.node.failure is None


def test_gains_are_set_until_the_node_is_active_and_used_from_its_activation_on(managed: Managed) -> None:
    assert not managed.set("gains.ksd", 2.0)
    managed.trigger("configure", "activate", "deactivate")
    assert managed.loop.asked == ["attach", "activate", "deactivate"], "it was made with what was set before"
    assert not managed.set("gains.k", [3.0, 4.0])
    assert not managed.set("gains.ksd", 5.0)
    assert not managed.set("use_sim_time", value=False), "it has nothing to do with the gains"
    managed.trigger("activate")
    assert managed.loop.asked[3:] == ["ksd 5.0", "activate"]
    refusal = managed.set("gains.ksd", 6.0)
    assert "parameter gains.ksd: probe is active" in refusal and "ros2 lifecycle set probe deactivate" in refusal
    managed.trigger("deactivate", "activate")
    assert managed.loop.asked[5:] == ["deactivate", "activate"], "the gains are the same"
    settings = managed.tuning.settings
    assert (settings.declared(Gains).gains.ksd, managed.node.get_parameter("gains.ksd").value) == (5.0, 5.0)


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("gains.ksd", -1.0, "ksd"),
        ("gains.ksd", FORBIDDEN, "the law cannot have it"),
        ("gains.ksd", None, "cannot be undeclared"),
        ("gains.k", [1.0], "is not allowed; give 2 elements"),
        ("mass", 0.7, "read-only"),
        ("use_sim_time", True, "parameter use_sim_time: no ROS clock"),
    ],
)
def test_what_cannot_be_set_is_refused_with_its_reason_and_nothing_changes(
    name: str, value: object, why: str, managed: Managed
) -> None:
    managed.trigger("configure")
    before = managed.node.get_parameter(name).value, managed.tuning.settings
    assert why in managed.set(name, value)
    assert before == (managed.node.get_parameter(name).value, managed.tuning.settings)
    managed.trigger("activate")
    assert managed.loop.asked == ["attach", "activate"]


def test_health_becomes_one_status_and_an_error_one_line() -> None:
    assert one_line(RunError("a\n b")) == "a b"
    assert one_line(ValueError("a\n b")) == "ValueError: a b"
    health = Health(Level.WARN, "keeps still", (("age", "3"), ("refused", "0")))
    array = diagnostic_array("agent_007", health, 12_000_000_034)
    (status,) = array.status
    assert (array.header.stamp.sec, array.header.stamp.nanosec) == (12, 34)
    assert (status.level, status.message) == (status.WARN, "keeps still")
    assert (status.name, status.hardware_id) == ("agent_007: realtime", "agent_007")
    assert [(value.key, value.value) for value in status.values] == list(health.values)


@pytest.fixture
def pipes(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, int]]:
    """Pipes as an orchestrator makes them; a test may close the orchestrator's ends."""
    report_read, report_write = os.pipe()
    start_read, start_write = os.pipe()
    monkeypatch.setenv(REPORT_FD, str(report_write))
    monkeypatch.setenv(START_FD, str(start_read))
    ends = {"reports": report_read, "start": start_write}
    yield ends
    for descriptor in (report_write, start_read, *ends.values()):
        os.close(descriptor)


def test_reports_are_lines_of_json(pipes: dict[str, int]) -> None:
    channel = StatusChannel("agent_007")
    channel.send("ready")
    channel.send("stalled", step=3, missing=("plane_sim", "ä\n"), silence=5.1)
    lines = os.read(pipes["reports"], 65536).decode().splitlines()
    me = {"node": "agent_007", "pid": os.getpid()}
    assert [json.loads(line) for line in lines] == [
        me | {"event": "ready"},
        me | {"event": "stalled", "step": 3, "missing": ["plane_sim", "ä\n"], "silence": 5.1},
    ]


def test_the_start_signal_is_the_end_of_the_other_pipe_and_an_orchestrator_that_has_gone_no_error(
    pipes: dict[str, int],
) -> None:
    channel = StatusChannel("plane_sim")
    assert not channel.wait_for_start(0.0)
    os.close(pipes.pop("start"))
    assert channel.wait_for_start(0.0)
    assert channel.wait_for_start(0.0)
    os.close(pipes.pop("reports"))
    channel.send("ready")
    channel.send("ready")


def test_every_process_finds_the_epoch_in_the_pipe_of_all(pipes: dict[str, int]) -> None:
    epoch = 2**63 - 1
    channels = [StatusChannel(name) for name in ("plane_sim", "recorder", "agent_001")]
    os.write(pipes["start"], epoch_records(epoch, len(channels)))
    os.close(pipes.pop("start"))
    assert [channel.wait_for_epoch() for channel in channels] == [epoch] * 3
    with pytest.raises(RunError, match="ended before the start"):
        StatusChannel("one too many").wait_for_epoch()


def test_a_node_started_by_hand_reports_nowhere_begins_at_once_and_is_told_no_epoch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(REPORT_FD, raising=False)
    monkeypatch.delenv(START_FD, raising=False)
    channel = StatusChannel("plane_sim")
    channel.send("ready")
    assert channel.wait_for_start(0.0)
    with pytest.raises(InputError, match="parameter await_epoch: no orchestrator started this node"):
        channel.wait_for_epoch()


@pytest.mark.parametrize("abstract", [False, True])
def test_systemd_is_told_where_it_listens(abstract: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: FBT001
    name = f"@{tmp_path}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(name.replace("@", "\0"))
        monkeypatch.setenv("NOTIFY_SOCKET", name)
        notify("READY=1")
        assert systemd.recv(100) == b"READY=1"
    for elsewhere in ("", "relative", "/nowhere/notify"):
        monkeypatch.setenv("NOTIFY_SOCKET", elsewhere)
        notify("READY=1")


@pytest.mark.parametrize(
    ("variables", "beats"),
    [
        ({"WATCHDOG_USEC": "2000", "WATCHDOG_PID": str(os.getpid())}, [5, 1_000_005, 2_500_000]),
        ({"WATCHDOG_USEC": "2000"}, [5, 1_000_005, 2_500_000]),
        ({"WATCHDOG_USEC": "2000", "WATCHDOG_PID": "1"}, []),
        ({"WATCHDOG_USEC": "soon"}, []),
        ({}, []),
    ],
)
def test_a_heart_beats_twice_in_the_time_that_systemd_gives_it(
    variables: dict[str, str], beats: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[int, str]] = []
    for name in ("WATCHDOG_USEC", "WATCHDOG_PID"):
        monkeypatch.delenv(name, raising=False)
    for name, text in variables.items():
        monkeypatch.setenv(name, text)
    heartbeat = Heartbeat()
    for now in (5, 6, 1_000_004, 1_000_005, 2_000_000, 2_500_000):
        monkeypatch.setattr(status, "notify", lambda text, now=now: told.append((now, text)))
        heartbeat.beat(now)
    assert told == [(now, "WATCHDOG=1") for now in beats]

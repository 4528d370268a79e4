"""An operator: how nodes are and what is asked of them, first of nodes of the test, then of a fleet of real nodes."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from functools import partial
from itertools import product
from math import inf
from pathlib import Path
from threading import Thread
from typing import Any, cast

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future
from std_srvs.srv import Trigger
from tests.processes import ROOT, until
from tests.swarmabs_fleet.bundle_processes import ended, installed, running
from tests.swarmabs_fleet.fleets import ONE_HOST, edited

from swarmabs_bag.reader import open_bag
from swarmabs_bag.run.realtime_gatherer import recorded as recorded_topics
from swarmabs_cli import main
from swarmabs_cli.fleet import operate as operate_commands
from swarmabs_config.fleet.loader import load_fleet
from swarmabs_config.graph import SILENCE
from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import AGENT_STATE, REMOVALS, AgentState, EventKind, Kind, Removal, Status
from swarmabs_core.realtime.base import Schedule
from swarmabs_fleet.operate import (
    SILENT,
    HealthMonitor,
    Row,
    StopMonitor,
    Target,
    _Call,
    in_order,
    joined,
    target,
)
from swarmabs_ros.endpoints import ros_type
from swarmabs_run.orchestration.network import claimed_domain
from swarmabs_run.orchestration.run_files import write_epoch, write_network

PATIENCE = 60.0
THIRD = "  - {id: 3, host: base, kind: single_integrator, mass: 0.3, drive: {type: simulated, position: -0.2}}\n"
COORDINATORS = ("plane_sim", "abstraction_observer", "parent_controller", "recorder")
HOSTS = {"plane_sim": "base", "agent_001": "cart-1", "agent_002": "cart-2"}


def test_nodes_are_shown_in_their_order_and_strangers_behind_them() -> None:
    monitor = HealthMonitor(HOSTS)
    for node in ("agent_009", "agent_002", "plane_sim"):
        assert not monitor.complete()
        monitor.hear(node, 0, "fine", {"x": "1"}, 10.0)
    rows = monitor.rows(10.5)
    assert rows == [
        Row("plane_sim", "base", "OK", "fine", {"x": "1"}),
        Row("agent_001", "cart-1", SILENT, "no diagnostics received", {}),
        Row("agent_002", "cart-2", "OK", "fine", {"x": "1"}),
        Row("agent_009", "unknown", "OK", "fine", {"x": "1"}),
    ]
    assert not in_order(rows)
    values = [monitor.value(*words) for words in (("plane_sim", "x"), ("plane_sim", "y"), ("agent_001", "x"))]
    assert values == ["1", "", ""]
    monitor.hear("agent_001", 1, "", {}, 10.0)
    assert monitor.complete() and in_order(monitor.rows(10.5))


def test_a_node_that_falls_silent_is_no_longer_believed_nor_in_order_with_an_error_or_an_unknown_level() -> None:
    monitor = HealthMonitor({"agent_001": "cart-1"})
    monitor.hear("agent_001", 0, "follows the broadcasts", {}, 10.0)
    assert in_order(monitor.rows(10.0 + SILENCE))
    (row,) = monitor.rows(10.1 + SILENCE)
    assert (row.level, row.text) == (SILENT, "no diagnostics for 3 s; last: follows the broadcasts")
    monitor.hear("agent_001", 0, "follows the broadcasts", {}, 14.0)
    levels = {}
    for level in (0, 1, 2, 3, 77):
        monitor.hear("agent_001", level, "", {}, 14.0)
        (row,) = rows = monitor.rows(14.0)
        levels[row.level] = in_order(rows)
    assert levels == {"OK": True, "WARN": True, "ERROR": False, "STALE": False}


def test_a_fleet_is_spoken_to_as_its_installed_bundle_says(tmp_path: Path) -> None:
    file = edited(tmp_path / "one.yaml", ONE_HOST, ("scenario:", "namespace: /hall\nscenario:"))
    with target(file) as operated:
        assert (operated.name, operated.namespace, operated.robots, operated.run) == ("one", "/hall", (1, 2), None)
        assert dict(operated.hosts) == dict.fromkeys((*COORDINATORS, "agent_001", "agent_002"), "base")
        assert operated.environment["ROS_DOMAIN_ID"] == "7"
        assert operated.schedule == Schedule(10_000_000, 1_767_225_600 * 10**9)
        profile = Path(operated.environment["FASTRTPS_DEFAULT_PROFILES_FILE"])
        assert "127.0.0.1" in profile.read_text(encoding="utf-8")
        assert operated.robot(2) == "agent_002"
        with pytest.raises(InputError, match="one has no robot 9; it has 1, 2"):
            operated.robot(9)
    assert not profile.parent.exists()


def test_a_run_is_spoken_to_by_its_folder_if_it_is_in_real_time(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    shutil.copyfile(ROOT / "src/swarmabs_bringup/scenarios/pd_het_4.yaml", tmp_path / "scenario.yaml")
    write_network(logs, 7, 5, realtime=True)
    with target(tmp_path) as operated:
        assert (operated.name, operated.namespace, operated.robots, operated.run) == (
            "pd_het_4",
            "/",
            (1, 2, 3, 4),
            tmp_path,
        )
        robots = [f"agent_00{number}" for number in range(1, 5)]
        assert dict(operated.hosts) == dict.fromkeys((*COORDINATORS, *robots), "this one")
        assert operated.schedule is None
        operated.check()
    write_epoch(logs, 5)
    with target(tmp_path) as operated:
        assert operated.schedule == Schedule(10_000_000, 5)
    write_network(logs, 7, 5, realtime=False)
    with pytest.raises(InputError, match="operator commands need a realtime run"), target(tmp_path):
        pass


def test_a_robot_has_stopped_if_it_says_so_after_the_controller_has_confirmed_and_still_says_so() -> None:
    monitor = StopMonitor((1, 2, 3))
    for robot in monitor.robots:
        monitor.hear(robot, Status.SAFE_STOP, 9.0)
    assert monitor.heard() == 3
    monitor.ask(10.0)
    assert monitor.heard() == 0
    assert monitor.problems() == dict.fromkeys(monitor.robots, "not heard"), "what they were before does not count"
    monitor.hear(1, Status.ACTIVE, 10.01)
    monitor.hear(1, Status.SAFE_STOP, 10.02)
    monitor.hear(2, Status.SAFE_STOP, 10.02)
    monitor.hear(9, Status.SAFE_STOP, 10.02)
    monitor.confirm(10.025)
    assert monitor.problems() == dict.fromkeys(monitor.robots, "not heard"), "they may have missed the stop"
    monitor.hear(1, Status.SAFE_STOP, 10.025)
    assert monitor.problem(1) == "not heard", "what arrives with the confirmation was sent before"
    for robot, status in ((1, Status.SAFE_STOP), (2, Status.ACTIVE), (3, Status.LEFT)):
        monitor.hear(robot, status, 10.03)
    assert monitor.problems() == {2: "not stopped"}
    assert [monitor.delay(robot) for robot in (1, 3)] == pytest.approx([0.02, 0.03])
    monitor.hear(2, Status.SAFE_STOP, 10.04)
    assert not monitor.problems()
    assert monitor.delay(2) == pytest.approx(0.04), "it had not stopped before"


class Peer:
    """A robot's node in a thread of this process: it answers, says how it is, and hears what operators announce."""

    def __init__(self, stack: ExitStack) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        stack.callback(self.context.try_shutdown)
        self.heard: list[bytes] = []
        self._mute = rclpy.create_node("mute", namespace="/hall", context=self.context)  # nobody spins it
        self._mute.create_service(Trigger, "mute/leave", self._answer)
        self._node = rclpy.create_node("agent_001", namespace="/hall", context=self.context)
        for name in ("leave", "join"):
            self._node.create_service(Trigger, f"agent_001/{name}", partial(self._answer, name))
        self._node.create_subscription(ros_type(REMOVALS), REMOVALS.name, self.heard.append, 10, raw=True)
        self._node.create_service(Trigger, "swarm/stop", self._stop)
        self.state = AgentState(0, 0, 0, 1, Kind.SINGLE_INTEGRATOR, Status.ACTIVE, 1.0, 0.0, 0.0, 0.0, 0.0)
        self._states = self._node.create_publisher(ros_type(AGENT_STATE), AGENT_STATE.name, 10)
        self._diagnostics = self._node.create_publisher(DiagnosticArray, "diagnostics", 10)
        self._node.create_timer(0.05, self._say)
        executor = SingleThreadedExecutor(context=self.context)
        executor.add_node(self._node)
        thread = Thread(target=executor.spin)
        thread.start()
        stack.callback(thread.join)
        stack.callback(executor.shutdown)

    @staticmethod
    def _answer(name: str, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        answer.success, answer.message = name == "leave", f"{name} is asked for"
        return answer

    def _stop(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        self.state = self.state._replace(status=Status.SAFE_STOP)
        answer.success = True
        return answer

    def _say(self) -> None:
        self._states.publish(encode(self.state))
        status = DiagnosticStatus(level=bytes([1]), hardware_id="agent_001", message="stands")
        status.values = [KeyValue(key="left", value="3 4")]
        self._diagnostics.publish(DiagnosticArray(status=[status]))


class ForgetfulClient:
    """A client of a service whose first answers are lost."""

    srv_name = "/hall/swarm/stop"

    def __init__(self, lost: int) -> None:
        self.lost = lost
        self.calls = 0

    def service_is_ready(self) -> bool:
        return True

    def call_async(self, _: Trigger.Request) -> Future:
        self.calls += 1
        future = Future()
        if self.calls > self.lost:
            future.set_result(Trigger.Response(success=True))
        return future


@pytest.mark.parametrize(("interval", "calls", "problem"), [(1.0, 3, ""), (inf, 1, "did not answer within 5 s")])
def test_a_call_that_may_be_repeated_survives_answers_that_are_lost(interval: float, calls: int, problem: str) -> None:
    client = ForgetfulClient(lost=2)
    call = _Call(cast("Any", client), 5.0, 100.0, interval)
    now = 98.0
    while call.waits(now):
        call.advance(now)
        now += 0.25
    assert (client.calls, now) == (calls, 100.25 if calls == 3 else 103.0)
    assert problem in call.problem() and bool(problem) == bool(call.problem())


MIXED = {"agent_001/leave": "", "agent_009/leave": "was not found", "agent_001/join": "join is asked for"}


@pytest.mark.usefixtures("ros")
def test_an_operator_calls_announces_and_hears(tmp_path: Path) -> None:
    before = time.time_ns()
    swarm = Target("one", "/hall", {"agent_001": "cart-1"}, (1,), {}, schedule=Schedule(10_000_000, before))
    monitor = HealthMonitor(swarm.hosts)
    with ExitStack() as stack:
        peer = Peer(stack)
        client = stack.enter_context(joined(swarm))
        client.call("agent_001/leave", PATIENCE)
        with pytest.raises(RunError, match="one: agent_001/join: join is asked for"):
            client.call("agent_001/join", PATIENCE)
        with pytest.raises(RunError, match=r"one: mute/leave did not answer within 0\.5 s"):
            client.call("mute/leave", 0.5)
        with pytest.raises(RunError, match="one: agent_009/leave was not found; check that its node is running"):
            client.call("agent_009/leave", 0.1)
        problems = client.call_each(("agent_001/leave", "agent_009/leave", "agent_001/join"), PATIENCE)
        assert [words in problems.pop(name) for name, words in MIXED.items()] == [True] * 3 and not problems
        with client.carried_away(7, PATIENCE):
            until(lambda: peer.heard, "the event is heard", PATIENCE)
        removal = decode(Removal, peer.heard[0])
        assert (removal.agent_id, removal.kind, removal.detail) == (7, EventKind.LEFT, "carried away")
        assert removal.step == (removal.stamp - before) // 10_000_000
        client.listen(monitor, PATIENCE, monitor.complete)
        assert monitor.rows(time.monotonic()) == [Row("agent_001", "cart-1", "WARN", "stands", {"left": "3 4"})]
        client.listen(HealthMonitor({}), 0.0, lambda: False)
    (tmp_path / "logs").mkdir()
    reused = {"domain": 7, "realtime": True, "orchestrator": os.getpid(), "started": 0}  # the id is of another process
    (tmp_path / "logs" / "network.json").write_text(json.dumps(reused))
    over = replace(swarm, run=tmp_path)
    with joined(over) as client, pytest.raises(RunError, match="the run has ended; start it again"):
        client.listen(monitor, PATIENCE, lambda: False)
    starting = pytest.raises(RunError, match="one: the run is still starting; try again in a moment")
    with joined(replace(swarm, schedule=None)) as client, starting, client.carried_away(7, 0.0):
        pass
    unheard = pytest.raises(RunError, match="one: no node receives /elsewhere/swarm/removals")
    with joined(replace(swarm, namespace="/elsewhere")) as client, unheard, client.carried_away(7, 0.0):
        pass


@pytest.mark.usefixtures("ros")
def test_a_stop_reports_who_has_stopped_and_fails_if_a_robot_is_not_known_to(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    swarm = Target("one", "/hall", {"parent_controller": "base"}, (1,), {})
    with ExitStack() as stack:
        peer = Peer(stack)
        found = [swarm]
        monkeypatch.setattr(operate_commands, "target", lambda _: nullcontext(found[0]))
        key, pressed = os.pipe()
        stack.callback(os.close, key)
        with os.fdopen(key, closefd=False) as keyboard:
            monkeypatch.setattr(sys, "stdin", keyboard)
            os.write(pressed, b"x")
            os.close(pressed)
            assert main(["stop", str(ROOT), "--armed", "--timeout", f"{PATIENCE}"]) == 0
            armed, stopped, summary = capsys.readouterr().out.splitlines()
            assert armed == "one: armed, 1 of 1 robots heard; press a key to stop them"
            assert re.fullmatch(r"robot 1: stopped after \d+ ms", stopped)
            assert summary == "one: all robots have stopped, until a reset"
            peer.state = peer.state._replace(status=Status.ACTIVE)
            assert main(["stop", str(ROOT), "--armed", "--timeout", f"{PATIENCE}"]) == 1
            assert "standard input has ended" in capsys.readouterr().err
            assert peer.state.status is Status.ACTIVE
        found[0] = replace(swarm, robots=(1, 2))
        assert main(["stop", str(ROOT), "--timeout", "5", "--json"]) == 1
        printed = capsys.readouterr()
        assert "one: 1 of 2 robots are not known to have stopped: 2; check them" in printed.err
        document = json.loads(printed.out)
        first, second = document.pop("robots")
        assert document == {"swarm": "one", "all_stopped": False}
        assert (first["robot"], first["problem"]) == (1, None) and first["stopped_after"] >= 0.0
        assert second == {"robot": 2, "stopped_after": None, "problem": "not heard"}


def test_what_is_no_swarm_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.yaml").write_text("schema: 1\nname: x\n")
    for command, path in product(("status", "stop", "reset"), (tmp_path, tmp_path / "x.yaml", tmp_path / "nowhere")):
        assert main([command, str(path)]) == 2
        assert capsys.readouterr().err.startswith("error: ")


MODULE = ("-m", "swarmabs_cli")
_AS_SECURED = """
import sys
from swarmabs_cli import main
from swarmabs_config.fleet.model import Fleet
Fleet.own_topics = True
sys.exit(main())
"""
"""The command line, which takes every fleet for one with robots' own topics."""


def operate(*arguments: object, program: tuple[str, str] = MODULE) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *program, *map(str, arguments)]
    return subprocess.run(command, env=os.environ, capture_output=True, text=True, timeout=120, check=False)


def status(fleet: Path) -> dict[str, Any]:
    return {row["node"]: row for row in json.loads(operate("status", fleet, "--json").stdout)["nodes"]}


def until_all_say(fleet: Path, words: str, *nodes: str) -> None:
    def said() -> bool:
        heard = status(fleet)
        return all(words in f"{heard[node]['level']}: {heard[node]['text']}" for node in nodes)

    until(said, f"{', '.join(nodes)} say {words!r}", PATIENCE)


OWN_TOPICS = (("level: none", "level: sros2"), ("installation: {", "installation: {ros: sourced, "))


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.parametrize("level", [OWN_TOPICS, pytest.param((), marks=pytest.mark.full)], ids=["own topics", "shared"])
def test_an_operator_starts_stops_and_thins_out_a_fleet(
    level: tuple[tuple[str, str], ...], tmp_path: Path, nothing_survives: str
) -> None:
    """With own topics the fleet is that of sros2; nodes and operator do without the security itself."""
    with claimed_domain() as domain:
        changes = (("domain: 7", f"domain: {domain}"), ("/etc/swarmabs", f"{tmp_path}/etc"))
        file = edited(tmp_path / "one.yaml", ONE_HOST, *changes, ("coordinators:", f"{THIRD}coordinators:"))
        bundle = installed(load_fleet(edited(tmp_path / "nodes.yaml", file.read_text(), *level)), tmp_path)
        robots = ("agent_001", "agent_002", "agent_003")
        with running(bundle, tmp_path) as units:
            for unit in units.values():
                assert unit.said(b"READY=1"), unit.complaint()
            # A fleet begins stopped.
            until_all_say(file, "stop commanded", *robots)
            assert operate("status", file).returncode == 0, "an operator wants it so"
            assert operate("reset", file).returncode == 0
            until_all_say(file, "follows", *robots)
            until_all_say(file, "3 of 3 robots follow", "abstraction_observer")
            until_all_say(file, "OK: recording", "recorder")
            until(lambda: operate("status", file).returncode == 0, "all is in order", PATIENCE)
            assert operate("drain", file, 3).returncode == 0
            until_all_say(file, "has left", "agent_003")
            until_all_say(file, "follows", *robots[:2])
            assert operate("join", file, 3).returncode == 0
            until_all_say(file, "follows", *robots)
            alive = operate("remove", file, 3)
            assert alive.returncode == 1
            assert "only a silent robot can be removed; use drain" in alive.stderr
            units["agent_003"].process.kill()
            until_all_say(file, "2 of 3 robots follow", "abstraction_observer")
            assert status(file)["abstraction_observer"]["values"]["left"] == ""
            removed = operate("remove", file, 3)
            assert (removed.returncode, removed.stderr) == (0, "")
            assert status(file)["abstraction_observer"]["values"]["left"].split() == ["3"]
            del units["agent_003"]
            stopped = operate("stop", file, program=("-c", _AS_SECURED) if level else MODULE)
            assert stopped.returncode == 1
            assert "1 of 3 robots are not known to have stopped: 3;" in stopped.stderr, "it was killed"
            for robot, words in enumerate((r"stopped after \d+ ms", r"stopped after \d+ ms", "not heard"), 1):
                assert re.search(f"^robot {robot}: {words}$", stopped.stdout, re.MULTILINE)
            until_all_say(file, "stop commanded", *robots[:2])
            assert ended(units) == [0] * 6
        gone = operate("stop", file, "--timeout", "1")
        assert gone.returncode == 1
        assert "swarm/stop was not found" in gone.stderr
        assert "Traceback" not in gone.stderr
    (bag,) = (path.parent for path in tmp_path.glob("one-*/*.mcap"))
    recorded = list(open_bag(bag).decoded())
    assert {topic for topic, _, _ in recorded} == {*recorded_topics(paired=False)}
    heard = {message.agent_id for topic, _, message in recorded if topic is AGENT_STATE}
    assert (heard, [message.agent_id for topic, _, message in recorded if topic is REMOVALS]) == ({1, 2, 3}, [3, 3])

"""Steering from outside: what a run answers over its socket, what it tells of it, and how fast it may go."""

import json
import socket
import stat
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import pytest
from tests.processes import until
from tests.swarmabs_ros.nodes import settings_from
from tests.transport.network import Reports

from swarmabs_config import configure
from swarmabs_config.scenario import dump_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import PLANE_STATE, Messages, PlaneState, Steering
from swarmabs_run.steering import node, server
from swarmabs_run.steering.client import SOCKET, SteeringClient, short_path
from swarmabs_run.steering.server import LONGEST, SteeringServer

ResultT = TypeVar("ResultT")
LAST = 6000
PERIOD_NS = 10_000_000


class SteeredRun:
    """The node that steers a run, and a plane that makes its steps."""

    def __init__(self, folder: Path, **values: float) -> None:
        scenario = find_scenario("pd_het_4", ["duration=60", "faults=[{kind: join, at: null, agent: 4}]"]).resolved()
        (folder / "scenario.yaml").write_text(dump_scenario(scenario), encoding="utf-8")
        places = {"scenario_file": str(folder / "scenario.yaml"), "folder": str(folder)}
        self.reports = Reports()
        self.spec = node.make(settings_from(node.PARAMETERS, **places, **values), cast("Any", self.reports))
        self.folder = folder
        self.step = 0
        self.orders: list[Steering] = []

    def make_step(self) -> None:
        self._publish(self.spec.behaviour.handle(PlaneState(self.step * PERIOD_NS, self.step, 0.1, 0.0)))

    def be_idle(self) -> None:
        assert self.spec.on_idle is not None
        self._publish(self.spec.on_idle(0.0) or ())

    def _publish(self, messages: Messages) -> None:
        """Publish orders; the plane answers the order of a step by its state of this step."""
        orders = [message for message in messages if isinstance(message, Steering)]
        self.orders += orders
        self.step = min(orders[-1].step, LAST) if orders else self.step

    def during(self, call: Callable[[], ResultT]) -> ResultT:
        """Go on with the run while something else is done in another thread, and return what came of it."""
        with ThreadPoolExecutor(1) as pool:
            result = pool.submit(call)
            while wait([result], timeout=0.001).not_done:
                self.be_idle()
                self.make_step()
        return result.result()

    def ask(self, request: Mapping[str, object]) -> dict[str, Any]:
        with SteeringClient(self.folder) as client:
            return self.during(lambda: client.ask(request))

    def answer(self, line: bytes) -> bytes:
        """Return all that is answered to bytes until the connection ends."""
        with socket.socket(socket.AF_UNIX) as wire:
            wire.connect(str(self.folder / SOCKET))
            wire.sendall(line)
            wire.shutdown(socket.SHUT_WR)
            return self.during(wire.makefile("rb").read)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SteeredRun]:
    servers: list[SteeringServer] = []

    class Noted(SteeringServer):
        def serve_forever(self, poll_interval: float = 0.005) -> None:
            super().serve_forever(poll_interval)

        def start(self) -> None:
            servers.append(self)
            super().start()

    monkeypatch.setattr(node, "SteeringServer", Noted)
    yield SteeredRun(tmp_path)
    for running in servers:
        running.shutdown()
        running.server_close()


@pytest.mark.parametrize(
    ("request_", "text", "change"),
    [
        ({"action": "reference", "value": 0.05}, "reference 0.05", None),
        ({"action": "reference", "value": -0.0}, "reference 0", None),
        ({"action": "disturbance", "value": -0.1}, "disturbance -0.1", None),
        ({"action": "kill", "agent": 3}, "kill 3", "kill 3"),
        ({"action": "remove", "agent": 3}, "remove 3", "remove 3"),
        ({"action": "leave", "agent": 3}, "remove 3", "remove 3"),
        ({"action": "add", "agent": 4}, "add 4", None),
    ],
)
def test_granted_is_ordered(run: SteeredRun, request_: dict[str, object], text: str, change: str | None) -> None:
    answer = run.ask(request_)
    step = answer["step"]
    assert answer == {"ok": True, "request": 1, "step": step, "time": pytest.approx(step / 100)}
    (order,) = (order for order in run.orders if order.action)
    assert (order.step, order.agent_id, order.value) == (step, request_.get("agent", 0), request_.get("value", 0.0))
    told = {"text": f"{text} from step {step} on", "change": f"{change} {step - 1}" if change else ""}
    assert run.reports.said == [("steered", told)]


def test_the_status_says_how_it_is(run: SteeredRun) -> None:
    asked = [run.ask({"action": name, "value": value}) for name, value in (("reference", 0.2), ("disturbance", 0.3))]
    assert asked[0]["step"] < asked[1]["step"]
    status = run.ask({"action": "status"})
    assert asked[1]["step"] <= status["step"] <= run.step
    assert status.pop("time") == pytest.approx(status.pop("step") / 100)
    bounds = {"largest_reference": configure.LARGEST_OFFSET, "largest_disturbance": 5.0}
    now = {"ok": True, "reference": 0.2, "disturbance": 0.3, "members": [1, 2, 3], "absent": [4]}
    assert status.pop("paused") is False
    facts = {"steps": LAST, "step_time": 0.01, "push_time": 0.2, "restarts": False}
    assert status == {**now, **facts, **bounds}


def test_a_paused_run_takes_no_step_until_it_is_resumed_or_asked(run: SteeredRun) -> None:
    """Each request is answered at once, although the run stands still."""
    paused = run.ask({"action": "pause"})
    assert paused == {"ok": True, "step": paused["step"], "time": pytest.approx(paused["step"] / 100)}
    status = run.ask({"action": "status"})
    assert (status["paused"], status["step"]) == (True, paused["step"])
    pushed = run.ask({"action": "push", "value": -0.5})
    assert pushed["step"] == paused["step"] + 1
    assert run.ask({"action": "resume"})["step"] == pushed["step"]
    while run.step < pushed["step"] + 30:
        run.make_step()
    orders = [(order.step, order.value) for order in run.orders if order.action]
    assert orders == [(pushed["step"], -0.5), (pushed["step"] + 20, 0.0)]
    text = f"push -0.5 in the steps {pushed['step']} to {pushed['step'] + 19}"
    assert run.reports.said == [
        ("paused", {"paused": True, "step": paused["step"]}),
        ("steered", {"text": text, "change": ""}),
        ("paused", {"paused": False, "step": pushed["step"]}),
    ]


def test_only_a_run_that_may_start_again_does(tmp_path: Path, run: SteeredRun) -> None:
    assert "only a run that was started by 'swarm demo'" in run.ask({"action": "restart"})["reason"]
    assert run.reports.said == []
    (tmp_path / "again").mkdir()
    other = SteeredRun(tmp_path / "again", restarts=True)
    assert other.ask({"action": "restart_beside"})["ok"]
    assert other.reports.said == [("restart", {"action": "restart_beside"})]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b'{"action": "kill", "agent": 9}', "there is no robot 9; the robots are 1, 2, 3, 4"),
        (b'{"action": "kill"}', "kill needs 'agent'"),
        (b'{"action": "reference", "value": 0.1, "agent": 1}', "reference takes no 'agent'"),
        (b'{"action": "reference", "value": NaN}', "value: Input should be a finite number"),
        (b'{"action": "reference", "value": 1.2}', "1.2 rad is out of range"),
        (b'{"action": "disturbance", "value": 5.1}', "5.1 N m is out of range"),
        (b'{"action": "explode"}', "action: Input should be 'reference'"),
        (b'{"action": "add", "agent": 2}', "robot 2 takes part already"),
        (b'{"action": "status", "request": ""}', "request: String should have at least 1 character"),
        (b'{"action": "status", "shell": "true"}', "shell: Extra inputs are not permitted"),
        (b"", "Invalid JSON"),
        (b'{"action": "status"}' + b" " * (LONGEST - 22) + b"x", "Invalid JSON"),
        (b"{" * LONGEST, f"the line is longer than {LONGEST} bytes"),
    ],
)
def test_what_is_refused_changes_nothing(run: SteeredRun, line: bytes, reason: str) -> None:
    told = [json.loads(answer) for answer in run.answer(line + b'\n{"action": "status"}\n').splitlines()]
    assert told[0]["ok"] is False and reason in told[0]["reason"]
    # After a line that is too long nobody knows where the next one begins.
    assert [answer["ok"] for answer in told[1:]] == [True] * (len(line) < LONGEST)
    assert not any(order.action for order in run.orders)
    assert run.reports.said == []


def test_a_request_that_is_repeated_is_done_once(run: SteeredRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "MOST_NAMED", 2)
    request = {"action": "disturbance", "value": 0.1, "request": "a"}
    first = run.ask(request)
    assert run.ask(request) == first
    assert "'a' already names a different request" in run.ask({**request, "value": 0.2})["reason"]
    assert len(run.reports.said) == 1
    for name in ("b", "c"):  # more names than are remembered
        assert run.ask({**request, "request": name})["ok"]
    assert run.ask(request)["step"] > first["step"]


def test_who_asks_in_the_end_is_told_that_the_run_is_over(run: SteeredRun) -> None:
    while run.step < LAST:
        run.make_step()
    for _ in ("waits for the next step", "comes after the last"):
        assert run.ask({"action": "kill", "agent": 1}) == {"ok": False, "reason": "the run is over"}
    assert run.reports.said == []


def test_the_socket_is_its_users_alone_and_holds_so_many_connections(run: SteeredRun) -> None:
    assert stat.S_IMODE((run.folder / SOCKET).stat().st_mode) == 0o600
    with ExitStack() as stack:
        for _ in range(server.MOST_CONNECTIONS):
            client = stack.enter_context(SteeringClient(run.folder))
            assert run.during(partial(client.ask, {"action": "status"}))["ok"]
        with pytest.raises(RunError, match="the run has ended before it answered"):
            run.ask({"action": "status"})

    def answered() -> bool:
        with suppress(RunError):
            return bool(run.ask({"action": "status"})["ok"])
        return False

    until(answered, "those who have left make room")


def test_a_folder_that_cannot_hold_a_socket_is_named(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"the folder cannot hold the steering socket; choose another"):
        SteeringServer(tmp_path / "nowhere", cast("Any", None))
    with pytest.raises(InputError, match="parameters scenario_file and folder: give the resolved scenario"):
        node.make(settings_from(node.PARAMETERS, folder=str(tmp_path)), cast("Any", None))
    with pytest.raises(InputError, match=r"not the folder of a running simulation .* start one with run --steer"):
        SteeringClient(tmp_path)


@pytest.mark.parametrize(
    ("answers", "problem"),
    [(None, "the run does not answer"), (b"", "the run has ended before it answered"), (b'{"ok', "ended before")],
)
def test_a_run_that_does_not_answer(tmp_path: Path, answers: bytes | None, problem: str) -> None:
    folder = tmp_path / ("long" * 30)  # longer than the path of a socket may be
    folder.mkdir()
    with short_path(folder) as place, socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(place / SOCKET))
        listener.listen()
        with SteeringClient(folder, timeout=0.05) as client:
            wire, _ = listener.accept()
            with wire:
                if answers is not None:
                    wire.sendall(answers)
                    wire.shutdown(socket.SHUT_RDWR)
                with pytest.raises(RunError, match=problem):
                    client.ask({"action": "status"})


def test_a_step_takes_so_long_at_least_and_a_late_run_catches_up_a_little(run: SteeredRun, tmp_path: Path) -> None:
    clock, slept = [100.0], []

    def sleep(seconds: float) -> None:
        slept.append(round(seconds, 6))
        clock[0] += seconds

    assert run.spec.hear is None
    controller = cast("Any", run.spec.behaviour)
    pace = node.Pace(controller, 0.5, lambda: clock[0], sleep)
    for late in (0.0, 0.2, 0.0, 3.0, 0.0):
        clock[0] += late
        (order,) = pace.hear(PLANE_STATE, encode(PlaneState(0, controller.step, 0.1, 0.0)))
        assert isinstance(order, Steering) and order.step == controller.step
    assert slept == [0.5, 0.3, 0.5, 0.0, 0.3]  # of the 2.5 s by which it was late, 0.2 s
    pace.hear(PLANE_STATE, encode(PlaneState(0, 0, 0.1, 0.0)))  # an old one
    assert len(slept) == 5
    controller.pause(paused=True)
    state = encode(PlaneState(0, controller.step, 0.1, 0.0))
    assert pace.hear(PLANE_STATE, state) == ()
    controller.pause(paused=False)
    (order,) = controller.release()
    clock[0] += 9.0
    pace.hear(PLANE_STATE, encode(PlaneState(0, order.step, 0.1, 0.0)))
    assert slept[5:] == [0.5]
    (tmp_path / "slow").mkdir()
    assert SteeredRun(tmp_path / "slow", step_seconds=0.5).spec.hear is not None

"""Both recorders in this process, from their parameters to bag and exit: what they report, and how they end."""

import json
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from tests.swarmabs_bag.sample_run import AGENTS, make_step
from tests.swarmabs_core.helpers import singly
from tests.swarmabs_core.realtime.bags import world
from tests.swarmabs_ros.nodes import given, settings_from
from tests.virtual.fleet import EPOCH

from swarmabs_bag.attached import attached_provenance
from swarmabs_bag.errors import BagWriteError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.recorder import node, realtime
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.recorder.swarm_summary import (
    EVENT_CHARACTERS,
    KEPT_EVENTS,
    SummaryTracker,
    SwarmSummary,
    describe_event,
)
from swarmabs_bag.run.step import Step
from swarmabs_bag.run.writer import BagWriter
from swarmabs_bag.shown.swarm_state import SILENT_STEPS
from swarmabs_config.graph import RECORDING_STEPS
from swarmabs_config.scenario import Scenario, dump_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core import messages as msg
from swarmabs_core.behaviours.base import ConflictError, UnexpectedMessageError
from swarmabs_core.cdr import encode
from swarmabs_core.parameters import Value
from swarmabs_core.record import Record
from swarmabs_ros.lockstep import INTERRUPTED, NodeSpec
from swarmabs_ros.status import StatusChannel
from swarmabs_run.simulation import Simulation, simulated_steps
from swarmabs_run.vector_simulation import vectorised

SECOND = 10**9
PERIOD = SECOND // 100


class Told:
    """What a recorder reports, by a clock that goes only where a test lets it."""

    def __init__(self) -> None:
        self.now = EPOCH
        self.reports: list[tuple[str, dict[str, Any]]] = []
        self.notices: list[str] = []
        self.health: list[str] = []

    def monotonic(self) -> float:
        return (self.now - EPOCH) / 1e9 + 1000.0

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)

    def report(self, event: str, **details: object) -> None:
        self.reports.append((event, json.loads(json.dumps(details))))

    def of(self, event: str) -> list[dict[str, Any]]:
        return [details for name, details in self.reports if name == event]


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Told:
    """Whoever has started the recorder of this test."""
    found, diagnostic_array = Told(), realtime.diagnostic_array
    clock = SimpleNamespace(
        time_ns=lambda: found.now, monotonic=found.monotonic, monotonic_ns=lambda: found.now, sleep=found.sleep
    )

    def diagnosed(name: str, health: Any, now: int) -> Any:
        assert (name, now) == ("recorder", found.now)
        found.health.append(health.text)
        return diagnostic_array(name, health, now)

    monkeypatch.setattr(StatusChannel, "send", lambda _, event, **details: found.report(event, **details))
    monkeypatch.setattr(StatusChannel, "wait_for_epoch", lambda _: EPOCH)
    monkeypatch.setattr(realtime, "diagnostic_array", diagnosed)
    for module in ("swarmabs_bag.recorder.realtime", "swarmabs_ros.status"):
        monkeypatch.setattr(f"{module}.notify", found.notices.append)
    for module in (node, realtime):
        monkeypatch.setattr(module, "time", clock)
    return found


def parameters(scenario: Scenario, folder: Path) -> dict[str, str]:
    """Return where scenario, bag and logs of a run are."""
    (folder / "logs").mkdir()
    for name, text in (("b.log", "two"), ("a.log", "one"), ("c.log", ""), ("d.txt", "no log")):
        (folder / "logs" / name).write_text(text)
    (folder / "scenario.yaml").write_text(dump_scenario(scenario))
    return {"scenario_file": str(folder / "scenario.yaml"), "bag": str(folder / "bag"), "logs": str(folder / "logs")}


LOG = b"==> a.log <==\none\n==> b.log <==\ntwo\n"


class Lockstep:
    """The recorder of a run of 31 steps in which a robot is killed, as its loop has it."""

    def __init__(self, folder: Path, **values: Value) -> None:
        faults = "faults=[{at: 0.17, kind: kill, agent: 2}]"
        self.scenario = find_scenario("pd_het_4", ["duration=0.3", faults]).resolved()
        self.steps = singly(Simulation(self.scenario).steps())
        settings = settings_from(node.PARAMETERS, **{**parameters(self.scenario, folder), **values})
        self.spec: NodeSpec = node.make(settings, StatusChannel("recorder"))
        self.recorder = self.spec.behaviour

    def hear(self, told: Told, steps: int = 31, *, lost: msg.Topic | None = None) -> list[msg.Message]:
        """Hear the first steps, each 40 ms after the one before; return the answers.

        One topic of step 5 may be lost. Padding may hold anything, and Fast DDS rounds the size up.
        """
        assert self.spec.hear_all is not None
        answers: list[msg.Message] = []
        for step in self.steps[:steps]:
            for topic, _, payload in sorted(step.stored(), key=lambda stored: stored[0] is not msg.EVENTS):
                if step.step != 5 or topic is not lost:
                    noise = payload[:2] + b"\xa5\xa5" + payload[4:22] + b"\xa5" * 6 + payload[28:] + b"\xa5" * 3
                    answers += self.spec.hear_all(topic, [noise])
            told.now += SECOND // 25
        return answers


def test_a_lockstep_run_is_recorded_and_reported(told: Told, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = Lockstep(tmp_path, max_bag_duration_ns=SECOND // 10)
    monkeypatch.setattr("swarmabs_core.record.encode", lambda _: pytest.fail("it has the bytes already"))
    assert run.recorder.start() == (msg.RecordingProgress(0, 0, msg.NEVER),)
    assert set(run.recorder.awaits()) == {*msg.MAIN_TOPICS, msg.STANDING, msg.EVENTS}
    every = RECORDING_STEPS // node.CREDITS
    written = [*range(every - 1, 30, every), 30]
    assert run.hear(told) == [msg.RecordingProgress(step * PERIOD, step, step) for step in written]
    assert run.recorder.awaits() == ()
    assert run.spec.on_idle is not None
    run.spec.on_idle(0.0)
    run.spec.on_exit(None)
    progress = told.of("progress")
    assert [each["step"] for each in progress] == [0, 3, 6, 9, 12, 15, 17, 20, 23, 26, 29, 30]
    assert progress[-1]["angle"] == run.steps[-1].parent.angle
    assert [each["robots"]["statuses"] for each in progress] == ["AAAA"] * 7 + ["ADAA"] * 5
    (done,) = told.of("done")
    assert (done["complete"], done["problem"]) == (True, None)
    assert done["figures"]["final_error"] == progress[-1]["error"] != 0.0
    bag = open_bag(tmp_path / "bag")
    assert [payload for _, _, payload in bag.messages()] == [r.payload for s in run.steps for r in s.records]
    assert bag.attachment("run.log") == LOG
    assert len(list((tmp_path / "bag").glob("*.mcap"))) == 4
    made = attached_provenance(bag)
    assert (made["driver"], made.get("steered")) == ("lockstep", None)
    assert "packed" not in made


def test_it_says_that_it_is_still_there_while_the_run_goes_on_without_it(told: Told, tmp_path: Path) -> None:
    """It lacks the plane's state of step 5: the run may go on, so it has not stalled, and its credit stays."""
    run = Lockstep(tmp_path, bag="")
    assert run.hear(told, lost=msg.PLANE_STATE) == [msg.RecordingProgress(0, 0, msg.NEVER)] * (
        26 - RECORDING_STEPS // node.CREDITS
    )
    assert run.hear(told, lost=msg.PLANE_STATE) == [], "repetitions are no sign of life"
    assert run.recorder.missing() == (5, ("plane/state",))
    assert run.recorder.handle(run.steps[5].parent) == (msg.RecordingProgress(30 * PERIOD, 30, 30),)
    with pytest.raises(UnexpectedMessageError):
        run.recorder.handle(msg.RecordingProgress(0, 0, msg.NEVER))


@pytest.mark.parametrize(
    ("steps", "problem", "why", "reported"),
    [
        (31, INTERRUPTED, None, None),
        (31, "the disk is full", "the disk is full", "the disk is full"),
        (9, INTERRUPTED, INTERRUPTED, None),
        (9, None, "stopped before the end", None),
    ],
)
def test_a_bag_says_why_it_is_not_complete(
    steps: int, problem: str | None, why: str | None, reported: str | None, told: Told, tmp_path: Path
) -> None:
    run = Lockstep(tmp_path)
    run.hear(told, steps)
    run.spec.on_exit(problem)
    (done,) = told.of("done")
    bag = open_bag(tmp_path / "bag")
    assert (done["complete"], done["problem"]) == (why is None, reported)
    assert (bag.aborted(), bag.attachment("run.log")) == (why, LOG)


def test_a_run_without_a_bag_has_figures_and_orders_are_known(told: Told, tmp_path: Path) -> None:
    run = Lockstep(tmp_path, bag="", logs="")
    run.hear(told)
    run.spec.on_exit(None)
    assert told.of("done")[0]["figures"]["messages"] == sum(len(step.records) for step in run.steps)
    assert not (tmp_path / "bag").exists()
    (tmp_path / "steered").mkdir()
    steered = Lockstep(tmp_path / "steered", steered=True)
    assert set(steered.recorder.awaits()) == {msg.STEERING, msg.EVENTS, *msg.MAIN_TOPICS, msg.STANDING}
    steered.spec.on_exit(None)
    assert attached_provenance(open_bag(tmp_path / "steered"))["steered"] is True


def test_messages_accumulate_for_longer_while_batches_are_small() -> None:
    scenario = find_scenario("pd_het_4", ["duration=1.0"]).resolved()
    recorder = node.Recorder(scenario, Recording(scenario, None, driver="lockstep"), lambda _: None)
    shortest, longest = node.GATHER_SECONDS
    assert recorder.gathering() == shortest
    seconds = []
    steps = singly(Simulation(scenario).steps())
    for first, stop in ((0, 1), *((n, n + 2) for n in range(1, 21, 2)), (21, 101)):
        for topic in msg.MAIN_TOPICS:
            recorder.hear_all(
                topic, [data for step in steps[first:stop] for of, _, data in step.stored() if of is topic]
            )
        seconds.append(recorder.gathering())
    assert seconds[:2] == [1.5 * shortest, 1.5 * 1.5 * shortest]
    assert seconds[-2:] == [longest, longest / 2], "a batch of more than half of the window"


def test_packed_states_are_recorded_one_by_one(told: Told, tmp_path: Path) -> None:
    run = Lockstep(tmp_path, logs="", packed=True)
    assert run.spec.hear_all is not None
    topics = {msg.SWARM_STATES, msg.BROADCAST, msg.EVENTS, *msg.MAIN_TOPICS, msg.STANDING} - {msg.AGENT_STATE}
    assert set(run.recorder.awaits()) == topics
    for step in run.steps:
        single = [record for record in step.records if record.topic is not msg.AGENT_STATE]
        states = b"".join(record.payload for record in step.records if record.topic is msg.AGENT_STATE)
        run.spec.hear_all(msg.SWARM_STATES, [encode(msg.SwarmStates(0, step.step, states))])
        for record in sorted(single, key=lambda record: record.topic is not msg.EVENTS):
            run.spec.hear_all(record.topic, [record.payload])
        parts = [record.message for record in single if record.topic in msg.BROADCASTS]
        run.spec.hear_all(msg.BROADCAST, [encode(msg.Broadcast(0, step.step, *parts))])
    forged = parts[0]._replace(torque=parts[0].torque + 0.2)
    with pytest.raises(ConflictError, match=f"swarm/abstract_state: two different messages of step {forged.step}"):
        run.spec.hear_all(msg.BROADCAST, [encode(msg.Broadcast(0, forged.step, forged, *parts[1:]))])
    run.spec.on_exit(None)
    bag = open_bag(tmp_path / "bag")
    assert [payload for _, _, payload in bag.messages()] == [r.payload for s in run.steps for r in s.records]
    assert attached_provenance(bag)["packed"] is True


class Heard:
    """What a recorder in real time hears of a fleet: the messages of 10 ms at a time, then nothing any more.

    A signal interrupts a wait while messages arrive. `writers` are the GIDs of writers by what they have written.
    """

    def __init__(
        self,
        told: Told,
        arriving: Sequence[tuple[msg.Topic, int, bytes]],
        at: Mapping[int, Callable[[], object]],
        writers: Mapping[bytes, bytes],
    ) -> None:
        self._told, self._arriving, self._at, self._writers = told, deque(arriving), at, writers
        self._waiting: dict[msg.Topic, deque[bytes]] = {topic: deque() for topic, _, _ in arriving}
        self._taken: dict[msg.Topic, bytes] = {}
        self.waits = 0

    def wait(self, topics: tuple[msg.Topic, ...], seconds: float) -> bool:
        assert {*self._waiting} <= {*topics}
        self.waits += 1
        self._at.get(self.waits, tuple)()
        self._told.now += round(seconds * 1e9) if not self._arriving else SECOND // 100
        heard = False
        while self._arriving and self._arriving[0][1] <= self._told.now:
            topic, _, payload = self._arriving.popleft()
            self._waiting[topic].append(payload)
            heard = True
        return heard and self.waits not in self._at

    def take(self, topic: msg.Topic) -> bytes | None:
        if not self._waiting.get(topic):
            return None
        self._taken[topic] = self._waiting[topic].popleft()
        return self._taken[topic]

    def writer(self, topic: msg.Topic) -> bytes:
        return self._writers.get(self._taken[topic], b"")


@pytest.fixture
def recorded(told: Told, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ros: None) -> Iterator[Callable[..., int]]:
    """Give a function that runs the recorder in real time beside a fleet, and returns its exit code."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    fleet = world("brief")

    def run(
        arriving: Sequence[tuple[msg.Topic, int, bytes]] = fleet.bag,
        at: Mapping[int, Callable[[], object]] = MappingProxyType({}),
        writers: Mapping[bytes, bytes] = MappingProxyType({}),
        **values: str,
    ) -> int:
        heard = Heard(told, arriving, at, writers)
        monkeypatch.setattr(realtime, "Receiver", lambda *_, **__: heard)
        usual = {**parameters(fleet.scenario, tmp_path), "period_ns": str(fleet.scenario.step_ns)}
        words = given(**{**usual, "epoch_ns": str(EPOCH), **values})
        return realtime.main(["--ros-args", "--disable-external-lib-logs", *words])

    yield run
    for number, handler in handlers.items():
        signal.signal(number, handler)


def test_what_is_heard_up_to_the_last_step_is_recorded(
    recorded: Callable[..., int],
    told: Told,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "200000")
    bag = world("brief").bag
    spoilt = [*bag[:99], (msg.PLANE_STATE, bag[99].time, b"\x00\x01\x00\x00"), *bag[99:]]
    values = {"own_limits": "[3]", "driven": "[2, 4]", "simulated_plane": "false", "max_bag_duration_ns": "200000000"}
    assert recorded(spoilt, last_step="40", **values) == 0
    expected = [stored.payload for stored in bag if stored.message.step <= 40]
    found = open_bag(tmp_path / "bag")
    assert sorted(payload for _, _, payload in found.messages()) == sorted(expected)
    assert (found.aborted(), found.attachment("run.log")) == (None, LOG)
    assert len(list((tmp_path / "bag").glob("*.mcap"))) == 2
    assert attached_provenance(found)["realtime"] == {
        "period_ns": 10_000_000,
        "epoch_ns": EPOCH,
        "simulated_robots": [1, 3],
        "simulated_plane": False,
        "own_limits": [3],
    }
    assert (told.now - EPOCH) / 1e9 == pytest.approx(0.41 + realtime.LINGER, abs=2 * realtime.SLICE)
    assert [event for event, _ in told.reports][:2] == ["ready", "progress"]
    assert 4 <= len(told.of("progress")) <= 10
    assert told.of("done")[0]["complete"]
    assert told.of("done")[0]["problem"] is None
    assert told.notices[0] == "READY=1\nSTATUS=recording"
    assert 4 <= told.notices.count("WATCHDOG=1") <= 10
    assert told.health == ["recording"]
    assert "1 malformed messages were not recorded" in capfd.readouterr().err


def test_each_message_is_that_of_its_own_writer(recorded: Callable[..., int], told: Told, tmp_path: Path) -> None:
    """A second sender contradicts each state of the plane at once: the first one is recorded."""
    arriving, writers = [], {}
    for stored in world("brief").bag:
        arriving.append(stored)
        if isinstance(stored.message, msg.PlaneState):
            forged = encode(stored.message._replace(angle=0.5))
            arriving.append(stored._replace(payload=forged))
            writers |= {stored.payload: b"1" * 16, forged: b"2" * 16}
    assert recorded(arriving, writers=writers, last_step="40") == 0
    planes = [payload for _, _, payload in open_bag(tmp_path / "bag").messages((msg.PLANE_STATE,))]
    assert planes == [s.payload for s in world("brief").bag if s.topic is msg.PLANE_STATE and s.message.step <= 40]
    assert told.of("done")[0]["figures"]["realtime"]["dropped"] == {"repeated": 0, "different": 41, "refused": 0}


FALLEN = "t = 0.3 s, step 30: the plane's angle is 1.5 rad"


@pytest.mark.parametrize(
    ("number", "wait", "last_step", "problem", "aborted"),
    [
        (signal.SIGTERM, 20, "-1", None, None),
        (signal.SIGINT, 20, "60", None, INTERRUPTED),
        (signal.SIGTERM, 20, "60", None, "stopped before the end"),
        (signal.SIGTERM, 60, "-1", None, None),
        (signal.SIGTERM, 99, "60", FALLEN, FALLEN),
    ],
)
def test_the_recording_of_a_fleet_ends_when_it_is_told_to_and_a_run_fails_with_its_plane(
    number: int,
    wait: int,
    last_step: str,
    problem: str | None,
    aborted: str | None,
    recorded: Callable[..., int],
    told: Told,
    tmp_path: Path,
) -> None:
    arriving = []
    for stored in world("brief").bag:
        message = stored.message
        fallen = isinstance(message, msg.PlaneState) and message.step >= 30
        arriving.append(stored._replace(payload=encode(message._replace(angle=1.5))) if fallen else stored)
    at = {wait: lambda: os.kill(os.getpid(), number)}
    assert recorded(arriving, at, last_step=last_step, bags=str(tmp_path / "bags"), await_epoch="true") == 0
    (folder,) = (tmp_path / "bags").iterdir()
    assert folder.name.startswith(f"{world('brief').scenario.name}-2")
    bag = open_bag(folder)
    (done,) = told.of("done")
    assert done["complete"] == (aborted is None)
    for said, expected in ((done["problem"], problem), (bag.aborted(), aborted)):
        assert (said or "").startswith(expected or "") and bool(said) == bool(expected)
    heard = sum(stored.time <= told.now for stored in arriving)
    assert 0 < bag.message_count == done["figures"]["messages"] == heard, "also what arrives while it is stopped"
    assert [event for event, _ in told.reports][:2] == ["ready", "ready"]
    assert len(told.of("failed")) == (wait > 20)
    seconds = (told.now - EPOCH) // SECOND
    assert told.health == (["recording"] * 2 + ["receives no messages of the swarm"] * seconds)[: seconds + 1]


def test_what_cannot_be_recorded_ends_the_node(
    recorded: Callable[..., int],
    told: Told,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    refusal = BagWriteError(tmp_path / "bag", OSError(28, "No space left on device"))
    monkeypatch.setattr(BagWriter, "write", Mock(side_effect=refusal))
    assert recorded(last_step="40") == 1
    (done,) = told.of("done")
    assert (done["complete"], done["problem"]) == (False, str(refusal))
    assert told.of("failed")[0]["reason"] == open_bag(tmp_path / "bag").aborted() == str(refusal)
    assert str(refusal) in capfd.readouterr().err


def test_another_period_than_the_scenarios_is_refused(recorded: Callable[..., int], told: Told, tmp_path: Path) -> None:
    assert recorded(period_ns="20000000") == 2
    assert told.of("failed")[0]["reason"] == "parameter period_ns does not match the scenario: set it to 10000000"
    assert not (tmp_path / "bag").exists()


# What people see of the robots while a run goes on: a report of it is short


def complete(step: int, messages: list[msg.Message]) -> Step:
    return Step.of(step, tuple(map(Record.of, messages)))


def robots(step: int, states: dict[int, tuple[msg.Status, float]], *more: msg.Message) -> Step:
    messages: list[msg.Message] = []
    for message in make_step(step, tuple(states)):
        if isinstance(message, msg.AgentState):
            status, position = states[message.agent_id]
            messages.append(message._replace(status=status, position=position))
        else:
            messages.append(message)
    return complete(step, [*messages, *more])


def test_the_summary_tells_statuses_and_places_and_who_is_silent_stays_where_it_was_seen() -> None:
    tracker = SummaryTracker(AGENTS, length=2.0)
    assert tracker.summary() is None
    states = {1: (msg.Status.ACTIVE, 0.5), 2: (msg.Status.SAFE_STOP, -1.0), 7: (msg.Status.LEFT, 0.0004)}
    tracker.take(robots(0, states))
    assert tracker.summary() == SwarmSummary({"A": 1, "L": 1, "S": 1}, "ASL", [500, -1000, 0], [])
    beyond = ((7.0, 1000), (-7.0, -1000), (float("inf"), 0), (float("nan"), 0))
    for step, (position, place) in enumerate(beyond, start=1):
        tracker.take(robots(step, states | {1: (msg.Status.ACTIVE, position)}))
        seen = tracker.summary()
        assert seen is not None and seen.places[0] == place
    for step, letter in ((4 + SILENT_STEPS, "S"), (5 + SILENT_STEPS, "-")):
        tracker.take(robots(step, {1: (msg.Status.ACTIVE, 0.2)}))
        assert tracker.summary() == SwarmSummary({letter: 1, "A": 1, "L": 1}, f"A{letter}L", [200, -1000, 0], [])
    many = SummaryTracker(range(1, 1001), length=1.0)
    many.take(robots(0, dict.fromkeys(range(1, 901), (msg.Status.ACTIVE, 0.0))))
    assert many.summary() == SwarmSummary({"?": 100, "A": 900}, "", [], []), "so many are counted only"


def test_in_real_time_messages_come_one_by_one() -> None:
    tracker = SummaryTracker((1, 2, 3), length=2.0)
    assert tracker.summary() is None
    said = {state.agent_id: state for state in make_step(0, (1, 2, 3)) if isinstance(state, msg.AgentState)}
    tracker.hear(said[1]._replace(position=0.5))
    tracker.hear(said[2]._replace(position=-0.5, status=msg.Status.LEFT))
    assert tracker.summary() == SwarmSummary({"?": 1, "A": 1, "L": 1}, "AL?", [500, 0, 0], [])
    tracker.hear(msg.SwarmEvent(0, 7, 1, msg.EventKind.HELD, 0.0, ""))
    tracker.hear(said[3]._replace(step=SILENT_STEPS + 1, position=1.0))
    tracker.hear(said[1])  # late
    seen = tracker.summary()
    assert seen == SwarmSummary({"-": 1, "A": 1, "L": 1}, "-LA", [500, 0, 1000], ["step 7: robot 1 held"])
    for step in (8, 9, 10, 11):
        tracker.hear(msg.SwarmEvent(0, step, 1, msg.EventKind.DEAD, 0.25, "kill"))
    latest = [f"step {step}: robot 1 dead, 0.25: kill" for step in (9, 10, 11)]
    assert tracker.summary() == SwarmSummary({"A": 1, "D": 1, "L": 1}, "DLA", [250, 0, 1000], latest)
    for step in range(12, 20):
        tracker.hear(msg.SwarmEvent(0, step, 1, msg.EventKind.HELD, 0.0, ""))
    *first, more = tracker.events()
    assert (len(first), first[0], more) == (KEPT_EVENTS, "step 7: robot 1 held", "and 3 more")


@pytest.mark.parametrize(
    ("kind", "value", "detail", "text"),
    [
        (msg.EventKind.STEERING, 0.05, "reference", "step 7: reference, 0.05"),
        (msg.EventKind.STEERING, 0.0, "disturbance", "step 7: disturbance, 0"),
        (
            msg.EventKind.SAFE_STOP,
            0.0,
            "no complete broadcasts yet",
            "step 7: robot 3 waits to start: no complete broadcasts yet",
        ),
        (msg.EventKind.DEAD, 0.107341234, "kill", "step 7: dead, 0.10734: kill"),
        (msg.EventKind.JOINED, 0.0, "", "step 7: joined"),
        (msg.EventKind.LIMIT_HIT, float("nan"), "", "step 7: limit hit"),
    ],
)
def test_events_are_told_with_their_values(kind: msg.EventKind, value: float, detail: str, text: str) -> None:
    robot = 3 if kind is msg.EventKind.SAFE_STOP else 0  # robots report about themselves alone
    assert describe_event(msg.SwarmEvent(0, 7, robot, kind, value, detail)) == text


@pytest.mark.parametrize("overrides", [(), ("swarm.actuator_lag=0.01",)])
def test_both_kinds_of_simulation_tell_the_events_that_they_store(overrides: tuple[str, ...]) -> None:
    changes = ["duration=0.5", "manifold.torque_max=0.05", *overrides]
    scenario = find_scenario("arise_het_4", changes).resolved()
    assert (vectorised(scenario) is None) == bool(overrides)
    steps = singly(simulated_steps(scenario))
    told = [encode(event) for step in steps for event in step.events]
    assert told == [payload for step in steps for topic, _, payload in step.stored() if topic is msg.EVENTS] != []


@pytest.mark.parametrize("detail", ["\x1b[31mred\nnext", "\U0001f41d" * 500, '"' * 500, "ü" * 500])
def test_a_report_is_short_whatever_robots_say(detail: str) -> None:
    """Longer lines would mix with those of other processes in the pipe."""
    event = msg.SwarmEvent(0, 2**64 - 1, 65535, msg.EventKind.REFUSED, 0.0, detail)
    text = describe_event(event)
    assert len(text) <= EVENT_CHARACTERS and text.isprintable()
    tracker = SummaryTracker(range(1, 201), length=1.0)
    states = dict.fromkeys(range(1, 201), (msg.Status.SAFE_STOP, -0.5))
    for step in range(3):
        tracker.take(robots(step, states, event._replace(step=2**64 - 1)))
    seen = tracker.summary()
    assert seen is not None and len(seen.places) == 200 and len(seen.events) == 3
    line = {"node": "recorder", "pid": 2**22, "event": "progress", "step": 2**63, "angle": -1 / 3, "error": 1e-300 / 3}
    assert len(json.dumps({**line, "robots": seen._asdict()})) < 4000
    assert SwarmSummary(**json.loads(json.dumps(seen._asdict()))) == seen

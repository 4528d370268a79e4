"""The loop by the clock, with a clock and messages that the tests make."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest
from tests.processes import until
from tests.swarmabs_ros.fakes import PERIOD_NS, desired, plane

from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.messages import DESIRED_ABSTRACT_STATE, PLANE_STATE, Message, Messages, Topic
from swarmabs_core.realtime.base import Health, Level, Schedule
from swarmabs_ros.realtime import Engine, RealtimeLoop
from swarmabs_ros.timing import Reading, StepClock

EPOCH = 1_000_000_000_000
DEPTH = 5


@dataclass
class World:
    """A clock that passes where somebody sleeps or waits, what arrives then, and what happens at which time."""

    system: int = EPOCH
    steady: int = 0
    arrivals: list[tuple[int, bytes]] = field(default_factory=list)
    plans: list[tuple[int, Callable[[], None]]] = field(default_factory=list)
    published: list[tuple[int, Message]] = field(default_factory=list)

    def read(self) -> Reading:
        return Reading(self.system, self.steady)

    def sleep(self, seconds: float) -> None:
        end = self.steady + max(1, round(seconds * 1e9))
        for plan in sorted((p for p in self.plans if p[0] <= end), key=lambda p: p[0]):
            self._advance(plan[0])
            self.plans.remove(plan)
            plan[1]()
        self._advance(end)

    def _advance(self, steady: int) -> None:
        passed = max(0, steady - self.steady)
        self.system += passed
        self.steady += passed

    # Receiver

    def take(self, topic: Topic) -> bytes | None:
        for index, (time, data) in enumerate(self.arrivals):
            if time <= self.steady:
                del self.arrivals[index]
                return data
        return None

    def wait(self, topics: tuple[Topic, ...], timeout: float) -> bool:
        assert topics == (PLANE_STATE,)
        first = min((time for time, _ in self.arrivals), default=10**18)
        self.sleep(max(0.0, min(timeout, (first - self.steady) / 1e9)))
        return first <= self.steady

    def publisher_count(self, topic: Topic) -> int:
        return 1


class Writer:
    def __init__(self, world: World) -> None:
        self._world = world

    def publish(self, data: bytes) -> None:
        self._world.published.append((self._world.steady, data))  # type: ignore[arg-type]


class Node:
    """Answers each plane state and each tick with a desired state, and notes everything."""

    def __init__(self) -> None:
        self.heard: list[tuple[int, int]] = []
        self.ticks: list[int] = []
        self.halts = 0
        self.fail_at: int | None = None
        self.halt_fails = False

    def hear(self, message: Message, now: int) -> Messages:
        self.heard.append((message.step, now))
        return (desired(1000 + message.step),)

    def tick(self, now: int) -> Messages:
        self.ticks.append((now - EPOCH) // PERIOD_NS)
        if self.ticks[-1] == self.fail_at:
            raise ZeroDivisionError("the drive's cable is off")
        return (desired(self.ticks[-1]),)

    def halt(self) -> None:
        self.halts += 1
        if self.halt_fails:
            raise OSError("no brake either")

    def health(self, now: int) -> Health:
        return Health(Level.OK, "fine", (("heard", str(len(self.heard))),))


@dataclass
class Run:
    world: World
    node: Node
    loop: RealtimeLoop
    clock: StepClock
    failures: list[Exception]

    def until(self, periods: float) -> None:
        """Run from now to the end of so many periods, and stop."""
        self.world.plans.append((round(periods * PERIOD_NS), self.loop.stop))
        self.loop.run()


def made(phase: float = 0.0, wakes: tuple[Topic, ...] = ()) -> Run:
    world, node, failures = World(), Node(), []

    def fail(error: Exception) -> None:
        failures.append(error)
        loop.stop()

    loop = RealtimeLoop(fail, read=world.read, sleep=world.sleep)
    loop._thread = threading.get_ident()  # jobs are done at once where there is one thread only
    clock = StepClock(Schedule(PERIOD_NS, EPOCH), phase)
    publishers = {DESIRED_ABSTRACT_STATE: Writer(world)}
    loop.attach(Engine(node, clock, world, {PLANE_STATE: DEPTH}, publishers, wakes))  # type: ignore[arg-type]
    loop.activate()
    return Run(world, node, loop, clock, failures)


def at(periods: float) -> int:
    return round(periods * PERIOD_NS)


def test_a_step_is_made_every_period_and_hears_first_what_has_come() -> None:
    run = made()
    run.world.arrivals = [(at(1.2), encode(plane(7))), (at(1.9), encode(plane(8)))]
    run.until(4.5)
    assert run.node.ticks == [1, 2, 3, 4]
    assert run.node.heard == [(7, EPOCH + at(2)), (8, EPOCH + at(2))]
    published = [data for _, data in run.world.published]
    assert published == [encode(desired(step)) for step in (1, 1007, 1008, 2, 3, 4)]
    assert run.node.halts == 1, "halted when told to stop"


def test_a_topic_that_wakes_is_answered_at_once() -> None:
    run = made(0.75, wakes=(PLANE_STATE,))
    run.world.arrivals = [(at(1.5), encode(plane(1))), (at(2.5), encode(plane(2)))]
    run.until(3.1)
    assert [time for time, _ in run.world.published] == [at(0.75), at(1.5), at(1.75), at(2.5), at(2.75)]


def test_what_came_before_the_activation_is_not_heard() -> None:
    world = made()
    world.loop.deactivate()
    world.world.arrivals = [(0, encode(plane(1)))]
    world.loop.activate()
    world.until(2.5)
    assert world.node.heard == []


def test_garbage_is_refused_and_counted_and_the_next_message_is_heard() -> None:
    run = made()
    foreign = encode(plane(3)).replace(b"plane\0", b"other\0")
    run.world.arrivals = [
        (at(0.1), b""),
        (at(0.1), foreign),
        (at(0.1), encode(plane(3))[:-9]),
        (at(0.1), encode(plane(4))),
    ]
    run.until(1.5)
    assert [step for step, _ in run.node.heard] == [4]
    assert run.loop.refused == 3
    assert not run.failures


def test_a_flood_does_not_keep_the_steps_from_being_made() -> None:
    run = made()
    run.world.arrivals = [(at(0.5), encode(plane(1)))] * 1000
    run.until(10.5)
    assert run.node.ticks == list(range(1, 11))
    assert len(run.node.heard) == 10 * DEPTH


def test_an_error_halts_and_silences_the_node_and_is_told() -> None:
    run = made()
    run.node.fail_at = 3
    run.until(8.0)
    assert run.node.ticks == [1, 2, 3]
    assert run.node.halts == 1
    assert [str(error) for error in run.failures] == ["the drive's cable is off"]


def test_an_error_in_halting_is_told_with_the_one_before() -> None:
    run = made()
    run.node.fail_at, run.node.halt_fails = 2, True
    run.until(4.0)
    (error,) = run.failures
    assert "the drive's cable is off" in str(error)
    assert "no brake either" in str(error)


def test_a_clock_set_back_far_is_told_to_the_node_at_once() -> None:
    run = made()
    run.world.system += at(100)

    def set_back() -> None:
        run.world.system -= at(50)

    run.world.plans = [(at(5.5), set_back)]
    run.until(8.2)
    # The loop sleeps on until the sixth period ends.
    assert run.node.ticks == [100, 101, 102, 103, 104, 105, 56, 57, 58]
    assert run.clock.jumps == 2


def test_health_has_the_figures_and_warns_of_what_was_missed_since_the_last_time() -> None:
    run = made()
    seen: list[Health] = []

    def stall() -> None:
        run.world._advance(run.world.steady + at(7.0))

    run.world.plans = [
        (at(3.5), stall),
        (at(11.2), lambda: seen.append(run.loop.health())),
        (at(12.2), lambda: seen.append(run.loop.health())),
    ]
    run.until(13.0)
    assert [health.level for health in seen] == [Level.WARN, Level.OK]
    assert seen[0].text == "fine; 6 periods missed"
    assert dict(seen[1].values)["periods missed"] == "6"
    report = run.clock.report()
    assert report["missed"] == 6
    assert report["longest_us"] == (at(6.5)) // 1000
    assert sum(report["lateness_us"].values()) == report["steps"] == 12 - 6  # type: ignore[attr-defined]


def test_a_command_is_published_at_once_and_refused_where_nothing_is_active() -> None:
    run = made()
    run.world.plans = [(at(1.3), lambda: run.loop.command(lambda now: (desired((now - EPOCH) // 1000),)))]
    run.until(1.5)
    assert run.world.published[-1] == (at(1.3), encode(desired(at(1.3) // 1000)))
    with pytest.raises(RunError, match="not active"):
        run.loop.command(lambda _: ())


@pytest.fixture
def real_loop() -> Iterator[RealtimeLoop]:
    """A loop with the real clock in a thread of its own."""
    loop = RealtimeLoop(lambda _: None)
    thread = threading.Thread(target=loop.run)
    thread.start()
    yield loop
    loop.stop()
    thread.join(10.0)
    assert not thread.is_alive()


def test_jobs_of_other_threads_are_done_in_the_loops_and_raise_where_they_were_asked_for(
    real_loop: RealtimeLoop,
) -> None:
    assert real_loop.call(threading.get_ident) not in {threading.get_ident(), None}
    with pytest.raises(RunError, match="nothing to activate"):
        real_loop.activate()


def test_a_loop_that_hangs_is_named_and_does_not_do_the_job_later(real_loop: RealtimeLoop) -> None:
    hanging, done = threading.Event(), threading.Event()
    release = threading.Event()

    def hang() -> None:
        hanging.set()
        release.wait(10.0)
        done.set()

    waiter = threading.Thread(target=lambda: real_loop.call(hang, 10.0))
    waiter.start()
    assert hanging.wait(10.0)
    late: list[int] = []
    with pytest.raises(RunError, match="has not answered"):
        real_loop.call(lambda: late.append(1), 0.01)
    release.set()
    waiter.join(10.0)
    until(done.is_set, "the job that hung is done")
    assert real_loop.call(lambda: 5) == 5
    assert late == []


@dataclass
class Hanging:
    """A loop in a thread of its own, whose node never ends what it begins there."""

    loop: RealtimeLoop
    hung: threading.Event
    """Set when the loop is known to be lost."""
    release: threading.Event


@pytest.fixture
def hanging() -> Iterator[Hanging]:
    hung, release = threading.Event(), threading.Event()
    loop = RealtimeLoop(lambda _: None, on_hang=hung.set, halts_within=0.5)
    thread = threading.Thread(target=loop.run)
    thread.start()
    yield Hanging(loop, hung, release)
    release.set()
    loop.stop()
    thread.join(10.0)
    assert not thread.is_alive()


def engine_of(node: Node) -> Engine:
    clock = StepClock(Schedule(PERIOD_NS, EPOCH), 0.0)
    world = World()
    return Engine(node, clock, world, {PLANE_STATE: DEPTH}, {DESIRED_ABSTRACT_STATE: Writer(world)})  # type: ignore[arg-type]


@pytest.mark.parametrize("where", ["halt", "tick"])
@pytest.mark.parametrize("request_of", ["deactivate", "take back"])
def test_a_node_that_does_not_halt_is_told_and_nobody_waits_for_it(
    hanging: Hanging, where: str, request_of: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, begun = Node(), threading.Event()

    def hang(*_: object) -> Messages:
        begun.set()
        hanging.release.wait(10.0)
        return ()

    monkeypatch.setattr(node, where, hang)
    loop = hanging.loop
    loop.attach(engine_of(node))
    loop.activate()
    if where == "tick":
        assert begun.wait(10.0)
    with pytest.raises(RunError, match=r"drive's stop|has not answered for 0\.5 s"):
        loop.deactivate() if request_of == "deactivate" else loop.attach(None)
    assert hanging.hung.wait(10.0)
    with pytest.raises(RunError, match=r"halting has not ended within 0\.5 s: a drive's stop\(\) hangs, or a step"):
        loop.health()


def test_a_loop_that_does_not_stop_is_told(hanging: Hanging, monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node()
    monkeypatch.setattr(node, "halt", lambda: hanging.release.wait(10.0))
    hanging.loop.attach(engine_of(node))
    hanging.loop.activate()
    hanging.loop.stop()
    assert hanging.hung.wait(10.0)


def test_who_halts_in_time_is_not_taken_to_hang(hanging: Hanging) -> None:
    hanging.loop.attach(engine_of(Node()))
    for _ in range(3):
        hanging.loop.activate()
        hanging.loop.deactivate()
    assert not hanging.hung.wait(0.8)
    assert hanging.loop.health().text.startswith("fine")

"""Steps by the clock, the histogram of their lateness and the loop, with clocks and messages that the tests make."""

import threading
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import pytest
from hypothesis import example, given, strategies as st
from tests.processes import until
from tests.swarmabs_ros.nodes import desired
from tests.transport.network import Inbox, Outbox

from swarmabs_config.graph import Qos
from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    EventKind,
    Message,
    Messages,
    PlaneState,
    SwarmEvent,
    Topic,
)
from swarmabs_core.realtime.base import MOST_BACK, UNKNOWN, Health, Level, Schedule, Sender
from swarmabs_ros.realtime import Engine, RealtimeLoop
from swarmabs_ros.timing import BINS, JUMP, Lateness, Reading, StepClock

EPOCH, PERIOD, DEPTH = 1_700_000_000_000_000_000, 10_000_000, 5
SCHEDULE = Schedule(PERIOD, EPOCH)


def at(periods: float) -> int:
    return round(periods * PERIOD)


def plane(step: int) -> bytes:
    return encode(PlaneState(0, step, 0.1, 0.0))


@dataclass
class Clocks:
    system: int = EPOCH
    steady: int = 0

    def read(self) -> Reading:
        return Reading(self.system, self.steady)

    def pass_by(self, nanoseconds: int) -> None:
        self.system += max(0, nanoseconds)
        self.steady += max(0, nanoseconds)


def started(phase: float = 0.0, system: int = EPOCH) -> tuple[StepClock, Clocks]:
    clocks = Clocks(system)
    clock = StepClock(SCHEDULE, phase)
    clock.start(clocks.read())
    return clock, clocks


def next_step(clock: StepClock, clocks: Clocks) -> int:
    """Wait as long as the clock says, and return the step that is due then."""
    assert clock.due(clocks.read()) is None
    clocks.pass_by(clock.wait(clocks.read()))
    step = clock.due(clocks.read())
    assert step is not None
    return step


@pytest.mark.parametrize(
    ("phase", "periods", "first"), [(0.0, 3.25, 4), (0.5, 3.25, 3), (0.75, 3.25, 3), (0.0, -100_000, 0)]
)
def test_steps_are_due_at_their_phase_and_once_and_none_before_the_epoch(
    phase: float, periods: float, first: int
) -> None:
    clock, clocks = started(phase, EPOCH + at(periods))
    for step in range(first, first + 5):
        assert next_step(clock, clocks) == step
        assert clocks.system == EPOCH + step * PERIOD + round(phase * PERIOD)
    assert (clock.missed, clock.lateness.count, clock.lateness.longest) == (0, 5, 0)


@pytest.mark.parametrize(
    ("begun", "passed", "set_by", "due", "following", "missed", "longest"),
    [
        (0, 3 * PERIOD + 1234, 0, 6, 7, 2, 2 * PERIOD + 1234),
        (0, 0, 360_000 * PERIOD, 360_003, 360_004, 0, 0),
        (0, 0, -JUMP - 1, None, 4, 0, 0),
        (0, 0, -2 * PERIOD, None, 4, 0, 0),
        (100, PERIOD // 2, -50 * PERIOD, 53, 54, 0, PERIOD // 2),
    ],
    ids=["late", "set forward", "set back a little", "set back two periods", "set back far"],
)
def test_who_is_late_or_whose_clock_is_set_makes_the_newest_step_and_none_twice(
    begun: int, passed: int, set_by: int, due: int | None, following: int, missed: int, longest: int
) -> None:
    """Steps that a clock skips are not missed; one that is set back far makes a step at once and goes on from there."""
    clock, clocks = started(0.0, EPOCH + begun * PERIOD)
    assert [next_step(clock, clocks) for _ in range(3)] == [begun + 1, begun + 2, begun + 3]
    clocks.pass_by(passed)
    clocks.system += set_by
    assert clock.due(clocks.read()) == due
    assert [next_step(clock, clocks) for _ in range(3)] == [following, following + 1, following + 2]
    assert (clock.missed, clock.jumps, clock.largest_jump) == (missed, int(set_by != 0), set_by)
    assert clock.lateness.longest == longest


def test_a_clock_set_back_before_the_epoch_is_noticed_once_and_waited_for() -> None:
    clock, clocks = started(0.0, EPOCH + 100 * PERIOD)
    assert next_step(clock, clocks) == 101
    clocks.system = EPOCH - 10**12
    assert clock.due(clocks.read()) == -(10**12) // PERIOD
    assert next_step(clock, clocks) == 0
    assert clocks.system == EPOCH


def test_steps_that_were_made_stay_made_when_the_clock_starts_again() -> None:
    clock, clocks = started()
    assert next_step(clock, clocks) == 1
    clocks.system -= PERIOD
    clock.start(clocks.read())
    assert next_step(clock, clocks) == 2
    clocks.pass_by(50 * PERIOD + 1)
    clock.start(clocks.read())
    assert next_step(clock, clocks) == 53
    assert clock.missed == 0


@given(
    st.floats(0.0, 0.99),
    st.lists(
        st.tuples(
            st.integers(0, 4 * PERIOD),
            st.sampled_from([0, 0, 0, JUMP // 2, -JUMP // 2]) | st.integers(-20 * PERIOD, 20 * PERIOD),
        )
    ),
)
def test_whatever_the_clocks_do_steps_are_of_their_time_and_come_once_or_begin_anew(
    phase: float, moves: list[tuple[int, int]]
) -> None:
    clock, clocks = started(phase, EPOCH + 10**6 * PERIOD)
    newest = -1
    for passed, jump in moves:
        clocks.pass_by(passed)
        clocks.system += jump
        step = clock.due(clocks.read())
        if step is not None:
            assert step > newest or newest - step > MOST_BACK
            assert SCHEDULE.begin(step, phase) <= clocks.system < SCHEDULE.begin(step + 1, phase)
            newest = step
        assert clock.wait(clocks.read()) <= (MOST_BACK + 1) * PERIOD


@given(st.lists(st.integers(-5, 10**13), max_size=200))
def test_the_histogram_counts_by_powers_of_two(values: list[int]) -> None:
    lateness = Lateness()
    for value in values:
        lateness.add(value)
    edges = [2**n * 1000 for n in range(BINS - 1)]
    expected = Counter(2 ** bisect_right(edges, max(0, value)) for value in values)
    assert lateness.bins() == dict(sorted(expected.items()))
    assert lateness.count == len(values)
    assert lateness.longest == max([0, *values])


@example([], 0.999)
@given(st.lists(st.integers(0, 10**12), max_size=100), st.sampled_from([0.5, 0.9, 0.999, 1.0]))
def test_a_share_of_the_values_is_below_its_bound(values: list[int], share: float) -> None:
    lateness = Lateness()
    for value in values:
        lateness.add(value)
    bound = lateness.below(share)
    assert values or bound == 0
    assert sum(value <= bound * 1000 for value in values) >= share * len(values)
    assert sum(2 * value + 2000 > bound * 1000 for value in values) >= (1.0 - share) * len(values)


class World(Clocks):
    """Clocks that pass where somebody sleeps or waits, and what happens at which time of the steady one."""

    def __init__(self) -> None:
        super().__init__()
        self.plans: list[tuple[int, Callable[[], object]]] = []
        self.published: list[tuple[int, int]] = []
        self._inbox = Inbox(dict.fromkeys((PLANE_STATE, EVENTS), Qos("best_effort", 1000)))
        self.take, self.writer = self._inbox.take, self._inbox.writer

    def plan(self, periods: float, do: Callable[[], object]) -> None:
        self.plans.append((at(periods), do))

    def deliver(self, periods: float, data: bytes, topic: Topic = PLANE_STATE) -> None:
        self.plan(periods, lambda: self._inbox.put(topic, data))

    def sleep(self, seconds: float) -> None:
        end = self.steady + max(1, round(seconds * 1e9))
        for plan in sorted((p for p in self.plans if p[0] <= end), key=lambda p: p[0]):
            self.pass_by(plan[0] - self.steady)
            self.plans.remove(plan)
            plan[1]()
        self.pass_by(end - self.steady)

    def wait(self, topics: tuple[Topic, ...], timeout: float) -> bool:
        first = min(time for time, _ in self.plans)
        self.sleep(max(0.0, min(timeout, (first - self.steady) / 1e9)))
        return self._inbox.has(topics)

    def publish(self, topic: Topic, data: bytes) -> None:
        self.published.append((self.steady, decode(topic.message, data).step))


class Node:
    """Answers each plane state and each tick with a desired state, and notes everything."""

    def __init__(self) -> None:
        self.heard: list[tuple[int, int]] = []
        self.ticks: list[int] = []
        self.halts = 0
        self.fail_at: int | None = None
        self.halt_fails = False

    def hear(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Messages:
        self.heard.append((message.step, now - EPOCH))
        return (desired(1000 + message.step),)

    def tick(self, now: int) -> Messages:
        self.ticks.append((now - EPOCH) // PERIOD)
        if self.ticks[-1] == self.fail_at:
            raise ZeroDivisionError("the drive's cable is off")
        return (desired(self.ticks[-1]),)

    def halt(self) -> None:
        self.halts += 1
        if self.halt_fails:
            raise OSError("no brake either")

    def health(self, now: int) -> Health:
        return Health(Level.OK, "fine", (("heard", str(len(self.heard))),))


def engine_of(node: Node, world: World, phase: float = 0.0, wakes: tuple[Topic, ...] = ()) -> Engine:
    publishers = {DESIRED_ABSTRACT_STATE: cast("Any", Outbox(DESIRED_ABSTRACT_STATE, world.publish))}
    clock = StepClock(SCHEDULE, phase)
    return Engine(node, clock, cast("Any", world), {PLANE_STATE: DEPTH, EVENTS: DEPTH}, publishers, wakes)


class Run:
    def __init__(self, phase: float = 0.0, wakes: tuple[Topic, ...] = ()) -> None:
        self.world, self.node = World(), Node()
        self.failures: list[str] = []
        self.engine = engine_of(self.node, self.world, phase, wakes)
        self.loop = RealtimeLoop(self._fail, self._begin, read=self.world.read, sleep=self.world.sleep)
        self._begun = False

    def _fail(self, error: Exception) -> None:
        self.failures.append(str(error))
        self.loop.stop()

    def _begin(self, _: int) -> None:
        if not self._begun:
            self._begun = True
            self.loop.attach(self.engine)
            self.loop.activate()

    def until(self, periods: float) -> None:
        """Run from now to the end of so many periods, and stop."""
        self.world.plan(periods, self.loop.stop)
        self.loop.run()


def test_a_step_is_made_every_period_and_hears_first_what_has_come() -> None:
    run = Run()
    run.world.deliver(1.2, plane(7))
    run.world.deliver(1.9, plane(8))
    run.until(4.5)
    assert run.node.heard == [(7, at(2)), (8, at(2))]
    assert [step for _, step in run.world.published] == [1, 1007, 1008, 2, 3, 4]
    assert run.node.halts == 1, "halted when told to stop"


def test_a_topic_that_wakes_is_answered_at_once_and_of_what_came_before_only_events_are_heard() -> None:
    run = Run(0.75, wakes=(PLANE_STATE,))
    run.world.deliver(0.0, plane(3))
    run.world.deliver(0.0, encode(SwarmEvent(0, 2, 3, EventKind.DEAD, 0.1, "silent")), EVENTS)
    run.world.sleep(0.0)
    for time in (1.5, 2.5):
        run.world.deliver(time, plane(1))
    run.until(3.1)
    assert [time for time, _ in run.world.published] == [at(0.75), at(0.75), at(1.5), at(1.75), at(2.5), at(2.75)]
    assert [step for step, _ in run.node.heard] == [2, 1, 1]


def test_garbage_is_refused_and_counted_and_a_flood_does_not_keep_the_steps_from_being_made() -> None:
    run = Run()
    for data in (b"", plane(3).replace(b"plane\0", b"other\0"), plane(3)[:-9], plane(4)):
        run.world.deliver(0.1, data)
    told: dict[str, str] = {}
    run.world.plan(1.4, lambda: told.update(run.loop.health().values))
    for _ in range(1000):
        run.world.deliver(1.5, plane(1))
    run.until(10.5)
    assert [step for step, _ in run.node.heard] == [4] + [1] * 9 * DEPTH
    assert run.node.ticks == list(range(1, 11))
    assert told["malformed messages"] == "3"
    assert "malformed PlaneState" in told["last malformed"]
    assert not run.failures


@pytest.mark.parametrize("halt_fails", [False, True])
def test_an_error_halts_and_silences_the_node_and_is_told(halt_fails: bool) -> None:  # noqa: FBT001
    run = Run()
    run.node.fail_at, run.node.halt_fails = 3, halt_fails
    run.until(8.0)
    assert (run.node.ticks, run.node.halts) == ([1, 2, 3], 1)
    (told,) = run.failures
    assert "the drive's cable is off" in told
    assert ("halting failed too: OSError: no brake either" in told) is halt_fails


def test_a_command_that_fails_halts_the_node_and_so_does_the_end_even_if_that_fails() -> None:
    def divide() -> None:
        with pytest.raises(ZeroDivisionError):
            run.loop.command(lambda _: (desired(1 // 0),))

    run = Run()
    run.world.plan(1.3, divide)
    run.until(3.0)
    assert (run.node.ticks, run.node.halts, len(run.failures)) == ([1], 1, 1)
    run = Run()
    run.node.halt_fails = True
    run.until(2.5)
    assert (run.node.ticks, run.node.halts, run.failures) == ([1, 2], 1, ["no brake either"])


def test_health_has_the_figures_and_warns_of_what_was_missed_since_the_last_time() -> None:
    run = Run()
    seen: list[Health] = []
    run.world.plan(3.5, lambda: run.world.pass_by(at(7.0)))
    for time in (11.2, 12.2, 12.3):  # between the last two no step is due
        run.world.plan(time, lambda: seen.append(run.loop.health()))
    run.until(13.0)
    told = [(Level.WARN, "fine; 6 periods missed"), (Level.OK, "fine"), (Level.OK, "fine")]
    assert [(health.level, health.text) for health in seen] == told
    assert {"heard": "0", "periods missed": "6"}.items() <= dict(seen[1].values).items()
    report = cast("dict[str, Any]", run.engine.clock.report())
    assert (report["missed"], report["longest_us"]) == (6, at(6.5) // 1000)
    assert sum(report["lateness_us"].values()) == report["steps"] == 12 - 6


def test_a_command_is_published_at_once_and_refused_where_nothing_is_active() -> None:
    run = Run()
    run.world.plan(1.3, lambda: run.loop.command(lambda now: (desired((now - EPOCH) // 1000),)))
    run.until(1.5)
    assert run.world.published[-1] == (at(1.3), at(1.3) // 1000)
    with pytest.raises(RunError, match="not active"):
        run.loop.command(lambda _: ())


class Real(NamedTuple):
    """A loop with the real clock in a thread of its own, whose node may never end what it begins there."""

    loop: RealtimeLoop
    hung: threading.Event
    """Set when the loop is known to be lost."""
    release: threading.Event

    def hang(self, *_: object) -> Messages:
        self.release.wait(10.0)
        return ()


@pytest.fixture
def real() -> Iterator[Real]:
    hung, release = threading.Event(), threading.Event()
    loop = RealtimeLoop(lambda _: None, on_hang=hung.set, halts_within=0.5)
    thread = threading.Thread(target=loop.run)
    thread.start()
    yield Real(loop, hung, release)
    release.set()
    loop.stop()
    thread.join(10.0)
    assert not thread.is_alive()


def test_jobs_of_other_threads_are_done_in_the_loops_and_who_halts_in_time_does_not_hang(real: Real) -> None:
    assert real.loop.call(threading.get_ident) not in {threading.get_ident(), None}
    with pytest.raises(RunError, match="nothing to activate"):
        real.loop.activate()
    real.loop.attach(engine_of(Node(), World()))
    for _ in range(3):
        real.loop.activate()
        real.loop.deactivate()
    assert not real.hung.wait(0.8)
    assert real.loop.health().text.startswith("fine")


def test_a_loop_that_hangs_is_named_and_does_not_do_the_job_later(real: Real) -> None:
    begun, late = threading.Event(), list[int]()
    waiter = threading.Thread(target=lambda: real.loop.call(lambda: (begun.set(), real.hang()), 10.0))
    waiter.start()
    assert begun.wait(10.0)
    with pytest.raises(RunError, match="has not answered"):
        real.loop.call(lambda: late.append(1), 0.01)
    real.release.set()
    waiter.join(10.0)
    until(lambda: not waiter.is_alive(), "the job that hung is done")
    assert real.loop.call(lambda: 5) == 5
    assert late == []


@pytest.mark.parametrize(("where", "asked"), [("halt", "deactivate"), ("tick", "take back"), ("halt", "stop")])
def test_a_node_that_does_not_halt_is_told_and_nobody_waits_for_it(
    real: Real, where: str, asked: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, begun = Node(), threading.Event()
    monkeypatch.setattr(node, where, lambda *_: begun.set() or real.hang())
    real.loop.attach(engine_of(node, World()))
    real.loop.activate()
    if where == "tick":
        assert begun.wait(10.0)
    if asked == "stop":
        real.loop.stop()
    else:
        with pytest.raises(RunError, match=r"drive's stop|has not answered for 0\.5 s"):
            real.loop.deactivate() if asked == "deactivate" else real.loop.attach(None)
    assert real.hung.wait(10.0)
    with pytest.raises(RunError, match=r"halting has not ended within 0\.5 s: a drive's stop\(\) hangs, or a step"):
        real.loop.health()

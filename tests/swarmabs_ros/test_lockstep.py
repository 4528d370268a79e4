"""The lockstep loop, driven without ROS and without waiting, and when it repeats itself, and how much."""

from collections.abc import Iterable
from contextlib import suppress
from itertools import groupby, pairwise
from math import inf
from operator import itemgetter
from typing import Any, cast

import pytest
from hypothesis import given, strategies as st
from tests.swarmabs_ros.nodes import desired
from tests.transport.network import Inbox, Outbox, Reports

from swarmabs_config.graph import KEPT_STEPS, Qos
from swarmabs_core.behaviours.base import ConflictError
from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import DESIRED_ABSTRACT_STATE, PLANE_STATE, Message, Messages, PlaneState, Topic
from swarmabs_ros.lockstep import FIRST, LONGEST, SLICE, Lockstep, NodeSpec, Repeater, RunningClock


def silence(repeater: Repeater, now: float, count: int) -> list[tuple[float, int]]:
    """Return times and sizes of the next repetitions if nothing comes."""
    repetitions = []
    for _ in range(count):
        now += repeater.wait(now)
        repetitions.append((now, repeater.due(now)))
    return repetitions


def stepping(repeater: Repeater, times: Iterable[float], now: float = 0.0) -> float:
    """Make steps that take these times, with whatever repetitions are due; return the time at the end."""
    for time in times:
        end = now + time
        while now + repeater.wait(now) < end:
            now += repeater.wait(now)
            repeater.due(now)
        now = end
        repeater.progress(now)
    return now


def test_windows_and_intervals_grow_to_their_bounds_and_begin_anew_with_progress() -> None:
    repeater = Repeater(0.0)
    assert repeater.due(0.99 * repeater.wait(0.0)) == 0
    repetitions = silence(repeater, 0.0, 33)
    assert [size for _, size in repetitions[:7]] == [1, 4, 16, 64, KEPT_STEPS, 1, 4]
    gaps = [after - before for (before, _), (after, _) in pairwise(repetitions)]
    assert gaps == sorted(gaps)
    assert gaps[-1] == pytest.approx(LONGEST)
    repeater.progress(500.0)
    assert repeater.due(500.0) == 0
    assert [size for _, size in silence(repeater, 500.0, 3)] == [1, 4, 16]


def test_a_large_swarm_is_more_patient_and_repeats_less() -> None:
    repetitions = silence(Repeater(0.0, first=0.4, most=20), 0.0, 5)
    assert repetitions[0][0] == pytest.approx(1.6)
    assert [size for _, size in repetitions] == [1, 4, 16, 20, 1]


@pytest.mark.parametrize(
    ("usual", "wait"),
    [(0.001, FIRST), (0.01, FIRST), (0.02, 0.08), (0.05, 0.2), (0.1, 0.4), (0.2, 0.8), (3.0, LONGEST)],
)
def test_a_slow_run_repeats_later_but_everything_before_silence_is_a_stall(usual: float, wait: float) -> None:
    repeater = Repeater(0.0)
    now = stepping(repeater, [usual] * 500)
    assert repeater.wait(now) == pytest.approx(wait, rel=0.1)
    all_repeated = next(time for time, size in silence(repeater, now, 20) if size == KEPT_STEPS)
    assert all_repeated - now < 5.0 or usual > 0.1


def test_a_run_that_becomes_slow_is_not_flooded_for_long() -> None:
    repeater = Repeater(0.0)
    now = stepping(repeater, [0.01] * 100 + [0.1] * 30)
    assert repeater.wait(now) > 0.2


def test_lost_messages_do_not_make_the_run_ever_slower() -> None:
    """A loss delays a step by the wait for the repetition; that must not lengthen the next wait."""
    repeater, now = Repeater(0.0), 0.0
    for step in range(2000):
        loss = step % 7 == 0
        now = stepping(repeater, [repeater.wait(now) + 0.001 if loss else 0.001], now)
    assert repeater.wait(now) == pytest.approx(FIRST)


@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.booleans()), max_size=60))
def test_bounds_hold_in_any_course_of_events(course: list[tuple[float, bool]]) -> None:
    now = 100.0
    repeater = Repeater(now)
    for pause, made_progress in course:
        now += pause
        if made_progress:
            repeater.progress(now)
            assert repeater.due(now) == 0
        due = repeater.due(now)
        assert due in {0, 1, 4, 16, 64, KEPT_STEPS}
        assert (FIRST - 1e-9 if due else 0.0) <= repeater.wait(now) <= LONGEST + 1e-9


class Follower:
    """Answers every plane state of the current step with a desired abstract state, up to a last step."""

    def __init__(self, last_step: int = 5000) -> None:
        self.step = 0
        self._last_step = last_step

    def start(self) -> Messages:
        return ()

    def handle(self, message: Message) -> Messages:
        if message.step != self.step:
            return ()
        self.step += 1
        return (desired(message.step),)

    def awaits(self) -> tuple[Topic, ...]:
        return () if self.step > self._last_step else (PLANE_STATE,)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        return self.step, ("plane_sim",)


class Bench:
    """A loop to which plane states come at their times; time passes only where it waits."""

    def __init__(self, behaviour: Follower, arrivals: Iterable[float], stall_timeout: float = 5.0, **spec: Any) -> None:
        self.now = 0.0
        self.arrivals = [(time, encode(PlaneState(0, step, 0.1, 0.0))) for step, time in enumerate(arrivals)]
        self.published: list[tuple[float, int]] = []
        self.reports = Reports()
        self.inbox = Inbox({PLANE_STATE: Qos("reliable", 1000)})
        self.loop = Lockstep(
            NodeSpec(behaviour, **spec),
            self.inbox,
            {DESIRED_ABSTRACT_STATE: cast("Any", Outbox(DESIRED_ABSTRACT_STATE, self._publish))},
            cast("Any", self.reports),
            topics=(PLANE_STATE,),
            stall_timeout=stall_timeout,
            clock=RunningClock(lambda: self.now),
        )

    def _publish(self, topic: Topic, data: bytes) -> None:
        self.published.append((self.now, decode(topic.message, data).step))

    def run(self, until: float) -> None:
        activity, heard = self.loop.activity(), None
        with suppress(StopIteration):
            while True:
                topics, seconds = activity.send(heard)
                due = min((time for time, _ in self.arrivals), default=inf)
                self.now = max(self.now + 1e-6, min(self.now + seconds, due))
                while self.arrivals and self.arrivals[0][0] <= self.now:
                    self.inbox.put(PLANE_STATE, self.arrivals.pop(0)[1])
                heard = self.inbox.has(topics)
                if self.now >= until:
                    self.loop.stop()

    def events(self) -> list[str]:
        return [event for event, _ in self.reports.said]


def test_a_node_to_which_nothing_comes_may_use_the_time_and_foreign_bytes_end_it() -> None:
    times: list[float] = []
    bench = Bench(Follower(), [], on_idle=times.append)
    bench.run(2.0)
    assert len(times) > 10
    assert max(later - earlier for earlier, later in pairwise(times)) <= SLICE + 1e-9
    bench = Bench(Follower(), [])
    bench.inbox.put(PLANE_STATE, b"\0\1\0\0 something else")
    with pytest.raises(MalformedMessageError, match="malformed PlaneState"):
        bench.run(5.0)


def test_who_waits_too_long_repeats_ever_more_but_no_more_than_the_window() -> None:
    bench = Bench(Follower(), [0.001 * step for step in range(1000)])
    bench.run(30.0)
    assert [step for _, step in bench.published[:1000]] == list(range(1000))
    groups = [[step for _, step in group] for _, group in groupby(bench.published[1000:], itemgetter(0))]
    assert [len(group) for group in groups[:6]] == [1, 4, 16, 64, KEPT_STEPS, 1]
    assert all(group == list(range(1000 - len(group), 1000)) for group in groups)


@pytest.mark.parametrize(
    ("arrivals", "last_step", "timeout", "reports"),
    [
        ([0.01], 10, 5.0, [1]),
        ([0.01, 7.0], 10, 5.0, [1, None, 2]),
        ([0.0, 4.0, 8.0, 12.0, 16.0], 4, 5.0, []),
        ([], 10, 0.0, []),
    ],
)
def test_stalls_and_recoveries_are_reported(
    arrivals: list[float], last_step: int, timeout: float, reports: list[int | None]
) -> None:
    bench = Bench(Follower(last_step), arrivals, timeout)
    bench.run(30.0)
    silence = pytest.approx(5.0, abs=0.2)
    assert bench.reports.said == [
        ("recovered", {})
        if step is None
        else ("stalled", {"step": step, "missing": ("plane_sim",), "count": 1, "silence": silence})
        for step in reports
    ]


@pytest.mark.parametrize(("until", "events"), [(93.0, []), (96.0, ["stalled"])])
def test_nobody_is_silent_while_the_whole_run_is_stopped(until: float, events: list[str]) -> None:
    def stop_once(_: float) -> None:
        bench.now += 90.0 if 2.0 < bench.now < 3.0 else 0.0

    bench = Bench(Follower(), [0.01], on_idle=stop_once)
    bench.run(until)
    assert bench.events() == events


def test_what_is_silent_after_an_answer_to_a_stall_is_a_stall_of_its_own() -> None:
    """The answer makes a step, such as one without the robots that were dropped; in the next others may be silent."""
    calls: list[float] = []
    bench = Bench(Follower(), [], on_stall=lambda: calls.append(bench.now) or (desired(77),))
    bench.run(16.0)
    assert calls == pytest.approx([5.0, 10.0, 15.0], abs=0.5)
    assert bench.events() == ["stalled", "recovered"] * 3
    assert 77 in {step for _, step in bench.published}


def test_the_behaviour_is_asked_until_it_has_an_answer_to_a_stall() -> None:
    """It has none as long as somebody else is waited for; once that changes, whoever is late gets his time, too."""
    calls: list[float] = []

    def drop() -> Messages:
        calls.append(bench.now)
        return (desired(77),) if bench.now > 20.0 else ()

    bench = Bench(Follower(), [12.0], on_stall=drop)
    bench.run(23.0)
    assert calls[0] == pytest.approx(5.0, abs=0.5)
    assert not [now for now in calls if 12.0 < now < 16.9], "since 12 s it is another step that is waited for"
    assert [now for now in calls if now > 20.0] == calls[-1:]
    assert bench.events() == ["stalled", "recovered"] * 2


@pytest.mark.parametrize("finished", [False, True])
def test_a_message_that_differs_from_the_one_that_was_used_ends_the_node(finished: bool) -> None:  # noqa: FBT001
    bench = Bench(Follower(0 if finished else 5000), [0.0])
    bench.inbox.put(PLANE_STATE, encode(PlaneState(0, 0, 0.1, 0.0)))
    bench.run(0.5)
    bench.inbox.put(PLANE_STATE, encode(PlaneState(0, 0, 0.2, 0.0)))
    with pytest.raises(ConflictError, match="plane/state: two different messages of step 0; is a second swarm"):
        bench.run(1.0)


@pytest.mark.parametrize("lingers", [True, False])
def test_only_who_lingers_repeats_its_end(lingers: bool) -> None:  # noqa: FBT001
    bench = Bench(Follower(0), [0.0, 0.0], lingers=lingers)
    bench.run(8.0)
    assert (len(bench.published) > 1, bench.now >= 8.0) == (lingers, lingers)
    assert bench.events() == [], "who has finished waits for nobody"
    assert not bench.inbox.has((PLANE_STATE,)), "what is not awaited is compared"

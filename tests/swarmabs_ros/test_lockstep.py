"""The lockstep loop, driven without ROS and without waiting."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, cast

import pytest
from tests.swarmabs_ros.fakes import ANSWERS, Clock, Follower, Inbox, Outbox, Reports, desired, plane

from swarmabs_core.errors import MalformedMessageError, RunError
from swarmabs_core.messages import PLANE_STATE, Message, Messages
from swarmabs_ros import lockstep
from swarmabs_ros.lockstep import WINDOW, Lockstep, NodeSpec


@dataclass
class Bench:
    """A loop with everything around it."""

    clock: Clock
    inbox: Inbox
    reports: Reports
    published: list[tuple[float, Message]]

    def run(self, behaviour: Follower, until: float, *, stall_timeout: float = 5.0, **spec: Any) -> Lockstep:
        loop = Lockstep(
            NodeSpec(behaviour, **spec),
            self.inbox,
            {ANSWERS: cast("Any", Outbox(self.clock, ANSWERS, self.published))},
            cast("Any", self.reports),
            stall_timeout=stall_timeout,
        )
        self.clock.end, self.clock.on_end = until, loop.stop
        loop.run()
        return loop

    def steps(self) -> list[int]:
        return [message.step for _, message in self.published]

    def repetitions(self, after: float) -> list[list[int]]:
        """Return the steps published together, for every time after one."""
        groups: dict[float, list[int]] = {}
        for time, message in self.published:
            if time > after:
                groups.setdefault(time, []).append(message.step)
        return list(groups.values())

    def events(self) -> list[str]:
        return [event for event, _ in self.reports.said]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    clock = Clock()
    monkeypatch.setattr(lockstep, "time", clock)
    return Bench(clock, Inbox(clock), Reports(), [])


def test_start_comes_first_and_answers_follow_in_order(bench: Bench) -> None:
    for step in range(5):
        bench.inbox.deliver(0.01 * (step + 1), plane(step))
    bench.run(Follower(4, first=(desired(0),)), 1.0, lingers=False)
    assert bench.steps() == [0, 0, 1, 2, 3, 4]
    assert bench.published[0][0] == 0.0


def test_a_node_to_which_nothing_comes_may_use_the_time(bench: Bench) -> None:
    times: list[float] = []
    bench.run(Follower(4), 2.0, on_idle=lambda: times.append(bench.clock.monotonic()))
    assert len(times) > 10
    assert max(later - earlier for earlier, later in pairwise(times)) <= lockstep.SLICE + 1e-9


def test_everything_that_has_arrived_is_handled_without_waiting(bench: Bench) -> None:
    for step in range(3):
        bench.inbox.deliver(0.0, plane(step))
    bench.run(Follower(2), 1.0, lingers=False)
    assert [time for time, _ in bench.published] == [0.0, 0.0, 0.0]


def test_repeated_and_outdated_messages_are_not_answered_again(bench: Bench) -> None:
    for time, step in ((0.01, 0), (0.011, 0), (0.012, 1), (0.013, 0), (0.014, 2)):
        bench.inbox.deliver(time, plane(step))
    bench.run(Follower(2), 0.1, lingers=False)
    assert bench.steps() == [0, 1, 2]


def test_who_waits_too_long_repeats_ever_more(bench: Bench) -> None:
    for step in range(200):
        bench.inbox.deliver(0.001 * (step + 1), plane(step))
    bench.run(Follower(1000), 30.0)
    groups = bench.repetitions(after=0.2001)
    assert [len(group) for group in groups[:6]] == [1, 4, 16, 64, WINDOW, 1]
    assert groups[1] == [196, 197, 198, 199]
    assert all(group == sorted(group) and group[-1] == 199 for group in groups)


def test_no_more_is_kept_than_is_repeated(bench: Bench) -> None:
    for step in range(1000):
        bench.inbox.deliver(0.001 * step, plane(step))
    loop = bench.run(Follower(5000), 60.0)
    assert len(loop._sent) <= WINDOW + 1
    assert min(step for group in bench.repetitions(after=1.0) for step in group) == 1000 - WINDOW


def test_progress_ends_the_repetitions(bench: Bench) -> None:
    for step in range(20):
        bench.inbox.deliver(0.001 * step, plane(step))
    bench.inbox.deliver(10.0, plane(20))
    for step in range(21, 400):
        bench.inbox.deliver(10.0 + 0.001 * (step - 20), plane(step))
    bench.run(Follower(1000), 10.3)
    later = [message.step for time, message in bench.published if time > 10.0]
    assert later == list(range(21, 21 + len(later)))
    assert len(later) > 250


def test_a_lost_answer_is_repeated_until_the_other_side_goes_on(bench: Bench) -> None:
    """The other side repeats step 0 until it has heard the answer; here it never needs to."""
    bench.inbox.deliver(0.01, plane(0))
    bench.run(Follower(10), 3.0)
    assert set(bench.steps()) == {0}
    assert len(bench.steps()) >= 4


def test_a_stall_is_reported_once_with_what_is_missing(bench: Bench) -> None:
    bench.inbox.deliver(0.01, plane(0))
    bench.run(Follower(10), 30.0)
    assert bench.events() == ["stalled"]
    details = bench.reports.said[0][1]
    assert (details["step"], details["missing"], details["count"]) == (1, ("plane_sim",), 1)
    assert cast("float", details["silence"]) == pytest.approx(5.0, abs=0.2)


def test_recovery_is_reported_and_a_second_stall_again(bench: Bench) -> None:
    bench.inbox.deliver(0.01, plane(0))
    bench.inbox.deliver(7.0, plane(1))
    bench.run(Follower(10), 20.0)
    assert bench.events() == ["stalled", "recovered", "stalled"]
    assert bench.reports.said[2][1]["step"] == 2


def test_steps_without_a_stall_report_nothing(bench: Bench) -> None:
    for step in range(5):
        bench.inbox.deliver(4.0 * step, plane(step))
    bench.run(Follower(4), 100.0, lingers=False)
    assert bench.events() == []


def test_a_timeout_of_zero_means_never(bench: Bench) -> None:
    bench.run(Follower(10), 200.0, stall_timeout=0.0)
    assert bench.events() == []


def test_what_the_behaviour_answers_to_a_stall_is_published(bench: Bench) -> None:
    calls = []

    def drop() -> Messages:
        calls.append(bench.clock.now)
        return (desired(77),)

    bench.run(Follower(10), 9.0, on_stall=drop)
    assert len(calls) == 1
    assert 77 in bench.steps()


def test_what_is_silent_after_an_answer_to_a_stall_is_a_stall_of_its_own(bench: Bench) -> None:
    """The answer makes a step, such as one without the robots that were dropped; in the next others may be silent."""
    calls = []

    def drop() -> Messages:
        calls.append(bench.clock.now)
        return (desired(77),)

    bench.run(Follower(10), 16.0, on_stall=drop)
    assert calls == pytest.approx([5.0, 10.0, 15.0], abs=0.5)
    assert bench.events() == ["stalled", "recovered"] * 3


def test_the_behaviour_is_asked_until_it_has_an_answer_to_a_stall(bench: Bench) -> None:
    """It has none as long as somebody else is waited for; once that changes, whoever is late gets his time, too."""
    calls = []
    follower = Follower(10)

    def drop() -> Messages:
        calls.append(bench.clock.now)
        return (desired(77),) if bench.clock.now > 20.0 else ()

    bench.inbox.deliver(12.0, plane(0))
    bench.run(follower, 23.0, on_stall=drop)
    assert calls[0] == pytest.approx(5.0, abs=0.5)
    assert not [now for now in calls if 12.0 < now < 16.9], "since 12 s it is another step that is waited for"
    assert [now for now in calls if now > 20.0] == calls[-1:]
    assert 77 in bench.steps()
    assert bench.events() == ["stalled", "recovered"] * 2


@pytest.mark.parametrize("lingers", [True, False])
def test_only_who_lingers_repeats_its_end(bench: Bench, lingers: bool) -> None:  # noqa: FBT001
    bench.inbox.deliver(0.0, plane(0))
    bench.run(Follower(0), 5.0, lingers=lingers)
    assert (len(bench.steps()) > 1) is lingers
    assert bench.events() == [], "who has finished waits for nobody"
    assert (bench.clock.now >= 5.0) is lingers


def test_a_behaviour_that_refuses_ends_the_loop(bench: Bench) -> None:
    class Refusing(Follower):
        def handle(self, message: Message) -> Messages:
            raise RunError(f"step {message.step}: no")

    bench.inbox.deliver(0.0, plane(3))
    with pytest.raises(RunError, match="step 3: no"):
        bench.run(Refusing(10), 5.0)


def test_foreign_bytes_end_the_loop(bench: Bench) -> None:
    bench.inbox.arrivals.append((0.0, PLANE_STATE, b"\0\1\0\0 something else"))
    with pytest.raises(MalformedMessageError, match="malformed PlaneState"):
        bench.run(Follower(10), 5.0)


def test_stop_ends_a_loop_that_waits(bench: Bench) -> None:
    bench.run(Follower(10), 2.0)
    assert 2.0 <= bench.clock.now < 2.0 + lockstep.SLICE


def test_what_is_not_awaited_yet_is_left_for_later(bench: Bench) -> None:
    bench.inbox.deliver(0.0, plane(0))
    bench.inbox.deliver(0.0, plane(1))
    behaviour = Follower(0)
    bench.run(behaviour, 1.0, lingers=False)
    assert behaviour.step == 1
    assert len(bench.inbox.arrivals) == 1

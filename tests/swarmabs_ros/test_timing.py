"""Steps by the clock, and the histogram of their lateness, with clocks that the tests set."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import pytest
from hypothesis import given, strategies as st

from swarmabs_core.realtime.base import MOST_BACK, Schedule
from swarmabs_ros.timing import BINS, JUMP, Lateness, Reading, StepClock

PERIOD = 10_000_000
EPOCH = 1_700_000_000_000_000_000
SCHEDULE = Schedule(PERIOD, EPOCH)


@dataclass
class Clocks:
    """A system clock that can be set, and a steady one."""

    system: int = EPOCH
    steady: int = 77

    def read(self) -> Reading:
        return Reading(self.system, self.steady)

    def pass_by(self, nanoseconds: int) -> None:
        self.system += nanoseconds
        self.steady += nanoseconds


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


@pytest.mark.parametrize("phase", [0.0, 0.5, 0.75])
def test_steps_are_due_at_their_phase_and_once(phase: float) -> None:
    clock, clocks = started(phase, EPOCH + 3 * PERIOD + PERIOD // 4)
    first = 4 if phase == 0.0 else 3
    for step in range(first, first + 5):
        assert next_step(clock, clocks) == step
        assert clocks.system == EPOCH + step * PERIOD + round(phase * PERIOD)
    assert (clock.missed, clock.lateness.count, clock.lateness.longest) == (0, 5, 0)


def test_nothing_is_due_before_the_epoch() -> None:
    clock, clocks = started(0.0, EPOCH - 10**12)
    assert clock.wait(clocks.read()) == 10**12
    assert next_step(clock, clocks) == 0


def test_who_comes_late_makes_the_newest_step_and_counts_those_missed() -> None:
    clock, clocks = started()
    assert next_step(clock, clocks) == 1
    clocks.pass_by(3 * PERIOD + 1234)
    assert clock.due(clocks.read()) == 4
    assert clock.due(clocks.read()) is None
    assert clock.missed == 2
    assert clock.lateness.longest == 2 * PERIOD + 1234


def test_a_clock_set_forward_skips_steps_that_are_not_missed() -> None:
    clock, clocks = started()
    assert next_step(clock, clocks) == 1
    clocks.system += 3_600_000_000_000
    assert clock.due(clocks.read()) == 1 + 360_000
    assert next_step(clock, clocks) == 2 + 360_000
    assert (clock.missed, clock.jumps, clock.largest_jump) == (0, 1, 3_600_000_000_000)
    assert clock.lateness.longest < PERIOD


@pytest.mark.parametrize("back", [JUMP + 1, PERIOD, 2 * PERIOD])
def test_a_clock_set_back_a_little_makes_no_step_again(back: int) -> None:
    clock, clocks = started()
    assert [next_step(clock, clocks) for _ in range(3)] == [1, 2, 3]
    clocks.system -= back
    assert next_step(clock, clocks) == 4
    assert (clock.missed, clock.jumps, clock.largest_jump) == (0, 1, -back)


def test_a_clock_set_back_far_makes_a_step_at_once_and_goes_on_from_there() -> None:
    clock, clocks = started(0.0, EPOCH + 100 * PERIOD)
    assert [next_step(clock, clocks) for _ in range(3)] == [101, 102, 103]
    clocks.system -= 50 * PERIOD
    clocks.pass_by(PERIOD // 2)
    assert clock.due(clocks.read()) == 53
    assert [next_step(clock, clocks) for _ in range(3)] == [54, 55, 56]
    assert (clock.missed, clock.jumps, clock.largest_jump) == (0, 1, -50 * PERIOD)


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
    expected: dict[int, int] = {}
    for value in values:
        edge = 2 ** bisect_right(edges, max(0, value))
        expected[edge] = expected.get(edge, 0) + 1
    assert lateness.bins() == dict(sorted(expected.items()))
    assert lateness.count == len(values)
    assert lateness.longest == max([0, *values])


@given(st.lists(st.integers(0, 10**12), min_size=1, max_size=100), st.sampled_from([0.5, 0.9, 0.999, 1.0]))
def test_a_share_of_the_values_is_below_its_bound(values: list[int], share: float) -> None:
    lateness = Lateness()
    for value in values:
        lateness.add(value)
    bound = lateness.below(share)
    assert sum(value <= bound * 1000 for value in values) >= share * len(values)
    assert sum(2 * value + 2000 > bound * 1000 for value in values) >= (1.0 - share) * len(values)


def test_nothing_is_below_nothing() -> None:
    assert Lateness().below(0.999) == 0

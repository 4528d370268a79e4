"""When a node repeats itself, and how much."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from swarmabs_ros.lockstep import FIRST, LONGEST, WINDOW, Repeater


def silence(repeater: Repeater, now: float, count: int) -> list[tuple[float, int]]:
    """Return times and sizes of the next repetitions if nothing comes."""
    found = []
    for _ in range(count):
        now += repeater.wait(now)
        found.append((now, repeater.due(now)))
    return found


def test_nothing_is_repeated_before_its_time() -> None:
    repeater = Repeater(10.0)
    assert repeater.due(10.0) == 0
    assert repeater.due(10.0 + 0.99 * repeater.wait(10.0)) == 0


def test_windows_and_intervals_grow_to_their_bounds() -> None:
    repetitions = silence(Repeater(0.0), 0.0, 30)
    sizes = [size for _, size in repetitions]
    assert sizes[:7] == [1, 4, 16, 64, WINDOW, 1, 4]
    times = [time for time, _ in repetitions]
    gaps = [after - before for before, after in pairwise(times)]
    assert gaps == sorted(gaps)
    assert gaps[-1] == pytest.approx(LONGEST)


def test_progress_starts_the_windows_anew() -> None:
    repeater = Repeater(0.0)
    assert [size for _, size in silence(repeater, 0.0, 3)] == [1, 4, 16]
    repeater.progress(5.0)
    assert repeater.due(5.0) == 0
    assert [size for _, size in silence(repeater, 5.0, 3)] == [1, 4, 16]


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


def test_everything_is_repeated_before_the_silence_counts_as_a_stall() -> None:
    for usual in (0.001, 0.01, 0.05, 0.1):
        repeater = Repeater(0.0)
        now = stepping(repeater, [usual] * 300)
        assert next(time for time, size in silence(repeater, now, 20) if size == WINDOW) - now < 5.0


@pytest.mark.parametrize(("usual", "wait"), [(0.001, FIRST), (0.02, 0.08), (0.1, 0.4), (0.2, 0.8), (3.0, LONGEST)])
def test_a_slow_run_repeats_later_than_a_fast_one(usual: float, wait: float) -> None:
    repeater = Repeater(0.0)
    now = stepping(repeater, [usual] * 500)
    assert repeater.wait(now) == pytest.approx(wait, rel=0.1)


def test_a_run_that_becomes_slow_is_not_flooded_for_long() -> None:
    repeater = Repeater(0.0)
    now = stepping(repeater, [0.01] * 100)
    now = stepping(repeater, [0.1] * 30, now)
    assert repeater.wait(now) > 0.2


def test_lost_messages_do_not_make_the_run_ever_slower() -> None:
    """A loss delays a step by the wait for the repetition; that must not lengthen the next wait."""
    repeater = Repeater(0.0)
    now = 0.0
    for step in range(2000):
        loss = step % 7 == 0
        now = stepping(repeater, [repeater.wait(now) + 0.001 if loss else 0.001], now)
    assert repeater.wait(now) == pytest.approx(FIRST)


def test_silence_counts_from_the_last_progress_whatever_was_repeated() -> None:
    repeater = Repeater(1.0)
    assert repeater.silence(3.0) == pytest.approx(2.0)
    silence(repeater, 1.0, 5)
    assert repeater.silence(9.0) == pytest.approx(8.0)
    repeater.progress(9.5)
    assert repeater.silence(10.0) == pytest.approx(0.5)


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
        assert due in {0, 1, 4, 16, 64, WINDOW}
        assert due <= WINDOW
        assert (FIRST - 1e-9 if due else 0.0) <= repeater.wait(now) <= LONGEST + 1e-9


def test_a_large_swarm_is_more_patient_and_repeats_less() -> None:
    repetitions = silence(Repeater(0.0, first=0.4, most=20), 0.0, 5)
    assert repetitions[0][0] == pytest.approx(1.6)
    assert [size for _, size in repetitions] == [1, 4, 16, 20, 1]

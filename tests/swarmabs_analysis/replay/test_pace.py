"""When messages of a playback are due."""

from __future__ import annotations

from itertools import islice

import pytest

from swarmabs_analysis.replay.playback import Pace

SECOND = 1_000_000_000
FIRST = 5 * SECOND
BAG = [(FIRST + number * SECOND // 10, number) for number in range(11)]
"""Eleven messages in one second of a bag that begins at 5 s."""


def test_messages_are_due_at_their_recorded_times_over_the_rate() -> None:
    for rate in (0.5, 1.0, 4.0):
        schedule = list(Pace(rate).schedule(FIRST, lambda: BAG))
        assert [number for _, number in schedule] == list(range(11))
        assert [due for due, _ in schedule] == pytest.approx([number / 10 / rate for number in range(11)])


def test_a_part_begins_at_once() -> None:
    schedule = list(Pace(2.0, start=0.3, duration=0.4).schedule(FIRST, lambda: BAG))
    assert [number for _, number in schedule] == [3, 4, 5, 6, 7]
    assert [due for due, _ in schedule] == pytest.approx([0.0, 0.05, 0.1, 0.15, 0.2])


def test_a_loop_begins_again_when_the_last_message_was_due_and_does_not_drift() -> None:
    schedule = list(islice(Pace(start=0.8, loop=True).schedule(FIRST, lambda: BAG), 3000))
    assert [number for _, number in schedule[:7]] == [8, 9, 10, 8, 9, 10, 8]
    assert schedule[-1][0] == pytest.approx(1000 * 0.2)


def test_an_empty_part_ends_even_in_a_loop() -> None:
    assert list(Pace(start=7.0, loop=True).schedule(FIRST, lambda: BAG)) == []


def test_times_that_go_back_do_not_reorder() -> None:
    bag = [(FIRST + SECOND, "a"), (FIRST, "b"), (FIRST + 2 * SECOND, "c")]
    assert list(Pace().schedule(FIRST, lambda: bag)) == [(1.0, "a"), (1.0, "b"), (2.0, "c")]

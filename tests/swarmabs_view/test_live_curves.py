"""Curves of something that grows, and what someone lacks who has a part of them."""

from __future__ import annotations

from itertools import pairwise

from swarmabs_bag.swarm_state import Abstract, Instant
from swarmabs_view.live import CurveBuffer


def point(step: int) -> Instant:
    return Instant(step, 0, step / 100, step * 0.5, 0.0, None, Abstract(1.0, 3.0), Abstract(2.0, 4.0))


def test_points_follow_each_other_and_those_who_have_them_get_the_rest() -> None:
    buffer = CurveBuffer()
    for step in (0, 1, 2):
        buffer.add(point(step))
    first = buffer.since(-1, 0)
    assert first is not None
    assert first.replace
    assert first.time == [0.0, 0.01, 0.02]
    assert first.reference == [None] * 3
    known = (buffer.epoch, len(buffer))
    assert buffer.since(*known) is None
    buffer.add(point(3))
    more = buffer.since(*known)
    assert more is not None
    assert not more.replace
    assert more.angle == [1.5]


def test_a_step_that_is_past_is_no_new_point() -> None:
    buffer = CurveBuffer()
    for step in (0, 5, 5, 3):
        buffer.add(point(step))
    assert len(buffer) == 2


def test_there_are_never_more_points_than_allowed_and_they_are_evenly_spread() -> None:
    buffer = CurveBuffer(most=100)
    shown: list[float] = []
    epoch, count = -1, 0
    for step in range(10_000):
        buffer.add(point(step))
        assert len(buffer) <= 100
        if step % 37 == 0:  # a page that follows
            found = buffer.since(epoch, count)
            epoch, count = buffer.epoch, len(buffer)
            if found is not None:
                shown = found.time if found.replace else shown + found.time
    last = buffer.since(epoch, count)
    if last is not None:
        shown = last.time if last.replace else shown + last.time
    whole = buffer.since(-1, 0)
    assert whole is not None
    assert shown == whole.time
    steps = [round(time * 100) for time in whole.time]
    assert steps[0] == 0
    assert {later - earlier for earlier, later in pairwise(steps)} == {128}
    assert steps[-1] > 9_800


def test_nobody_gets_anything_of_nothing() -> None:
    empty = CurveBuffer().since(-1, 0)
    assert empty is not None
    assert empty.time == []

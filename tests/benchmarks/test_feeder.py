"""What feeds the recorder when it is measured alone."""

from __future__ import annotations

import pytest
from benchmarks.feeder import FEWEST, IN_FLIGHT, MOST, Feeder

from swarmabs_core.messages import NEVER, RECORDING_PROGRESS, PlaneState, RecordingProgress


def steps(count: int, each: int) -> list[list[PlaneState]]:
    return [[PlaneState(0, step, 0.0, 0.0)] * each for step in range(count)]


def credit(step: int) -> RecordingProgress:
    return RecordingProgress(0, 0, step)


@pytest.mark.parametrize(("each", "window"), [(1, MOST), (IN_FLIGHT // 20, 20), (IN_FLIGHT, FEWEST)])
def test_no_more_is_on_its_way_than_a_buffer_holds(each: int, window: int) -> None:
    feeder = Feeder(steps(1000, each))
    assert len(feeder.start()) == window * each
    assert {message.step for message in feeder.handle(credit(9))} == set(range(window, window + 10))


def test_what_is_credited_twice_or_not_at_all_moves_nothing() -> None:
    feeder = Feeder(steps(1000, 1))
    feeder.start()
    assert feeder.handle(credit(NEVER)) == ()
    assert len(feeder.handle(credit(9))) == 10
    assert feeder.handle(credit(9)) == ()
    assert feeder.missing() == (10, ("recorder",))


def test_it_has_finished_when_everything_is_recorded() -> None:
    feeder = Feeder(steps(30, 1))
    assert len(feeder.start()) == 30
    assert feeder.awaits() == (RECORDING_PROGRESS,)
    assert feeder.handle(credit(29)) == ()
    assert feeder.awaits() == ()

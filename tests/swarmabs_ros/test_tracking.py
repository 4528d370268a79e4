"""What is believed of a sensor, and what is not."""

from __future__ import annotations

from math import exp, inf, nan

import pytest
from tests.swarmabs_ros.bodies import EPOCH, SECOND

from swarmabs_ros.readings import SETTLING, RefusedReadingError, RefusedReadings, Sample, Track

MS = 1_000_000
BANDWIDTH = 50.0


@pytest.fixture
def track() -> Track:
    return Track(2.0, 0.01, 0.02, BANDWIDTH)


def refusal(track: Track, stamp: int, value: float, rate: float | None = 0.0, now: int | None = None) -> str:
    """Offer what is to be refused; return the reason."""
    before = track.newest
    with pytest.raises(RefusedReadingError) as caught:
        track.offer(stamp, value, rate, stamp if now is None else now)
    assert track.newest == before
    return caught.value.reason


def test_the_newest_is_kept(track: Track) -> None:
    assert track.newest is None
    track.offer(EPOCH, 0.1, 0.5, EPOCH)
    track.offer(EPOCH + 10 * MS, 0.105, 0.4, EPOCH + 12 * MS)
    assert track.newest == Sample(EPOCH + 10 * MS, 0.105, 0.4)


@pytest.mark.parametrize(("value", "rate"), [(nan, 0.0), (inf, 0.0), (0.0, nan), (0.0, -inf), (nan, None)])
def test_what_is_no_number_is_refused(track: Track, value: float, rate: float | None) -> None:
    assert refusal(track, EPOCH, value, rate) == "not finite"


@pytest.mark.parametrize("age", [0, 1, 10 * MS])
def test_what_is_not_newer_is_refused(track: Track, age: int) -> None:
    track.offer(EPOCH, 0.1, 0.0, EPOCH)
    assert refusal(track, EPOCH - age, 0.1, now=EPOCH) == "order"


def test_the_future_is_refused_beyond_the_tolerance(track: Track) -> None:
    assert refusal(track, EPOCH + 20 * MS + 1, 0.1, now=EPOCH) == "future"
    track.offer(EPOCH + 20 * MS, 0.1, 0.0, EPOCH)


def test_a_message_without_stamp_is_refused(track: Track) -> None:
    assert refusal(track, 0, 0.1, now=EPOCH) == "no stamp"


def test_a_clock_that_is_set_back_does_not_silence_the_sensor_for_good(track: Track) -> None:
    track.offer(EPOCH, 0.1, 0.0, EPOCH)
    earlier = EPOCH - 3600 * SECOND
    track.offer(earlier, 0.1, 0.0, earlier)
    assert track.newest == Sample(earlier, 0.1, 0.0)


def test_a_jump_is_refused_and_believed_when_there_was_time_for_it(track: Track) -> None:
    """With 2 m/s and 0.01 m, a place 0.5 m away is believed 0.245 s later."""
    track.offer(EPOCH, 0.0, 0.0, EPOCH)
    for late in range(10, 245, 10):
        assert refusal(track, EPOCH + late * MS, 0.5) == "jump"
    track.offer(EPOCH + 246 * MS, 0.5, 0.0, EPOCH + 246 * MS)
    assert track.newest == Sample(EPOCH + 246 * MS, 0.5, 0.0)


def test_a_rate_beyond_what_is_possible_is_refused(track: Track) -> None:
    assert refusal(track, EPOCH, 0.0, 2.1) == "speed"
    assert refusal(track, EPOCH, 0.0, -2.1) == "speed"


def test_a_straight_line_is_differentiated_as_the_filter_s_equation_says(track: Track) -> None:
    """r' = w (x' - r), r(0) = 0, x' = 0.3: r = 0.3 (1 - exp(-w t)), whatever the intervals."""
    times = [0, 3, 10, 17, 18, 40, 60, 90, 100, 120, 121, 150, 200]
    for time in times:
        track.offer(EPOCH + time * MS, 0.3 * time / 1000, None, EPOCH + time * MS)
        settled = time / 1000 >= SETTLING / BANDWIDTH
        assert (track.newest is not None) == settled
        if track.newest is not None:
            assert track.newest.rate == pytest.approx(0.3 * (1.0 - exp(-BANDWIDTH * time / 1000)), rel=1e-12)


def test_a_place_that_was_jumped_to_gives_no_rate(track: Track) -> None:
    for time in range(0, 200, 10):
        track.offer(EPOCH + time * MS, 0.0, None, EPOCH + time * MS)
    found = []
    for time in range(200, 700, 10):
        try:
            track.offer(EPOCH + time * MS, 0.4, None, EPOCH + time * MS)
        except RefusedReadingError:
            continue
        found.append(track.newest)
    assert found[0] is None
    assert found[-1] == Sample(EPOCH + 690 * MS, 0.4, 0.0)
    assert {each.rate for each in found if each is not None} == {0.0}


def test_refusals_are_counted_by_reason() -> None:
    refusals = RefusedReadings()
    assert refusals.values() == ()
    for reason in ("jump", "frame", "jump"):
        refusals.add(RefusedReadingError(reason, f"a {reason}"))
    assert refusals.values() == (
        ("readings refused, frame", "1"),
        ("readings refused, jump", "2"),
        ("last reading refused", "a jump"),
    )

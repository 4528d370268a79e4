"""Which robots leave the ranges of their coordinates: what is told when, and what follows for the run."""

from math import inf, nan

import pytest

from swarmabs_core.messages import EventKind, SwarmEvent
from swarmabs_core.ranges import ASSUMED, RangeMonitor, Strays, crossing_of, lane, reason_of, texts_of
from swarmabs_core.systems import Quantity

LANE = lane(1.0)


def told(ranges: tuple[Quantity, ...], path: list[tuple[float, ...]], robot: int = 1) -> list[tuple[int, float, str]]:
    """Return step, value and detail of the events of a robot that moves along a path, a step each."""
    monitor = RangeMonitor(ranges)
    events = [event for step, q in enumerate(path) for event in monitor.watch([(robot, q)], step, step * 10)]
    assert all((e.stamp, e.agent_id, e.kind) == (10 * e.step, robot, EventKind.LIMIT_HIT) for e in events)
    return [(event.step, event.value, event.detail) for event in events]


def on_line(*places: float) -> list[tuple[float, ...]]:
    return [(place,) for place in places]


def test_leaving_flying_off_and_returning_are_told_once_each() -> None:
    path = on_line(0.4, 0.5, 0.51, 0.9, 1.01, 3.0, 0.6, 0.5, 0.3, -0.6, -1.1, 0.0)
    assert told(LANE, path) == [
        (2, 0.51, "out of range: position above 0.5 m"),
        (4, 1.01, "far out of range: position above 0.5 m"),
        (7, 0.5, "back in range: position"),
        (9, -0.6, "out of range: position below -0.5 m"),
        (10, -1.1, "far out of range: position below -0.5 m"),
        (11, 0.0, "back in range: position"),
    ]
    assert [detail for *_, detail in told(LANE, on_line(0.0, 7.0))] == ["far out of range: position above 0.5 m"]


def test_a_robot_that_dithers_around_its_bound_is_told_once() -> None:
    dither = on_line(*(0.5 + 0.004 * (-1) ** k for k in range(1000)))
    assert len(told(LANE, dither)) == 2, "out and back"
    assert len(told(LANE, [*dither, (0.0,), *dither])) == 4, "once it was well inside, it is told again"
    assert len(told(LANE, [*dither, (0.52,)])) == 3, "and if it goes further than it dithers"


def test_each_coordinate_has_its_own_range_and_missing_bounds_are_assumed_from_scale_and_first_places() -> None:
    ranges = (Quantity("x", "m", low=0.0), Quantity("thrust", "N", scale=0.1))
    start = (0.5, 3.0)
    path = [start, (99.0, 299.0), (101.5, 301.0), (-0.1, -299.0), (-2.0, -310.0)]
    assert told(ranges, path) == [
        (2, 101.5, f"far out of range: x above {ASSUMED:g} m, as assumed"),
        (2, 301.0, "out of range: thrust above 300 N, as assumed"),
        (3, -299.0, "back in range: thrust"),
        (4, -310.0, "far out of range: thrust below -300 N, as assumed"),
    ]
    (first, *_) = told(ranges, [start, (-0.1, 3.0)])
    assert first == (1, -0.1, "out of range: x below 0 m")
    late = RangeMonitor((Quantity("x", ""),))
    assert late.watch([(1, (1.0,))], 0, 0) == []
    assert late.watch([(1, (1.0,)), (2, (500.0,))], 1, 1) == [], "a robot that joins far away is not lost"
    (event,) = late.watch([(1, (5e4 + 1.0,)), (2, (500.0,))], 2, 2)
    assert event.detail == "out of range: x above 50000, as assumed"


def test_no_number_is_out_of_range() -> None:
    assert [detail.partition(":")[0] for *_, detail in told(LANE, on_line(0.0, nan, 0.0))] == [
        "far out of range",
        "back in range",
    ]
    assert told(LANE, on_line(0.0, inf))[0][1] == inf


@pytest.mark.parametrize("beyond", [0.0, 1e-6])
def test_nothing_is_told_of_a_robot_between_two_borders(beyond: float) -> None:
    borders = RangeMonitor(LANE).borders()
    assert borders == sorted(borders)
    for low, high in zip([-7.0, *borders], [*borders, 7.0], strict=True):
        inner = [low + beyond + (high - low) * 1e-3 * k for k in range(1, 999)]
        for first in (0.0, 0.6, 3.0):
            assert len(told(LANE, on_line(first, *inner))) == len(told(LANE, on_line(first, inner[0])))


def test_it_is_quiet_while_no_robot_can_cross_an_end() -> None:
    monitor = RangeMonitor(LANE)
    assert monitor.quiet(0.5)
    assert not monitor.quiet(0.51)
    assert not monitor.quiet(nan)
    monitor.watch([(1, (0.6,))], 0, 0)
    assert not monitor.quiet(0.1), "a robot has to return"
    assumed = RangeMonitor((Quantity("x", ""),))
    assert not assumed.quiet(0.0, same=True), "first places count"
    assumed.watch([(1, (2.0,))], 0, 0)
    assert assumed.quiet(200.0, same=True)
    assert not assumed.quiet(200.1, same=True)
    assert not assumed.quiet(0.0), "another robot may come"


def event(step: int, robot: int, detail: str, value: float = 0.0, kind: EventKind = EventKind.LIMIT_HIT) -> SwarmEvent:
    return SwarmEvent(0, step, robot, kind, value, detail)


OUT, FAR, BACK = "out of range: p above 0.5 m", "far out of range: p above 0.5 m", "back in range: p"


@pytest.mark.parametrize(
    ("events", "flown", "texts", "clear"),
    [
        ([], [], [], 0.0),
        ([event(3, 1, "command limited")], [], [], 0.0),
        ([event(3, 1, "off the plane's end", 0.6)], [], [], 0.0),  # of an earlier version
        (
            [event(3, 1, OUT, 0.6), event(5, 1, BACK)],
            [],
            ["robot 1 was out of range: p above 0.5 m, from step 3 to 5"],
            5.0,
        ),
        (
            [event(3, 1, OUT, 0.6)],
            [1],
            ["robot 1 is out of range at the end: p above 0.5 m since step 3"],
            None,
        ),
        (
            [event(3, 2, OUT, 0.6), event(4, 2, FAR, 1.5), event(7, 2, BACK), event(1, 1, OUT), event(2, 1, BACK)],
            [2],
            [
                "robot 2 flew off: p above 0.5 m since step 3, 1.5 at step 4",
                "robot 1 was out of range: p above 0.5 m, from step 1 to 2",
            ],
            None,
        ),
        (
            [event(3, 1, OUT), event(9, 1, "remove", kind=EventKind.LEFT)],
            [],
            ["robot 1 was out of range: p above 0.5 m, from step 3 to 9"],
            9.0,
        ),
        (
            [event(3, 1, OUT), event(9, 1, "kill", kind=EventKind.DEAD)],
            [1],
            ["robot 1 is out of range at the end: p above 0.5 m since step 3"],
            None,
        ),
    ],
)
def test_what_events_tell_of_the_robots_of_a_run(
    events: list[SwarmEvent], flown: list[int], texts: list[str], clear: float | None
) -> None:
    strays = Strays()
    for each in events:
        strays.hear(each, float(each.step))
    assert [stray.robot for stray in strays.flown] == flown
    assert [stray.text for stray in strays.all] == texts
    assert strays.clear_from == clear


def test_the_reason_of_a_failed_run_names_the_first_robot_and_counts_the_others() -> None:
    first = "robot 1 is out of range at the end: p above 0.5 m since step 3"
    for robots, others, untold in ((1, "", 0), (2, "; 1 more robot likewise", 0), (7, "; 6 more robots likewise", 2)):
        summary = Strays(event(3, robot, OUT) for robot in range(1, robots + 1)).summary()
        assert (summary["robots"], summary["flown_off"]) == (robots, robots)
        assert reason_of(summary) == first + others
        more = [f"{untold} more robots were out of range"] if untold else []
        assert texts_of(summary)[0] == first
        assert [*texts_of(summary)[5:]] == more
    back = Strays([event(3, 1, OUT), event(5, 1, BACK)]).summary()
    assert (reason_of(back), reason_of({}), texts_of({})) == ("", "", ())


def test_crossings_are_read_as_they_are_told() -> None:
    assert crossing_of(event(0, 1, FAR)) == ("far out of range", "p", "above 0.5 m")
    assert crossing_of(event(0, 1, BACK)) == ("back in range", "p", "")
    assert crossing_of(event(0, 0, OUT)) is None, "of no robot"
    assert crossing_of(event(0, 1, OUT, kind=EventKind.REFUSED)) is None

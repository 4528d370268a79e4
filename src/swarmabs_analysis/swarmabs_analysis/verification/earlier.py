"""The events about robots beyond the ends of the plane as versions before the ranges of coordinates told them."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

from swarmabs_core.events import EventCode, code_of
from swarmabs_core.messages import SwarmEvent
from swarmabs_core.ranges import RangeMonitor, crossing_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.systems import Quantity


def are_earlier(events: Iterable[SwarmEvent], scenario: Scenario) -> bool:
    """Return whether the events of a run are those of such a version: the first about a robot out of range decides.

    If there is none, they are, unless the parent system states ends of coordinates, as only later versions can.
    """
    for event in events:
        if crossing_of(event) is not None:
            return False
        if code_of(event) is EventCode.OFF_END:
            return True
    return not any(isfinite(end) for row in scenario.tables.robot for end in (row.low, row.high))


class EarlierEnds(RangeMonitor):
    """Tells of robots that have just crossed an end of the plane; on other parent systems of none."""

    def __init__(self, ranges: Sequence[Quantity]) -> None:
        super().__init__(ranges)
        self._lane = ranges
        self._outside: set[int] = set()

    def watch(self, robots: Iterable[tuple[int, Sequence[float]]], step: int, stamp: int) -> list[SwarmEvent]:
        """Return the events of a step; see `RangeMonitor.watch`."""
        places = {robot: q[0] for robot, q in robots if not self._assumes and abs(q[0]) > self._lane[0].high}
        new = places.keys() - self._outside
        self._outside = {*places}
        return [EventCode.OFF_END.event(stamp, step, places[i], robot=i) for i in sorted(new)]

"""The ranges of the robots' coordinates: which robots leave theirs, and the events that tell it.

Of the plane the range is its length; another parent system may state the ends of each coordinate of its robots. Where
it states none, one is assumed, so large that only robots out of control leave it.
"""

from __future__ import annotations

from enum import Enum
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_core.events import EventCode, code_of
from swarmabs_core.messages import EventKind, SwarmEvent
from swarmabs_core.systems.interface import Quantity

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

ASSUMED = 100.0
"""An assumed end, in units of the largest of the coordinate's scale, the other end, and the first places of the robots.

A run fails if a robot stays beyond it, so it must be far from what any sound system does.
"""
_ASSUMED = ", as assumed"
"""What events say of an end that is not stated."""
_MARGIN = 0.02
"""Way from an end, as a part of half the range, within which a robot that has returned may dither untold."""


def lane(length: float) -> tuple[Quantity, ...]:
    """Return the coordinate of robots on a plane of a length (m), with its ends (eq. swarmStateConstraint)."""
    return (Quantity("position", "m", low=-0.5 * length, high=0.5 * length),)


class Phase(str, Enum):
    """How a coordinate of a robot has crossed the end of its range."""

    OUT = "out of range"
    FAR = "far out of range"  # as far beyond an end as half the range is long
    BACK = "back in range"


_CODES = {
    Phase.OUT: EventCode.OUT_OF_RANGE,
    Phase.FAR: EventCode.FAR_OUT_OF_RANGE,
    Phase.BACK: EventCode.BACK_IN_RANGE,
}
_PHASES = {code: phase for phase, code in _CODES.items()}


class Crossing(NamedTuple):
    """What an event tells of a robot: phase, coordinate, and where it is beyond its range, such as "above 0.5 m"."""

    phase: Phase
    coordinate: str
    where: str


def crossing_of(event: SwarmEvent) -> Crossing | None:
    """Return how a robot has crossed the end of a range by an event; None for other events."""
    code = code_of(event)
    if code is None or code not in _PHASES or not event.agent_id:
        return None
    coordinate, _, where = code.read(event)["where"].partition(" ")
    return Crossing(_PHASES[code], coordinate, where)


class _Ends(NamedTuple):
    """The ends of a range, and what lies as far beyond them as half the range, or else its unit, is long."""

    low: float
    high: float
    reach: float

    @classmethod
    def of(cls, stated: Quantity, first: float) -> _Ends:
        """Return the ends; `first` is the largest absolute coordinate of any robot in its first state."""
        ends = [abs(end) for end in (stated.low, stated.high) if isfinite(end)]
        unit = max(stated.scale, first, *ends)
        low = stated.low if isfinite(stated.low) else -ASSUMED * unit
        high = stated.high if isfinite(stated.high) else ASSUMED * unit
        return cls(low, high, 0.5 * (high - low) if len(ends) == 2 else unit)

    @property
    def margin(self) -> float:
        """Way within which a robot that has returned may dither untold."""
        return _MARGIN * self.reach

    def within(self, x: float, by: float = 0.0) -> bool:
        """Return whether a coordinate is in the range, moved outwards by a length; NaN is not."""
        return self.low - by <= x <= self.high + by


class RangeMonitor:
    """Tells which robots cross the ends of their ranges; no events follow from other robots or their order.

    Parameters
    ----------
    ranges : sequence of Quantity
        The coordinates of a robot with their ends.
    """

    def __init__(self, ranges: Sequence[Quantity]) -> None:
        self._ranges = tuple(ranges)
        self._first = [0.0] * len(self._ranges)
        self._ends = [_Ends.of(stated, 0.0) for stated in self._ranges]
        self._assumes = any(not isfinite(end) for stated in self._ranges for end in (stated.low, stated.high))
        self._known: set[int] = set()
        self._phases: dict[tuple[int, int], Phase] = {}

    def quiet(self, farthest: float, *, same: bool = False) -> bool:
        """Return whether nothing can be told of robots none of whose coordinates is beyond a distance from 0.

        The first places of robots may widen assumed ranges, unless they are the `same` robots in all steps.
        """
        inside = all(farthest <= min(-ends.low, ends.high) for ends in self._ends)
        met = not self._assumes or (same and self._known)
        return inside and bool(met) and not self._phases

    def borders(self, place: int = 0) -> list[float]:
        """Return ascending values of a coordinate: while it moves between two of them, nothing is told."""
        ends = self._ends[place]
        steps = (ends.reach, ends.margin, 0.0, -ends.margin)
        return [*(ends.low - by for by in steps), *(ends.high + by for by in reversed(steps))]

    def watch(self, robots: Iterable[tuple[int, Sequence[float]]], step: int, stamp: int) -> list[SwarmEvent]:
        """Return the events of a step, with its time stamp (ns), for robots given by their ids and coordinates."""
        robots = [*robots]
        if self._assumes:
            self._meet(robots)
        events = []
        for robot, q in robots:
            for place, (x, ends) in enumerate(zip(q, self._ends, strict=True)):
                key = (robot, place)
                if (key in self._phases or not ends.within(x)) and (phase := self._crossed(key, x, ends)) is not None:
                    where = self._said(phase, self._ranges[place], x, ends)
                    events.append(_CODES[phase].event(stamp, step, x, robot=robot, where=where))
        return events

    def _meet(self, robots: Sequence[tuple[int, Sequence[float]]]) -> None:
        """Widen the assumed ranges by the first places of robots."""
        for robot, q in robots:
            if robot not in self._known:
                self._known.add(robot)
                self._first = [max(first, abs(x)) for first, x in zip(self._first, q, strict=True)]
                self._ends = [_Ends.of(*pair) for pair in zip(self._ranges, self._first, strict=True)]

    def _crossed(self, key: tuple[int, int], x: float, ends: _Ends) -> Phase | None:
        """Return the phase that a coordinate enters, if it is to be told."""
        before = self._phases.get(key)
        far, inside = not ends.within(x, ends.reach), ends.within(x)
        entered: Phase | None = None
        if before in (Phase.OUT, Phase.FAR):
            entered = Phase.BACK if inside else Phase.FAR if far and before is Phase.OUT else None
        elif far:
            entered = Phase.FAR
        elif not ends.within(x, ends.margin if before is Phase.BACK else 0.0):
            entered = Phase.OUT
        elif ends.within(x, -ends.margin):
            self._phases.pop(key, None)
        if entered is not None:
            self._phases[key] = entered
        return entered

    @staticmethod
    def _said(phase: Phase, of: Quantity, x: float, ends: _Ends) -> str:
        if phase is Phase.BACK:
            return of.name
        side, end, stated = ("below", ends.low, of.low) if x < ends.low else ("above", ends.high, of.high)
        assumed = "" if isfinite(stated) else _ASSUMED
        return f"{of.name} {side} {f'{end:g} {of.unit}'.rstrip()}{assumed}"


class Stray(NamedTuple):
    """A robot that has left the range of a coordinate.

    Attributes
    ----------
    where : str
        Where it was beyond the range, such as "above 0.5 m".
    since : int
        Step at which it left the range the last time before it flew off, or else before the end.
    far : tuple of int and float, or None
        Step at which it was far out of range the first time, with the coordinate.
    back : int or None
        Step at which it returned, or was taken away.
    """

    robot: int
    coordinate: str
    where: str
    since: int
    far: tuple[int, float] | None = None
    back: int | None = None

    @property
    def flown(self) -> bool:
        """Whether it was far out of range, or has not returned: the run has failed."""
        return self.far is not None or self.back is None

    @property
    def text(self) -> str:
        """What has happened, in a line."""
        what = f"{self.coordinate} {self.where}"
        if self.far is not None:
            step, value = self.far
            return f"robot {self.robot} flew off: {what} since step {self.since}, {value:.4g} at step {step}"
        if self.back is None:
            return f"robot {self.robot} is out of range at the end: {what} since step {self.since}"
        return f"robot {self.robot} was out of range: {what}, from step {self.since} to {self.back}"


class Strays:
    """The robots that have left their ranges, by the events of a run in lockstep, or one after the other."""

    def __init__(self, events: Iterable[SwarmEvent] = ()) -> None:
        self._found: dict[tuple[int, str], Stray] = {}
        self._clear_from = 0.0
        for event in events:
            self.hear(event, event.stamp / 1e9)

    def hear(self, event: SwarmEvent, time: float) -> None:
        """Take the next event; `time` is that of its step, s."""
        if event.kind == EventKind.LEFT:
            for key, stray in self._found.items():
                if stray.robot == event.agent_id:
                    self._end(key, event.step, time)
            return
        if (told := crossing_of(event)) is None:
            return
        key = (event.agent_id, told.coordinate)
        latest = self._found.get(key)
        if told.phase is Phase.BACK:
            if latest is not None:
                self._end(key, event.step, time)
            return
        if latest is None or (latest.back is not None and latest.far is None):
            latest = Stray(*key, told.where, event.step)
        if told.phase is Phase.FAR and latest.far is None:
            latest = latest._replace(where=told.where, far=(event.step, event.value))
        self._found[key] = latest._replace(back=None)

    def _end(self, key: tuple[int, str], step: int, time: float) -> None:
        stray = self._found[key]
        if stray.back is None:
            self._found[key] = stray._replace(back=step)
            self._clear_from = max(self._clear_from, time)

    @property
    def all(self) -> list[Stray]:
        """All of them: those that flew off first, then by step and robot."""
        return sorted(self._found.values(), key=lambda stray: (not stray.flown, stray.since, stray[:2]))

    @property
    def flown(self) -> list[Stray]:
        """Those that flew off, in the same order."""
        return [stray for stray in self.all if stray.flown]

    @property
    def clear_from(self) -> float | None:
        """Time, s, from which no robot is out of range any more; None if one is, or flew off."""
        return None if any(stray.flown for stray in self._found.values()) else self._clear_from

    def summary(self) -> dict[str, Any]:
        """Return numbers of robots and the first texts, as plain data; empty if no robot left its range."""
        strays = self.all
        if not strays:
            return {}
        robots, flown = ({stray.robot for stray in of} for of in (strays, self.flown))
        return {"robots": len(robots), "flown_off": len(flown), "first": [stray.text for stray in strays[:SHOWN]]}


def reason_of(summary: Mapping[str, Any]) -> str:
    """Return why a run with a summary of its strays has failed; empty if no robot flew off."""
    others = summary.get("flown_off", 0) - 1
    if others < 0:
        return ""
    first = summary["first"][0]
    more = f"; {others} more {'robot' if others == 1 else 'robots'} likewise" if others else ""
    advice = "; if the system allows that, state low and high of this coordinate" if _ASSUMED in first else ""
    return f"{first}{more}{advice}"


def texts_of(summary: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the texts of a summary of strays, with the number of robots that have none."""
    first = tuple(summary.get("first", ()))
    more = summary.get("robots", 0) - len(first)
    return (*first, *([f"{more} more robots were out of range"] if more > 0 else []))


SHOWN = 5
"""Most robots out of range that a summary describes; further ones are counted."""

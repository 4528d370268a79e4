"""A bag as the view shows it: any step of it at once, and a playback that each page controls for itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import starmap
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_bringup.report.record import read_recorded
from swarmabs_bringup.report.thinning import column_points
from swarmabs_bringup.view.curves import Point, curves
from swarmabs_bringup.view.facts import finite, scenario_facts
from swarmabs_bringup.view.picture import MOST_EVENTS, STATUS, event_of
from swarmabs_bringup.view.protocol import (
    Abstract,
    Control,
    Curves,
    Events,
    Frame,
    Hello,
    Message,
    Pause,
    Play,
    RobotStates,
    RobotStatus,
    Seek,
    Speed,
    State,
)
from swarmabs_core.messages import EventKind

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from swarmabs_bringup.report.record import Recorded
    from swarmabs_core.messages import SwarmEvent

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

COLUMNS = 1000
"""Columns of a picture of a curve; of each the first, lowest, highest and last point of every curve are sent."""
STATE_INTERVAL = 1.0
"""Longest time, s, between two messages to a page."""

_ENDS: dict[int, RobotStatus] = {EventKind.DEAD: "dead", EventKind.LEFT: "left"}


class Recording:
    """A bag, read once.

    Parameters
    ----------
    recorded : Recorded
        The bag.
    """

    def __init__(self, recorded: Recorded) -> None:
        self.recorded = recorded
        agents = recorded.arrays.agents
        wanted = np.array([agent.id for agent in recorded.scenario.agents])
        found = np.isin(wanted, agents.ids)
        self._column: Integers = np.where(found, np.searchsorted(agents.ids, wanted) * found, -1)
        # A robot that says nothing more stays where it was.
        heard = agents.status > 0
        rows = np.where(heard, np.arange(len(heard))[:, None], -1)
        self._latest: Integers = np.maximum.accumulate(rows, axis=0)
        self._ends = _ends(recorded.events)

    def __len__(self) -> int:
        return len(self.recorded.arrays.step)

    @cached_property
    def hello(self) -> Hello:
        """The first message."""
        recorded = self.recorded
        facts = scenario_facts(recorded.scenario)
        facts["last_step"] = int(recorded.arrays.step[-1]) if len(self) else 0
        return Hello(source="bag", title=recorded.scenario.name, place=str(recorded.bag), playback=True, **facts)

    @cached_property
    def curves(self) -> Curves:
        """All curves, thinned so that they look the same."""
        arrays = self.recorded.arrays
        abstract, desired = arrays.abstract, arrays.desired
        columns = (
            *(arrays.angle, self.recorded.reference, abstract.torque, desired.torque),
            *(abstract.inertia, desired.inertia),
        )
        chosen = np.arange(len(self))
        if len(self) > 2 * COLUMNS:
            column = np.arange(len(self)) * COLUMNS // len(self)
            chosen = np.unique(np.concatenate([column_points(column, values) for values in columns]))
        steps, times = arrays.step[chosen].tolist(), arrays.time[chosen].tolist()
        return curves(
            list(starmap(Point, zip(steps, times, *(numbers(values[chosen]) for values in columns), strict=True))),
            replace=True,
        )

    @cached_property
    def events(self) -> Events:
        """The latest events."""
        recorded = self.recorded
        return Events(
            replace=True, events=[event_of(one, recorded.time_of(one)) for one in recorded.events[-MOST_EVENTS:]]
        )

    def frame(self, row: int, step_rate: float | None = None) -> Frame:
        """Return what is to be seen at a row of the arrays."""
        recorded, arrays = self.recorded, self.recorded.arrays
        step = int(arrays.step[row])
        agents = arrays.agents
        # The last entry stands for robots of which the bag has nothing at all.
        latest = np.append(self._latest[row], -1)[self._column]
        there = latest >= 0
        place = (latest[there], self._column[there])
        position, velocity, command = (
            numbers(_scattered(there, values[place])) for values in (agents.position, agents.velocity, agents.command)
        )
        statuses = _scattered(there, agents.status[place].astype(float))
        robots = [agent.id for agent in recorded.scenario.agents]
        return Frame(
            step=step,
            time=float(arrays.time[row]),
            angle=finite(float(arrays.angle[row])),
            angular_velocity=finite(float(arrays.angular_velocity[row])),
            reference=finite(float(recorded.reference[row])),
            abstract=_pair(arrays.abstract.torque[row], arrays.abstract.inertia[row]),
            desired=_pair(arrays.desired.torque[row], arrays.desired.inertia[row]),
            robots=RobotStates(
                position=position,
                velocity=velocity,
                command=command,
                status=[
                    self._status(robot, int(status), row - last, step) if last >= 0 else None
                    for robot, status, last in zip(robots, statuses.tolist(), latest.tolist(), strict=True)
                ],
            ),
            step_rate=step_rate,
        )

    def row_at(self, step: int) -> int:
        """Return the row of a step, of one that is not there the row before it."""
        found = int(np.searchsorted(self.recorded.arrays.step, step, side="right")) - 1
        return min(max(found, 0), len(self) - 1)

    def row_at_time(self, time: float) -> int:
        """Return the last row that is not later than a time (s)."""
        found = int(np.searchsorted(self.recorded.arrays.time, time + 1e-9, side="right")) - 1
        return min(max(found, 0), len(self) - 1)

    def _status(self, robot: int, status: int, age: int, step: int) -> RobotStatus | None:
        end: RobotStatus | None = None
        for since, found in self._ends.get(robot, ()):
            if since <= step:
                end = found
        if end is not None:
            return end
        known = STATUS.get(status)
        return "silent" if age > 0 and known != "left" else known


def open_recording(path: Path, *, namespace: str | None = None) -> Recording:
    """Read a bag; errors as of `swarmabs_bringup.report.record.read_recorded`."""
    return Recording(read_recorded(path, namespace=namespace))


def numbers(values: Floats) -> list[float | None]:
    """Return numbers as JSON holds them: None for what is not finite."""
    found: list[float | None] = values.tolist()
    for index in np.flatnonzero(~np.isfinite(values)).tolist():
        found[index] = None
    return found


def _scattered(there: NDArray[np.bool_], values: Floats) -> Floats:
    """Return an array with values where they are, NaN elsewhere."""
    found = np.full(len(there), np.nan)
    found[there] = values
    return found


def _pair(torque: float, inertia: float) -> Abstract:
    return Abstract(torque=finite(float(torque)), inertia=finite(float(inertia)))


def _ends(events: tuple[SwarmEvent, ...]) -> dict[int, list[tuple[int, RobotStatus | None]]]:
    """Return for each robot from which step on it is out, and in which way; None from when it is in again."""
    found: dict[int, list[tuple[int, RobotStatus | None]]] = {}
    for event in events:
        if event.kind in _ENDS:
            found.setdefault(event.agent_id, []).append((event.step, _ENDS[event.kind]))
        elif event.kind in {EventKind.JOINED, EventKind.RECOVERED}:
            found.setdefault(event.agent_id, []).append((event.step, None))
    return found


@dataclass(slots=True)
class PlaybackSession:
    """What one page sees of a bag: pure, on any clock that does not jump.

    Parameters
    ----------
    recording : Recording
        The bag.
    """

    recording: Recording
    _row: int = 0
    _playing: bool = False
    _speed: float = 1.0
    _time: float = 0.0
    _now: float | None = None
    _shown: tuple[int, bool, float] | None = None
    _told: float = float("-inf")

    def hello(self) -> list[Message]:
        """Return what a page needs first."""
        return [self.recording.hello, self.recording.curves, self.recording.events]

    def poll(self, now: float) -> list[Message]:
        """Return what is new at a time (s) of the clock."""
        if not len(self.recording):
            return self._state(now)
        self._go_on(now)
        shown = (self._row, self._playing, self._speed)
        if shown == self._shown:
            return self._state(now) if now - self._told >= STATE_INTERVAL else []
        moved = self._shown is None or self._shown[0] != self._row
        changed = self._shown is None or self._shown[1:] != shown[1:] or now - self._told >= STATE_INTERVAL
        self._shown = shown
        rate = self._speed / self.recording.recorded.scenario.period if self._playing else None
        frames: list[Message] = [self.recording.frame(self._row, rate)] if moved else []
        return [*frames, *(self._state(now) if changed else [])]

    def control(self, wish: Control) -> None:
        """Do what the page asks for; what is over cannot be steered."""
        if isinstance(wish, Play):
            if self._row >= len(self.recording) - 1:
                self._jump(0)
            self._playing = len(self.recording) > 1
        elif isinstance(wish, Pause):
            self._playing = False
        elif isinstance(wish, Seek):
            self._jump(self.recording.row_at(wish.step))
        elif isinstance(wish, Speed):
            self._speed = wish.speed

    def _jump(self, row: int) -> None:
        if len(self.recording):
            self._row = row
            self._time = float(self.recording.recorded.arrays.time[row])

    def _go_on(self, now: float) -> None:
        passed = 0.0 if self._now is None else now - self._now
        self._now = now
        if not self._playing:
            return
        self._time += passed * self._speed
        self._row = self.recording.row_at_time(self._time)
        if self._row == len(self.recording) - 1:
            self._playing = False

    def _state(self, now: float) -> list[Message]:
        self._told = now
        recorded = self.recording.recorded
        text = recorded.status if recorded.reason is None else f"{recorded.status}: {recorded.reason}"
        return [State(phase="recorded", text=text, playing=self._playing, speed=self._speed)]

"""A bag as the view shows it: any step of it at once, and a playback that each page controls for itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import starmap
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_analysis.report.record import read_recorded
from swarmabs_analysis.report.thinning import column_points
from swarmabs_bag.membership_timeline import Attendance, is_silent
from swarmabs_view.curves import Point, curves
from swarmabs_view.facts import finite, scenario_facts
from swarmabs_view.picture import MOST_EVENTS, Seen, event_of, robot_states, seen
from swarmabs_view.protocol import (
    Abstract,
    Control,
    Curves,
    Events,
    Frame,
    Hello,
    Message,
    Pause,
    Play,
    Seek,
    Sets,
    Speed,
    State,
)
from swarmabs_view.shading import Shading

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from swarmabs_analysis.report.record import Recorded

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

COLUMNS = 1000
"""Columns of a picture of a curve; of each the first, lowest, highest and last point of every curve are sent."""
STATE_INTERVAL = 1.0
"""Longest time, s, between two messages to a page."""


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
        there = {agent.id for agent in recorded.scenario.initial_agents}
        self._attendance = Attendance(wanted.tolist(), [robot for robot in wanted.tolist() if robot not in there])
        for event in recorded.events:
            self._attendance.take(event)

    def __len__(self) -> int:
        return len(self.recorded.arrays.step)

    @cached_property
    def hello(self) -> Hello:
        """The first message."""
        recorded = self.recorded
        facts = scenario_facts(recorded.scenario)
        facts["last_step"] = int(recorded.arrays.step[-1]) if len(self) else 0
        title, place = recorded.scenario.name, str(recorded.bag)
        if recorded.swarm is not None:
            title, place = f"{title}, swarm {recorded.swarm}", f"{place}, namespace {recorded.swarm}"
        return Hello(source="bag", title=title, place=place, playback=True, **facts)

    @cached_property
    def shading(self) -> Shading:
        """The sets of whoever takes part."""
        return Shading(self.hello)

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
        said = (
            numbers(_scattered(there, values[place].astype(np.float64)))
            for values in (agents.position, agents.velocity, agents.command, agents.status)
        )
        robots = [
            self._seen(agent.id, Seen(position, velocity, command), status, heard, step)
            for agent, position, velocity, command, status, heard in zip(
                recorded.scenario.agents, *said, arrays.step[latest].tolist(), strict=True
            )
        ]
        return Frame(
            step=step,
            time=float(arrays.time[row]),
            angle=finite(float(arrays.angle[row])),
            angular_velocity=finite(float(arrays.angular_velocity[row])),
            reference=finite(float(recorded.reference[row])),
            abstract=_pair(arrays.abstract.torque[row], arrays.abstract.inertia[row]),
            desired=_pair(arrays.desired.torque[row], arrays.desired.inertia[row]),
            robots=robot_states(robots),
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

    def sets(self, row: int) -> Sets | None:
        """Return the sets of those who take part at a row, None as long as they are not computed."""
        return self.shading.of(self._attendance.members(int(self.recorded.arrays.step[row])))

    def _seen(self, robot: int, said: Seen, status: float | None, heard: int, step: int) -> Seen:
        """Return what is shown of a robot at a step: what it has said last, in step `heard`, unless it is out."""
        known = None if status is None else int(status)
        return seen(self._attendance.out(robot, step), said, known, silent=is_silent(heard, step))


def open_recording(path: Path, *, namespace: str | None = None) -> Recording:
    """Read a bag; errors as of `swarmabs_analysis.report.record.read_recorded`."""
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
    _sets: Sets | None = None
    _told: float = float("-inf")

    def hello(self) -> list[Message]:
        """Return what a page needs first."""
        self._sets = self.recording.shading.first
        return [self.recording.hello, self.recording.curves, self.recording.events]

    def poll(self, now: float) -> list[Message]:
        """Return what is new at a time (s) of the clock."""
        if not len(self.recording):
            return self._state(now)
        self._go_on(now)
        shown = (self._row, self._playing, self._speed)
        if shown == self._shown:
            return [*self._new_sets(), *(self._state(now) if now - self._told >= STATE_INTERVAL else [])]
        moved = self._shown is None or self._shown[0] != self._row
        changed = self._shown is None or self._shown[1:] != shown[1:] or now - self._told >= STATE_INTERVAL
        self._shown = shown
        rate = self._speed / self.recording.recorded.scenario.period if self._playing else None
        frames: list[Message] = [self.recording.frame(self._row, rate)] if moved else []
        return [*frames, *self._new_sets(), *(self._state(now) if changed else [])]

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

    def _new_sets(self) -> list[Message]:
        found = self.recording.sets(self._row)
        if found is None or found is (self._sets or self.recording.shading.first):
            return []
        self._sets = found
        return [found]

    def _state(self, now: float) -> list[Message]:
        self._told = now
        recorded = self.recording.recorded
        told = recorded.reason in {None, recorded.status}
        text = recorded.status if told else f"{recorded.status}: {recorded.reason}"
        return [State(phase="recorded", text=text, playing=self._playing, speed=self._speed)]

"""The view of a bag: random access to steps, and a playback that each page controls separately."""

from __future__ import annotations

from functools import cached_property
from heapq import merge
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_bag.run_folder import RunFolder
from swarmabs_bag.shown.recorded_swarm import RecordedSwarm, column_points, read_swarm
from swarmabs_bag.shown.swarm_state import MOST_EVENTS, SwarmState, TimedEvent
from swarmabs_view.coordinators import coordinators_at, read_roles, takeovers
from swarmabs_view.facts import Shading, scenario_facts
from swarmabs_view.ports import bound, need_web_server
from swarmabs_view.presenter import Presenter
from swarmabs_view.protocol import (
    Control,
    Coordinators,
    Events,
    Hello,
    Message,
    Pause,
    Placed,
    Play,
    Positions,
    Seek,
    Session,
    Sets,
    Speed,
    State,
    sides,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from swarmabs_bag.shown.swarm_state import RobotIdentity
    from swarmabs_view.coordinators import Role

COLUMNS = 1000
"""Columns of a chart; of each column the first, lowest, highest and last point of every curve are sent."""


def evenly(count: int, most: int) -> Sequence[int]:
    """Return at most `most` evenly spaced rows out of `count`."""
    return range(0, count, -(-count // most) or 1)


def places(swarm: RecordedSwarm, rows: Iterable[int]) -> list[Placed]:
    """Return the coordinates of the robots at rows of the arrays."""
    arrays, ids = swarm.arrays, swarm.arrays.agents.ids.tolist()
    known = np.where(np.isfinite(swarm.coordinates), swarm.coordinates.astype(object), None)
    return [
        Placed(
            int(arrays.step[row]),
            float(arrays.time[row]),
            dict(zip(ids, map(tuple, known[row].tolist()), strict=True)),
        )
        for row in rows
    ]


class Recording:
    """A bag, read once, as messages of the page; `roles` are those of an earlier run in lockstep with standbys."""

    def __init__(self, swarm: RecordedSwarm, roles: Sequence[Role] = ()) -> None:
        self.swarm = swarm
        self.roles = roles
        self.presenter = Presenter(swarm.tables)

    def __len__(self) -> int:
        return len(self.swarm)

    @cached_property
    def hello(self) -> Hello:
        """The first message."""
        swarm = self.swarm
        facts = scenario_facts(swarm.scenario)
        facts["last_step"] = int(swarm.arrays.step[-1]) if len(self) else 0
        facts |= {"system": self.presenter.system, "robots": self.presenter.robots(self.robots)}
        title, place = swarm.scenario.name, str(swarm.bag)
        if swarm.name is not None:
            title, place = f"{title}, swarm {swarm.name}", f"{place}, namespace {swarm.name}"
        return Hello(source="bag", title=title, place=place, playback=True, **facts)

    @cached_property
    def robots(self) -> Sequence[RobotIdentity]:
        """The robots, in the order of the scenario."""
        return SwarmState.of(self.swarm.scenario).robots

    @cached_property
    def shading(self) -> Shading:
        """The sets of the robots that take part."""
        return Shading(self.hello)

    @cached_property
    def curves(self) -> Message:
        """All curves, thinned without a visible change."""
        chosen = np.arange(len(self))
        if len(self) > 2 * COLUMNS:
            column = np.arange(len(self)) * COLUMNS // len(self)
            chosen = np.unique(
                np.concatenate([column_points(column, values) for values in np.hstack(self.swarm.vectors).T])
            )
        return self.presenter.curves([self.swarm.instant(row) for row in chosen.tolist()], replace=True)

    @cached_property
    def positions(self) -> Positions:
        """The positions, at most at `COLUMNS` steps."""
        points = places(self.swarm, evenly(len(self), COLUMNS))
        robots = [robot.id for robot in self.robots]
        return Positions.of(robots, points, sides(points), replace=True, axes=self.presenter.axes)

    @cached_property
    def events(self) -> Events:
        """The latest events."""
        swarm = self.swarm
        told = [TimedEvent(event, swarm.time_of(event)) for event in takeovers(self.roles)]
        found = [*merge(swarm.timed_events(), told, key=lambda timed: timed.event.step)]
        left_out = max(0, len(found) - MOST_EVENTS)
        return Events(replace=True, events=[self.presenter.event(one) for one in found[left_out:]], left_out=left_out)

    def frame(self, row: int, step_rate: float | None = None) -> Message:
        """Return the frame at a row of the arrays."""
        return self.presenter.frame(self.swarm.instant(row), self.swarm.shown_robots(row), self.robots, step_rate)

    def coordinators(self, row: int) -> Coordinators | None:
        """Return the roles at a row, None if no coordinator has a standby."""
        return coordinators_at(self.roles, int(self.swarm.arrays.step[row]), self.swarm.scenario.period)

    def row_at(self, step: int) -> int:
        """Return the row of a step, or the row before a missing step."""
        found = int(np.searchsorted(self.swarm.arrays.step, step, side="right")) - 1
        return min(max(found, 0), len(self) - 1)

    def row_at_time(self, time: float) -> int:
        """Return the last row that is not later than a time (s)."""
        found = int(np.searchsorted(self.swarm.arrays.time, time + 1e-9, side="right")) - 1
        return min(max(found, 0), len(self) - 1)

    def sets(self, row: int) -> Sets | None:
        """Return the sets of the robots that take part at a row, None until they are computed."""
        return self.shading.of(self.swarm.members(row))


def open_recording(path: Path, *, namespace: str | None = None) -> Recording:
    """Read a bag; errors as for `swarmabs_bag.shown.recorded_swarm.read_swarm`."""
    swarm = read_swarm(path, namespace=namespace)
    bag = swarm.bag if swarm.bag.is_dir() else swarm.bag.parent
    return Recording(swarm, read_roles(RunFolder(bag.parent).logs))


class PlaybackSession(Session):
    """The session of a page that shows a bag; a pure state machine on any monotonic clock."""

    def __init__(self, recording: Recording) -> None:
        super().__init__()
        self.recording = recording
        self._row = 0
        self._playing = False
        self._speed = 1.0
        self._time = 0.0
        self._now: float | None = None
        self._drawn: tuple[int, Message] | None = None
        self._sent = {Sets: recording.shading.first}

    def hello(self) -> list[Message]:
        """Return the initial messages for a page."""
        recording = self.recording
        return [recording.hello, recording.curves, recording.positions, recording.events]

    def poll(self, now: float) -> list[Message]:
        """Return the new messages at a time (s) of the clock."""
        swarm = self.recording.swarm
        told = swarm.reason in {None, swarm.status}
        text = swarm.status if told else f"{swarm.status}: {swarm.reason}"
        if not len(self.recording):
            return self.new(now, State(phase="recorded", text=text, playing=False, speed=self._speed))
        self._advance(now)
        if self._drawn is None or self._drawn[0] != self._row:
            rate = self._speed / swarm.scenario.period if self._playing else None
            self._drawn = (self._row, self.recording.frame(self._row, rate))
        state = State(phase="recorded", text=text, playing=self._playing, speed=self._speed)
        shown = self.recording
        return self.new(now, self._drawn[1], shown.sets(self._row), shown.coordinators(self._row), state)

    def control(self, request: Control) -> None:
        """Handle a request of the page; a recorded run cannot be steered."""
        if isinstance(request, Play):
            if self._row >= len(self.recording) - 1:
                self._jump(0)
            self._playing = len(self.recording) > 1
        elif isinstance(request, Pause):
            self._playing = False
        elif isinstance(request, Seek):
            self._jump(self.recording.row_at(request.step))
        elif isinstance(request, Speed):
            self._speed = request.speed

    def _jump(self, row: int) -> None:
        if len(self.recording):
            self._row = row
            self._time = float(self.recording.swarm.arrays.time[row])

    def _advance(self, now: float) -> None:
        passed = 0.0 if self._now is None else now - self._now
        self._now = now
        if not self._playing:
            return
        self._time += passed * self._speed
        self._row = self.recording.row_at_time(self._time)
        if self._row == len(self.recording) - 1:
            self._playing = False


def view_bag(path: Path, *, namespace: str | None, port: int, ready: Callable[[str], None]) -> None:
    """Show a bag until the user ends it; `ready` receives the address of the page.

    Raises
    ------
    InputError
        If the port is taken, or it is not the bag of a swarm.
    DamagedBagError
        If it cannot be read.
    """
    need_web_server()
    from swarmabs_view.server import serve  # noqa: PLC0415 - needs aiohttp

    recording = open_recording(path, namespace=namespace)
    _ = recording.hello, recording.curves, recording.positions, recording.events  # computed before a page connects
    with bound(port) as listener:
        serve(listener, lambda: PlaybackSession(recording), ready=ready)

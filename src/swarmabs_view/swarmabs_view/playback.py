"""The view of a bag: random access to steps, and a playback that each page controls separately."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from swarmabs_bag.shown.recorded_swarm import RecordedSwarm, column_points, read_swarm
from swarmabs_bag.shown.swarm_state import MOST_EVENTS, SwarmState
from swarmabs_view.facts import Shading, hello_of
from swarmabs_view.ports import bound, need_web_server
from swarmabs_view.presenter import Placed, Presenter, sides
from swarmabs_view.protocol import Control, Frame, Hello, Message, Pause, Play, Seek, Sets, Speed, State
from swarmabs_view.session import CurveBuffer, Session

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from swarmabs_bag.shown.swarm_state import Instant

COLUMNS = 1000
"""Columns of a chart; of each column the first, lowest, highest and last point of every curve are sent."""


def evenly(count: int, most: int) -> Sequence[int]:
    """Return at most `most` evenly spaced rows out of `count`."""
    return range(0, count, -(-count // most) or 1)


def places(swarm: RecordedSwarm, rows: Iterable[int]) -> Iterator[Placed]:
    """Yield the coordinates of the robots at rows of the arrays."""
    arrays, ids = swarm.arrays, swarm.arrays.agents.ids.tolist()
    coordinates = np.where(np.isfinite(swarm.coordinates), swarm.coordinates.astype(object), None)
    for row in rows:
        by_robot = dict(zip(ids, map(tuple, coordinates[row].tolist()), strict=True))
        yield Placed(int(arrays.step[row]), float(arrays.time[row]), by_robot)


class Recording:
    """A bag, read once; all pages share it. Its curves are thinned without a visible change."""

    version = 0

    def __init__(self, swarm: RecordedSwarm) -> None:
        self.swarm = swarm
        self.presenter = Presenter(swarm.tables)
        self.robots = SwarmState.of(swarm.scenario).robots
        self._hello = self._described()
        self.shading = Shading(self._hello)
        self.curves: CurveBuffer[Instant] = CurveBuffer.of(map(swarm.instant, self._thinned()))
        self.positions = CurveBuffer.of(places(swarm, evenly(len(swarm), COLUMNS)))
        self.above = sides(self.positions)
        events = swarm.timed_events()
        self.events, self.event_count = events[-MOST_EVENTS:], len(events)

    def __len__(self) -> int:
        return len(self.swarm)

    def hello(self) -> Hello:
        """Return the first message for a page."""
        return self._hello

    def _described(self) -> Hello:
        swarm = self.swarm
        title, place = swarm.scenario.name, str(swarm.bag)
        if swarm.name is not None:
            title, place = f"{title}, swarm {swarm.name}", f"{place}, namespace {swarm.name}"
        last = int(swarm.arrays.step[-1]) if len(self) else 0
        hello = hello_of("bag", title, place, swarm.scenario, last)
        return hello.model_copy(update={"robots": self.presenter.robots(self.robots)})

    def _thinned(self) -> Sequence[int]:
        """Return the rows of the points of the curves."""
        count = len(self)
        if count <= 2 * COLUMNS:
            return range(count)
        column = np.arange(count) * COLUMNS // count
        points = [column_points(column, values) for values in np.hstack(self.swarm.vectors).T]
        rows: list[int] = np.unique(np.concatenate(points)).tolist()
        return rows

    def frame(self, row: int, step_rate: float | None = None) -> Frame:
        """Return the frame at a row of the arrays."""
        return self.presenter.frame(self.swarm.instant(row), self.swarm.shown_robots(row), self.robots, step_rate)

    def row_at(self, step: int) -> int:
        """Return the row of a step, or the row before a missing step."""
        return self._row(int(np.searchsorted(self.swarm.arrays.step, step, side="right")))

    def row_at_time(self, time: float) -> int:
        """Return the last row that is not later than a time (s)."""
        return self._row(int(np.searchsorted(self.swarm.arrays.time, time + 1e-9, side="right")))

    def _row(self, rows: int) -> int:
        """Return the last of the first rows."""
        return min(max(rows - 1, 0), len(self) - 1)

    def sets(self, row: int) -> Sets | None:
        """Return the sets of the robots that take part at a row, None until they are computed."""
        return self.shading.of(self.swarm.members(row))


def open_recording(path: Path, *, namespace: str | None = None) -> Recording:
    """Read a bag; errors as for `swarmabs_bag.shown.recorded_swarm.read_swarm`."""
    return Recording(read_swarm(path, namespace=namespace))


class PlaybackSession(Session):
    """The session of a page that shows a bag; a pure state machine on any monotonic clock."""

    def __init__(self, recording: Recording) -> None:
        super().__init__(recording)
        self.recording = recording
        self._row = 0
        self._playing = False
        self._speed = 1.0
        self._time = 0.0
        self._now: float | None = None
        self._drawn: tuple[int, Frame] | None = None

    def latest(self, now: float) -> Iterable[Message | None]:
        """Return the messages that hold at a time (s)."""
        self._advance(now)
        swarm = self.recording.swarm
        said = swarm.reason in {None, swarm.status}
        text = swarm.status if said else f"{swarm.status}: {swarm.reason}"
        if len(self.recording):
            yield self._frame()
            yield self.recording.sets(self._row)
        yield State(phase="recorded", text=text, playing=self._playing, speed=self._speed)

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

    def _frame(self) -> Frame:
        if self._drawn is None or self._drawn[0] != self._row:
            rate = self._speed / self.recording.swarm.scenario.period if self._playing else None
            self._drawn = (self._row, self.recording.frame(self._row, rate))
        return self._drawn[1]

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
    with bound(port) as listener:
        serve(listener, lambda: PlaybackSession(recording), ready=ready)

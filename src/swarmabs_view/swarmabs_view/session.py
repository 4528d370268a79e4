"""What pages are sent of a swarm, running or recorded: first everything that is known, then what is new."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from swarmabs_view.protocol import Message, Sets, State

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from swarmabs_bag.shown.swarm_state import Instant, RobotIdentity, TimedEvent
    from swarmabs_view.facts import Shading
    from swarmabs_view.presenter import Placed, Presenter
    from swarmabs_view.protocol import Control, Hello

MOST_POINTS = 4000
"""Most points of the curves, as many as a screen can show; beyond, every second point is dropped."""
STATE_INTERVAL = 1.0
"""Longest time between two states of the source, s."""


class _Point(Protocol):
    @property
    def step(self) -> int: ...


PointT = TypeVar("PointT", bound=_Point)

NOTHING = (-1, 0)
"""What a new page has of a buffer, see `CurveBuffer.since`."""


class CurveBuffer(Generic[PointT]):
    """Points of growing curves: those whose step is a multiple of a stride, which doubles when the buffer is full."""

    def __init__(self, most: int = MOST_POINTS, stride: int = 1) -> None:
        self._most = most
        self._stride = stride
        self._points: list[PointT] = []
        self._epoch = 0

    @classmethod
    def of(cls, points: Iterable[PointT]) -> CurveBuffer[PointT]:
        """Return a buffer of exactly these points, to which none are added."""
        buffer = cls()
        buffer._points = list(points)
        return buffer

    def __len__(self) -> int:
        return len(self._points)

    def __iter__(self) -> Iterator[PointT]:
        return iter(self._points)

    @property
    def first(self) -> int | None:
        """The first step in the buffer, or None."""
        return self._points[0].step if self._points else None

    def wants(self, step: int) -> bool:
        """Return whether the buffer would keep a point of a step."""
        return step % self._stride == 0 and not (self._points and step <= self._points[-1].step)

    def add(self, point: PointT) -> None:
        """Add a point; ignore one that is not later than the last."""
        if self.wants(point.step):
            self._points.append(point)
            self._thin()

    def begin(self, points: Iterable[PointT], until: int) -> None:
        """Replace what is known before a step by the points before it."""
        earlier = [point for point in points if point.step % self._stride == 0 and point.step < until]
        if earlier:
            self._points = earlier + [point for point in self._points if point.step >= until]
            self._epoch += 1
            self._thin()

    def _thin(self) -> None:
        while len(self._points) > self._most:
            self._stride *= 2
            self._points = [point for point in self._points if point.step % self._stride == 0]
            self._epoch += 1

    @property
    def mark(self) -> tuple[int, int]:
        """The epoch, which changes whenever points are removed or inserted, and the number of points."""
        return self._epoch, len(self._points)

    def since(self, mark: tuple[int, int]) -> tuple[list[PointT], bool] | None:
        """Return the points that a page lacks which has those up to a mark, and whether they replace these; or None."""
        epoch, count = mark
        replace = epoch != self._epoch
        missing = self._points if replace else self._points[count:]
        return (missing, replace) if missing or replace else None


class Source(Protocol):
    """A swarm that pages show.

    Attributes
    ----------
    presenter : Presenter
        Presents the swarm by the tables of its parent system.
    shading : Shading
        The sets of the robots that take part.
    curves, positions : CurveBuffer
        Points of the curves, and of the positions of the robots.
    above : mapping
        Whether each robot starts above 0, see `swarmabs_view.presenter.sides`.
    """

    presenter: Presenter
    shading: Shading
    curves: CurveBuffer[Instant]
    positions: CurveBuffer[Placed]
    above: dict[int, bool]

    @property
    def robots(self) -> Sequence[RobotIdentity]:
        """The robots, in the order of the hello."""
        ...

    @property
    def events(self) -> Sequence[TimedEvent]:
        """The latest events."""
        ...

    @property
    def event_count(self) -> int:
        """The number of all events."""
        ...

    @property
    def version(self) -> object:
        """Changes when the hello does."""
        ...

    def hello(self) -> Hello:
        """Return the first message for a page."""
        ...


class Session:
    """The messages for one page. A message that a later one replaces is sent once, the state every second."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._sent: dict[type[Message], Message] = {}
        self._told = float("-inf")
        self._version: object = None

    def poll(self, now: float) -> list[Message]:
        """Return the new messages at a time (s) of the clock: at first, and when the hello changes, everything."""
        if self._version != self._source.version:
            added = self._everything()
        else:
            added = [*self._new_points(), *self._new_events()]
        return [*added, *self._changed(now, self.latest(now))]

    def latest(self, now: float) -> Iterable[Message | None]:
        """Return the messages that hold at a time (s), at most one per type."""
        raise NotImplementedError

    def control(self, request: Control) -> None:
        """Handle a request of the page."""
        raise NotImplementedError

    def _everything(self) -> list[Message]:
        source = self._source
        self._version, self._events = source.version, source.event_count
        self._curves = self._positions = NOTHING
        self._sent = {Sets: source.shading.first}
        left_out = source.event_count - len(source.events)
        events = source.presenter.events(source.events, replace=True, left_out=left_out)
        return [source.hello(), *self._new_points(), events]

    def _new_points(self) -> list[Message]:
        source, presenter = self._source, self._source.presenter
        curves, self._curves = source.curves.since(self._curves), source.curves.mark
        places, self._positions = source.positions.since(self._positions), source.positions.mark
        messages: list[Message] = [] if curves is None else [presenter.curves(*curves)]
        if places is not None:
            robots = [robot.id for robot in source.robots]
            messages.append(presenter.positions(robots, *places, source.above))
        return messages

    def _new_events(self) -> list[Message]:
        source = self._source
        count = min(source.event_count - self._events, len(source.events))
        self._events = source.event_count
        return [source.presenter.events(source.events[-count:], replace=False)] if count else []

    def _changed(self, now: float, latest: Iterable[Message | None]) -> list[Message]:
        """Return those messages that the page lacks; the state every second."""
        if now - self._told >= STATE_INTERVAL:
            self._sent.pop(State, None)
        changed = [message for message in latest if message is not None and self._sent.get(type(message)) != message]
        self._sent |= {type(message): message for message in changed}
        if any(isinstance(message, State) for message in changed):
            self._told = now
        return changed

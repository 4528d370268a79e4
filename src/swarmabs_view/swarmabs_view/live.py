"""The view of a running swarm, and the messages for each page."""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from swarmabs_bag.shown.swarm_state import SwarmState
from swarmabs_config.graph import SILENCE
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import SystemDescription
from swarmabs_core.systems import PLANE_TABLES, SystemTables
from swarmabs_view.coordinators import DiagnosedRoles
from swarmabs_view.facts import Shading
from swarmabs_view.presenter import Presenter
from swarmabs_view.protocol import (
    Events,
    Hello,
    Placed,
    Positions,
    Session,
    Sets,
    State,
    sides,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from swarmabs_bag.shown.swarm_state import Instant
    from swarmabs_core.messages import Message
    from swarmabs_view import protocol
    from swarmabs_view.listener import DiagnosticsListener, Listener
    from swarmabs_view.protocol import Control, Coordinators, Health, Phase

INTERVAL = 1.0 / 30.0
"""Time between two polls of the received messages, s."""
RATE_WINDOW = 2.0
"""Time over which the step rate is computed, s."""
MOST_PLACES = 1000
"""Most points of each robot's position."""
ROBOTS_A_STEP = 10
"""Robots whose positions are kept in every step; for more robots, fewer steps are kept."""
MOST_POINTS = 4000
"""Most points of the curves, as many as a screen can show; beyond, every second point is dropped."""


class StepRate:
    """Steps per second of wall time, over the last seconds."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, int]] = deque()

    def __len__(self) -> int:
        return len(self._seen)

    def take(self, now: float, step: int | None) -> None:
        """Record the step at a time (s)."""
        if step is not None and (not self._seen or step != self._seen[-1][1]):
            self._seen.append((now, step))
            self._forget(now)

    def at(self, now: float) -> float | None:
        """Return the rate at a time (s), None if unknown."""
        self._forget(now)
        if len(self._seen) < 2:
            return None
        (begin, first), last = self._seen[0], self._seen[-1][1]
        return (last - first) / (now - begin) if now > begin else None

    def silent_for(self, now: float) -> float | None:
        """Return the time since the last new step, s, None before the first."""
        return now - self._seen[-1][0] if self._seen else None

    def _forget(self, now: float) -> None:
        """Drop steps before the window, even while no page asks for the rate."""
        while len(self._seen) > 2 and self._seen[0][0] < now - RATE_WINDOW:
            self._seen.popleft()


class _Point(Protocol):
    @property
    def step(self) -> int: ...


Kept = TypeVar("Kept", bound=_Point)


class CurveBuffer(Generic[Kept]):
    """Points of growing curves: those whose step is a multiple of a stride, which doubles when the buffer is full.

    `epoch` changes whenever points were removed or inserted.
    """

    def __init__(self, most: int = MOST_POINTS, stride: int = 1) -> None:
        self._most = most
        self._stride = stride
        self._points: list[Kept] = []
        self.epoch = 0

    def __len__(self) -> int:
        return len(self._points)

    @property
    def first(self) -> int | None:
        """The first step in the buffer, or None."""
        return self._points[0].step if self._points else None

    def wants(self, step: int) -> bool:
        """Return whether the buffer would keep a point of a step."""
        return step % self._stride == 0 and not (self._points and step <= self._points[-1].step)

    def add(self, point: Kept) -> None:
        """Add a point; ignore one that is not later than the last."""
        if self.wants(point.step):
            self._points.append(point)
            self._thin()

    def begin(self, points: Iterable[Kept], until: int) -> None:
        """Replace what is known before a step by the points before it."""
        earlier = [one for one in points if one.step % self._stride == 0 and one.step < until]
        if earlier:
            self._points = earlier + [one for one in self._points if one.step >= until]
            self.epoch += 1
            self._thin()

    def _thin(self) -> None:
        while len(self._points) > self._most:
            self._stride *= 2
            self._points = [kept for kept in self._points if kept.step % self._stride == 0]
            self.epoch += 1

    def since(self, epoch: int, count: int) -> tuple[list[Kept], bool] | None:
        """Return the points that a page with `count` points of an epoch lacks, and if they replace them; or None."""
        replace = epoch != self.epoch
        missing = self._points if replace else self._points[count:]
        return (missing, replace) if missing or replace else None


class LiveView:
    """Everything shown of a running swarm, shared by all pages: state, curves, phase and processes.

    The hello contains what is known in advance; its robots are then those of the state.
    """

    def __init__(self, hello: Hello, state: SwarmState) -> None:
        self.health: Health | None = None
        self.phase: Phase = "waiting"
        self.text = "waiting for the first step"
        self.paused = False
        self._paused_at = float("-inf")
        self.facts = -1
        self.rate = StepRate()
        self.diagnosed = DiagnosedRoles()
        self._drawn = (-1, -1)
        self._frame: protocol.Message | None = None
        self.learn(hello, state)

    def learn(self, hello: Hello, state: SwarmState) -> None:
        """Restart with newly known facts."""
        self.presenter = Presenter(state.tables)
        self._hello, self.state = hello, state
        self.shading = Shading(self.hello())
        self.curves: CurveBuffer[Instant] = CurveBuffer()
        # Fewer steps of many robots, which bounds the messages and the computation.
        stride = 1 + len(state.robots) // ROBOTS_A_STEP
        self.positions: CurveBuffer[Placed] = CurveBuffer(MOST_PLACES, stride)
        self.sides: dict[int, bool] = {}
        self._placed_since: dict[int, int] = {}
        self._complete: list[Instant] = []
        self.facts += 1

    def hello(self) -> Hello:
        """Return the first message for a page."""
        presenter = self.presenter
        return self._hello.model_copy(
            update={"system": presenter.system, "robots": presenter.robots(self.state.robots)}
        )

    def frame(self, now: float) -> protocol.Message | None:
        """Return the step to show at a time (s), computed once for all pages; None before the plane's first state."""
        if self._drawn != (self.facts, self.state.version):
            self._drawn = (self.facts, self.state.version)
            state, shown = self.state, self.state.instant()
            robots = [] if shown is None else state.shown_robots(shown.step)
            rate = self.rate.at(now)
            self._frame = None if shown is None else self.presenter.frame(shown, robots, state.robots, rate)
        return self._frame

    def add(self, message: Message) -> None:
        """Process a message of the swarm; the description of a parent system begins the view of that."""
        if isinstance(message, SystemDescription) and self.state.tables is PLANE_TABLES:
            with suppress(MalformedMessageError, LookupError, ValueError):  # of a description that is not one
                self.learn(self._hello, SwarmState(tables=SystemTables.read(message.description)))
        complete = self.state.add(message)
        if complete is not None:
            self.curves.add(complete)
            if self.positions.wants(complete.step):
                self._complete.append(complete)

    def coordinators(self, now: float) -> Coordinators | None:
        """Return the roles of coordinators with standbys at a time (s), None if there are none."""
        return self.diagnosed.message(now)

    def refresh(self, now: float) -> None:
        """Update positions, step rate and phase."""
        self._place()
        self.rate.take(now, self.state.step)
        silence = self.rate.silent_for(now)
        if self.paused:
            self._paused_at = now
            self.phase, self.text = "paused", "" if silence is None else f"at step {self.state.step}"
        elif silence is None:
            return
        elif min(silence, now - self._paused_at) < SILENCE:
            self.phase, self.text = "running", ""
        else:
            self.phase, self.text = "silent", f"no step since {self.state.step}"

    @property
    def heard_since(self) -> int | None:
        """The first step in which the parent system and all robots heard by now are known, or None.

        Robots are discovered one after the other.
        """
        first = self.curves.first
        return None if first is None else max([first, *self._placed_since.values()])

    def begin(self, instants: Iterable[Instant], places: Iterable[Placed], until: int) -> None:
        """Show the recorded data before a step instead of what was received of it."""
        self.curves.begin(instants, until)
        earlier = list(places)
        self.sides |= sides(earlier)
        self.positions.begin(earlier, until)

    def _place(self) -> None:
        """Keep the positions of the complete steps: robots' states arrive after the rest of a step."""
        for instant in self._complete:
            shown = self.state.shown_robots(instant.step)
            ids = [robot.id for robot in self.state.robots]
            places = dict(zip(ids, [robot.coordinates for robot in shown], strict=True))
            placed = Placed(instant.step, instant.time, places)
            known = sides([placed])
            self.sides = known | self.sides
            self._placed_since = dict.fromkeys(known, placed.step) | self._placed_since
            self.positions.add(placed)
        self._complete.clear()

    async def listen(self, listener: Listener, diagnostics: DiagnosticsListener, over: Callable[[], bool]) -> None:
        """Listen until the swarm has ended, then a few polls longer for messages on the way."""
        clock = asyncio.get_running_loop().time
        left = 3
        while left:
            for heard in listener.poll():
                self.add(heard.message)
            for node, values in diagnostics.poll():
                self.diagnosed.hear(node, values, clock())
            self.refresh(clock())
            left = left - 1 if over() else 3
            await asyncio.sleep(INTERVAL)


class LiveSession(Session):
    """The session of a page that shows a running swarm; `after` returns the session to use when the run has ended."""

    def __init__(self, live: LiveView, after: Callable[[], Session | None] = lambda: None) -> None:
        super().__init__()
        self._live = live
        self._make_after = after
        self._after: Session | None = None
        self._known = (-1, -1)
        self._curves = self._positions = (-1, 0)
        self._events = 0

    def hello(self) -> list[protocol.Message]:
        """Return the initial messages for a page."""
        live = self._live
        self._known, self._events = (live.facts, len(live.state.robots)), 0
        self._curves = self._positions = (-1, 0)
        self._sent = {Sets: live.shading.first}
        return [live.hello(), Events(replace=True, events=[])]

    def poll(self, now: float) -> list[protocol.Message]:
        """Return the new messages at a time (s) of the clock."""
        if self._after is None:
            self._after = self._make_after()
            if self._after is not None:
                return self._after.hello()
        if self._after is not None:
            return self._after.poll(now)
        live = self._live
        messages = self.hello() if self._known != (live.facts, len(live.state.robots)) else []
        messages += [*self._new_curves(), *self._new_positions(), *self._new_events()]
        sets, state = live.shading.of(live.state.members()), State(phase=live.phase, text=live.text)
        return [*messages, *self.new(now, live.frame(now), sets, live.health, live.coordinators(now), state)]

    def control(self, request: Control) -> None:
        """Handle a request of the page; a running swarm has no playback."""
        if self._after is not None:
            self._after.control(request)

    def _new_curves(self) -> list[protocol.Message]:
        buffer = self._live.curves
        found = buffer.since(*self._curves)
        self._curves = (buffer.epoch, len(buffer))
        return [] if found is None else [self._live.presenter.curves(found[0], replace=found[1])]

    def _new_positions(self) -> list[protocol.Message]:
        buffer = self._live.positions
        found = buffer.since(*self._positions)
        self._positions = (buffer.epoch, len(buffer))
        robots = [robot.id for robot in self._live.state.robots]
        if found is None or not len(buffer):
            return []
        points, replace = found
        return [Positions.of(robots, points, self._live.sides, replace=replace, axes=self._live.presenter.axes)]

    def _new_events(self) -> list[Events]:
        state = self._live.state
        count = min(state.event_count - self._events, len(state.events))
        self._events = state.event_count
        return (
            [Events(replace=False, events=[self._live.presenter.event(one) for one in state.events[-count:]])]
            if count
            else []
        )

"""The view of a running swarm, and the messages for each page."""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING

from swarmabs_bag.shown.swarm_state import SwarmState
from swarmabs_config.graph import SILENCE
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import SystemDescription
from swarmabs_core.systems import PLANE_TABLES, SystemTables
from swarmabs_view.coordinators import DiagnosedRoles
from swarmabs_view.facts import Shading
from swarmabs_view.linked_robots import DiagnosedLinks
from swarmabs_view.presenter import Placed, Presenter, sides
from swarmabs_view.protocol import State
from swarmabs_view.session import CurveBuffer, Session

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from swarmabs_bag.shown.swarm_state import Instant, RobotIdentity, TimedEvent
    from swarmabs_core.messages import Message
    from swarmabs_view import protocol
    from swarmabs_view.listener import DiagnosticsListener, Listener
    from swarmabs_view.protocol import Control, Frame, Health, Hello, Phase

INTERVAL = 1.0 / 30.0
"""Time between two polls of the received messages, s."""
RATE_WINDOW = 2.0
"""Time over which the step rate is computed, s."""
MOST_PLACES = 1000
"""Most points of each robot's position."""
ROBOTS_A_STEP = 10
"""Robots whose positions are kept in every step; for more robots, fewer steps are kept."""


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
        self._learned = 0
        self.rate = StepRate()
        self.roles = DiagnosedRoles()
        self.links = DiagnosedLinks()
        self._drawn: object = None
        self._frame: Frame | None = None
        self.learn(hello, state)

    def learn(self, hello: Hello, state: SwarmState) -> None:
        """Restart with newly known facts."""
        self.presenter = Presenter(state.tables)
        self._hello, self.state = hello, state
        self._expected: SwarmState | None = None
        self.shading = Shading(self.hello())
        self.curves: CurveBuffer[Instant] = CurveBuffer()
        # Fewer steps of many robots, which bounds the messages and the computation.
        stride = 1 + len(state.robots) // ROBOTS_A_STEP
        self.positions: CurveBuffer[Placed] = CurveBuffer(MOST_PLACES, stride)
        self.above: dict[int, bool] = {}
        self._placed_since: dict[int, int] = {}
        self._complete: list[Instant] = []
        self._learned += 1

    def expect(self, first: SwarmState) -> None:
        """Show the first step of the run, which is known in advance, until messages arrive."""
        self._expected = first

    @property
    def version(self) -> tuple[int, int]:
        """Changes when the hello does."""
        return self._learned, len(self.state.robots)

    @property
    def robots(self) -> Sequence[RobotIdentity]:
        """The robots heard by now."""
        return self.state.robots

    @property
    def events(self) -> Sequence[TimedEvent]:
        """The latest events."""
        return self.state.events

    @property
    def event_count(self) -> int:
        """The number of all events."""
        return self.state.event_count

    def hello(self) -> Hello:
        """Return the first message for a page."""
        presenter = self.presenter
        return self._hello.model_copy(
            update={"system": presenter.system, "robots": presenter.robots(self.state.robots)}
        )

    def frame(self, now: float) -> Frame | None:
        """Return the step to show at a time (s), computed once for all pages; None before the plane's first state."""
        state = self.state if self.state.version or self._expected is None else self._expected
        if self._drawn != (state, state.version):
            self._drawn = (state, state.version)
            shown, rate = state.instant(), self.rate.at(now)
            robots = [] if shown is None else state.shown_robots(shown.step)
            self._frame = None if shown is None else self.presenter.frame(shown, robots, state.robots, rate)
        return self._frame

    def latest(self, now: float) -> tuple[protocol.Message | None, ...]:
        """Return the messages that hold at a time (s) for every page."""
        sets, state = self.shading.of(self.state.members()), State(phase=self.phase, text=self.text)
        return self.frame(now), sets, self.health, self.roles.message(now), self.links.message(now), state

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
        self.above |= sides(earlier)
        self.positions.begin(earlier, until)

    def _place(self) -> None:
        """Keep the positions of the complete steps: robots' states arrive after the rest of a step."""
        for instant in self._complete:
            shown = self.state.shown_robots(instant.step)
            ids = [robot.id for robot in self.state.robots]
            places = dict(zip(ids, [robot.coordinates for robot in shown], strict=True))
            placed = Placed(instant.step, instant.time, places)
            above = sides([placed])
            self.above = above | self.above
            self._placed_since = dict.fromkeys(above, placed.step) | self._placed_since
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
                self.roles.hear(node, values, clock())
                self.links.hear(node, values, clock())
            self.refresh(clock())
            left = left - 1 if over() else 3
            await asyncio.sleep(INTERVAL)


class LiveSession(Session):
    """The session of a page that shows a running swarm; `after` returns the session to use when the run has ended."""

    def __init__(self, live: LiveView, after: Callable[[], Session | None] = lambda: None) -> None:
        super().__init__(live)
        self._live = live
        self._make_after = after
        self._after: Session | None = None

    @property
    def over(self) -> bool:
        """Whether the session is that of the ended run."""
        return self._after is not None

    def poll(self, now: float) -> list[protocol.Message]:
        """Return the new messages at a time (s) of the clock."""
        if self._after is None:
            self._after = self._make_after()
        return super().poll(now) if self._after is None else self._after.poll(now)

    def latest(self, now: float) -> Iterable[protocol.Message | None]:
        """Return the messages that hold at a time (s)."""
        return self._live.latest(now)

    def control(self, request: Control) -> None:
        """Handle a request of the page; a running swarm has no playback."""
        if self._after is not None:
            self._after.control(request)

"""A running swarm as the view shows it, and what each page gets of it."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING

from swarmabs_view.curves import CurveBuffer
from swarmabs_view.frame import events_of, frame_of, robots_of
from swarmabs_view.protocol import Curves, Events, Frame, Hello, Sets, State
from swarmabs_view.shading import Shading

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_bag.swarm_state import SwarmState
    from swarmabs_core.messages import Message
    from swarmabs_view import protocol
    from swarmabs_view.listener import Listener
    from swarmabs_view.protocol import Control, Health, Phase
    from swarmabs_view.server import Session

INTERVAL = 1.0 / 30.0
"""Time, s, between two looks at what has come."""
RATE_WINDOW = 2.0
"""Time, s, over which the step rate is taken."""
SILENCE = 3.0
"""Time, s, without a new step after which the swarm counts as silent."""
STATE_INTERVAL = 1.0
"""Longest time, s, between two messages to a page."""


class StepRate:
    """Steps per second of wall time, over the last seconds."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, int]] = deque()

    def __len__(self) -> int:
        return len(self._seen)

    def take(self, now: float, step: int | None) -> None:
        """Note the step at a time (s)."""
        if step is not None and (not self._seen or step != self._seen[-1][1]):
            self._seen.append((now, step))
            self._forget(now)

    def at(self, now: float) -> float | None:
        """Return the rate at a time (s), None if it is not known yet."""
        self._forget(now)
        if len(self._seen) < 2:
            return None
        (begin, first), last = self._seen[0], self._seen[-1][1]
        return (last - first) / (now - begin) if now > begin else None

    def silent_for(self, now: float) -> float | None:
        """Return for how long (s) there has been no new step, None before the first."""
        return now - self._seen[-1][0] if self._seen else None

    def _forget(self, now: float) -> None:
        """Drop what lies before the window, also while no page asks for the rate."""
        while len(self._seen) > 2 and self._seen[0][0] < now - RATE_WINDOW:
            self._seen.popleft()


class LiveView:
    """What is known of a running swarm, for all pages.

    Parameters
    ----------
    hello : Hello
        What is known of it before anything is heard; its robots are then those of the state.
    state : SwarmState
        What is shown.

    Attributes
    ----------
    state : SwarmState
        What is shown.
    curves : CurveBuffer
        The curves so far.
    health : Health or None
        Its processes, as far as they are known.
    phase, text : str
        How it is doing.
    """

    def __init__(self, hello: Hello, state: SwarmState) -> None:
        self.health: Health | None = None
        self.phase: Phase = "waiting"
        self.text = "waiting for the first step"
        self.facts = -1
        self.rate = StepRate()
        self.learn(hello, state)

    def learn(self, hello: Hello, state: SwarmState) -> None:
        """Begin again, with what has become known."""
        self._hello, self.state, self.curves, self.shading = hello, state, CurveBuffer(), Shading(hello)
        self.facts += 1

    def hello(self) -> Hello:
        """Return the first message for a page."""
        return self._hello.model_copy(update={"robots": robots_of(self.state.robots)})

    def add(self, message: Message) -> None:
        """Take a message of the swarm."""
        complete = self.state.add(message)
        if complete is not None:
            self.curves.add(complete)

    def look(self, now: float) -> None:
        """Conclude from the steps that have come how the swarm is doing."""
        self.rate.take(now, self.state.step)
        silence = self.rate.silent_for(now)
        if silence is None:
            return
        if silence < SILENCE:
            self.phase, self.text = "running", ""
        else:
            self.phase, self.text = "silent", f"no step since {self.state.step}"

    async def listen(self, listener: Listener, over: Callable[[], bool]) -> None:
        """Listen until it is over, and some time longer for what is still on its way."""
        clock = asyncio.get_running_loop().time
        left = 3
        while left:
            for heard in listener.poll():
                self.add(heard.message)
            self.look(clock())
            left = left - 1 if over() else 3
            await asyncio.sleep(INTERVAL)


class LiveSession:
    """What one page has received of a running swarm, and what it still lacks.

    Parameters
    ----------
    live : LiveView
        The swarm.
    after : callable
        Makes what the page sees when the run is over; None as long as it is not.
    """

    def __init__(self, live: LiveView, after: Callable[[], Session | None] = lambda: None) -> None:
        self._live = live
        self._make_after = after
        self._after: Session | None = None
        self._known = (-1, -1)
        self._version = -1
        self._curves = (-1, 0)
        self._events = 0
        self._sets: Sets | None = None
        self._health: Health | None = None
        self._state: tuple[str, str] | None = None
        self._told = float("-inf")

    def hello(self) -> list[protocol.Message]:
        """Return what a page needs first."""
        live = self._live
        self._known = (live.facts, len(live.state.robots))
        self._version, self._curves, self._events, self._state = -1, (-1, 0), 0, None
        self._sets = live.shading.first
        return [live.hello(), Events(replace=True, events=[])]

    def poll(self, now: float) -> list[protocol.Message]:
        """Return what is new at a time (s) of the clock."""
        if self._after is None:
            self._after = self._make_after()
            if self._after is not None:
                return self._after.hello()
        if self._after is not None:
            return self._after.poll(now)
        live, state = self._live, self._live.state
        messages: list[protocol.Message] = []
        if self._known != (live.facts, len(state.robots)):
            messages += self.hello()
        if state.version != self._version:
            self._version = state.version
            messages += [*self._new_curves(), *self._new_events(), *self._frame(now)]
        messages += self._new_sets()
        if live.health is not self._health and live.health is not None:
            self._health = live.health
            messages.append(live.health)
        if (live.phase, live.text) != self._state or (not messages and now - self._told >= STATE_INTERVAL):
            self._state = (live.phase, live.text)
            messages.append(State(phase=live.phase, text=live.text))
        if messages:
            self._told = now
        return messages

    def control(self, request: Control) -> None:
        """Do what the page asks for; a running swarm cannot be played."""
        if self._after is not None:
            self._after.control(request)

    def _frame(self, now: float) -> list[Frame]:
        instant = self._live.state.instant()
        if instant is None:
            return []
        return [frame_of(instant, self._live.state.shown_robots(instant.step), self._live.rate.at(now))]

    def _new_sets(self) -> list[Sets]:
        found = self._live.shading.of(self._live.state.members())
        if found is None or found is self._sets:
            return []
        self._sets = found
        return [found]

    def _new_curves(self) -> list[Curves]:
        buffer = self._live.curves
        found = buffer.since(*self._curves)
        self._curves = (buffer.epoch, len(buffer))
        return [] if found is None else [found]

    def _new_events(self) -> list[Events]:
        state = self._live.state
        count = min(state.event_count - self._events, len(state.events))
        self._events = state.event_count
        return [Events(replace=False, events=events_of(state.events[-count:]))] if count else []

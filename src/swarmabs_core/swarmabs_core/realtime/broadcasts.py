"""Validation of the broadcasts that a robot receives: the newest complete set of one step, or why there is none."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.messages import (
    BROADCASTS,
    DESIRED_ABSTRACT_STATE,
    TOPIC_OF,
    Broadcast,
    DesiredAbstractState,
    Message,
    Mode,
    Topic,
)
from swarmabs_core.realtime.validation import Heard

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_core.realtime.base import Schedule
    from swarmabs_core.realtime.validation import Bounds

MOST_GUARD = 0.5
"""Upper limit of the guard time between the last STOP and an effective RESET, s: half of the duration of RESET."""
MOST_CHANGES = 2
"""Steps within the age limit in which one parent controller may change its mode; more indicate a second one."""
_LONG_AGO = -(2**62)


class ModeLatch:
    """Whether the swarm is stopped: STOP sets the latch, RESET releases it.

    Order and repetition of messages do not matter: only the newest step of each mode counts. A RESET is effective only
    if it is more than `guard` steps newer than the newest STOP, so that a forged RESET from the allowed future cannot
    override a controller that keeps publishing STOP. After a reset by the operator, a controller no longer publishes
    STOP, and publishes RESET for longer than the guard.

    Attributes
    ----------
    reset_step : int
        Newest step of a RESET.
    """

    def __init__(self, guard: int) -> None:
        self._guard = guard
        self._stop_step: int | None = None
        self.reset_step = _LONG_AGO

    @property
    def stopped(self) -> bool:
        """Whether a STOP was received and no effective RESET."""
        return self._stop_step is not None and self.reset_step - self._stop_step <= self._guard

    def stop(self, step: int) -> None:
        """Record a STOP of a step."""
        self._stop_step = step if self._stop_step is None else max(self._stop_step, step)

    def reset(self, step: int) -> None:
        """Record a validated RESET of a step."""
        self.reset_step = max(self.reset_step, step)

    def forget(self, step: int) -> None:
        """Discard steps of the old clock; if the latch is set, it is set as of `step`."""
        self._stop_step = step if self.stopped else None
        self.reset_step = _LONG_AGO


class BroadcastInbox:
    """Takes broadcasts in any order and keeps the newest complete set of valid ones.

    Above the age limit (s) a broadcast is outdated; it may be in the future by at most the tolerance (s).

    Attributes
    ----------
    newest : Broadcast or None
        The newest complete set.
    """

    def __init__(self, schedule: Schedule, age_limit: float, clock_tolerance: float, bounds: Bounds) -> None:
        self._schedule = schedule
        self._age = schedule.steps(age_limit)
        ahead = schedule.ahead(clock_tolerance)
        self._bounds = bounds
        self._heard: Heard[tuple[Topic, int]] = Heard(self._age, ahead)
        self._latch = ModeLatch(min(self._age + ahead, schedule.steps(MOST_GUARD)))
        self.newest: Broadcast | None = None

    @property
    def stopped(self) -> bool:
        """Whether a STOP was received, and since then no effective RESET."""
        return self._latch.stopped

    def add(self, message: Message, now: int) -> str:
        """Take a message; return why it is rejected, empty if it is valid. An older or repeated one changes nothing."""
        topic = TOPIC_OF[type(message)]
        if topic not in BROADCASTS:
            return "not a broadcast"
        step = self._schedule.step(now)
        if self._heard.from_future(message, step):
            return f"{topic.name}: from the future; the clocks differ, or it is of another swarm"
        if isinstance(message, DesiredAbstractState) and message.mode == Mode.STOP:
            self._latch.stop(message.step)  # even if it is otherwise invalid
        if message.step < step - self._age:
            return f"{topic.name}: outdated"
        problem = self._bounds.problem(message) or self._contradiction(topic, message, step)
        if problem:
            return f"{topic.name}: {problem}"
        if isinstance(message, DesiredAbstractState) and message.mode == Mode.RESET:
            self._latch.reset(message.step)
        self._complete(message.step)
        return ""

    def forget(self, now: int) -> None:
        """Discard everything but the latch, because the clock was set."""
        self._heard.forget()
        self._latch.forget(self._schedule.step(now))
        self.newest = None

    def _contradiction(self, topic: Topic, message: Message, step: int) -> str:
        """Store a message; return a contradiction with another of the same step, or a sign of a second controller."""
        mode = 0
        if isinstance(message, DesiredAbstractState):
            mode = message.mode  # the parent controller may change its mode within a step
            if mode != Mode.RUN:
                message = message._replace(stamp=0)  # a repeated service call publishes the mode again
        place = topic, mode
        if self._heard.add(place, message, step):
            return "two different ones of a step; a second swarm, or an intruder"
        if _has_changed(self._heard.of(message.step)) and self._changes() > MOST_CHANGES:
            self._heard.doubt(place, step)
            return "its mode changes again and again; a second controller, or an intruder"
        return ""

    def _changes(self) -> int:
        """Return the number of steps with more than one mode."""
        return sum(map(_has_changed, self._heard.steps()))

    def _complete(self, step: int) -> None:
        """Make the broadcasts of a step the newest set, if it is complete."""
        if self.newest is not None and step <= self.newest.step:
            return
        first: dict[Topic, Message] = {}
        for (topic, _), message in self._heard.of(step).items():
            first.setdefault(topic, message)
        if len(first) == len(BROADCASTS):
            abstract, sums, desired = (first[t] for t in BROADCASTS)
            self.newest = Broadcast(desired.stamp, step, abstract, sums, desired)  # type: ignore[arg-type]  # by topic

    def problem(self, now: int) -> str:
        """Return why the newest set must not be followed; empty if it may be."""
        step = self._schedule.step(now)
        if self.stopped:
            return "stop commanded"
        if self._heard.doubts_any(step):
            return "the broadcasts contradict each other"
        if self.newest is None:
            return "no complete broadcasts yet"
        if step - self.newest.step > self._age:
            return "the broadcasts are outdated"
        if self.newest.desired.mode != Mode.RUN or self.newest.step <= self._latch.reset_step:
            return "reset commanded"
        return ""


def _has_changed(places: Iterable[tuple[Topic, int]]) -> bool:
    """Return whether the messages of a step contain more than one mode."""
    return sum(topic is DESIRED_ABSTRACT_STATE for topic, _ in places) > 1

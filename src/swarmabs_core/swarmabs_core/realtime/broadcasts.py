"""What a robot believes of what it hears: the newest complete set of broadcasts of one step, or why there is none."""

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
"""Time by which a RESET must at most be newer than the last STOP, s: half of that for which RESET is said."""
MOST_CHANGES = 2
"""Steps within the age limit in which a parent controller may change its mode; more often, there are two of them."""
_LONG_AGO = -(2**62)


class ModeLatch:
    """Whether the swarm is stopped: what STOP closes and RESET opens.

    It is the same for the same messages, in whatever order and however often they arrive: only the newest step of each
    counts. A RESET wins only if it is more than `guard` steps newer than the newest STOP: whoever says RESET from as
    far in the future as is allowed does not overrule one who goes on to say STOP. A controller whose operator resets
    says no STOP any more, and RESET for long enough to come beyond the guard.

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
        """Whether STOP was heard and no RESET that opens it."""
        return self._stop_step is not None and self.reset_step - self._stop_step <= self._guard

    def stop(self, step: int) -> None:
        """Take a STOP of a step."""
        self._stop_step = step if self._stop_step is None else max(self._stop_step, step)

    def reset(self, step: int) -> None:
        """Take a RESET of a step, which must have been found good."""
        self.reset_step = max(self.reset_step, step)

    def forget(self, step: int) -> None:
        """Forget the steps since they were counted by another clock; who is stopped, is so as of now."""
        self._stop_step = step if self.stopped else None
        self.reset_step = _LONG_AGO


class BroadcastInbox:
    """Takes broadcasts in any order and keeps the newest complete set of those that can be vouched for.

    From the age limit (s) on a broadcast is outdated, and by the tolerance (s) it may be from the future.

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
        """Whether STOP was heard, and since then no RESET that opens the latch."""
        return self._latch.stopped

    def add(self, message: Message, now: int) -> str:
        """Take a message; return why it is refused, empty if it is not. An older or repeated one changes nothing."""
        topic = TOPIC_OF[type(message)]
        if topic not in BROADCASTS:
            return "not a broadcast"
        step = self._schedule.step(now)
        if self._heard.from_future(message, step):
            return f"{topic.name}: from the future; the clocks differ, or it is of another swarm"
        if isinstance(message, DesiredAbstractState) and message.mode == Mode.STOP:
            self._latch.stop(message.step)  # whatever else may be wrong with it
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
        """Forget all but whether the swarm was stopped, since the clock was set."""
        self._heard.forget()
        self._latch.forget(self._schedule.step(now))
        self.newest = None

    def _contradiction(self, topic: Topic, message: Message, step: int) -> str:
        """Keep a message; notice if another one claims to be the one of its step, or if there are two controllers."""
        mode = 0
        if isinstance(message, DesiredAbstractState):
            mode = message.mode  # the parent controller may change its mind within a step
            if mode != Mode.RUN:
                message = message._replace(stamp=0)  # and says it once more when it is asked twice
        place = topic, mode
        if self._heard.add(place, message, step):
            return "two different ones of a step; a second swarm, or an intruder"
        if _has_changed(self._heard.of(message.step)) and self._changes() > MOST_CHANGES:
            self._heard.doubt(place, step)
            return "its mode changes again and again; a second controller, or an intruder"
        return ""

    def _changes(self) -> int:
        """Return in how many steps there was more than one mode."""
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
        """Return why the newest set must not be followed, empty if it may be."""
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
    """Tell whether there was more than one mode among what was heard of a step."""
    return sum(topic is DESIRED_ABSTRACT_STATE for topic, _ in places) > 1

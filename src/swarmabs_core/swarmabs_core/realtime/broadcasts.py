"""What a robot believes of what it hears: the newest complete set of broadcasts of one step, or why there is none."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.messages import (
    BROADCASTS,
    TOPIC_OF,
    AbstractState,
    AuxiliaryState,
    DesiredAbstractState,
    Message,
    Mode,
    Topic,
)

if TYPE_CHECKING:
    from swarmabs_core.realtime.base import Schedule
    from swarmabs_core.realtime.plausibility import Bounds

MOST_STEPS = 16
"""Steps whose sets may be incomplete at the same time; of more, the oldest is given up."""


_LONG_AGO = -(2**62)


class BroadcastSet(NamedTuple):
    """The three broadcasts of one step."""

    abstract: AbstractState
    sums: AuxiliaryState
    desired: DesiredAbstractState

    @property
    def step(self) -> int:
        """The step."""
        return self.abstract.step


class BroadcastInbox:
    """Takes broadcasts in any order and keeps the newest complete set of those that can be vouched for.

    Parameters
    ----------
    schedule : Schedule
        How time becomes steps.
    age_limit, clock_tolerance : float
        From which age on a broadcast is outdated, and by how much it may be from the future, s.
    bounds : Bounds
        What a broadcast may say.

    Attributes
    ----------
    newest : BroadcastSet or None
        The newest complete set.
    stopped : bool
        Whether STOP was heard and no RESET since.
    """

    def __init__(self, schedule: Schedule, age_limit: float, clock_tolerance: float, bounds: Bounds) -> None:
        self._schedule = schedule
        self._age = schedule.steps(age_limit)
        self._ahead = schedule.ahead(clock_tolerance)
        self._bounds = bounds
        self._partial: dict[int, dict[Topic, Message]] = {}
        self._contradicted = self._mode_step = _LONG_AGO
        self.newest: BroadcastSet | None = None
        self.stopped = False

    def add(self, message: Message, now: int) -> str:
        """Take a message; return why it is refused, empty if it is not. An older or repeated one changes nothing."""
        topic = TOPIC_OF[type(message)]
        if topic not in BROADCASTS:
            return "not a broadcast"
        step = self._schedule.step(now)
        if message.step > step + self._ahead:
            return f"{topic.name}: from the future; the clocks differ, or it is of another swarm"
        if isinstance(message, DesiredAbstractState) and message.mode != Mode.RUN:
            self._obey(message)
        if message.step < step - self._age:
            return f"{topic.name}: outdated"
        problem = self._bounds.problem(message)
        if problem:
            return f"{topic.name}: {problem}"
        return self._keep(topic, message, step)

    def forget(self) -> None:
        """Forget all but whether the swarm was stopped."""
        self._partial.clear()
        self.newest = None
        self._contradicted = self._mode_step = _LONG_AGO

    def _obey(self, desired: DesiredAbstractState) -> None:
        """Take over STOP and RESET; one that was overtaken by a later one has no effect."""
        if desired.step < self._mode_step:
            return
        if desired.mode == Mode.STOP:
            self.stopped, self._mode_step = True, desired.step
        elif desired.mode == Mode.RESET and (desired.step > self._mode_step or not self.stopped):
            self.stopped, self._mode_step = False, desired.step

    def _keep(self, topic: Topic, message: Message, step: int) -> str:
        if self.newest is not None and message.step <= self.newest.step:
            return self._check(self.newest[BROADCASTS.index(topic)], topic, message, step)
        heard = self._partial.setdefault(message.step, {})
        problem = self._check(heard.setdefault(topic, message), topic, message, step)
        if len(heard) == len(BROADCASTS):
            self.newest = BroadcastSet(*(heard[t] for t in BROADCASTS))  # type: ignore[arg-type]  # kept by topic
            self._partial = {k: v for k, v in self._partial.items() if k > message.step}
        while len(self._partial) > MOST_STEPS:
            del self._partial[min(self._partial)]
        return problem

    def _check(self, known: Message, topic: Topic, message: Message, step: int) -> str:
        """Notice that two different messages claim to be the one of a step."""
        if message.step != known.step or message == known:
            return ""
        if isinstance(message, DesiredAbstractState) and message.mode != known.mode:  # type: ignore[union-attr]
            return ""  # the parent controller has changed its mind within the step
        self._contradicted = step
        return f"{topic.name}: two different ones of a step; a second swarm, or an intruder"

    def problem(self, now: int) -> str:
        """Return why the newest set must not be followed, empty if it may be."""
        step = self._schedule.step(now)
        if self.stopped:
            return "stop commanded"
        if step - self._contradicted <= self._age:
            return "the broadcasts contradict each other"
        if self.newest is None:
            return "no complete broadcasts yet"
        if step - self.newest.step > self._age:
            return "the broadcasts are outdated"
        return "" if self.newest.desired.mode == Mode.RUN else "reset commanded"

"""Validation of the broadcasts that a robot receives: the newest complete set of one step, or why there is none."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.events import EventCode
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
from swarmabs_core.realtime.base import UNKNOWN
from swarmabs_core.realtime.leadership import PRIMARY, STANDBY
from swarmabs_core.realtime.modes import MOST_LATE, ModeLatch
from swarmabs_core.realtime.validation import Heard, Origin, Problem, Writers

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_core.realtime.base import Schedule, Sender
    from swarmabs_core.realtime.validation import Bounds

MOST_CHANGES = 2
"""Steps within the age limit in which one parent controller may change its mode; more indicate a second one."""
_LONG_AGO = -(2**62)
MOST_BEHIND = 3
"""Largest number of steps by which a robot's coordinators may be behind others without being left for them."""


_Place = tuple[Topic, int, bool]
"""Where a broadcast belongs within its step: topic, mode of a desired state, and whether it is a standby's."""


class Coordinators(NamedTuple):
    """The instances that broadcasts come from: for each, whether it is the standby and not the primary."""

    observer: bool = False
    controller: bool = False

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the values for a health status."""
        instance = {False: PRIMARY, True: STANDBY}
        return ("follows observer", instance[self.observer]), ("follows controller", instance[self.controller])


ANY = tuple(Coordinators(observer, controller) for observer in (False, True) for controller in (False, True))
"""All combinations of instances, first those of the primaries."""
_SENDERS = {of: tuple(zip(BROADCASTS, (of.observer, of.observer, of.controller), strict=True)) for of in ANY}
"""For each combination, the topics of a set, and whether a standby sends it."""


class BroadcastInbox:
    """Takes broadcasts in any order and keeps the newest complete set of valid ones.

    Above the age limit (s) a broadcast is outdated; it may be in the future by at most the tolerance (s).

    Where coordinators have standbys, a set consists of the two broadcasts of one observer and the one of one
    controller. The robot stays with the instances that it follows until others are more than `MOST_BEHIND` steps ahead,
    or theirs contradict each other.

    Attributes
    ----------
    followed : Coordinators
        The instances that the robot follows.
    writers : Writers
        Who speaks for which instance.
    """

    def __init__(self, schedule: Schedule, age_limit: float, clock_tolerance: float, bounds: Bounds) -> None:
        self._schedule = schedule
        self._age = schedule.steps(age_limit)
        self._bounds = bounds
        self._heard: Heard[_Place] = Heard(self._age, schedule.ahead(clock_tolerance))
        self.writers = Writers(self._age)
        self._latch = ModeLatch(schedule, age_limit, clock_tolerance)
        self._latest = max(self._age, schedule.steps(MOST_LATE))
        self._sets: dict[Coordinators, Broadcast] = {}
        self.followed = ANY[0]

    @property
    def newest(self) -> Broadcast | None:
        """The newest complete set of the coordinators that the robot follows."""
        return self._sets.get(self.followed)

    @property
    def stopped(self) -> bool:
        """Whether a STOP was received, and since then no effective RESET."""
        return self._latch.stopped

    def add(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Problem | None:
        """Take a message; return why it is rejected, None if it is valid. An older or repeated one changes nothing."""
        topic = TOPIC_OF[type(message)]
        if topic not in BROADCASTS:
            return Problem("not a broadcast")
        step, origin = self._schedule.step(now), Origin(topic.name, standby=sender.standby)
        untimely = self._heard.untimely(message, step)
        if self._heard.from_future(message, step):
            return untimely and untimely.of(origin)
        if isinstance(message, DesiredAbstractState) and message.mode == Mode.STOP:
            self._latch.stop(message.step)  # even if it is otherwise invalid
        problem = self._bounds.problem(message)
        if not problem and not untimely:
            problem = self._contradiction(topic, message, step, origin, sender.writer)
        if isinstance(message, DesiredAbstractState) and message.mode == Mode.RESET and not problem:
            self._reset(message.step, step)
        problem = untimely or problem
        if problem:
            return problem.of(origin)
        self._complete(message.step)
        self._choose(step)
        return None

    def _reset(self, of: int, step: int) -> None:
        """Note a RESET of a step, which may be outdated, but not by much."""
        if step - of <= self._latest:
            self._latch.reset(of)

    def forget(self, now: int) -> None:
        """Discard everything but the latch, because the clock was set."""
        self._heard.forget()
        self._latch.forget(self._schedule.step(now))
        self._sets.clear()

    def _contradiction(
        self, topic: Topic, message: Message, step: int, origin: Origin, writer: bytes
    ) -> Problem | None:
        """Store a message; return a contradiction with another of the same step, or a sign of a second sender."""
        standby = origin.standby
        second = self.writers.second(origin, writer, step)
        mode = 0
        if isinstance(message, DesiredAbstractState):
            mode = message.mode  # the parent controller may change its mode within a step
            if mode != Mode.RUN:
                message = message._replace(stamp=0)  # a repeated service call publishes the mode again
        place = topic, mode, standby
        differs = self._heard.add(place, message, step, refused=second is not None)
        if second:
            return second
        if differs:
            return Problem("two different ones of a step; a second swarm, or an intruder")
        if _has_changed(self._heard.of(message.step), standby) and self._changes(standby) > MOST_CHANGES:
            self._heard.doubt(place, step)
            return Problem("its mode changes again and again; a second controller, or an intruder")
        return None

    def _changes(self, standby: bool) -> int:  # noqa: FBT001 - it identifies the controller
        """Return the number of steps in which a controller has sent more than one mode."""
        return sum(_has_changed(places, standby) for places in self._heard.steps())

    def _complete(self, step: int) -> None:
        """Make the broadcasts of a step the newest set of the coordinators that have sent all of them."""
        heard = self._heard.of(step)
        if len(heard) < len(BROADCASTS):
            return
        first: dict[tuple[Topic, bool], Message] = {}
        for (topic, _, standby), message in heard.items():
            first.setdefault((topic, standby), message)
        for of, senders in _SENDERS.items():
            newest = self._sets.get(of)
            if all(map(first.__contains__, senders)) and (newest is None or step > newest.step):
                abstract, sums, desired = map(first.__getitem__, senders)
                self._sets[of] = Broadcast(desired.stamp, step, abstract, sums, desired)  # type: ignore[arg-type]  # by topic

    def _choose(self, step: int) -> None:
        """Leave the coordinators that the robot follows if their set is doubted, missing, or far behind others.

        Those that are doubted are left once their known writers are silent: who contradicts them may be speaking for
        the others, too.
        """
        if len(self._sets) == 1 and self.followed in self._sets:
            return
        if self._doubts(self.followed, step) and self._speaks(self.followed):
            return
        trusted = {of: newest.step for of, newest in self._sets.items() if not self._doubts(of, step)}
        if not trusted:
            return
        newest = max(trusted.values())
        if newest - trusted.get(self.followed, _LONG_AGO) > MOST_BEHIND:
            before = self.followed
            self.followed = max(
                trusted,
                key=lambda of: (trusted[of], of.observer == before.observer, of.controller == before.controller),
            )

    def _speaks(self, of: Coordinators) -> bool:
        """Return whether the known writers of coordinators are heard."""
        origins = (Origin(topic.name, standby=standby) for topic, standby in _SENDERS[of])
        return all(self.writers.is_heard(origin, MOST_BEHIND) for origin in origins)

    def _doubts(self, of: Coordinators, step: int) -> bool:
        """Return whether any broadcasts of these coordinators contradict each other."""
        return any(
            standby is (of.controller if topic is DESIRED_ABSTRACT_STATE else of.observer)
            for topic, _, standby in self._heard.doubted(step)
        )

    def problem(self, now: int) -> str:
        """Return why the newest set must not be followed; empty if it may be."""
        step = self._schedule.step(now)
        if self.stopped:
            return "stop commanded"
        self._choose(step)
        newest = self.newest
        if self._doubts(self.followed, step):
            return "the broadcasts contradict each other"
        if newest is None:
            return EventCode.NO_BROADCASTS.text
        if step - newest.step > self._age:
            return "the broadcasts are outdated"
        if newest.desired.mode != Mode.RUN or newest.step <= self._latch.reset_step:
            return "reset commanded"
        return ""


def _has_changed(places: Iterable[_Place], standby: bool) -> bool:  # noqa: FBT001 - it identifies the controller
    """Return whether the messages of a step contain more than one mode of a controller."""
    return [(topic, sender) for topic, _, sender in places].count((DESIRED_ABSTRACT_STATE, standby)) > 1

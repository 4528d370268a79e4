"""The messages of a few steps, as a bag brings them, sorted by the step to which they belong."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_analysis.difference import Difference
from swarmabs_core.messages import AGENT_STATE, EVENTS, MAIN_TOPICS

if TYPE_CHECKING:
    from swarmabs_core.messages import Topic
    from swarmabs_core.record import Record

WINDOW = 100
"""How many steps the messages of a bag may be out of order."""
_MOST_PER_MEMBER = 8
"""More than a robot or a topic has of messages and events in a step."""


class Slot:
    """What a bag has of one step."""

    __slots__ = ("agents", "coordinated", "events", "malformed")

    def __init__(self) -> None:
        self.agents: list[Record] = []
        self.coordinated: dict[Topic, list[Record]] = {}
        self.events: list[Record] = []
        self.malformed: list[Difference] = []

    def __len__(self) -> int:
        others = sum(len(found) for found in self.coordinated.values())
        return len(self.agents) + others + len(self.events) + len(self.malformed)

    def add(self, stored: Record) -> None:
        """Put a message into its place."""
        if stored.topic is AGENT_STATE:
            self.agents.append(stored)
        elif stored.topic is EVENTS:
            self.events.append(stored)
        else:
            self.coordinated.setdefault(stored.topic, []).append(stored)


_EMPTY = Slot()


class Window:
    """The steps that are not judged yet.

    Parameters
    ----------
    period_ns : int
        Control period, ns.
    robots : int
        Number of robots.
    """

    def __init__(self, period_ns: int, robots: int) -> None:
        self._period_ns = period_ns
        self._slots: dict[int, Slot] = {}
        self._capacity = (WINDOW + 2) * _MOST_PER_MEMBER * (robots + len(MAIN_TOPICS))
        self._count = 0
        self.newest = -1

    def __len__(self) -> int:
        return len(self._slots)

    @property
    def full(self) -> bool:
        """Whether there is more than any run has in so many steps."""
        return self._count > self._capacity

    def step_of(self, found: Record | Difference) -> int:
        """Return the step to which a message belongs, or what is none: that on which two of its three times agree.

        They are log time, stamp and step; if all differ, the step that it says.
        """
        if isinstance(found, Difference):
            return found.step or 0
        message, time = found.message, found.time
        stamp, step = message.stamp, message.step
        said = step * self._period_ns
        if said not in {stamp, time} and stamp == time and stamp % self._period_ns == 0:
            return stamp // self._period_ns
        return step

    def add(self, step: int, found: Record | Difference) -> None:
        """Put a message, or what is none, into the slot of a step."""
        self._count += 1
        slot = self._slots.get(step)
        if slot is None:
            slot = self._slots[step] = Slot()
            self.newest = max(self.newest, step)
        if isinstance(found, Difference):
            slot.malformed.append(found)
        else:
            slot.add(found)

    def get(self, step: int) -> Slot:
        """Return the slot of a step."""
        return self._slots.get(step, _EMPTY)

    def take(self, step: int) -> Slot:
        """Return the slot of a step, and forget it."""
        slot = self._slots.pop(step, _EMPTY)
        self._count -= len(slot)
        return slot

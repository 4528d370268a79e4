"""Which messages a node in real time believes: none from the future, and none of a place where two differ.

In lockstep a node gathers all messages of a step (`swarmabs_core.behaviours.gathering`). Here it takes the newest, so
it has to notice by itself when two senders claim one place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from swarmabs_core.messages import Message

Place = TypeVar("Place")
"""What tells messages of a step apart that do not exclude each other; hashable."""


TWO_STATES = "two different states of a step"
"""Why no state of a robot is believed."""


class Heard(Generic[Place]):
    """The first message of each step and place, for as long as another one may come there, and where two differed.

    Nodes believe the newest message. What is from the future is the newest until its step has come, so it is not enough
    to compare with the newest: whoever is always ahead would never be compared with those whom he has overtaken.

    Parameters
    ----------
    age, ahead : int
        Steps, older and newer than now, of which messages are kept.
    """

    def __init__(self, age: int, ahead: int) -> None:
        self._age = age
        self._ahead = ahead
        self._steps: dict[int, dict[Place, Message]] = {}
        self._contradicted: dict[Place, int] = {}

    def from_future(self, message: Message, step: int) -> bool:
        """Tell whether a message is newer than clocks that agree allow in a step."""
        return message.step > step + self._ahead

    def add(self, place: Place, message: Message, step: int) -> bool:
        """Keep a message that is the first in its place; tell whether it differs from the first.

        Parameters
        ----------
        place : hashable
            Its place within the step.
        message : Message
            The message; one of a step that is not kept differs from nothing.
        step : int
            The step that it is now.
        """
        if not step - self._age <= message.step <= step + self._ahead:
            return False
        if message.step not in self._steps:
            kept = range(step - self._age, step + self._ahead + 1)
            self._steps = {k: heard for k, heard in self._steps.items() if k in kept}
        differs = self._steps.setdefault(message.step, {}).setdefault(place, message) != message
        if differs:
            self.doubt(place, step)
        return differs

    def doubt(self, place: Place, step: int) -> None:
        """Believe nothing of a place from a step on, until the messages of that step are outdated."""
        self._contradicted[place] = step

    def doubts(self, place: Place, step: int) -> bool:
        """Tell whether nothing of a place is to be believed: two differed, and nobody knows who was first."""
        since = self._contradicted.get(place)
        return since is not None and step - since <= self._age

    def doubts_any(self, step: int) -> bool:
        """Tell whether nothing of some place is to be believed."""
        return any(self.doubts(place, step) for place in self._contradicted)

    def of(self, step: int) -> Mapping[Place, Message]:
        """Return what was heard of a step, by its place, in the order in which it came."""
        return self._steps.get(step, {})

    def steps(self) -> Collection[Mapping[Place, Message]]:
        """Return what was heard of each step that is kept."""
        return self._steps.values()

    def forget(self) -> None:
        """Forget everything."""
        self._steps.clear()
        self._contradicted.clear()

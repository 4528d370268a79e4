"""What was heard of the last steps: two different messages in one place are noticed, whatever came in between."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from swarmabs_core.messages import Message

Place = TypeVar("Place")
"""What tells messages of a step apart that do not exclude each other; hashable."""


class Heard(Generic[Place]):
    """The first message of each step and place, for as long as another one may come there.

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
        return self._steps.setdefault(message.step, {}).setdefault(place, message) != message

    def of(self, step: int) -> Mapping[Place, Message]:
        """Return what was heard of a step, by its place, in the order in which it came."""
        return self._steps.get(step, {})

    def steps(self) -> Collection[Mapping[Place, Message]]:
        """Return what was heard of each step that is kept."""
        return self._steps.values()

    def forget(self) -> None:
        """Forget everything."""
        self._steps.clear()

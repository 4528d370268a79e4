"""Holding a run back, so that people can follow it: it is no faster than wanted, and the same in every bit."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from swarmabs_core.messages import PlaneState

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.behaviours import SteeringController
    from swarmabs_core.messages import Message, Messages, Topic

SLOWEST = 1.0
"""Longest wall time of a step, s: shorter than any stall."""


class Paced:
    """What steers a run, holding each order back until its step is due.

    Parameters
    ----------
    controller : SteeringController
        What steers.
    seconds : float
        Shortest wall time of a step, s.
    clock, sleep : callable
        Time in s, and waiting for some.
    """

    def __init__(
        self,
        controller: SteeringController,
        seconds: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._controller = controller
        self._seconds = seconds
        self._clock = clock
        self._sleep = sleep
        self._due = 0.0

    def start(self) -> Messages:
        """Start what steers."""
        self._due = self._clock()
        return self._controller.start()

    def handle(self, message: Message) -> Messages:
        """Hand a message on; with the plane's state of a new step not before the next step is due.

        A run that is late is not made up for: the next step is due its time after this one.
        """
        if isinstance(message, PlaneState) and message.step == self._controller.step:
            wait = self._due + self._seconds - self._clock()
            if wait > 0.0:
                self._sleep(wait)
            self._due = max(self._due + self._seconds, self._clock())
        return self._controller.handle(message)

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for what it waits for."""
        return self._controller.awaits()

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and what is missing for it."""
        return self._controller.missing()

"""What verifying a run has in common, in lockstep and in real time; see `swarmabs_analysis.verification`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from enum import Enum
from typing import TYPE_CHECKING

from swarmabs_analysis.difference import PAYLOAD, Difference, in_hex
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from swarmabs_core.messages import Topic


class Ending(Enum):
    """How a bag ends."""

    WHOLE = "whole"
    """With the last step of the scenario."""
    EARLY = "early"
    """Before, and it says so: its run failed or was interrupted, or its recorder came to an end within a step."""
    CUT = "cut"
    """Anywhere: the rest was lost."""


class Verification(ABC):
    """Follows a recorded run message by message, and judges a step when nothing of it can come any more.

    Parameters
    ----------
    tolerance : float
        A recorded number may differ from the recomputed b by ``tolerance * (1 + |b|)``; with 0 every bit counts.

    Attributes
    ----------
    difference : Difference or None
        The first difference by step; within a step robots by id, plane, abstract, auxiliary, desired state, events.
    steps : int
        Steps that were found right, in real time those of which a message was judged.
    messages : int
        How many messages were found right.
    not_checkable : Counter of str
        How many could not be checked, by the reason.
    expected_steps : int or None
        How many steps a whole run has, None if that is not known.
    """

    def __init__(self, tolerance: float) -> None:
        self.difference: Difference | None = None
        self.steps = self.messages = 0
        self.not_checkable: Counter[str] = Counter()
        self.expected_steps: int | None = None
        self._tolerance = tolerance

    @property
    @abstractmethod
    def step(self) -> int:
        """The first step that is not verified, 0 before there is one."""

    @property
    @abstractmethod
    def decided(self) -> bool:
        """Whether no further message can change what is found."""

    def add(self, topic: Topic, time: int, payload: bytes, published: int | None = None) -> None:
        """Take the next message of the bag.

        Parameters
        ----------
        topic : Topic
            A topic that is recorded.
        time : int
            Its log time, ns.
        payload : bytes
            Its bytes.
        published : int, optional
            When it was published, ns, if that is to be verified.
        """
        if self.decided:
            return
        try:
            found: Record | Difference = Record.read(topic, time, payload, published)
        except MalformedMessageError as error:
            step = self._step_of_no_message(time)
            found = Difference(topic.name, step, None, PAYLOAD, in_hex(payload), None, str(error))
        self._take(found)

    @abstractmethod
    def _take(self, found: Record | Difference) -> None:
        """Take a message, or that there is none."""

    @abstractmethod
    def _step_of_no_message(self, time: int) -> int | None:
        """Return the step of bytes that are no message, by their log time (ns); None if that does not tell it."""

    @abstractmethod
    def finish(self, ending: Ending) -> None:
        """Judge what is left at the end of the bag."""

    @abstractmethod
    def digest(self) -> str | None:
        """Return the digest of what was found right, None if such a run has none."""

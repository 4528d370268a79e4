"""What verifying a run has in common, in lockstep and in real time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from enum import Enum
from typing import TYPE_CHECKING, TypeAlias

from swarmabs_analysis.difference import PAYLOAD, Difference, in_hex
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_core.messages import Topic

Finding: TypeAlias = "Difference | str | None"
"""None if a message is right, else what is wrong, or why it cannot be checked."""


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
    period_ns : int, optional
        Period of a run in lockstep, ns, whose log times tell the steps.

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

    def __init__(self, tolerance: float, period_ns: int | None = None) -> None:
        self.difference: Difference | None = None
        self.steps = self.messages = 0
        self.not_checkable: Counter[str] = Counter()
        self.expected_steps: int | None = None
        self._tolerance = tolerance
        self._period_ns = period_ns

    @property
    @abstractmethod
    def step(self) -> int:
        """The first step that is not verified, 0 before there is one."""

    @property
    def decided(self) -> bool:
        """Whether no further message can change what is found."""
        return self.difference is not None

    def add(self, topic: Topic, time: int, payload: bytes, published: int | None = None) -> None:
        """Take the next message of the bag, with its log time and, if that is to be verified, its publish time, ns."""
        if self.decided:
            return
        try:
            found: Record | Difference = Record.read(topic, time, payload, published)
        except MalformedMessageError as error:
            step = None if self._period_ns is None else time // self._period_ns
            found = Difference(topic.name, step, None, PAYLOAD, in_hex(payload), None, str(error))
        self._take(found)

    @abstractmethod
    def _take(self, found: Record | Difference) -> None:
        """Take a message, or that there is none."""

    def _judge(self, findings: Iterable[Finding]) -> int:
        """Count what was found of messages, up to the first difference; return of how many something was found."""
        judged = 0
        for finding in findings:
            judged += 1
            if finding is None:
                self.messages += 1
            elif isinstance(finding, str):
                self.not_checkable[finding] += 1
            else:
                self.difference = finding
                break
        return judged

    @abstractmethod
    def finish(self, ending: Ending) -> None:
        """Judge what is left at the end of the bag."""

    def digest(self) -> str | None:
        """Return the digest of what was found right; None in real time, where what is heard differs by the run."""
        return None

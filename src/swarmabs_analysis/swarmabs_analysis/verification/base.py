"""What verifying a run has in common, in lockstep and in real time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

from swarmabs_analysis.difference import PAYLOAD, Difference, in_hex
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_core.messages import Topic

Finding: TypeAlias = "Difference | str | None"
"""None if a message is right, else what is wrong, or why it cannot be checked."""


@dataclass(slots=True)
class Verdict:
    """What was found out about a bag.

    Attributes
    ----------
    bag : str
        The MCAP file.
    scenario : str or None
        Name of its scenario; None if nothing of the bag can be read.
    difference : Difference or None
        The first between what is recorded and what is recomputed, by step; within a step robots by id, plane, abstract,
        auxiliary, desired state, events.
    problem : str or None
        What is wrong with the file.
    steps : int
        Steps that were found right, in real time those of which a message was judged.
    messages : int
        How many messages were found right.
    expected_steps : int or None
        How many steps a whole run of the scenario has: 0 to n are n + 1; None in real time.
    ended_early : str or None
        Why the run ended before its last step.
    digest : str or None
        Digest of what was found right; None in real time, where what is heard differs from run to run.
    tolerance : float
        A recorded number may differ from the recomputed b by ``tolerance * (1 + |b|)``; with 0 every bit counts.
    notes : tuple of str
        What people should know besides.
    not_checkable : Counter of str
        How many messages of a run in real time could not be checked, by the reason.
    """

    bag: str = ""
    scenario: str | None = None
    difference: Difference | None = None
    problem: str | None = None
    steps: int = 0
    messages: int = 0
    expected_steps: int | None = None
    ended_early: str | None = None
    digest: str | None = None
    tolerance: float = 0.0
    notes: tuple[str, ...] = ()
    not_checkable: Counter[str] = field(default_factory=Counter)

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return self.difference is None and self.problem is None

    @property
    def complete(self) -> bool:
        """Whether all of the run is there and right; in real time the bag says itself whether it ended early."""
        whole = self.ended_early is None if self.expected_steps is None else self.steps == self.expected_steps
        return self.ok and whole

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain data for JSON."""
        return {
            "ok": self.ok,
            "first_difference": self.difference and self.difference.to_dict("recorded", "recomputed"),
            "problem": self.problem,
            "bag": self.bag,
            "scenario": self.scenario,
            "complete": self.complete,
            "ended_early": self.ended_early,
            "steps": self.steps,
            "expected_steps": self.expected_steps,
            "messages": self.messages,
            "digest": self.digest,
            "tolerance": self.tolerance,
            "notes": list(self.notes),
            "not_checkable": dict(self.not_checkable.most_common()),
        }


class Verification(ABC):
    """Follows a recorded run message by message, and judges a step when nothing of it can come any more.

    `period_ns` is the period of a run in lockstep, where the log time of bytes that are no message tells their step.

    Attributes
    ----------
    found : Verdict
        What is found of the messages; the rest of it is for others to fill in.
    """

    def __init__(self, tolerance: float, period_ns: int | None = None) -> None:
        self.found = Verdict(tolerance=tolerance)
        self._period_ns = period_ns

    @property
    @abstractmethod
    def step(self) -> int:
        """The first step that is not verified, 0 before there is one."""

    @property
    def decided(self) -> bool:
        """Whether no further message can change what is found."""
        return self.found.difference is not None

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
                self.found.messages += 1
            elif isinstance(finding, str):
                self.found.not_checkable[finding] += 1
            else:
                self.found.difference = finding
                break
        return judged

    @abstractmethod
    def finish(self, *, whole: bool = True) -> None:
        """Judge what is left at the end of the bag, which is whole if nothing says why it ends before its run."""

"""The common parts of verification in lockstep and in real time."""

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

    from swarmabs_bag.run.step import Step
    from swarmabs_core.messages import Topic

Finding: TypeAlias = "Difference | str | None"
"""None if a message is correct, otherwise the difference, or the reason why it cannot be checked."""


@dataclass(slots=True)
class VerificationResult:
    """The result of verifying a bag.

    Attributes
    ----------
    bag : str
        The MCAP file.
    scenario : str or None
        Name of its scenario; None if the bag is unreadable.
    difference : Difference or None
        The first difference between recorded and recomputed messages, by step; within a step in the order robots by id,
        plane, abstract, auxiliary, desired state, events.
    problem : str or None
        Damage of the file.
    steps : int
        Number of verified steps; in real time, of steps with a checked message.
    messages : int
        Number of verified messages.
    expected_steps : int or None
        Number of steps of a complete run, 0 to n, thus n + 1; None in real time.
    ended_early : str or None
        Why the run ended before its last step.
    digest : str or None
        Digest of the verified messages; None in real time, where received messages differ from run to run.
    tolerance : float
        A recorded number may differ from the recomputed b by ``tolerance * (1 + |b|)``; with 0 every bit counts.
    not_read : tuple of str
        Topics of the swarm in the bag whose messages are not compared with anything, in `notes`, too.
    notes : tuple of str
        Further remarks for the user.
    not_checkable : Counter of str
        Number of messages that could not be checked, by reason.
    lost : str or None
        For a run in real time, what repairs could not recover of its bag; which messages that was is not known.
    second_senders : dict
        For a run in real time, the first and the last step in which a second sender spoke, by what it spoke for.
    trial : dict
        For a trial of nodes, these, the overrides and the deviations; `messages` are then those that were compared.
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
    not_read: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    not_checkable: Counter[str] = field(default_factory=Counter)
    lost: str | None = None
    second_senders: dict[str, tuple[int, int]] = field(default_factory=dict)
    trial: dict[str, Any] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether there is neither a difference nor damage, nor a second sender whose messages are not in the bag."""
        return self.difference is None and self.problem is None and not self.second_senders

    @property
    def complete(self) -> bool:
        """Whether the whole run is present and correct; in real time the bag itself records an early end and losses."""
        if self.not_read:
            return False
        if self.expected_steps is None:
            return self.ok and self.ended_early is None and self.lost is None
        return self.ok and self.steps == self.expected_steps

    def to_dict(self) -> dict[str, object]:
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
            "lost": self.lost,
            "second_senders": {of: list(steps) for of, steps in self.second_senders.items()},
            **self.trial,
        }


class Verification(ABC):
    """Checks a recorded run message by message; a step is judged when no more of its messages can follow.

    `period_ns` is the period of a run in lockstep, where the log time of malformed bytes determines their step.

    Attributes
    ----------
    result : VerificationResult
        The result about the messages; the caller fills in the rest.
    """

    def __init__(self, tolerance: float, period_ns: int | None = None) -> None:
        self.result = VerificationResult(tolerance=tolerance)
        self._period_ns = period_ns

    @property
    @abstractmethod
    def step(self) -> int:
        """The first step that is not verified yet, initially 0."""

    @property
    def decided(self) -> bool:
        """Whether no further message can change the result."""
        return self.result.difference is not None

    def add(self, topic: Topic, time: int, payload: bytes, published: int | None = None) -> None:
        """Check the next message of the bag, with its log time and, if it is to be verified, its publish time, ns."""
        if self.decided:
            return
        try:
            stored: Record | Difference = Record.read(topic, time, payload, published)
        except MalformedMessageError as error:
            step = None if self._period_ns is None else time // self._period_ns
            stored = Difference(topic.name, step, None, PAYLOAD, in_hex(payload), None, str(error))
        self._take(stored)

    def add_steps(self, steps: Step) -> None:
        """Check the next messages of the bag, which form whole steps."""
        for topic, time, payload in steps.stored():
            self.add(topic, time, payload, time)

    @abstractmethod
    def _take(self, stored: Record | Difference) -> None:
        """Handle a message, or malformed bytes as a difference."""

    def _judge(self, findings: Iterable[Finding]) -> int:
        """Count the findings up to the first difference, and return their number."""
        judged = 0
        for finding in findings:
            judged += 1
            if finding is None:
                self.result.messages += 1
            elif isinstance(finding, str):
                self.result.not_checkable[finding] += 1
            else:
                self.result.difference = finding
                break
        return judged

    @abstractmethod
    def finish(self, *, whole: bool = True) -> None:
        """Judge the remaining messages at the end of the bag; `whole` if the bag gives no reason for ending early."""

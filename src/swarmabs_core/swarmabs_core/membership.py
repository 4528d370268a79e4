"""Who takes part in which step: the same rule for observer, plane and recorder.

Scheduled changes (the faults of a scenario) are known to all three beforehand. A change that nobody planned
is decided by the observer alone and reaches the others as an event.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from swarmabs_core.errors import InputError
from swarmabs_core.messages import EventKind

if TYPE_CHECKING:
    from collections.abc import Iterable

SILENT = "silent"
"""Reason of the end of a robot that did not answer and was dropped."""

UNPLANNED = 2**63 - 1
"""Step at which a robot joins that is only there when it is added: beyond every run."""


class ChangeKind(str, Enum):
    """How a robot's membership changes at a step."""

    JOIN = "join"
    """It publishes its first state at the step."""
    LEAVE = "leave"
    """It publishes its last state, saying so, at the step; afterwards its weight is gone."""
    KILL = "kill"
    """It publishes its last state at the step; afterwards it stands still where it was."""
    FREEZE = "freeze"
    """Like `KILL`, but the process is stopped and not ended."""
    REMOVE = "remove"
    """It publishes its last state, not knowing it, at the step; afterwards its weight is gone."""

    @property
    def stays(self) -> bool:
        """Whether the robot's weight stays on the plane when it has ended so."""
        return self in (ChangeKind.KILL, ChangeKind.FREEZE)


@dataclass(frozen=True, slots=True, order=True)
class Change:
    """A scheduled change of one robot's membership."""

    step: int
    agent_id: int
    kind: ChangeKind

    def __str__(self) -> str:
        return f"{self.kind.value} {self.agent_id} {self.step}"

    @classmethod
    def parse(cls, text: str) -> Change:
        """Read ``KIND AGENT STEP``, such as ``kill 3 500``.

        Raises
        ------
        InputError
            If the text is not of this form.
        """
        try:
            kind, agent_id, step = text.split()
            return cls(int(step), int(agent_id), ChangeKind(kind))
        except ValueError:
            raise InputError(
                f"membership change {text!r} is not of the form 'KIND AGENT STEP' with KIND one of "
                + ", ".join(kind.value for kind in ChangeKind)
            ) from None


def with_ends(schedule: Iterable[Change], ends: Iterable[Change]) -> tuple[Change, ...]:
    """Return the scheduled changes with unplanned ends, which come before the planned ones."""
    unplanned = tuple(ends)
    ended = {change.agent_id for change in unplanned}
    kept = (change for change in schedule if change.kind is ChangeKind.JOIN or change.agent_id not in ended)
    return tuple(sorted((*kept, *unplanned)))


@dataclass(slots=True)
class Span:
    """First and last step (None: not known) at which a robot publishes, and whether its weight stays on the plane then.

    The first is `UNPLANNED` if it is not known.
    """

    first: int = 0
    last: int | None = None
    stays: bool = False
    reason: str = ""

    def covers(self, step: int) -> bool:
        """Tell whether the robot publishes its state of a step."""
        return self.first <= step and (self.last is None or step <= self.last)


class Membership:
    """Membership by step of all robots that ever take part, from step 0 those without a scheduled ``join``."""

    def __init__(self, members: Iterable[int], schedule: Iterable[Change] = ()) -> None:
        self._spans = {agent_id: Span() for agent_id in sorted(members)}
        self._cached: tuple[int, tuple[int, ...]] = (-1, ())
        for change in sorted(schedule):
            if change.agent_id not in self._spans:
                raise InputError(f"membership change '{change}': there is no robot {change.agent_id}")
            self.plan(change)

    def plan(self, change: Change) -> None:
        """Note a change, which may be scheduled or ordered from outside; an earlier end that is known stands."""
        if change.kind is ChangeKind.JOIN:
            self._spans[change.agent_id].first = change.step
            self._cached = (-1, ())
        else:
            self.end(change.agent_id, change.step, stays=change.kind.stays, reason=change.kind.value)

    def __contains__(self, agent_id: object) -> bool:
        return agent_id in self._spans

    def publishing(self, step: int) -> tuple[int, ...]:
        """Return the ids, ascending, of the robots whose state of a step is waited for."""
        if self._cached[0] != step:
            self._cached = (step, tuple(i for i, span in self._spans.items() if span.covers(step)))
        return self._cached[1]

    def publishes(self, agent_id: int, step: int) -> bool:
        """Tell whether a robot publishes its state of a step."""
        span = self._spans.get(agent_id)
        return span is not None and span.covers(step)

    def span(self, agent_id: int) -> Span:
        """Return when a robot publishes its states."""
        return self._spans[agent_id]

    def changes(self, step: int) -> list[tuple[int, EventKind, str]]:
        """Return robot, kind and reason of every change that holds from a step on, by robot id."""
        found = []
        for agent_id, span in self._spans.items():
            if span.first == step and step > 0:
                found.append((agent_id, EventKind.JOINED, ""))
            if span.last is not None and span.last + 1 == step:
                found.append((agent_id, EventKind.DEAD if span.stays else EventKind.LEFT, span.reason))
        return found

    def end(self, agent_id: int, last: int, *, stays: bool, reason: str) -> None:
        """Note that a robot publishes its last state at step `last`; an earlier end that is known stands."""
        span = self._spans[agent_id]
        if span.last is None or span.last > last:
            span.last, span.stays, span.reason = last, stays, reason
            self._cached = (-1, ())

    def apply(self, kind: int, agent_id: int, step: int, reason: str) -> None:
        """Take over a change that the observer has announced; `step` is the first at which it holds."""
        if kind in (EventKind.DEAD, EventKind.LEFT) and agent_id in self._spans:
            self.end(agent_id, step - 1, stays=kind == EventKind.DEAD, reason=reason)

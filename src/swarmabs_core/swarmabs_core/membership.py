"""Which robots take part in which step: the same rule for observer, plane and recorder.

All three know scheduled changes (the faults of a scenario) in advance. Unplanned changes are decided by the observer
alone and reach the others as events.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.errors import InputError
from swarmabs_core.events import EventCode
from swarmabs_core.messages import EventKind

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

SILENT = EventCode.SILENT.text
"""Reason for the end of a robot that was dropped because it did not answer."""

ALWAYS = 2**62
"""Steps for which the observer tells how the abstract state divides if robots may be dropped: only it knows when."""
SETTLING_NS = 2_000_000_000
"""Time from a change of the membership on for which the observer tells how the abstract state divides, ns."""

UNPLANNED = 2**63 - 1
"""Step at which a robot joins that takes part only once it is added: later than any run."""


class ChangeKind(str, Enum):
    """A way in which a robot's membership changes at a step."""

    JOIN = "join"
    """It publishes its first state at the step."""
    LEAVE = "leave"
    """It publishes its last state, marked as such, at the step; afterwards its weight is gone."""
    KILL = "kill"
    """It publishes its last state at the step; afterwards it remains at rest in its position."""
    FREEZE = "freeze"
    """Like `KILL`, but the process is suspended instead of ended."""
    REMOVE = "remove"
    """It publishes its last state, without knowing that, at the step; afterwards its weight is gone."""

    @property
    def stays(self) -> bool:
        """Whether the weight of a robot that ends in this way stays on the plane."""
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


@dataclass(slots=True)
class Span:
    """First and last step in which a robot publishes, and whether its weight stays on the plane afterwards.

    If unknown, the first step is `UNPLANNED` and the last one None.
    """

    first: int = 0
    last: int | None = None
    stays: bool = False
    reason: str = ""

    def covers(self, step: int) -> bool:
        """Return whether the robot publishes its state of a step."""
        return self.first <= step and (self.last is None or step <= self.last)


class Interval(NamedTuple):
    """Steps from the first to before the end in which the robots with these ids, ascending, publish their states."""

    first: int
    end: int
    ids: tuple[int, ...]


_NEVER = 2**64
_NONE = Interval(0, 0, ())


class Membership:
    """Membership by step of all robots that ever take part; those without a scheduled ``join`` start at step 0."""

    def __init__(self, members: Iterable[int], schedule: Iterable[Change] = ()) -> None:
        self._spans = {agent_id: Span() for agent_id in sorted(members)}
        self._current = _NONE
        for change in sorted(schedule):
            if change.agent_id not in self._spans:
                raise InputError(f"membership change '{change}': there is no robot {change.agent_id}")
            self.plan(change)

    def plan(self, change: Change) -> None:
        """Add a change, whether scheduled or requested from outside; a known earlier end takes precedence."""
        if change.kind is ChangeKind.JOIN:
            self._spans[change.agent_id].first = change.step
            self._current = _NONE
        else:
            self.end(change.agent_id, change.step, stays=change.kind.stays, reason=change.kind.value)

    def __contains__(self, agent_id: object) -> bool:
        return agent_id in self._spans

    def __iter__(self) -> Iterator[int]:
        """Return the ids of all robots that ever take part, ascending."""
        return iter(self._spans)

    def publishing(self, step: int) -> tuple[int, ...]:
        """Return the ids, ascending, of the robots that publish a state in a step."""
        return self._around(step).ids

    def _around(self, step: int) -> Interval:
        """Return the steps around this one in which the same robots publish."""
        if not self._current.first <= step < self._current.end:
            edges = {span.first for span in self._spans.values()}
            edges |= {span.last + 1 for span in self._spans.values() if span.last is not None}
            self._current = Interval(
                max((edge for edge in edges if edge <= step), default=0),
                min((edge for edge in edges if edge > step), default=_NEVER),
                tuple(i for i, span in self._spans.items() if span.covers(step)),
            )
        return self._current

    def publishes(self, agent_id: int, step: int) -> bool:
        """Return whether a robot publishes its state of a step."""
        span = self._spans.get(agent_id)
        return span is not None and span.covers(step)

    def lasts(self, agent_id: int, step: int) -> bool:
        """Return whether a robot has not ended before a step; it may have yet to join."""
        last = self._spans[agent_id].last
        return last is None or step <= last

    def lasting(self, step: int) -> tuple[int, ...]:
        """Return the ids, ascending, of the robots that have not ended before a step."""
        return tuple(agent_id for agent_id in self._spans if self.lasts(agent_id, step))

    def is_dropped(self, agent_id: int) -> bool:
        """Return whether a robot has ended because it did not answer."""
        return self._spans[agent_id].reason == SILENT

    def constant_until(self, step: int) -> int:
        """Return the first step after a step in which other robots publish; later than any run if there is none."""
        return self._around(step).end

    def span(self, agent_id: int) -> Span:
        """Return the steps in which a robot publishes."""
        return self._spans[agent_id]

    def changes(self, step: int) -> list[tuple[int, EventKind, str]]:
        """Return robot, kind and reason of every change that takes effect at a step, by robot id."""
        changes: list[tuple[int, EventKind, str]] = []
        if self._around(step).first != step:
            return changes
        for agent_id, span in self._spans.items():
            if span.first == step and step > 0 and span.covers(step):  # who ended before never joins
                changes.append((agent_id, EventKind.JOINED, ""))
            if span.last is not None and span.last + 1 == step:
                changes.append((agent_id, EventKind.DEAD if span.stays else EventKind.LEFT, span.reason))
        return changes

    def divides(self, step: int, window: int) -> bool:
        """Return whether the observer tells at a step how the abstract state divides (`StandingState`).

        It does so for `window` steps from a change on, with `ALWAYS` in all but step 0, with 0 never.
        """
        first = self._around(step).first
        return step > 0 and step - first < window and (first > 0 or window >= ALWAYS)

    def undivided_until(self, step: int, window: int) -> int:
        """Return the first step from a step on in which other robots publish, or which `divides`.

        Without a change of the robots, the observer begins to tell only after step 0.
        """
        if self.divides(step, window):
            return step
        return step + 1 if self.divides(step + 1, window) else self.constant_until(step)

    def end(self, agent_id: int, last: int, *, stays: bool, reason: str) -> None:
        """Set the step `last` in which a robot publishes its last state; a known earlier end takes precedence."""
        span = self._spans[agent_id]
        if span.last is None or span.last > last:
            span.last, span.stays, span.reason = last, stays, reason
            self._current = _NONE

    def apply(self, kind: int, agent_id: int, step: int, reason: str) -> None:
        """Apply a change that the observer announced; `step` is the first at which it holds."""
        if kind in (EventKind.DEAD, EventKind.LEFT) and agent_id in self._spans:
            self.end(agent_id, step - 1, stays=kind == EventKind.DEAD, reason=reason)

"""Figures of a run, computed while it is recorded or read: steps in order, or in real time whatever arrives."""

from __future__ import annotations

from collections import Counter
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_bag.recording import Digest
from swarmabs_core.desired_state import fallen
from swarmabs_core.messages import (
    MAIN_TOPICS,
    NEVER,
    AgentState,
    Basis,
    EventKind,
    PlaneState,
    Source,
    SwarmEvent,
    Topic,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_bag.recording import Step
    from swarmabs_core.realtime.base import Schedule
    from swarmabs_core.record import Record

    Reference = Callable[[float], float]

TOLERANCE = 0.01
"""Error, rad, below which the plane counts as settled."""
_PENDING = 100
"""Steps for which a state of the plane waits for the answer of the parent controller, or the other way round."""
_ANSWERED = 10
"""Steps of the plane without such an answer after which its angle is shown without an error."""


class Latest(NamedTuple):
    """What people watch of a running simulation: the angle and its error, rad; None where nothing is asked for."""

    step: int
    angle: float
    error: float | None


class Figures:
    """What a run comes to: how well the plane follows its reference, how far robots go, how many messages there are.

    Parameters
    ----------
    reference : callable
        Angle (rad) that the plane should have at a time (s), in real time that of the law.

    Attributes
    ----------
    newest : int
        The newest step, -1 before the first.
    """

    def __init__(self, reference: Reference) -> None:
        self._reference = reference
        self._settled_at: float | None = None
        self._error: float | None = None
        self._squares = 0.0
        self._steps = 0
        self._max_abs_position: float | None = None
        self._messages = 0
        self._latest: Latest | None = None
        self.newest = -1

    @property
    def latest(self) -> Latest | None:
        """What the run looks like now."""
        return self._latest

    def reach(self, distance: float) -> None:
        """Note how far a robot was from the axis, m."""
        if self._max_abs_position is None or not distance <= self._max_abs_position:
            self._max_abs_position = distance  # also if it is NaN

    def follow(self, step: int, time: float, angle: float) -> None:
        """Compare the plane's angle (rad) of a step with the reference at a time (s)."""
        error = self._reference(time) - angle
        if not abs(error) < TOLERANCE:  # NaN is no small error
            self._settled_at = None
        elif self._settled_at is None:
            self._settled_at = time
        self._error = error
        self._squares += error * error
        self._steps += 1
        self._latest = Latest(step, angle, error)
        self.newest = max(self.newest, step)

    def figures(self) -> dict[str, float | int | None]:
        """Return the figures under their names in ``summary.json``; None where there is no finite one."""
        rms_error = (self._squares / self._steps) ** 0.5 if self._steps else None
        return {
            "settled_at": self._settled_at,
            "final_error": _finite(self._error),
            "rms_error": _finite(rms_error),
            "max_abs_position": _finite(self._max_abs_position),
            "messages": self._messages,
        }


def _finite(value: float | None) -> float | None:
    return value if value is not None and isfinite(value) else None


class RunFigures(Figures):
    """Digest and figures of a run whose steps come in order."""

    def __init__(self, reference: Reference) -> None:
        super().__init__(reference)
        self._digest = Digest()

    def add(self, step: Step) -> None:
        """Add the next step."""
        self._digest.update(step)
        self._messages += step.messages
        if step.max_abs_position is not None:
            self.reach(step.max_abs_position)
        if step.plane is not None:
            self.follow(step.plane.step, step.plane.stamp / 1e9, step.plane.angle)

    def digest(self) -> str:
        """Return the digest of the steps so far."""
        return self._digest.hexdigest()

    def summary(self) -> dict[str, Any]:
        """Return figures and digest; there is no digest of a run that recorded nothing."""
        return {**self.figures(), "digest": self.digest() if self._latest is not None else None}


class _Span:
    """Steps of which there were messages: the first, the last, how many."""

    __slots__ = ("count", "first", "last")

    def __init__(self, step: int) -> None:
        self.first = self.last = step
        self.count = 0

    def add(self, step: int) -> None:
        self.first, self.last = min(self.first, step), max(self.last, step)
        self.count += 1


class RealtimeFigures(Figures):
    """Figures of a run in real time.

    The error counts from the answer of the parent controller on with which its law's time has begun, and in this time.

    Attributes
    ----------
    fallen : str
        When and why the swarm has lost the plane, and what helps; empty if it has not.
    """

    def __init__(self, reference: Reference, schedule: Schedule) -> None:
        super().__init__(reference)
        self._schedule = schedule
        self._spans: dict[tuple[Topic, int], _Span] = {}
        self._angles: dict[int, float] = {}
        self._begun: dict[int, int] = {}
        self._ages: Counter[int] = Counter()
        self._safe_stops = 0
        self._plane: PlaneState | None = None
        self.fallen = ""

    @property
    def latest(self) -> Latest | None:
        """What the run looks like now: without an error where the parent controller no longer answers the plane."""
        plane, compared = self._plane, self._latest
        if plane is None or compared is None or abs(plane.step - compared.step) <= _ANSWERED:
            return compared
        return Latest(plane.step, plane.angle, None)

    def add(self, record: Record) -> None:
        """Take a recorded message."""
        message = record.message
        self._messages += 1
        if isinstance(message, SwarmEvent):
            self._safe_stops += message.kind == EventKind.SAFE_STOP
            return
        if isinstance(message, Basis):
            if message.source == Source.CONTROLLER:
                self._begun[message.step] = message.begun
                self._follow(message.step)
            return
        place = record.topic, record.agent_id
        self._spans.setdefault(place, _Span(message.step)).add(message.step)
        self.newest = max(self.newest, message.step)
        if isinstance(message, AgentState):
            self.reach(abs(message.position))
            if message.broadcast_step != NEVER:
                self._ages[message.step - message.broadcast_step] += 1
        elif isinstance(message, PlaneState):
            self._angles[message.step] = message.angle
            self._follow(message.step)
            self._watch(message)

    def _watch(self, plane: PlaneState) -> None:
        """Keep the plane's state, and notice the first in which the swarm has lost it."""
        self._plane = plane
        if not self.fallen and (problem := fallen(plane)):
            self.fallen = f"t = {plane.step * self._schedule.period_ns / 1e9:g} s, {problem}"

    def _follow(self, step: int) -> None:
        """Compare the plane's angle with the reference once angle and time of the law are known."""
        if step in self._angles and step in self._begun:
            periods = step - self._begun.pop(step)
            self.follow(step, periods * self._schedule.period_ns / 1e9, self._angles.pop(step))
        for waiting in (self._angles, self._begun):
            while len(waiting) > _PENDING:
                del waiting[next(iter(waiting))]

    def summary(self) -> dict[str, Any]:
        """Return all figures; there is no digest, since what arrives differs from run to run."""
        return {**self.figures(), "digest": None, "realtime": self.realtime()}

    def realtime(self) -> dict[str, object]:
        """Return what only a run in real time has: received and missing messages, ages of broadcasts, safe stops.

        A robot's states count from its first to its last. A message is missing if it was lost on its way to the
        recorder, or never sent since its node missed the period.
        """
        losses = {}
        for topic in MAIN_TOPICS:
            spans = [span for (of, _), span in self._spans.items() if of is topic]
            received = sum(span.count for span in spans)
            expected = sum(span.last - span.first + 1 for span in spans)
            # A mode that changes within a step gives two desired states of it.
            losses[topic.name] = {"received": received, "missing": max(0, expected - received)}
        return {
            "losses": losses,
            "broadcast_ages": {str(age): self._ages[age] for age in sorted(self._ages)},
            "safe_stops": self._safe_stops,
        }

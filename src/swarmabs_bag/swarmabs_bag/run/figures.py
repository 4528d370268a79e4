"""Figures of a run, computed during recording or reading: from ordered steps, or in real time from messages."""

from __future__ import annotations

from collections import Counter
from math import isfinite, isnan, sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_bag.run.digest import Digest
from swarmabs_core.desired_state import fallen
from swarmabs_core.messages import (
    MAIN_TOPICS,
    NEVER,
    AgentState,
    Basis,
    EventKind,
    PlaneState,
    Relay,
    Source,
    SwarmEvent,
    Topic,
    vector_of,
)
from swarmabs_core.ranges import Strays
from swarmabs_core.summation import added
from swarmabs_core.systems.interface import PLANE_TABLES, Quantity

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_bag.run.step import Step
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.realtime.base import Schedule
    from swarmabs_core.record import Record
    from swarmabs_core.systems.interface import ParentSystem, SystemTables, Vector

    Reference = Callable[[float], float | Vector]

_PENDING = 100
"""Steps for which a state of the plane waits for the answer of the parent controller, or vice versa."""
_ANSWERED = 10
"""Steps without such an answer after which the plane's angle is reported without an error."""


class Tracking(NamedTuple):
    """What of the parent's state follows the reference: indices, errors below which the numbers count as settled.

    The first of them, or else of the state, is the number to show, with its name and unit. `coordinate` is what the
    robots' coordinates are called, their common unit empty if they have several.
    """

    followed: tuple[int, ...]
    tolerances: tuple[float, ...]
    name: str
    unit: str
    coordinate: str
    coordinate_unit: str

    @classmethod
    def of(cls, system: ParentSystem | SystemTables) -> Tracking:
        """Return what a parent system tracks; if it tracks nothing, the first number of its state is shown."""
        names = [quantity.name for quantity in system.parent]
        followed = tuple(names.index(tracked.name) for tracked in system.tracked)
        shown = system.parent[followed[0] if followed else 0]
        tolerances = tuple(tracked.tolerance for tracked in system.tracked)
        units = {row.unit for row in system.robot}
        unit = units.pop() if len(units) == 1 else ""
        coordinate = system.robot[0].name if len(system.robot) == 1 else "coordinate"
        return cls(followed, tolerances, shown.name, shown.unit, coordinate, unit)

    @property
    def figures(self) -> dict[str, Quantity]:
        """What the figures of a run are called, with their units, by their names in ``summary.json``."""
        return {
            "settled_at": Quantity("settled at", "s"),
            "rms_error": Quantity("rms error", self.unit),
            "final_error": Quantity("final error", self.unit),
            "max_abs_position": Quantity(f"max |{self.coordinate}|", self.coordinate_unit),
            "messages": Quantity("messages", ""),
        }

    def errors(self, reference: float | Vector, state: Vector) -> list[float]:
        """Return the errors of the parent's state: one for each quantity that follows a reference."""
        goals = reference if isinstance(reference, tuple) else (reference,)
        return [goal - state[place] for goal, place in zip(goals, self.followed, strict=True)]


PLANE_TRACKING = Tracking.of(PLANE_TABLES)
TOLERANCE = PLANE_TRACKING.tolerances[0]
"""Error below which the plane counts as settled, rad."""


def tracking_of(scenario: Scenario) -> Tracking:
    """Return what the parent system of a scenario tracks."""
    return Tracking.of(scenario.tables)


class Latest(NamedTuple):
    """The latest angle of the plane, or number to show of another parent, and its error; None without a reference."""

    step: int
    angle: float
    error: float | None


class Figures:
    """Figures of a run: tracking of the reference, largest position, number of messages.

    Parameters
    ----------
    reference : callable
        Reference of the plane's angle (rad), or of all that another parent tracks, at a time (s), in real time that of
        the law.
    tracking : Tracking
        What the parent tracks.

    Attributes
    ----------
    newest : int
        The newest step, -1 before the first.
    strays : Strays
        The robots that have left the ranges of their coordinates.
    max_abs_shown : float or None
        Largest absolute value of the plane's angle, or of the number to show of another parent.
    """

    def __init__(self, reference: Reference, tracking: Tracking = PLANE_TRACKING) -> None:
        self.tracking = tracking
        self._reference = reference
        self._settled_at: float | None = None
        self._error: float | None = None
        self._squares = 0.0
        self._steps = 0
        self._max_abs_position: float | None = None
        self._messages = 0
        self._latest: Latest | None = None
        self.newest = -1
        self.max_abs_shown: float | None = None
        self.strays = Strays()

    @property
    def latest(self) -> Latest | None:
        """The latest angle, or number to show, and its error."""
        return self._latest

    def reach(self, distance: float) -> None:
        """Record a coordinate of a robot without its sign: on the plane its distance from the axis, m."""
        largest = self._max_abs_position
        if largest is None or isnan(distance) or distance > largest:  # nothing is larger than NaN
            self._max_abs_position = distance

    def follow(self, step: int, time: float, state: Vector) -> None:
        """Compare the parent's state, on the plane its angle (rad), at a step with the reference at a time (s).

        The error of several numbers is the Euclidean norm of their errors.
        """
        followed, tolerances, *_ = self.tracking
        errors = self.tracking.errors(self._reference(time), state)
        if not errors or not all(map(_within, errors, tolerances)):
            self._settled_at = None
        elif self._settled_at is None:
            self._settled_at = time
        error = errors[0] if len(errors) == 1 else sqrt(added(part * part for part in errors)) if errors else None
        self._error = error
        if error is not None:
            self._squares += error * error
            self._steps += 1
        shown = state[followed[0] if followed else 0]
        self.max_abs_shown = max(self.max_abs_shown or 0.0, abs(shown))
        self._latest = Latest(step, shown, error)
        self.newest = max(self.newest, step)

    def figures(self) -> dict[str, float | int | None]:
        """Return the figures by their names in ``summary.json``; None for unknown and non-finite ones."""
        rms_error = sqrt(self._squares / self._steps) if self._steps else None
        settled, clear = self._settled_at, self.strays.clear_from
        return {
            "settled_at": None if settled is None or clear is None else max(settled, clear),
            "final_error": _finite(self._error),
            "rms_error": _finite(rms_error),
            "max_abs_position": _finite(self._max_abs_position),
            "messages": self._messages,
        }

    def _summary(self, **more: object) -> dict[str, Any]:
        """Return the figures and more, with the robots that left their ranges if any did."""
        strays = self.strays.summary()
        return {**self.figures(), **more, **({"out_of_range": strays} if strays else {})}


def _within(error: float, tolerance: float) -> bool:
    return abs(error) < tolerance  # NaN is not


def _finite(value: float | None) -> float | None:
    return value if value is not None and isfinite(value) else None


class RunFigures(Figures):
    """Digest and figures of a run with ordered steps."""

    def __init__(self, reference: Reference, tracking: Tracking = PLANE_TRACKING) -> None:
        super().__init__(reference, tracking)
        self._digest = Digest()

    def add(self, step: Step) -> None:
        """Add the next step, or steps."""
        self._digest.update(step)
        self._messages += step.messages
        for event in step.events:
            self.strays.hear(event, event.stamp / 1e9)
        for distance in step.max_abs_positions:
            self.reach(distance)
        for parent in step.parents:
            self.follow(parent.step, parent.stamp / 1e9, vector_of(parent, "state"))

    def digest(self) -> str:
        """Return the digest of the steps so far."""
        return self._digest.hexdigest()

    def summary(self) -> dict[str, Any]:
        """Return figures and digest; the digest of a run without messages is None."""
        return self._summary(digest=self.digest() if self._latest is not None else None)


class _Span:
    """Steps with messages: first, last and count."""

    __slots__ = ("count", "first", "last")

    def __init__(self, step: int) -> None:
        self.first = self.last = step
        self.count = 0

    def add(self, step: int) -> None:
        self.first, self.last = min(self.first, step), max(self.last, step)
        self.count += 1


class RealtimeFigures(Figures):
    """Figures of a run in real time.

    The tracking error starts with the answer at which the time of the parent controller's law begins, and uses this
    time.

    Attributes
    ----------
    fallen : str
        When and why the swarm lost control of the plane, and a remedy; empty if it has not.
    """

    def __init__(self, reference: Reference, schedule: Schedule) -> None:
        super().__init__(reference)
        self._schedule = schedule
        self._spans: dict[tuple[Topic, int], _Span] = {}
        self._angles: dict[int, float] = {}
        self._begun: dict[int, int] = {}
        self._law_begun = 0
        self._ages: Counter[int] = Counter()
        self._safe_stops = 0
        self._plane: PlaneState | None = None
        self.fallen = ""

    @property
    def latest(self) -> Latest | None:
        """The latest angle and error; without an error if the parent controller no longer answers the plane."""
        plane, compared = self._plane, self._latest
        if plane is None or compared is None or abs(plane.step - compared.step) <= _ANSWERED:
            return compared
        return Latest(plane.step, plane.angle, None)

    def add(self, record: Record) -> None:
        """Add a recorded message."""
        message = record.message
        self._messages += 1
        if isinstance(message, SwarmEvent):
            self._safe_stops += message.kind == EventKind.SAFE_STOP
            self.strays.hear(message, max(0, message.step - self._law_begun) * self._schedule.period_ns / 1e9)
            return
        if isinstance(message, Basis):
            if message.source == Source.CONTROLLER:
                self._begun[message.step] = self._law_begun = message.begun
                self._follow(message.step)
            return
        if isinstance(message, Relay):
            from swarmabs_core.realtime.relayed import law_time  # noqa: PLC0415 - loading NumPy would delay every run

            step, begun = law_time(message)
            if step in self._angles:
                self._begun[step] = self._law_begun = begun
                self._follow(step)
        place = record.topic, record.agent_id
        if place not in self._spans:
            self._spans[place] = _Span(message.step)
        self._spans[place].add(message.step)
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
        """Keep the plane's state, and detect the first one out of control."""
        self._plane = plane
        if not self.fallen and (problem := fallen(plane)):
            self.fallen = f"t = {plane.step * self._schedule.period_ns / 1e9:g} s, {problem}"

    def _follow(self, step: int) -> None:
        """Compare the plane's angle with the reference once both angle and time of the law are known."""
        if step in self._angles and step in self._begun:
            periods = step - self._begun.pop(step)
            self.follow(step, periods * self._schedule.period_ns / 1e9, (self._angles.pop(step),))
        for waiting in (self._angles, self._begun):
            while len(waiting) > _PENDING:
                del waiting[next(iter(waiting))]

    def summary(self) -> dict[str, Any]:
        """Return all figures; there is no digest, because received messages differ from run to run."""
        return self._summary(digest=None, realtime=self.realtime())

    def realtime(self) -> dict[str, object]:
        """Return the figures specific to real time: received and missing messages, ages of broadcasts, safe stops.

        A robot's states count from its first to its last. A message is missing if it was lost on the way to the
        recorder, or never sent because its node missed the period.
        """
        losses = {}
        for topic in MAIN_TOPICS:
            spans = [span for (of, _), span in self._spans.items() if of is topic]
            received = sum(span.count for span in spans)
            expected = sum(span.last - span.first + 1 for span in spans)
            # A change of mode within a step gives two desired states.
            losses[topic.name] = {"received": received, "missing": max(0, expected - received)}
        return {
            "losses": losses,
            "broadcast_ages": {str(age): self._ages[age] for age in sorted(self._ages)},
            "safe_stops": self._safe_stops,
        }

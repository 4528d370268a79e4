"""A compact summary of the robots during a recording, computed about ten times a second."""

from __future__ import annotations

from collections import Counter, deque
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_bag.shown.swarm_state import RobotHistory, further_numbers, shown_robot, shown_status
from swarmabs_core.events import said_event
from swarmabs_core.messages import FAMILIES, ROBOT_STATES, EventKind, Removal, SwarmEvent
from swarmabs_core.ranges import crossing_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_bag.run.step import Step
    from swarmabs_bag.shown.swarm_state import RobotStatus, ShownRobot
    from swarmabs_core.messages import Message

SHOWN_ROBOTS = 200
"""Most robots that are listed; more are only counted, because a report must stay below 4 KiB."""
SHOWN_EVENTS = 3
KEPT_EVENTS = 10
"""Most events listed in the summary of a run, the first ones; further events are counted."""
EVENT_CHARACTERS = 80
THOUSAND = 1000
"""The end of the plane, in the unit of `SwarmSummary.places`."""

LETTERS: dict[RobotStatus | None, str] = {
    "active": "A",
    "safe_stop": "S",
    "left": "L",
    "dead": "D",
    "silent": "-",
    "limited": "M",
    None: "?",
}
"""A letter for each status; `?` is a robot without a state, such as one that waits to join."""


class SwarmSummary(NamedTuple):
    """Robots and events at a step, as plain data for JSON.

    Attributes
    ----------
    counts : dict
        Number of robots by the letter of their status, as in `LETTERS`.
    statuses : str
        A letter per robot, by ascending id; empty for more than `SHOWN_ROBOTS`.
    places : list of int
        Last known position of each robot on the plane, in thousandths of half the plane's length; 0 for others. Empty
        for another parent system.
    events : list of str
        The latest events, the newest last.
    strays : list of str
        The events with which the first few robots left the ranges of their coordinates.
    further : list of str
        The numbers on further topics in lockstep, with names and units.
    """

    counts: dict[str, int]
    statuses: str
    places: list[int]
    events: list[str]
    strays: list[str] = []  # noqa: RUF012 - nothing changes it
    further: list[str] = []  # noqa: RUF012 - nothing changes it


class SummaryTracker:
    """Tracks the data for the summary of a run, of robots with ascending ids on a plane with a length (m).

    The length is None for another parent system.
    """

    def __init__(self, members: Sequence[int], length: float | None) -> None:
        self._members = tuple(members)
        self._half = None if length is None else length / 2.0
        self._robots = RobotHistory(members, states=1)
        self._newest = -1
        self._events: deque[str] = deque(maxlen=SHOWN_EVENTS)
        self._first_events: list[str] = []
        self._further_events = 0
        self._unread: Step | None = None
        self._strays: dict[int, str] = {}
        self._further: list[str] = []

    def take(self, step: Step) -> None:
        """Process a complete step; the robots' states are only read when a summary is requested."""
        for event in step.events:
            self.hear(event)
        if step.parent is not None:
            self._unread = step

    def hear(self, message: Message) -> None:
        """Process a single message, as received in real time."""
        if isinstance(message, ROBOT_STATES):
            self._robots.add(message)
            self._newest = max(self._newest, message.step)
        elif isinstance(message, SwarmEvent) and not isinstance(message, Removal):  # its effect is announced
            self._keep(describe_event(message))
            self._robots.take(message)
            if crossing_of(message) is not None:
                self._strays.setdefault(message.agent_id, describe_event(message))

    def summary(self) -> SwarmSummary | None:
        """Return the current summary, None before the first step."""
        self._read()
        if self._newest < 0:
            return None
        robots = [
            (self._robots.out(member, self._newest), self._robots.latest(member, self._newest), self._newest)
            for member in self._members
        ]
        letters = [LETTERS[shown_status(*robot)] for robot in robots]
        few = len(letters) <= SHOWN_ROBOTS
        half = self._half
        return SwarmSummary(
            dict(sorted(Counter(letters).items())),
            "".join(letters) if few else "",
            [_place(shown_robot(*robot), half) for robot in robots] if few and half is not None else [],
            list(self._events),
            [*self._strays.values()][:SHOWN_EVENTS],
            self._further,
        )

    def events(self) -> list[str]:
        """Return the first events of the run, and the number of further ones."""
        more = [f"and {self._further_events} more"] if self._further_events else []
        return self._first_events + more

    def _keep(self, event: str) -> None:
        self._events.append(event)
        if len(self._first_events) < KEPT_EVENTS:
            self._first_events.append(event)
        else:
            self._further_events += 1

    def _read(self) -> None:
        """Read the robots' states of the latest step, if it is new."""
        step, self._unread = self._unread, None
        if step is None:
            return
        self._newest = step.step
        for state in step.states():
            self.hear(state)
        family = next(family for family in FAMILIES if family.parent in step.tables)
        self._further = [
            f"{quantity.name.replace('_', ' ')} {step.tables[topic][name][-1]:+.4g} {quantity.unit}"
            for topic, name, quantity in further_numbers(family)
        ]


def _place(robot: ShownRobot, half: float) -> int:
    position = robot.coordinates[0] if robot.coordinates else None
    if position is None:
        return 0
    return round(max(-THOUSAND, min(THOUSAND * position / half, THOUSAND)))


def describe_event(event: SwarmEvent) -> str:
    """Describe an event in a line."""
    who = f"robot {event.agent_id} " if event.agent_id else ""
    told = isfinite(event.value) and (event.value != 0.0 or event.kind == EventKind.STEERING)  # which may set it to 0
    value = f", {event.value:.5g}" if told else ""
    detail = f": {event.detail}" if event.detail and event.detail != said_event(event) else ""
    said = f"step {event.step}: {who}{said_event(event)}{value}{detail}"
    text = "".join(c if c.isprintable() else " " for c in said)
    return text if len(text) <= EVENT_CHARACTERS else f"{text[: EVENT_CHARACTERS - 1]}…"

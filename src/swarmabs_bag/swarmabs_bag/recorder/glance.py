"""What people see of the robots while a run goes on: few bytes, made some ten times a second."""

from __future__ import annotations

from collections import Counter, deque
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_bag.membership_timeline import Attendance, is_silent
from swarmabs_core.cdr import decode
from swarmabs_core.messages import AGENT_STATE, AgentState, EventKind, Status, SwarmEvent, said

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from swarmabs_bag.recording import Step
    from swarmabs_core.messages import Message

SHOWN_ROBOTS = 200
"""More robots than these are only counted: a report must stay below 4 KiB."""
SHOWN_EVENTS = 3
EVENT_CHARACTERS = 80
MOST_CHANGES = 16
"""How often a robot is in and out that is remembered, the latest times."""
THOUSAND = 1000
"""The end of the plane, in the unit of the places."""

DEAD, LEFT = "D", "L"
"""Letters of robots that are out, whatever they still say."""
_LETTERS: dict[int, str] = {Status.ACTIVE: "A", Status.SAFE_STOP: "S", Status.LEFT: LEFT}
_OUT = {"dead": DEAD, "left": LEFT}
SILENT = "-"
"""Letter of a robot that has said nothing for `SILENT_STEPS`."""
UNHEARD = "?"
"""Letter of a robot that was not heard yet, such as one that waits to join."""


class Glance(NamedTuple):
    """Robots and events as of a step.

    Parameters
    ----------
    counts : dict
        Number of robots by the letter of their status: A active, S safe stop, L left, D dead, - silent, ? not
        heard yet.
    statuses : str
        A letter per robot, by ascending id; empty if they are more than `SHOWN_ROBOTS`.
    places : list of int
        Where each robot is or was last seen, in thousandths of half the plane's length.
    events : list of str
        The latest ones, the newest last.
    """

    counts: dict[str, int]
    statuses: str
    places: list[int]
    events: list[str]

    def report(self) -> dict[str, Any]:
        """Return it as JSON takes it."""
        return self._asdict()

    @classmethod
    def of(cls, report: Mapping[str, Any]) -> Glance:
        """Read it from a report."""
        return cls(**report)


class Onlooker:
    """Keeps of a run what is to be seen.

    Parameters
    ----------
    members : sequence of int
        Ids of all robots, ascending.
    length : float
        Length of the plane, m.
    """

    def __init__(self, members: Sequence[int], length: float) -> None:
        self._members = tuple(members)
        self._half = length / 2.0
        self._said: dict[int, AgentState] = {}
        self._newest = -1
        self._events: deque[str] = deque(maxlen=SHOWN_EVENTS)
        self._attendance = Attendance(members, most=MOST_CHANGES)
        self._unread: Step | None = None

    def take(self, step: Step) -> None:
        """Take a complete step; what the robots have said in it is only read when it is asked for."""
        for event in step.events:
            self._happened(event)
        if step.plane is not None:
            self._unread = step

    def hear(self, message: Message) -> None:
        """Take a message by itself, as they come in real time."""
        if isinstance(message, AgentState):
            self._said[message.agent_id] = message
            self._newest = max(self._newest, message.step)
        elif isinstance(message, SwarmEvent):
            self._happened(message)

    def glance(self) -> Glance | None:
        """Return what is to be seen now, None before the first step."""
        self._read()
        if self._newest < 0:
            return None
        seen = [self._seen(member) for member in self._members]
        few = len(seen) <= SHOWN_ROBOTS
        return Glance(
            dict(sorted(Counter(letter for letter, _ in seen).items())),
            "".join(letter for letter, _ in seen) if few else "",
            [place for _, place in seen] if few else [],
            list(self._events),
        )

    def _happened(self, event: SwarmEvent) -> None:
        self._events.append(describe_event(event))
        if event.agent_id in self._members:
            self._attendance.take(event)

    def _read(self) -> None:
        """Read what the robots have said in the latest step, if it is new."""
        step, self._unread = self._unread, None
        if step is None:
            return
        self._newest = step.step
        for topic, _, payload in step.stored():
            if topic is AGENT_STATE:
                self.hear(decode(AgentState, payload))

    def _seen(self, member: int) -> tuple[str, int]:
        """Return letter and place of a robot; a dead one stands where its event says."""
        out, state = self._attendance.out(member, self._newest), self._said.get(member)
        place = 0 if state is None else self._place(state.position)
        if out is not None:
            return _OUT[out.status], self._place(out.place) if out.status == "dead" else place
        if state is None:
            return UNHEARD, place
        if state.status != Status.LEFT and is_silent(state.step, self._newest):
            return SILENT, place
        return _LETTERS.get(state.status, SILENT), place

    def _place(self, position: float) -> int:
        part = THOUSAND * position / self._half
        return round(max(-THOUSAND, min(part, THOUSAND))) if part == part else 0  # noqa: PLR0124 - NaN is nowhere


def describe_event(event: SwarmEvent) -> str:
    """Say in a line what happened."""
    try:
        kind = said(EventKind(event.kind))
    except ValueError:
        kind = f"event {event.kind}"
    who = f"robot {event.agent_id} " if event.agent_id else ""
    told = isfinite(event.value) and (event.value != 0.0 or event.kind == EventKind.STEERING)  # which may set it to 0
    value = f", {event.value:.5g}" if told else ""
    detail = f": {event.detail}" if event.detail else ""
    text = "".join(c if c.isprintable() else " " for c in f"step {event.step}: {who}{kind}{value}{detail}")
    return text if len(text) <= EVENT_CHARACTERS else f"{text[: EVENT_CHARACTERS - 1]}…"

"""What people see of the robots while a run goes on: few bytes, made some ten times a second."""

from __future__ import annotations

from collections import Counter, deque
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_bringup.attendance import Attendance
from swarmabs_core.cdr import decode
from swarmabs_core.messages import AGENT_STATE, AgentState, EventKind, Status, SwarmEvent, said

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from swarmabs_core.messages import Message
    from swarmabs_core.recording import Step

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
"""Letter of a robot that has said nothing in the latest step, in real time in the latest `SILENT_STEPS`."""
UNHEARD = "?"
"""Letter of a robot that was not heard yet, such as one that waits to join."""
SILENT_STEPS = 50


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
        self._places: dict[int, int] = {}
        self._events: deque[str] = deque(maxlen=SHOWN_EVENTS)
        self._attendance = Attendance(members, most=MOST_CHANGES)
        self._latest: Step | None = None

    def take(self, step: Step) -> None:
        """Take a complete step; what is shown of it is only found out when it is asked for."""
        for event in step.events:
            self._happened(event)
        if step.plane is not None:
            self._latest = step

    def glance(self) -> Glance | None:
        """Return what is to be seen now, None before the first step."""
        states = self._states()
        if states is None:
            return None
        found = {}
        for state in states:
            found[state.agent_id] = _LETTERS.get(state.status, SILENT)
            self._places[state.agent_id] = self._place(state.position)
        statuses = [self._out(member) or found.get(member) or self._unheard(member) for member in self._members]
        few = len(statuses) <= SHOWN_ROBOTS
        return Glance(
            dict(sorted(Counter(statuses).items())),
            "".join(statuses) if few else "",
            [self._places.get(member, 0) for member in self._members] if few else [],
            list(self._events),
        )

    def _happened(self, event: SwarmEvent) -> None:
        self._events.append(describe_event(event))
        if event.agent_id in self._members:
            self._attendance.take(event)

    def _step(self) -> int:
        """Return the latest step, -1 before the first."""
        return -1 if self._latest is None else self._latest.step

    def _out(self, member: int) -> str | None:
        """Return the letter of a robot that is out, None if it is in; a dead one stands where its event says."""
        out = self._attendance.out(member, self._step())
        if out is not None and out.status == "dead":
            self._places[member] = self._place(out.place)
        return None if out is None else _OUT[out.status]

    def _unheard(self, member: int) -> str:
        return SILENT if member in self._places else UNHEARD

    def _states(self) -> list[AgentState] | None:
        """Return what the robots have said in the latest step, None before the first."""
        if self._latest is None:
            return None
        states = (decode(AgentState, payload) for topic, _, payload in self._latest.stored() if topic is AGENT_STATE)
        return [state for state in states if isinstance(state, AgentState)]

    def _place(self, position: float) -> int:
        part = THOUSAND * position / self._half
        return round(max(-THOUSAND, min(part, THOUSAND))) if part == part else 0  # noqa: PLR0124 - NaN is nowhere


class RealtimeOnlooker(Onlooker):
    """The same for runs in real time, where messages come one by one; parameters as of `Onlooker`."""

    def __init__(self, members: Sequence[int], length: float) -> None:
        super().__init__(members, length)
        self._said: dict[int, AgentState] = {}
        self._newest = -1

    def hear(self, message: Message) -> None:
        """Take a message."""
        if isinstance(message, AgentState):
            self._said[message.agent_id] = message
            self._newest = max(self._newest, message.step)
        elif isinstance(message, SwarmEvent):
            self._happened(message)

    def _step(self) -> int:
        return self._newest

    def _states(self) -> list[AgentState] | None:
        # Who has left says nothing any more, and is still known to have left.
        heard = (s for s in self._said.values() if s.status == Status.LEFT or s.step + SILENT_STEPS > self._newest)
        return list(heard) if self._said else None


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

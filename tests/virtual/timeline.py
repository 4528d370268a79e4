"""What happened in a case, for people: who, when, what; and why it is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from hashlib import blake2b
from typing import NamedTuple, TextIO

from tests.virtual.fleet import Parcel, VirtualFleet, Watcher

from swarmabs_core.messages import (
    NEVER,
    AbstractState,
    AgentState,
    DesiredAbstractState,
    EventKind,
    Message,
    Mode,
    PlaneState,
    Status,
    SwarmEvent,
    Topic,
    said,
)
from swarmabs_core.nodes import ROBOT_PREFIX

_SILENT = 2.5
"""Periods after which a node that speaks in each of them counts as silent."""
_OWN = {EventKind.SAFE_STOP, EventKind.RECOVERED}
"""Events that the states of a robot tell, too."""
_AGAIN = 3.0
"""Time, s, in which a node that reports the same again and again is quoted once."""


class Entry(NamedTuple):
    """Something that happened; `done` if it was done to the node, and is not what the node did."""

    time: float
    number: int
    who: str
    what: str
    done: bool


class Timeline(Watcher):
    """Collects what changes: what is done, who falls silent, stops, follows, leads, and who hears a STOP first."""

    def __init__(self) -> None:
        self._entries: list[Entry] = []
        self._fleet: VirtualFleet | None = None
        self._spoke: dict[str, float] = {}
        self._status: dict[str, str] = {}
        self._modes: dict[tuple[str, str], int] = {}
        self._quoted: dict[tuple[str, str], float] = {}
        self._known: dict[str, tuple[str, str]] = {}

    def watch(self, fleet: VirtualFleet) -> None:
        """Set the fleet that is watched."""
        self._fleet = fleet

    def tell(self, time: float, who: str, what: str, *, done: bool = True) -> None:
        """Note what happens to somebody; see `Tell`."""
        self._entries.append(Entry(time, len(self._entries), who, what, done))

    def _now(self, who: str, what: str) -> None:
        if self._fleet is not None:
            self.tell(self._fleet.time, who, what, done=False)

    def _reports(self, who: str, what: str) -> None:
        assert self._fleet is not None
        before, self._quoted[who, what] = self._quoted.get((who, what), -_AGAIN), self._fleet.time
        if self._fleet.time - before >= _AGAIN:
            self._now(who, f"reports{what}")

    def begins(self, node: str) -> None:
        for key in [key for key in self._modes if key[0] == node]:
            del self._modes[key]

    def published(self, node: str, topic: Topic, message: Message, data: bytes) -> None:
        if isinstance(message, (AbstractState, DesiredAbstractState, PlaneState, AgentState)):
            self._speaks(node)
        if isinstance(message, AgentState):
            self._robot(node, message)
            self._hears(node)
        elif isinstance(message, DesiredAbstractState):
            self._mode(node, "publishes", message.mode)
        elif isinstance(message, SwarmEvent) and message.kind not in _OWN:
            of = (
                f" of robot {message.agent_id}"
                if message.agent_id and not node.endswith(f"{message.agent_id:03d}")
                else ""
            )
            kind = said(EventKind(message.kind)) if message.kind in set(EventKind) else str(message.kind)
            self._reports(node, f"{of}: {kind}{', ' + message.detail if message.detail else ''}")
        elif isinstance(message, SwarmEvent) and message.kind == EventKind.SAFE_STOP:
            self._status[node] = f"stops: {message.detail}"
            self._now(node, self._status[node])

    def heard(self, node: str, parcel: Parcel) -> None:
        if isinstance(parcel.message, DesiredAbstractState) and parcel.message.mode != Mode.RUN:
            self._mode(node, f"hears from {parcel.sender or 'a stranger'}", parcel.message.mode)

    def _speaks(self, node: str) -> None:
        assert self._fleet is not None
        if node not in self._spoke:
            self._now(node, "speaks for the first time")
        elif silence := [*self._silences(node)]:
            self._entries += silence
            self._now(node, "speaks again")
        self._spoke[node] = self._fleet.time

    def _silences(self, *nodes: str) -> Iterator[Entry]:
        """Yield which nodes that have spoken are silent now."""
        if self._fleet is None:
            return
        period = self._fleet.clock.period
        for node in nodes:
            if self._fleet.time - self._spoke[node] > _SILENT * period:
                yield Entry(self._spoke[node] + period, len(self._entries), node, "falls silent", done=False)

    def _robot(self, node: str, state: AgentState) -> None:
        follows = state.status == Status.ACTIVE and state.broadcast_step != NEVER
        before = self._status.get(node, "")
        if follows and before != "follows":
            self._status[node] = "follows"
            self._now(node, "follows the broadcasts")
        elif not follows and not before.startswith("stops"):
            self._status[node] = "stops"
            self._now(node, "does not follow" if before == "" else "no longer follows")

    def _hears(self, node: str) -> None:
        """Note what a robot without coordinators knows of the others."""
        assert self._fleet is not None
        if not self._fleet.scenario.decentralised:
            return
        values = dict(self._fleet.activity(node).engine.behaviour.health(self._fleet.now(node)).values)
        words = {"yes": "hears a majority of those that count", "no": "hears no majority of those that count"}
        known = words[values["hears a majority"]], f"counts robots {values['counted robots']}"
        before = self._known.get(node, ("", ""))
        self._known[node] = known
        for what, other in zip(known, before, strict=True):
            if what != other:
                self._now(node, what)

    def _mode(self, node: str, how: str, mode: int) -> None:
        key = node, how
        if self._modes.get(key) != mode:
            self._modes[key] = mode
            self._now(node, f"{how} {Mode(mode).name}")

    def lines(self) -> list[str]:
        """Return a line for each time and each thing that happened then; the same of several nodes is one.

        What was done to nodes is marked.
        """
        lines: list[tuple[Entry, list[str]]] = []
        for entry in sorted([*self._entries, *self._silences(*self._spoke)]):
            same = (names for one, names in reversed(lines[-12:]) if _is_same(one, entry))
            names = next(same, None)
            if names is None:
                lines.append((entry, [entry.who]))
            elif entry.who not in names:
                names.append(entry.who)
        return [f"{e.time:9.4f} s {'*' if e.done else ' '} {self._named(names)}: {e.what}" for e, names in lines]

    def _named(self, names: list[str]) -> str:
        robots = set() if self._fleet is None else {name for name in self._fleet.names if name.startswith(ROBOT_PREFIX)}
        if len(robots) > 2 and robots <= {*names}:
            names = [f"all {len(robots)} robots", *({*names} - robots)]
        return ", ".join(sorted(names))


def _is_same(one: Entry, other: Entry) -> bool:
    return (one.what, one.done) == (other.what, other.done) and abs(other.time - one.time) < 2e-3


class Trace(Watcher):
    """Writes everything that is published and heard, one line each, and counts its digest."""

    def __init__(self, fleet: VirtualFleet, output: TextIO | None) -> None:
        self._fleet = fleet
        self._output = output
        self._digest = blake2b(digest_size=16)

    def _write(self, line: str) -> None:
        self._digest.update(line.encode())
        if self._output is not None:
            self._output.write(line)

    def published(self, node: str, topic: Topic, message: Message, data: bytes) -> None:
        self._write(f"{self._fleet.now_ns} {node} publishes {topic.name} {data.hex()}\n")

    def heard(self, node: str, parcel: Parcel) -> None:
        self._write(f"{self._fleet.now_ns} {node} hears {parcel.topic.name} of {parcel.sender} {parcel.data.hex()}\n")

    def begins(self, node: str) -> None:
        self._write(f"{self._fleet.now_ns} {node} begins\n")

    def ends(self, node: str) -> None:
        self._write(f"{self._fleet.now_ns} {node} ends\n")

    def resumes(self, node: str) -> None:
        self._write(f"{self._fleet.now_ns} {node} resumes\n")

    def told(self, node: str, command: str) -> None:
        self._write(f"{self._fleet.now_ns} {node} is told {command}\n")

    @property
    def digest(self) -> str:
        return self._digest.hexdigest()

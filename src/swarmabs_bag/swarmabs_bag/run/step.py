"""A step of a run: the one form between the messages of a run and its bag, its figures and what people see."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, cast

import numpy as np

from swarmabs_bag.run.digest import digest_head
from swarmabs_core.arrays import canonical_table, layout_of, raw
from swarmabs_core.cdr import SECOND, decode
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import EVENTS, FAMILIES, SYSTEM_FAMILY, Topic
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from swarmabs_core.messages import AnyParentState, AnyRobotState, Message, SwarmEvent

    Rows = NDArray[np.void]

STEP_BYTES = 2**18
"""Size of the messages of a `Step` above which more steps in it would gain nothing."""
STEP_SECONDS = 0.05
"""Time for which a producer may hold back steps to join them, s: with the age of a chunk, it stays below 1 s."""

ORDER = {topic: number for family in FAMILIES for number, topic in enumerate(family.recorded, -len(family.once))}
ORDER[EVENTS] = 1 + max(ORDER.values())
"""Place of each recorded topic within a step of a bag."""
_MAIN = {topic for family in FAMILIES for topic in family.main}
_STEPWISE = {topic for family in FAMILIES for topic in family.stepwise}
_ROBOTS = {family.robot for family in FAMILIES}
_PARENTS = [family.parent for family in FAMILIES]


class Step:
    """K >= 1 consecutive steps of a run with the same N robots: messages as arrays by topic, events of the last step.

    Where robots pass on to each other what they know, it is one step, with their relays, which a bag holds before the
    other messages.

    A step has one message of each coordinator and one of each robot that takes part. One from a damaged bag may lack
    some; one of late events has no others. `step`, `parent` and `states` are those of the last step. The constructor
    checks nothing; use `of` for the messages of a step, and `whole` for bytes of uncertain form.

    Parameters
    ----------
    first : int
        Number of the first step.
    tables : mapping of Topic to ndarray
        For each topic but events its messages in canonical CDR with the encapsulation header, contiguous: those of the
        robots have shape (K, N), with ascending ids, the others (K,). On topics with messages in every step they have a
        layout of `swarmabs_core.arrays`; on others they are plain bytes.
    told : tuple of bytes
        The events in canonical CDR.
    relays : sequence of (Topic, bytes)
        The relays in canonical CDR by round and robot, with their topics; K is 1 if there are any.
    time : int, optional
        Time of a step without a state of the parent, ns; by default that of its first message.

    Attributes
    ----------
    first, told, relays
        As given.
    tables : dict of Topic to ndarray
        As given, in the order in which a bag holds the topics within a step.
    times : ndarray, (K,)
        Times of the steps, ns: the stamps of the parent's states, which are the log times of all messages.
    """

    __slots__ = ("first", "relays", "tables", "times", "told")

    def __init__(
        self,
        first: int,
        tables: Mapping[Topic, Rows],
        told: tuple[bytes, ...] = (),
        time: int | None = None,
        relays: Sequence[tuple[Topic, bytes]] = (),
    ) -> None:
        self.first, self.relays = first, relays
        self.tables = {topic: tables[topic] for topic in sorted(tables, key=ORDER.__getitem__)}
        self.told = told
        parents = next((self.tables[topic] for topic in _PARENTS if topic in self.tables), None)
        if parents is not None:
            self.times = parents["sec"].astype(np.int64) * SECOND + parents["nanosec"]
        else:
            self.times = np.array([self._first_stamp() if time is None else time], dtype=np.int64)

    def _first_stamp(self) -> int:
        """Return the time stamp of the first message, ns."""
        payload = next((table.tobytes() for table in self.tables.values()), b"") or self.told[0]
        seconds, nanoseconds = np.frombuffer(payload, "<i4", 1, 4), np.frombuffer(payload, "<u4", 1, 8)
        return int(seconds[0]) * SECOND + int(nanoseconds[0])

    @classmethod
    def of(cls, number: int, records: Iterable[Record], time: int | None = None) -> Step:
        """Return a single step of its messages, in any order; of a coordinator it has at most one on each topic.

        Raises
        ------
        MalformedMessageError
            If the lists in the robots' states are not equally long.
        """
        by_topic: dict[Topic, list[Record]] = {}
        for record in records:
            by_topic.setdefault(record.topic, []).append(record)
        told = tuple(record.payload for record in by_topic.pop(EVENTS, ()))
        tables = {}
        for topic, same in by_topic.items():
            if topic in _ROBOTS:
                same.sort(key=lambda record: record.agent_id)
                tables[topic] = rows_of(topic, [record.payload for record in same])[np.newaxis]
            else:
                (record,) = same
                tables[topic] = rows_of(topic, [record.payload])
        return cls(number, tables, told, time)

    @classmethod
    def whole(cls, payloads: Mapping[Topic, bytes | bytearray | memoryview]) -> Step | None:
        """Return the steps of joined payloads: for each topic by step, for the robots by step and id.

        Returns None if they are not whole steps that follow each other: if a payload is not canonical, lists change
        their lengths, robots join or leave, a step is missing, or a time of the parent is negative.
        """
        tables: dict[Topic, Rows] = {}
        for topic, data in payloads.items():
            table = canonical_table(topic, data)
            if table is None:
                return None
            tables[topic] = table
        family = next(family for family in FAMILIES if family.robot in tables)
        steps = len(tables[family.parent])
        robots, rest = divmod(len(tables[family.robot]), steps)
        if rest or any(len(table) != steps for topic, table in tables.items() if topic is not family.robot):
            return None
        tables[family.robot] = tables[family.robot].reshape(steps, robots)
        first = int(tables[family.parent]["step"][0])
        numbers = first + np.arange(steps, dtype=np.uint64)
        ids = tables[family.robot]["agent_id"]
        consecutive = all((numbers == table["step"].T).all() for table in tables.values())
        same = bool((ids == ids[0]).all() and (ids[0, 1:] > ids[0, :-1]).all())
        timed = bool((tables[family.parent]["sec"] >= 0).all())
        return cls(first, tables) if consecutive and same and timed else None

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.times)

    def __getitem__(self, steps: slice) -> Step:
        """Return some of the steps, numbered from 0; they share the memory of all."""
        chosen = range(len(self))[steps]
        told = self.told if chosen.stop == len(self) else ()
        tables = {topic: table[steps] for topic, table in self.tables.items()}
        return Step(self.first + chosen.start, tables, told, int(self.times[-1]), self.relays)

    def __eq__(self, other: object) -> bool:
        """Return whether these are the same messages at the same times."""
        same = isinstance(other, Step) and (self.first, len(self)) == (other.first, len(other))
        return same and list(self.stored()) == list(other.stored())  # type: ignore[attr-defined]

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Return the numbers of the steps and of the messages on each topic."""
        counts = ", ".join(f"{topic.name}: {table.size}" for topic, table in self.tables.items())
        return f"Step({self.first} to {self.step}; {counts}; {len(self.told)} events, {len(self.relays)} relays)"

    def singly(self) -> Iterator[Step]:
        """Return the steps one after the other."""
        return (self[place : place + 1] for place in range(len(self)))

    def alike(self, other: Step) -> bool:
        """Return whether other steps are of the same robots and topics, with lists of the same lengths."""
        layouts = ({topic: table.dtype for topic, table in step.tables.items()} for step in (self, other))
        ours, theirs = layouts
        return ours == theirs and np.array_equal(self.robots, other.robots)

    def joined(self, other: Step) -> Step:
        """Return these steps, which have no events, and others that are `alike` and follow them."""
        tables = {topic: np.concatenate((table, other.tables[topic])) for topic, table in self.tables.items()}
        return Step(self.first, tables, other.told)

    @property
    def robots(self) -> NDArray[np.uint16]:
        """Ids of the robots."""
        table = self._robots
        return np.empty(0, dtype=np.uint16) if table is None else table["agent_id"][0]

    @property
    def _robots(self) -> Rows | None:
        return next((table for topic, table in self.tables.items() if topic in _ROBOTS), None)

    @property
    def step(self) -> int:
        """Number of the last step."""
        return self.first + len(self) - 1

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(table.size for table in self.tables.values()) + len(self.told) + len(self.relays)

    @property
    def parents(self) -> tuple[AnyParentState, ...]:
        """States of the parent system, by step; empty for late events of an earlier step."""
        topic = next((topic for topic in _PARENTS if topic in self.tables), None)
        return () if topic is None else cast("tuple[AnyParentState, ...]", tuple(self._read(topic, slice(None))))

    @property
    def parent(self) -> AnyParentState | None:
        """State of the parent system in the last step; None for late events of an earlier step."""
        topic = next((topic for topic in _PARENTS if topic in self.tables), None)
        if topic is None:
            return None
        return cast("AnyParentState", self._read(topic, -1)[0])

    @property
    def max_abs_positions(self) -> tuple[float, ...]:
        """Largest absolute coordinate of a robot in each step: on the plane, its distance from the axis, m.

        NaN if one of them is. Empty if there are no robots, or they have no coordinates.
        """
        robots = self._robots
        name = "coordinates" if SYSTEM_FAMILY.robot in self.tables else "position"
        if robots is None or name not in (robots.dtype.names or ()):
            return ()
        return tuple(np.abs(robots[name]).reshape(len(self), -1).max(axis=1).tolist())

    @property
    def events(self) -> tuple[SwarmEvent, ...]:
        """The events of the last step."""
        return cast("tuple[SwarmEvent, ...]", tuple(decode(EVENTS.message, payload) for payload in self.told))

    def states(self) -> Iterator[AnyRobotState]:
        """Return the robots' states in the last step."""
        topic = next((topic for topic in self.tables if topic in _ROBOTS), None)
        return iter(() if topic is None else cast("list[AnyRobotState]", self._read(topic, -1)))

    @property
    def records(self) -> tuple[Record, ...]:
        """All messages with their bytes, in the order of a bag."""
        return tuple(Record.heard(topic, payload) for topic, _, payload in self.stored())

    def digest_text(self) -> bytes:
        """Return the contribution of the steps to the digest of a run."""
        main = [(topic, table) for topic, table in self.tables.items() if topic in _MAIN]
        if not main:
            return b""
        template = _digested(tuple((topic, table.itemsize, table[0].size) for topic, table in main))
        rows = np.repeat(template, len(self))
        for topic, table in main:
            rows[topic.name]["payload"] = raw(table).reshape(len(self), -1, table.itemsize)
        return rows.tobytes()

    def stored(self) -> Iterator[tuple[Topic, int, bytes]]:
        """Return topic, time (ns) and bytes of every message, in the order of a bag."""
        for topic, payload in self.relays:
            yield topic, int(self.times[-1]), payload
        for place, stamp in enumerate(self.times.tolist()):
            for topic in self.tables:
                for payload in self._payloads(topic, place):
                    yield topic, stamp, payload
        for payload in self.told:
            yield EVENTS, int(self.times[-1]), payload

    def _payloads(self, topic: Topic, place: int | slice) -> list[bytes]:
        """Return the bytes of a topic's messages in a step, or in several."""
        table = self.tables[topic]
        data, size = table[place].tobytes(), table.itemsize
        return [data[start : start + size] for start in range(0, len(data), size)]

    def _read(self, topic: Topic, place: int | slice) -> list[Message]:
        return [decode(topic.message, data) for data in self._payloads(topic, place)]


def rows_of(topic: Topic, payloads: Sequence[bytes]) -> Rows:
    """Return messages in canonical form as rows of a table of a `Step`.

    Raises
    ------
    MalformedMessageError
        If they are not equally long.
    """
    if len(set(map(len, payloads))) > 1:
        raise MalformedMessageError(topic.message.__name__, "lists of different lengths in one step")
    layout = layout_of(topic, payloads[0]) if topic in _STEPWISE else np.dtype((np.void, len(payloads[0])))
    return np.frombuffer(b"".join(payloads), layout)


@lru_cache(maxsize=64)
def _digested(tables: tuple[tuple[Topic, int, int], ...]) -> NDArray[np.void]:
    """Return a step as it enters the digest, shape (1,), with its heads; the payloads are zero.

    `tables` are topic, size of a message and number of messages in the step.
    """
    layout = []
    for topic, size, count in sorted(tables, key=lambda table: table[0].name):
        head = np.dtype((np.void, len(digest_head(topic, size))))
        layout.append((topic.name, np.dtype([("head", head), ("payload", np.uint8, (size,))]), (count,)))
    row = np.zeros(1, dtype=layout)
    for topic, size, _ in tables:
        row[topic.name]["head"] = np.void(digest_head(topic, size))
    return row

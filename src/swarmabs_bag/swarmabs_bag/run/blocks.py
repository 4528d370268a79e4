"""Consecutive steps of a run as one array per topic, so that work on many messages is work on few arrays."""

from __future__ import annotations

import time
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_bag.run.recording import RecordedStep, digest_head
from swarmabs_core.arrays import Tables, canonical_table, raw
from swarmabs_core.cdr import SECOND, decode
from swarmabs_core.messages import FAMILIES, PLANE_FAMILY, Topic
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from typing import Any

    from numpy.typing import NDArray

    from swarmabs_bag.run.recording import Step
    from swarmabs_core.messages import AnyParentState, AnyRobotState, SwarmEvent

BLOCK_BYTES = 2**18
"""Size of the messages of a block above which a longer one would gain nothing."""
BLOCK_SECONDS = 0.05
"""Time for which a producer may hold back steps for a block, s: with the age of a chunk, it stays below 1 s."""


class Block:
    """K >= 1 consecutive complete steps with the same N >= 1 robots and without events, as arrays.

    It can be used wherever a single `Step` can: `step`, `parent` and `states` are those of its last step. Use `of` or
    `gathered` for bytes of uncertain form; the constructor checks nothing.

    Parameters
    ----------
    tables : mapping of Topic to ndarray
        For each main topic of a family its messages in canonical CDR with the encapsulation header, in a layout of
        `swarmabs_core.arrays`, contiguous: those of the robots have shape (K, N), with ascending ids, the others (K,).

    Attributes
    ----------
    family : Family
        The topics.
    tables : dict of Topic to ndarray
        As given, in the order in which a bag holds the topics within a step.
    times : ndarray, (K,)
        Times of the steps, ns: the stamps of the parent's states, which are the log times of all messages.
    """

    __slots__ = ("family", "tables", "times")

    def __init__(self, tables: Tables) -> None:
        self.family = next(family for family in FAMILIES if family.robot in tables)
        self.tables = {topic: tables[topic] for topic in self.family.main}
        parents = self.tables[self.family.parent]
        self.times = parents["sec"].astype(np.int64) * SECOND + parents["nanosec"]

    @classmethod
    def of(cls, payloads: Mapping[Topic, bytes | bytearray | memoryview]) -> Block | None:
        """Return the block of joined payloads: for each main topic by step, for the robots by step and id.

        Returns None if they do not form a block: if a payload is not canonical, lists change their lengths, robots
        join or leave, a step is missing, or a time of the parent is negative.
        """
        tables: dict[Topic, NDArray[np.void]] = {}
        for topic, data in payloads.items():
            table = canonical_table(topic, data)
            if table is None:
                return None
            tables[topic] = table
        family = next(family for family in FAMILIES if family.robot in tables)
        steps = len(tables[family.parent])
        robots, rest = divmod(len(tables[family.robot]), steps)
        if rest or any(len(tables[topic]) != steps for topic in family.main[1:]):
            return None
        tables[family.robot] = tables[family.robot].reshape(steps, robots)
        block = cls(tables)
        return block if block._is_consecutive() else None

    @classmethod
    def gathered(cls, steps: Sequence[RecordedStep]) -> Block | None:
        """Return the block of steps, None if they do not form one; see `of`."""
        payloads: dict[Topic, list[bytes]] = {}
        for step in steps:
            for record in step.records:
                payloads.setdefault(record.topic, []).append(record.payload)
        if not any(payloads.keys() == set(family.main) for family in FAMILIES):
            return None
        if any(len({len(payload) for payload in found}) > 1 for found in payloads.values()):
            return None
        return cls.of({topic: b"".join(found) for topic, found in payloads.items()})

    def _is_consecutive(self) -> bool:
        """Return whether step follows step, each with the same robots in ascending order."""
        steps = self.tables[self.family.parent]["step"][0] + np.arange(len(self), dtype=np.uint64)
        ids = self.tables[self.family.robot]["agent_id"]
        numbered = all((steps == table["step"].T).all() for table in self.tables.values())
        same = bool((ids == ids[0]).all() and (ids[0, 1:] > ids[0, :-1]).all())
        return numbered and same and bool((self.tables[self.family.parent]["sec"] >= 0).all())

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.times)

    def __getitem__(self, steps: slice) -> Block:
        """Return some of the steps, numbered from 0 in the block; they share its memory."""
        return Block({topic: table[steps] for topic, table in self.tables.items()})

    def alike(self, other: Block) -> bool:
        """Return whether the steps of another block are of the same robots, with lists of the same lengths."""
        layouts = all(
            topic in other.tables and table.dtype == other.tables[topic].dtype for topic, table in self.tables.items()
        )
        robots = self.family.robot
        return layouts and np.array_equal(self.tables[robots]["agent_id"][0], other.tables[robots]["agent_id"][0])

    def joined(self, other: Block) -> Block:
        """Return the block of these steps and of others that are `alike` and follow them."""
        return Block({topic: np.concatenate((table, other.tables[topic])) for topic, table in self.tables.items()})

    @property
    def robots(self) -> int:
        """Number of robots."""
        return int(self.tables[self.family.robot].shape[1])

    @property
    def first(self) -> int:
        """Number of the first step."""
        return int(self.tables[self.family.parent]["step"][0])

    @property
    def step(self) -> int:
        """Number of the last step."""
        return int(self.tables[self.family.parent]["step"][-1])

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(table.size for table in self.tables.values())

    @property
    def parent(self) -> AnyParentState:
        """State of the parent system in the last step."""
        state: AnyParentState = self._read(self.family.parent, -1)[0]
        return state

    @property
    def parents(self) -> tuple[AnyParentState, ...]:
        """States of the parent system, by step."""
        return tuple(self._read(self.family.parent, slice(None)))

    @property
    def max_abs_positions(self) -> tuple[float, ...]:
        """Largest absolute coordinate of a robot, by step; empty if the robots have no coordinates."""
        robots = self.tables[self.family.robot]
        name = "position" if self.family is PLANE_FAMILY else "coordinates"
        if name not in (robots.dtype.names or ()):
            return ()
        sizes = np.abs(robots[name]).reshape(len(self), -1)
        largest = np.where(np.isnan(sizes), -1.0, sizes).max(axis=1)
        # As `max` of the numbers one after the other: NaN if the first one is, else the largest that is a number.
        return tuple(np.where(np.isnan(sizes[:, 0]), np.nan, largest).tolist())

    @property
    def events(self) -> tuple[SwarmEvent, ...]:
        """No events."""
        return ()

    def states(self) -> Iterator[AnyRobotState]:
        """Return the robots' states in the last step."""
        return iter(self._read(self.family.robot, -1))

    def digest_text(self) -> bytes:
        """Return the contribution of the steps to the digest of a run."""
        template = _digested(tuple((topic, table.dtype) for topic, table in self.tables.items()), self.robots)
        rows = np.repeat(template, len(self))
        for topic, table in self.tables.items():
            rows[topic.name]["payload"] = raw(table)
        return rows.tobytes()

    def stored(self) -> Iterator[tuple[Topic, int, bytes]]:
        """Return topic, time (ns) and bytes of every message, in the order of a bag."""
        for place, stamp in enumerate(self.times.tolist()):
            for topic in self.tables:
                for payload in self._payloads(topic, place):
                    yield topic, stamp, payload

    def recorded(self) -> Iterator[RecordedStep]:
        """Return the steps one after the other, with their messages."""
        for place in range(len(self)):
            records = [Record.heard(topic, data) for topic in self.tables for data in self._payloads(topic, place)]
            yield RecordedStep(self.first + place, tuple(records))

    def _payloads(self, topic: Topic, place: int | slice) -> list[bytes]:
        """Return the bytes of a topic's messages in a step, or in several."""
        table = self.tables[topic]
        data, size = table[place].tobytes(), table.itemsize
        return [data[start : start + size] for start in range(0, len(data), size)]

    def _read(self, topic: Topic, place: int | slice) -> list[Any]:
        return [decode(topic.message, data) for data in self._payloads(topic, place)]


def gathered_steps(steps: Iterable[RecordedStep]) -> Iterator[Step]:
    """Yield steps in blocks, those that do not fit on their own; after an error, those before it have been yielded."""
    waiting: list[RecordedStep] = []
    size, begun = 0, 0.0
    try:
        for step in steps:
            if waiting and (step.events or len(step.records) != len(waiting[0].records)):
                yield from _taken(waiting)
            if not waiting:
                size, begun = 0, time.monotonic()
            waiting.append(step)
            size += sum(len(record.payload) for record in step.records)
            if step.events or size >= BLOCK_BYTES or time.monotonic() - begun >= BLOCK_SECONDS:
                yield from _taken(waiting)
    except Exception:
        yield from _taken(waiting)
        raise
    yield from _taken(waiting)


def _taken(steps: list[RecordedStep]) -> Iterator[Step]:
    """Yield the steps, as a block if they form one, and clear the list."""
    block = Block.gathered(steps)
    yield from [block] if block is not None else steps
    steps.clear()


@lru_cache(maxsize=16)
def _digested(layouts: tuple[tuple[Topic, np.dtype[np.void]], ...], robots: int) -> NDArray[np.void]:
    """Return a step as it enters the digest, shape (1,), with its heads; the payloads are zero."""
    parts: list[Any] = []
    for number, (topic, layout) in sorted(enumerate(layouts), key=lambda each: each[1][0].name):
        size = layout.itemsize
        part = np.dtype([("head", f"V{len(digest_head(topic, size))}"), ("payload", "u1", (size,))])
        parts.append((topic.name, part, (() if number else (robots,))))
    row = np.zeros(1, dtype=parts)
    for topic, layout in layouts:
        row[topic.name]["head"] = np.void(digest_head(topic, layout.itemsize))
    return row

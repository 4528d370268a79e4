"""Chunks of an MCAP file in the making: message records and their indexes, of single messages and of blocks."""

from __future__ import annotations

import struct
import zlib
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk

from swarmabs_bag.records import HEAD_SIZE
from swarmabs_core.arrays import raw

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from swarmabs_bag.blocks import Block
    from swarmabs_core.messages import Topic

_MESSAGE_HEAD = struct.Struct("<BQH")
_MESSAGE_REST = struct.Struct("<IQQ")
_BEFORE_PAYLOAD = _MESSAGE_HEAD.size + _MESSAGE_REST.size
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_ENTRY = struct.Struct("<QQ")
_SEQUENCE_MASK = 2**32 - 1


def _message_head(channel: int, size: int) -> bytes:
    """Return opcode, length and channel of a message record with a payload of this size."""
    return _MESSAGE_HEAD.pack(Opcode.MESSAGE, _BEFORE_PAYLOAD - HEAD_SIZE + size, channel)


class _StepLayout(NamedTuple):
    """The message records of a step with M messages.

    Attributes
    ----------
    rows : dtype
        A field by topic, with the fields `head`, `sequence`, `times` (log and publish time), `payload`.
    begins : ndarray, (M,)
        Offsets of the records.
    places : ndarray, (M,)
        Number of each message's topic.
    """

    rows: np.dtype[np.void]
    begins: NDArray[np.int64]
    places: NDArray[np.uint8]


@lru_cache(maxsize=64)
def _step_layout(topics: tuple[str, ...], sizes: tuple[int, ...], robots: int) -> _StepLayout:
    """Return the layout of steps whose payloads have these sizes by topic, the first of which is that of the robots."""
    fields: list[Any] = []
    for topic, size in zip(topics, sizes, strict=True):
        record = [
            ("head", f"V{_MESSAGE_HEAD.size}"),
            *(("sequence", "<u4"), ("times", "<u8", (2,))),
            ("payload", "u1", (size,)),
        ]
        fields.append((topic, np.dtype(record), () if fields else (robots,)))
    places = np.repeat(np.arange(len(sizes), dtype=np.uint8), [robots, *(1 for _ in sizes[1:])])
    lengths = _BEFORE_PAYLOAD + np.array(sizes)[places]
    return _StepLayout(np.dtype(fields), np.cumsum(lengths) - lengths, places)


class BlockRecords:
    """The message records of a block, step by step in the order of a bag.

    Parameters
    ----------
    block : Block
        The steps.
    channels : mapping of Topic to int
        Ids of the channels.
    counts : mapping of int to int
        By channel, the number of messages before the block, from which the sequence numbers follow.

    Attributes
    ----------
    data : memoryview
        The records.
    entries : ndarray, (n, 2)
        By message, its log time (ns) and the offset of its record in `data`.
    ends : ndarray, (n,)
        By message, the end of its record in `data`.
    places : ndarray, (n,)
        By message, the place of its channel in `order`.
    order : list of int
        The channels, as they follow each other within a step.
    """

    __slots__ = ("data", "ends", "entries", "order", "places")

    def __init__(self, block: Block, channels: Mapping[Topic, int], counts: Mapping[int, int]) -> None:
        tables = block.tables
        self.order = [channels[topic] for topic in tables]
        sizes = tuple(table.itemsize for table in tables.values())
        layout = _step_layout(tuple(topic.name for topic in tables), sizes, block.robots)
        steps = len(block)
        rows = np.empty(steps, dtype=layout.rows)
        for channel, (topic, table) in zip(self.order, tables.items(), strict=True):
            records = rows[topic.name]
            records["head"] = np.void(_message_head(channel, table.itemsize))
            numbers = np.arange(counts[channel], counts[channel] + table.size).reshape(table.shape)
            records["sequence"] = numbers & _SEQUENCE_MASK
            records["times"] = block.times.reshape(steps, *[1] * table.ndim)
            records["payload"] = raw(table)
        self.data = memoryview(rows.view(np.uint8))
        entries = np.empty((steps, len(layout.begins), 2), dtype=np.int64)
        entries[..., 0] = block.times[:, np.newaxis]
        entries[..., 1] = np.arange(steps)[:, np.newaxis] * layout.rows.itemsize + layout.begins
        self.entries = entries.reshape(-1, 2)
        self.ends = np.append(self.entries[1:, 1], len(self.data))
        self.places = np.tile(layout.places, steps)

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.entries)


def step_bytes(block: Block) -> int:
    """Return the size of the message records of a step."""
    return sum(table[0].size * (_BEFORE_PAYLOAD + table.itemsize) for table in block.tables.values())


class Contents(NamedTuple):
    """The contents of a chunk: its records, entries of the message indexes by channel, first and last log time, ns."""

    data: bytearray
    entries: dict[int, bytearray]
    start: int
    end: int

    def counts(self) -> dict[int, int]:
        """Return the number of messages by channel."""
        return {channel: len(listed) // _INDEX_ENTRY.size for channel, listed in self.entries.items()}

    def indexes(self) -> list[tuple[int, bytes]]:
        """Return the channels with their message index records."""
        return [
            (channel, _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(listed), channel, len(listed)) + listed)
            for channel, listed in self.entries.items()
        ]

    def packed(self) -> Chunk:
        """Return the chunk record, compressed as the mcap library compresses it."""
        return Chunk(
            compression="zstd",
            data=zstandard.compress(self.data),
            message_start_time=self.start,
            message_end_time=self.end,
            uncompressed_crc=zlib.crc32(self.data),
            uncompressed_size=len(self.data),
        )


class ChunkBuilder:
    """Collects the records of a chunk, which is full as soon as it exceeds `limit` bytes."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._data = bytearray()
        self._entries: dict[int, bytearray] = {}
        self._start = self._end = 0

    @property
    def empty(self) -> bool:
        """Whether the chunk has no messages."""
        return not self._entries

    @property
    def full(self) -> bool:
        """Whether the chunk is full."""
        return len(self._data) > self._limit and not self.empty

    def define(self, record: bytes) -> None:
        """Add the record of a schema or a channel."""
        self._data += record

    def add(self, channel: int, sequence: int, times: tuple[int, int], payload: bytes) -> None:
        """Add a message with its log and publish time, ns."""
        self._cover(times[0], times[0])
        self._index(channel, _INDEX_ENTRY.pack(times[0], len(self._data)))
        self._data += _message_head(channel, len(payload))
        self._data += _MESSAGE_REST.pack(sequence & _SEQUENCE_MASK, *times)
        self._data += payload

    def steps_to_fill(self, step_bytes: int) -> int:
        """Return the number of steps, each with records of so many bytes, of which only the last fills the chunk."""
        return max(0, self._limit - len(self._data)) // step_bytes + 1

    def add_records(self, records: BlockRecords, first: int) -> int:
        """Add message `first` and those after it until the chunk is full; return the number of the next one."""
        begin = int(records.entries[first, 1])
        base = len(self._data) - begin
        filling = int(np.searchsorted(records.ends, self._limit - base, side="right"))
        stop = min(max(filling, first) + 1, len(records))
        entries, places = records.entries[first:stop] + np.array([0, base]), records.places[first:stop]
        self._cover(int(entries[:, 0].min()), int(entries[:, 0].max()))
        for turn in range(len(records.order)):
            place = (int(places[0]) + turn) % len(records.order)
            if len(listed := entries[places == place]):
                self._index(records.order[place], listed.tobytes())
        self._data += records.data[begin : int(records.ends[stop - 1])]
        return stop

    def take(self) -> Contents:
        """Return the contents, and begin the next chunk."""
        taken = Contents(self._data, self._entries, self._start, self._end)
        self._data, self._entries = bytearray(), {}
        return taken

    def _cover(self, start: int, end: int) -> None:
        """Extend the times of the chunk; call it before the first entry is added."""
        self._start = start if self.empty else min(self._start, start)
        self._end = end if self.empty else max(self._end, end)

    def _index(self, channel: int, entries: bytes) -> None:
        self._entries.setdefault(channel, bytearray()).extend(entries)

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

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

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
    bounds : ndarray, (M+1,)
        Offsets of the records, and the size of all.
    spans : tuple of (int, int)
        First and last+1 message of each topic.
    """

    rows: np.dtype[np.void]
    bounds: NDArray[np.int64]
    spans: tuple[tuple[int, int], ...]


@lru_cache(maxsize=64)
def _step_layout(topics: tuple[str, ...], sizes: tuple[int, ...], robots: int) -> _StepLayout:
    """Return the layout of steps whose payloads have these sizes by topic, the first of which is that of the robots."""
    fields: list[Any] = []
    spans, lengths = [], [0]
    for topic, size in zip(topics, sizes, strict=True):
        number = 1 if fields else robots
        record = [
            ("head", f"V{_MESSAGE_HEAD.size}"),
            *(("sequence", "<u4"), ("times", "<u8", (2,))),
            ("payload", f"V{size}"),
        ]
        fields.append((topic, np.dtype(record), (number,)))
        spans.append((len(lengths) - 1, len(lengths) - 1 + number))
        lengths += [_BEFORE_PAYLOAD + size] * number
    return _StepLayout(np.dtype(fields), np.cumsum(lengths), tuple(spans))


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
    channels : list of int
        The channels, as they follow each other within a step.
    data : memoryview
        The records.
    """

    __slots__ = ("_entries", "_layout", "_times", "channels", "data")

    def __init__(self, block: Block, channels: Mapping[Topic, int], counts: Mapping[int, int]) -> None:
        tables, steps = block.tables, len(block)
        self.channels = [channels[topic] for topic in tables]
        sizes = tuple(table.itemsize for table in tables.values())
        self._layout = layout = _step_layout(tuple(topic.name for topic in tables), sizes, block.robots)
        self._times = block.times
        rows = np.empty(steps, dtype=layout.rows)
        begins = np.arange(steps)[:, np.newaxis] * layout.rows.itemsize
        self._entries: list[NDArray[np.int64]] = []
        for channel, (topic, table), (first, stop) in zip(self.channels, tables.items(), layout.spans, strict=True):
            records = rows[topic.name]
            records["head"] = np.void(_message_head(channel, table.itemsize))
            numbers = np.arange(counts[channel], counts[channel] + table.size).reshape(records.shape)
            records["sequence"] = numbers & _SEQUENCE_MASK
            records["times"] = block.times[:, np.newaxis, np.newaxis]
            records["payload"] = table.view(f"V{table.itemsize}").reshape(records.shape)
            entries = np.empty((*records.shape, 2), dtype=np.int64)
            entries[..., 0] = block.times[:, np.newaxis]
            entries[..., 1] = begins + layout.bounds[first:stop]
            self._entries.append(entries.reshape(-1, 2))
        self.data = memoryview(rows.view(np.uint8))

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self._times) * (len(self._layout.bounds) - 1)

    def begin(self, message: int) -> int:
        """Return the offset of a message's record in `data`, or of its end for the number of messages."""
        step, place = divmod(message, len(self._layout.bounds) - 1)
        return step * self._layout.rows.itemsize + int(self._layout.bounds[place])

    def reaching(self, offset: int) -> int:
        """Return the first message whose record ends beyond an offset in `data`; negative or too large beyond it."""
        step, rest = divmod(offset, self._layout.rows.itemsize)
        place = np.searchsorted(self._layout.bounds[1:], rest, side="right")
        return step * (len(self._layout.bounds) - 1) + int(place)

    def times(self, first: int, stop: int) -> NDArray[np.int64]:
        """Return the log times, ns, of the steps of messages `first` to `stop` - 1."""
        each = len(self._layout.bounds) - 1
        found: NDArray[np.int64] = self._times[first // each : (stop - 1) // each + 1]
        return found

    def entries(self, first: int, stop: int) -> Iterator[tuple[int, NDArray[np.int64]]]:
        """Yield each channel of messages `first` to `stop` - 1, in order, with their log times (ns) and offsets."""
        each, spans = len(self._layout.bounds) - 1, self._layout.spans
        begun = next(number for number, (_, end) in enumerate(spans) if first % each < end)
        for number in (*range(begun, len(spans)), *range(begun)):
            start, end = spans[number]
            low, high = (m // each * (end - start) + min(max(m % each - start, 0), end - start) for m in (first, stop))
            if low < high:
                yield self.channels[number], self._entries[number][low:high]


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
        begin = records.begin(first)
        base = len(self._data) - begin
        stop = min(max(records.reaching(self._limit - base), first) + 1, len(records))
        times = records.times(first, stop)
        self._cover(int(np.min(times)), int(np.max(times)))
        for channel, entries in records.entries(first, stop):
            self._index(channel, (entries + np.array([0, base])).tobytes())
        self._data += records.data[begin : records.begin(stop)]
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

"""Chunks of an MCAP file in the making: records and index entries of single messages, and of many equally long ones."""

from __future__ import annotations

import struct
import zlib
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk

from swarmabs_bag.mcap.records import MESSAGE_HEAD_SIZE
from swarmabs_bag.mcap.stored import UINT32, UINT64, index_entries, plain_bytes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_MESSAGE_HEAD = struct.Struct("<BQH")
_MESSAGE_REST = struct.Struct("<IQQ")
_BEFORE_PAYLOAD = _MESSAGE_HEAD.size + _MESSAGE_REST.size
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_ENTRY = struct.Struct("<QQ")
_SEQUENCE_MASK = 2**32 - 1


def _message_head(channel: int, size: int) -> bytes:
    """Return opcode, length and channel of a message record with a payload of this size."""
    return _MESSAGE_HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD_SIZE + size, channel)


def message_index(channel: int, entries: bytes | bytearray) -> bytes:
    """Return the message index record of a channel in a chunk."""
    return _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)) + entries


class Column(NamedTuple):
    """Messages of one channel that are equally long, in K groups of n messages each.

    Attributes
    ----------
    channel : int
        Id of the channel.
    sequence : int
        Sequence number of the first message.
    payloads : ndarray, (K, n)
        The payloads, contiguous, of any type with their size.
    """

    channel: int
    sequence: int
    payloads: NDArray[np.void]


class _Group(NamedTuple):
    """A group of M messages: its records, a field for each column; their channels, begins and ends, bytes, (M,)."""

    layout: np.dtype[np.void]
    channels: NDArray[np.int64]
    begins: NDArray[np.int64]
    ends: NDArray[np.int64]


@lru_cache(maxsize=64)
def _group(columns: tuple[tuple[int, int, int], ...]) -> _Group:
    """Return a group of columns, each given by channel, number of messages and size of a payload."""
    layout = np.dtype([(str(number), _record(size), (count,)) for number, (_, count, size) in enumerate(columns)])
    channels, counts, sizes = np.array(columns, dtype=np.int64).T
    sizes = np.repeat(_BEFORE_PAYLOAD + sizes, counts)
    ends = np.cumsum(sizes)
    return _Group(layout, np.repeat(channels, counts), ends - sizes, ends)


def _record(size: int) -> np.dtype[np.void]:
    """Return the layout of a message record with a payload of this size."""
    head, payload = plain_bytes(_MESSAGE_HEAD.size), plain_bytes(size)
    return np.dtype([("head", head), ("sequence", UINT32), ("times", UINT64, (2,)), ("payload", payload)])


class MessageRecords:
    """The message records of K groups of messages, such as steps, one group after the other.

    Parameters
    ----------
    times : ndarray, (K,)
        Log and publish time of the messages of each group, ns.
    columns : sequence of Column
        The messages of a group, in this order.

    Attributes
    ----------
    data : memoryview
        The records.
    channels, times, begins, ends : ndarray, (K * M,)
        Of each message the channel, the log time in ns, and where its record begins and ends in `data`.
    """

    __slots__ = ("begins", "channels", "data", "ends", "times")

    def __init__(self, times: NDArray[np.int64], columns: Sequence[Column]) -> None:
        group = _group(tuple((c.channel, c.payloads.shape[1], c.payloads.itemsize) for c in columns))
        rows = np.empty(len(times), dtype=group.layout)
        for name, (channel, sequence, payloads) in zip(group.layout.names or (), columns, strict=True):
            records, size = rows[name], payloads.itemsize
            records["head"] = np.void(_message_head(channel, size))
            records["sequence"] = np.arange(sequence, sequence + payloads.size).reshape(records.shape) & _SEQUENCE_MASK
            records["times"] = times[:, np.newaxis, np.newaxis]
            records["payload"] = payloads.view(plain_bytes(size)).reshape(records.shape)
        self.data = memoryview(rows.view(np.uint8))
        starts = np.arange(len(times))[:, np.newaxis] * rows.itemsize
        self.begins, self.ends = (starts + group.begins).ravel(), (starts + group.ends).ravel()
        self.channels = np.tile(group.channels, len(times))
        self.times = np.repeat(times, len(group.channels))

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.ends)

    def until(self, first: int, size: int) -> int:
        """Return the message after the one from `first` on with whose record they exceed a size, bytes."""
        exceeding = int(np.searchsorted(self.ends, int(self.begins[first]) + size, side="right"))
        return min(max(exceeding, first) + 1, len(self))


def group_size(columns: Sequence[Column]) -> int:
    """Return the size of the message records of a group, bytes."""
    return sum(c.payloads.shape[1] * (_BEFORE_PAYLOAD + c.payloads.itemsize) for c in columns)


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
        return [(channel, message_index(channel, entries)) for channel, entries in self.entries.items()]

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

    def groups_to_fill(self, size: int) -> int:
        """Return the number of groups, each with records of so many bytes, of which only the last fills the chunk."""
        return max(0, self._limit - len(self._data)) // size + 1

    def add_records(self, records: MessageRecords, first: int) -> int:
        """Add message `first` and those after it until the chunk is full; return the number of the next one."""
        stop = records.until(first, self._limit - len(self._data))
        times, begins = records.times[first:stop], records.begins[first:stop]
        self._cover(int(np.min(times)), int(np.max(times)))
        offsets = begins - begins[0] + len(self._data)
        for channel, entries in index_entries(records.channels[first:stop], times, offsets).items():
            self._index(channel, entries)
        self._data += records.data[int(begins[0]) : int(records.ends[stop - 1])]
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

"""The messages in a chunk as arrays: one pass over the lengths of its records instead of work per message."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from swarmabs_bag.mcap.records import HEAD_SIZE, MESSAGE_HEAD_SIZE, Record, RecordError, StoredMessage

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from mcap.records import Statistics
    from numpy.typing import NDArray
    from typing_extensions import Self

UINT16, UINT32, UINT64 = (np.dtype(kind).newbyteorder("<") for kind in (np.uint16, np.uint32, np.uint64))
"""Numbers as they are stored in a file."""

MESSAGE_HEAD = np.dtype(
    [
        ("opcode", np.uint8),
        ("length", UINT64),
        ("channel_id", UINT16),
        ("sequence", UINT32),
        ("log_time", UINT64),
        ("publish_time", UINT64),
    ]
)
"""The bytes of a message record before its payload."""
_LENGTH = struct.Struct("<xQ")


class StoredMessages:
    """Messages as stored in a file, as arrays of the same length.

    Attributes
    ----------
    data : bytes
        Bytes that contain them.
    heads : structured ndarray
        Their ``channel_id``, ``sequence``, ``log_time`` and ``publish_time`` (ns).
    begins, sizes : ndarray of int64
        Where each payload begins in `data`, and its size in bytes.
    """

    __slots__ = ("begins", "data", "heads", "sizes")

    def __init__(self, data: bytes, heads: NDArray[np.void], begins: NDArray[np.int64]) -> None:
        self.data, self.heads, self.begins = data, heads, begins
        self.sizes = heads["length"].astype(np.int64) - MESSAGE_HEAD_SIZE

    @classmethod
    def at(cls, data: bytes, starts: NDArray[np.int64]) -> Self:
        """Return the messages whose records start at these places in the data."""
        return cls(data, _at(data, starts, MESSAGE_HEAD), starts + MESSAGE_HEAD.itemsize)

    def __getitem__(self, selected: slice | NDArray[np.bool_]) -> Self:
        """Return some of the messages, in the same data."""
        return type(self)(self.data, self.heads[selected], self.begins[selected])

    def joined(self, other: Self) -> Self:
        """Return these messages, followed by others."""
        if not len(self):
            return other
        first, last = int(self.begins[0]), int(self.begins[-1] + self.sizes[-1])
        kept = self.data[first:last]
        begins = np.concatenate((self.begins - first, other.begins + len(kept)))
        return type(self)(kept + other.data, np.concatenate((self.heads, other.heads)), begins)

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.begins)

    def __iter__(self) -> Iterator[StoredMessage]:
        """Yield the messages one after the other."""
        columns = (self.heads[name].tolist() for name in ("channel_id", "sequence", "log_time", "publish_time"))
        ends = (self.begins + self.sizes).tolist()
        for channel_id, sequence, log_time, publish_time, begin, end in zip(
            *columns, self.begins.tolist(), ends, strict=True
        ):
            yield StoredMessage(channel_id, sequence, log_time, publish_time, self.data[begin:end])

    def renumber(self, numbers: Mapping[int, int]) -> None:
        """Replace the numbers of channels; those not given stay."""
        before = self.heads["channel_id"].copy()
        for old, new in numbers.items():
            if old != new:
                self.heads["channel_id"][before == old] = new

    def add_to(self, statistics: Statistics) -> None:
        """Count the messages in statistics without messages."""
        if not len(self):
            return
        times = self.heads["log_time"]
        statistics.message_start_time, statistics.message_end_time = int(times.min()), int(times.max())
        statistics.message_count = len(self)
        channels, counts = np.unique(self.heads["channel_id"], return_counts=True)
        statistics.channel_message_counts.update(zip(channels.tolist(), counts.tolist(), strict=True))

    def rows(self, layout: np.dtype[np.void]) -> NDArray[np.void]:
        """Return the payloads, each at least as long as the layout, as rows of a structured array."""
        return _at(self.data, self.begins, layout)

    def gathered(self, begins: NDArray[np.int64], size: int) -> bytes:
        """Return the joined bytes of payloads of a size (bytes) that begin at places in the data."""
        return _at(self.data, begins, plain_bytes(size)).tobytes()

    def index_entries(self) -> dict[int, bytes]:
        """Return the entries of the message indexes by channel."""
        return index_entries(self.heads["channel_id"], self.heads["log_time"], self.begins - MESSAGE_HEAD.itemsize)


class ChunkContent(NamedTuple):
    """The records in a chunk, up to the first that is cut off.

    Attributes
    ----------
    data : bytes
        The records.
    messages : StoredMessages
        The messages.
    others : list of (int, Record)
        All other records with their places in the data; their position in the file is that of the chunk.
    end : int
        Where the records end that could be read.
    problem : RecordError or None
        Why not all could be read.
    """

    data: bytes
    messages: StoredMessages
    others: list[tuple[int, Record]]
    end: int
    problem: RecordError | None

    @classmethod
    def of(cls, data: bytes, offset: int) -> ChunkContent:
        """Return the records in the chunk at `offset` of a file."""
        positions, position, size, unpack = [], 0, len(data), _LENGTH.unpack_from
        problem = None
        last = size - HEAD_SIZE
        while position <= last:
            positions.append(position)
            position += HEAD_SIZE + unpack(data, position)[0]
        if position > size:
            length, position = position - HEAD_SIZE - positions[-1], positions.pop()
            problem = RecordError(offset, f"a record of {length} bytes exceeds its chunk")
        elif position < size:
            problem = RecordError(offset, "the chunk ends within the head of a record")
        starts = np.array(positions, dtype=np.int64)
        opcodes = np.frombuffer(data, dtype=np.uint8)[starts]
        ends = np.append(starts[1:], position)[: len(starts)]
        short = np.flatnonzero((opcodes == Opcode.MESSAGE) & (ends - starts < MESSAGE_HEAD.itemsize))
        if len(short):
            position = int(starts[short[0]])
            starts, ends, opcodes = starts[: short[0]], ends[: short[0]], opcodes[: short[0]]
            problem = RecordError(offset, "a message record is cut off")
        of_messages = opcodes == Opcode.MESSAGE
        places = (array[~of_messages].tolist() for array in (starts, ends, opcodes))
        others = [
            (start, Record(offset, opcode, data[start + HEAD_SIZE : end]))
            for start, end, opcode in zip(*places, strict=True)
        ]
        return cls(data, StoredMessages.at(data, starts[of_messages]), others, position, problem)


def plain_bytes(size: int) -> np.dtype[np.void]:
    """Return the type of so many bytes without a meaning."""
    return np.dtype((np.void, size))


def index_entries(
    channels: NDArray[np.integer], times: NDArray[np.integer], offsets: NDArray[np.int64]
) -> dict[int, bytes]:
    """Return the entries of the message indexes of a chunk by channel: log times (ns), and offsets of the records.

    The channels are in the order of their first messages.
    """
    entries = np.empty((len(channels), 2), dtype=UINT64)
    entries[:, 0], entries[:, 1] = times, offsets
    return {channel: entries[channels == channel].tobytes() for channel in dict.fromkeys(channels.tolist())}


def _at(data: bytes, places: NDArray[np.int64], layout: np.dtype[np.void]) -> NDArray[np.void]:
    """Return what begins at places in the data, in a layout."""
    size = layout.itemsize
    if not len(places):
        return np.empty(0, dtype=layout)
    overlapping = np.ndarray((len(data) - size + 1,), dtype=plain_bytes(size), buffer=data, strides=(1,))
    rows: NDArray[np.void] = overlapping[places].view(layout)
    return rows

"""Writing what was saved of an MCAP file as a new file with every index and a summary section."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO, Protocol

import zstandard
from mcap.opcode import Opcode
from mcap.records import Header, Metadata

from swarmabs_bag.index import FileIndex, append, encoded, read_index, tail
from swarmabs_bag.metadata import RECORD_KEY, RECORD_NAME
from swarmabs_bag.records import MAGIC, Record, RecordError, chunk_head, inner_records, parse, read_message
from swarmabs_bag.salvage import Damage, Salvage

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_bag.records import StoredMessage
    from swarmabs_bag.salvage import Saved

_PROFILE = "ros2"
_CHUNK_TIMES = struct.Struct("<QQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_CHUNK_BYTES = 2**20
_OWN = "swarmabs"


class Output(Protocol):
    """Where the new file goes."""

    def write(self, data: bytes) -> object:
        """Take over whole records."""
        ...

    def commit(self) -> None:
        """Hand them on."""
        ...


class Nowhere:
    """An output that keeps nothing: for finding out what a repair would come to."""

    def write(self, data: bytes) -> None:
        """Forget the bytes."""

    def commit(self) -> None:
        """Do nothing."""


@dataclass(slots=True)
class Rebuilt:
    """What became of a file.

    Attributes
    ----------
    index : FileIndex
        What the new file holds, and where.
    stated : FileIndex or None
        What the old file says it holds, if that can be read.
    damage : list of Damage
        What was left out.
    ended : bool
        Whether the old file's writer had ended its data section.
    reindexed : int
        Chunks whose message indexes were missing or wrong, or whose stated times were wrong.
    repacked : int
        Messages that stand in a new chunk, since they were outside of any or in one that was cut off.
    unschemed : set of int
        Numbers of the channels whose schema was nowhere, and which have none in the new file.
    gaps : dict
        Messages missing between those that are there, by number of the channel, from the sequence numbers that this
        project's writer gives.
    description : dict of str to str
        rosbag2's metadata record of the old file.
    """

    index: FileIndex
    stated: FileIndex | None
    damage: list[Damage]
    ended: bool = False
    reindexed: int = 0
    repacked: int = 0
    unschemed: set[int] = field(default_factory=set)
    gaps: dict[int, int] = field(default_factory=dict)
    description: dict[str, str] = field(default_factory=dict)


def rebuild(
    stream: BinaryIO,
    size: int,
    output: Output,
    *,
    definitions: FileIndex | None = None,
    describe: Callable[[Rebuilt], str],
) -> Rebuilt:
    """Write a file anew from what can be saved of it.

    Chunks that are whole are taken over as they are.

    Parameters
    ----------
    stream : binary file
        The old file, open for reading.
    size : int
        Its size in bytes.
    output : Output
        Where the new one goes.
    definitions : FileIndex, optional
        Schemas and channels with the same numbers, for a file that has lost them.
    describe : callable
        Told everything when all messages are written; returns rosbag2's description of the file.
    """
    try:
        stated = read_index(stream, size)
    except RecordError:
        stated = None
    salvage = Salvage(stream, size)
    rebuilder = _Rebuilder(output, Rebuilt(FileIndex(), stated, salvage.damage), stated or definitions)
    for saved in salvage.records():
        rebuilder.take(saved)
    rebuilder.result.ended = salvage.ended
    return rebuilder.finish(describe)


class _Rebuilder:
    def __init__(self, output: Output, result: Rebuilt, definitions: FileIndex | None) -> None:
        self.result = result
        self._output = output
        self._definitions = definitions
        self._begun = False
        self._loose = bytearray()
        self._loose_count = 0
        self._expected: dict[int, bytes] = {}
        self._next_sequence: dict[int, int] = {}

    def take(self, saved: Saved) -> None:
        record = saved.record
        if record.opcode == Opcode.HEADER:
            self._begin(parse(Header, record))
            return
        self._begin(Header(profile=_PROFILE, library=""))
        if record.opcode == Opcode.MESSAGE_INDEX:
            self._compare_index(record.content)
            return
        if record.opcode == Opcode.CHUNK:
            self._take_chunk(saved)
        elif record.opcode == Opcode.MESSAGE:
            self._take_loose(record.content, record.offset)
        elif record.opcode == Opcode.METADATA and (metadata := parse(Metadata, record)).name == RECORD_NAME:
            self.result.description = dict(metadata.metadata)
        else:
            self._flush()
            self._put_other(record.opcode, record.content)

    def finish(self, describe: Callable[[Rebuilt], str]) -> Rebuilt:
        """Write the end of the file."""
        self._begin(Header(profile=_PROFILE, library=""))
        self._flush()
        self._define()  # also topics without messages, which other writers describe in the summary section alone
        text = describe(self.result)
        self._output.write(self.result.index.add_metadata(Metadata(name=RECORD_NAME, metadata={RECORD_KEY: text})))
        for piece in tail(self.result.index):
            self._output.write(piece)
        self._output.commit()
        return self.result

    def _begin(self, header: Header) -> None:
        if self._begun:
            return
        self._begun = True
        self._output.write(MAGIC)
        self.result.index.crc = zlib.crc32(MAGIC)
        self.result.index.header = header
        content = encoded(header)
        self._put(Opcode.HEADER, content[9:])

    def _put(self, opcode: int, content: bytes) -> None:
        self._output.write(append(self.result.index, opcode, content))
        if opcode != Opcode.MESSAGE_INDEX:
            self._output.commit()

    def _compare_index(self, content: bytes) -> None:
        (channel,) = struct.unpack_from("<H", content)
        if self._expected.get(channel) == content:
            del self._expected[channel]

    def _count_unindexed(self) -> None:
        self.result.reindexed += bool(self._expected)
        self._expected = {}

    def _take_chunk(self, saved: Saved) -> None:
        record, data = saved.record, saved.data
        if not self._is_described(data, record.offset):
            self._define()
        if saved.cut or not self._is_described(data, record.offset):
            self._take_apart(data, record.offset)
            return
        self._flush()
        self._put_chunk(record, data)

    def _is_described(self, data: bytes, offset: int) -> bool:
        """Tell whether the channels of all messages in a chunk, and the schemas of its channels, are known."""
        known, schemas = set(self.result.index.channels), {0, *self.result.index.schemas}
        for opcode, begin, _ in inner_records(data, offset):
            number = int.from_bytes(data[begin : begin + 2], "little")
            if opcode == Opcode.SCHEMA:
                schemas.add(number)
            elif opcode == Opcode.CHANNEL:
                known.add(number)
                if int.from_bytes(data[begin + 2 : begin + 4], "little") not in schemas:
                    return False
            elif opcode == Opcode.MESSAGE and number not in known:
                return False
        return True

    def _take_apart(self, data: bytes, offset: int) -> None:
        for opcode, begin, end in inner_records(data, offset):
            if opcode == Opcode.MESSAGE:
                self._take_loose(data[begin:end], offset)
            else:
                self._put_other(opcode, data[begin:end])

    def _put_other(self, opcode: int, content: bytes) -> None:
        """Write a record outside of a chunk."""
        if opcode == Opcode.CHANNEL and not self._has_schema(content):
            self._define()
        self._put_definition(opcode, content)

    def _put_definition(self, opcode: int, content: bytes) -> None:
        """Write a schema, or a channel, which has none if its own is nowhere."""
        if opcode == Opcode.CHANNEL and not self._has_schema(content):
            self.result.unschemed.add(int.from_bytes(content[:2], "little"))
            content = content[:2] + bytes(2) + content[4:]
        self._put(opcode, content)

    def _has_schema(self, channel: bytes) -> bool:
        number = int.from_bytes(channel[2:4], "little")
        return number == 0 or number in self.result.index.schemas

    def _take_loose(self, content: bytes, offset: int) -> None:
        (channel,) = struct.unpack_from("<H", content)
        if channel not in self.result.index.channels:
            self._define()
        if channel not in self.result.index.channels:
            problem = f"messages of channel {channel}, which nothing in the file describes"
            last = self.result.damage[-1] if self.result.damage else None
            if last is None or (last.offset, last.problem) != (offset, problem):
                self.result.damage.append(Damage(offset, 0, problem))
            return
        self._loose += struct.pack("<BQ", Opcode.MESSAGE, len(content)) + content
        self._loose_count += 1
        if len(self._loose) >= _CHUNK_BYTES:
            self._flush()

    def _define(self) -> None:
        """Write the schemas and channels that only the summary section or another file of the bag describes."""
        if self._definitions is None:
            return
        index = self.result.index
        for records, own in ((self._definitions.schemas, index.schemas), (self._definitions.channels, index.channels)):
            for number, record in sorted(records.items()):
                if number not in own:
                    content = encoded(record)
                    self._put_definition(content[0], content[9:])

    def _flush(self) -> None:
        """Write the messages without a chunk into a new one."""
        self._count_unindexed()
        if not self._loose:
            return
        data, count = bytes(self._loose), self._loose_count
        self._loose.clear()
        self._loose_count = 0
        self.result.repacked += count
        packed = zstandard.ZstdCompressor().compress(data)
        name = b"zstd"
        head = _CHUNK_HEAD.pack(0, 0, len(data), zlib.crc32(data)) + struct.pack("<I", len(name)) + name
        content = head + struct.pack("<Q", len(packed)) + packed
        reindexed = self.result.reindexed
        self._put_chunk(Record(self.result.index.data_end, Opcode.CHUNK, content), data)
        self._expected, self.result.reindexed = {}, reindexed

    def _put_chunk(self, record: Record, data: bytes) -> None:
        """Write a chunk, its stated times put right, and its message indexes."""
        entries: dict[int, bytearray] = {}
        start, end = 2**64, 0
        for opcode, begin, stop in inner_records(data, record.offset):
            if opcode == Opcode.MESSAGE:
                message = read_message(data, begin, stop, record.offset)
                entries.setdefault(message.channel_id, bytearray()).extend(
                    struct.pack("<QQ", message.log_time, begin - 9)
                )
                start, end = min(start, message.log_time), max(end, message.log_time)
                self._count_gap(message)
        times = _CHUNK_TIMES.pack(start if entries else 0, end)
        head = chunk_head(record)
        if entries and (head.message_start_time, head.message_end_time) != (start, end):
            self.result.reindexed += 1
            record = record._replace(content=times + record.content[_CHUNK_TIMES.size :])
        self._put(Opcode.CHUNK, record.content)
        self._expected = {
            channel: struct.pack("<HI", channel, len(listed)) + bytes(listed) for channel, listed in entries.items()
        }
        for content in self._expected.values():
            self._put(Opcode.MESSAGE_INDEX, content)

    def _count_gap(self, message: StoredMessage) -> None:
        if not self.result.index.header.library.startswith(_OWN):
            return
        channel, sequence = message.channel_id, message.sequence
        gap = sequence - self._next_sequence.get(channel, 0)
        if gap > 0:
            self.result.gaps[channel] = self.result.gaps.get(channel, 0) + gap
        self._next_sequence[channel] = sequence + 1

"""Writing the records recovered from an MCAP file to a new file with all indexes and a summary section."""

from __future__ import annotations

import struct
import zlib
from math import inf
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata

from swarmabs_bag.mcap.chunks import ChunkBuilder, message_index
from swarmabs_bag.mcap.index import RECORD_KEY, RECORD_NAME, FileIndex, ending, read_index
from swarmabs_bag.mcap.records import (
    HEAD_SIZE,
    MAGIC,
    Record,
    RecordError,
    StoredMessage,
    encoded,
    parse,
    stored_message,
)
from swarmabs_bag.mcap.stored import ChunkContent
from swarmabs_bag.repair.salvage import Damage, Salvage
from swarmabs_bag.run.channels import bag_topics
from swarmabs_bag.run.metadata import FileRecord, bag_metadata, dump_yaml

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_bag.mcap.output import RecordFile
    from swarmabs_bag.repair.salvage import Saved

_PROFILE = "ros2"
_CHUNK_TIMES = struct.Struct("<QQ")
_CHUNK_BYTES = 2**20


class Rebuilt:
    """The records recovered from a file of `size` bytes, and the new file made of them; intact chunks are copied.

    Parameters
    ----------
    output : RecordFile, optional
        The new file; without it the result of a repair is determined, but nothing is written.
    definitions : FileIndex, optional
        Schemas and channels with the same numbers, for a file that has lost them.
    name, custom
        Name of the new file and entries under ``custom_data`` for rosbag2's description.

    Attributes
    ----------
    index, before : FileIndex
        Contents of the new file, and of the old one before the first damage.
    stated : FileIndex or None
        Summary section of the old file; if unreadable, `unstated` says why.
    damage : list of Damage
        The parts that were left out.
    end : DataEnd or None
        The end of the old file's data section, None if it was never written.
    reindexed : int
        Chunks with missing or wrong message indexes, or wrong times.
    repacked : int
        Messages in a new chunk, because they were outside of chunks or in a truncated one.
    unschemed : set of int
        Channels whose schema was not found, and which have none in the new file.
    gaps : dict
        Messages missing between others, by channel, from the sequence numbers of this project's writer.
    description : str
        rosbag2's description of the old file, or of the new one if it was written.
    """

    def __init__(
        self,
        stream: BinaryIO,
        size: int,
        output: RecordFile | None = None,
        *,
        definitions: FileIndex | None = None,
        name: str = "",
        custom: Mapping[str, str] | None = None,
    ) -> None:
        self.index = FileIndex()
        self.stated: FileIndex | None = None
        self.unstated = ""
        self.reindexed = self.repacked = 0
        self.unschemed: set[int] = set()
        self.gaps: dict[int, int] = {}
        self.description = ""
        self._output = output
        self._loose = ChunkBuilder(_CHUNK_BYTES)
        self._expected: dict[int, bytes] = {}
        self._next_sequence: dict[int, int] = {}
        try:
            self.stated = read_index(stream, size)
        except RecordError as error:
            self.unstated = str(error)
        self._definitions = self.stated or definitions
        salvage = Salvage(stream, size)
        self.damage: list[Damage] = salvage.damage
        for saved in salvage.records():
            self._take(saved)
        self.before, self.end = salvage.before, salvage.end
        self._finish(name, custom or {})

    def _take(self, saved: Saved) -> None:
        record = saved.record
        if record.opcode == Opcode.HEADER:
            self._begin(parse(Header, record))
            return
        self._begin(Header(profile=_PROFILE, library=""))
        if record.opcode == Opcode.MESSAGE_INDEX:
            channel = int.from_bytes(record.content[:2], "little")
            if self._expected.get(channel) == record.content:
                del self._expected[channel]
        elif record.opcode == Opcode.CHUNK:
            self._take_chunk(record, saved.data, cut=saved.cut)
        elif record.opcode == Opcode.MESSAGE:
            self._take_loose(stored_message(record), record.offset)
        elif record.opcode == Opcode.METADATA and (metadata := parse(Metadata, record)).name == RECORD_NAME:
            self.description = metadata.metadata.get(RECORD_KEY, "")
        else:
            self._flush()
            self._put_other(record)

    def _finish(self, name: str, custom: Mapping[str, str]) -> None:
        """Write the end of the file."""
        self._begin(Header(profile=_PROFILE, library=""))
        self._flush()
        self._define()  # even topics without messages, which other writers describe only in the summary section
        if self._output is None:
            return
        files = [FileRecord.of(name, self.index.statistics)]
        self.description = dump_yaml(bag_metadata(bag_topics([self.index]), files=files, custom_data=custom))
        for piece in ending(self.index, self.description):
            self._write(piece)

    def _begin(self, header: Header) -> None:
        if self.index.crc == 0:
            self._write(MAGIC)
            self.index.crc = zlib.crc32(MAGIC)
            self._put(Opcode.HEADER, encoded(header)[HEAD_SIZE:])

    def _put(self, opcode: int, content: bytes, data: bytes | None = None) -> None:
        """Write a record; `data` is the content of a chunk."""
        record = Record(self.index.data_end, opcode, content)
        self.index.take(record, data)
        self._write(record.stored)

    def _write(self, data: bytes) -> None:
        if self._output is not None:
            self._output.write(data)
            self._output.commit()

    def _take_chunk(self, record: Record, data: bytes, *, cut: bool) -> None:
        content = ChunkContent.of(data, record.offset)
        if not self._is_described(content):
            self._define()
        if not cut and self._is_described(content):
            self._flush()
            self._put_chunk(record, content)
            return
        for _, other in content.others:
            self._put_other(other)
        for message in content.messages:
            self._take_loose(message, record.offset)

    def _is_described(self, content: ChunkContent) -> bool:
        """Return whether all messages in a chunk follow the definitions of their channels, and these their schemas."""
        defined: dict[int, float] = dict.fromkeys(self.index.channels, 0)  # where each channel is
        schemas = {0, *self.index.schemas}
        for place, other in content.others:
            number = int.from_bytes(other.content[:2], "little")
            if other.opcode == Opcode.SCHEMA:
                schemas.add(number)
            elif other.opcode == Opcode.CHANNEL:
                defined.setdefault(number, place)
                if int.from_bytes(other.content[2:4], "little") not in schemas:
                    return False
        channels, firsts = np.unique(content.messages.heads["channel_id"], return_index=True)
        begins = content.messages.begins[firsts].tolist()
        return all(defined.get(number, inf) < begin for number, begin in zip(channels.tolist(), begins, strict=True))

    def _put_other(self, record: Record) -> None:
        """Write a record outside of chunks; a channel whose schema was not found gets none."""
        content = record.content
        if record.opcode == Opcode.CHANNEL:
            channel = parse(Channel, record)
            if not self._has_schema(channel):
                self._define()
            if not self._has_schema(channel):
                self.unschemed.add(channel.id)
                content = content[:2] + bytes(2) + content[4:]
        self._put(record.opcode, content)

    def _has_schema(self, channel: Channel) -> bool:
        return channel.schema_id in {0, *self.index.schemas}

    def _take_loose(self, message: StoredMessage, offset: int) -> None:
        """Keep a message outside of chunks, or in a truncated one, for a new chunk."""
        channel, sequence, log_time, publish_time, payload = message
        if channel not in self.index.channels:
            self._define()
        if channel not in self.index.channels:
            problem = f"messages of channel {channel}, which the file does not describe"
            last = self.damage[-1] if self.damage else None
            if last is None or (last.offset, last.problem) != (offset, problem):
                self.damage.append(Damage(offset, 0, problem))
            return
        self._loose.add(channel, sequence, (log_time, publish_time), payload)
        self.repacked += 1
        if self._loose.full:
            self._flush()

    def _define(self) -> None:
        """Write the schemas and channels found only in the summary section or another file of the bag."""
        definitions, self._definitions = self._definitions, None
        if definitions is None:
            return
        index = self.index
        for records, own in ((definitions.schemas, index.schemas), (definitions.channels, index.channels)):
            for number, record in sorted(records.items()):
                if number not in own:
                    stored = encoded(record)
                    self._put_other(Record(index.data_end, stored[0], stored[HEAD_SIZE:]))

    def _flush(self) -> None:
        """Write the messages outside of chunks to a new chunk."""
        self.reindexed += bool(self._expected)
        self._expected = {}
        if self._loose.empty:
            return
        contents = self._loose.take()
        record = Record(self.index.data_end, Opcode.CHUNK, encoded(contents.packed())[HEAD_SIZE:])
        self._put_chunk(record, ChunkContent.of(bytes(contents.data), record.offset))
        self._expected = {}

    def _put_chunk(self, record: Record, content: ChunkContent) -> None:
        """Write a chunk, with corrected times, and its message indexes."""
        stored, heads = record.content, content.messages.heads
        if len(heads):
            times = int(heads["log_time"].min()), int(heads["log_time"].max())
            if _CHUNK_TIMES.unpack_from(stored) != times:
                self.reindexed += 1
                stored = _CHUNK_TIMES.pack(*times) + stored[_CHUNK_TIMES.size :]
        self._count_gaps(heads["channel_id"].tolist(), heads["sequence"].tolist())
        self._put(Opcode.CHUNK, stored, content.data)
        self._expected = {
            channel: message_index(channel, entries)[HEAD_SIZE:]
            for channel, entries in content.messages.index_entries().items()
        }
        for index in self._expected.values():
            self._put(Opcode.MESSAGE_INDEX, index)

    def _count_gaps(self, channels: list[int], sequences: list[int]) -> None:
        """Count the messages that are missing before those with these channels and sequence numbers."""
        if not self.index.is_own:
            return
        for channel, sequence in zip(channels, sequences, strict=True):
            gap = sequence - self._next_sequence.get(channel, 0)
            if gap > 0:
                self.gaps[channel] = self.gaps.get(channel, 0) + gap
            self._next_sequence[channel] = sequence + 1

"""An MCAP file in the making, byte for byte as the mcap library writes it."""

from __future__ import annotations

import zlib
from pathlib import PurePath
from typing import TYPE_CHECKING

from mcap.records import Attachment, Header

from swarmabs_bag.mcap.chunks import ChunkBuilder, group_size
from swarmabs_bag.mcap.index import FileIndex, ending, no_statistics
from swarmabs_bag.mcap.records import HEAD_SIZE, MAGIC, Record, encoded

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mcap.records import Channel, Schema, Statistics

    from swarmabs_bag.mcap.chunks import Column, MessageRecords
    from swarmabs_bag.mcap.output import RecordFile

_PROFILE = "ros2"
_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json"}


class McapFile:
    """The records of a new file: messages are collected in chunks, everything else is written at once.

    Parameters
    ----------
    output : RecordFile
        Receives complete records; a chunk is written as soon as it is full.
    library : str
        Name of the library in the header.
    chunk_bytes : int
        A chunk is full when it exceeds this size, uncompressed.
    """

    def __init__(self, output: RecordFile, library: str, chunk_bytes: int) -> None:
        self._output = output
        self._index = FileIndex(crc=zlib.crc32(MAGIC))
        self._chunk = ChunkBuilder(chunk_bytes)
        output.write(MAGIC)
        self._put(encoded(Header(_PROFILE, library)))

    @property
    def statistics(self) -> Statistics:
        """Statistics of the records that are not in the current chunk."""
        return self._index.statistics

    def attach(self, name: str, data: bytes, log_time: int) -> None:
        """Write an attachment with a log time, ns."""
        media_type = _MEDIA_TYPES.get(PurePath(name).suffix, "text/plain")
        self._put(encoded(Attachment(0, log_time, name, media_type, data)))

    def define(self, definition: Schema | Channel) -> None:
        """Add a schema or a channel to the current chunk and to the summary section."""
        self._index.define(definition, self._index.data_end)
        self._chunk.define(encoded(definition))

    def add(self, channel: int, sequence: int, times: tuple[int, int], payload: bytes) -> None:
        """Add a message with its log and publish time, ns."""
        self._chunk.add(channel, sequence, times, payload)
        if self._chunk.full:
            self.flush()

    def groups_to_fill(self, columns: Sequence[Column]) -> int:
        """Return the number of groups with these columns of which only the last fills the current chunk."""
        return self._chunk.groups_to_fill(group_size(columns))

    def add_records(self, records: MessageRecords, first: int) -> int:
        """Add message `first` and those after it, until a chunk is full; return the number of the next one."""
        following = self._chunk.add_records(records, first)
        if self._chunk.full:
            self.flush()
        return following

    def flush(self) -> None:
        """Write the current chunk, if it has messages."""
        if self._chunk.empty:
            return
        contents = self._chunk.take()
        chunk = contents.packed()
        record = encoded(chunk)
        statistics = no_statistics()
        statistics.channel_message_counts = contents.counts()
        statistics.message_count = sum(statistics.channel_message_counts.values())
        statistics.message_start_time, statistics.message_end_time = contents.start, contents.end
        self._index.add_chunk(chunk, self._index.data_end, len(record), statistics)
        entry = self._index.chunks[-1]
        self._write(record)
        for channel, listed in contents.indexes():
            entry.message_index_offsets[channel] = self._index.data_end
            entry.message_index_length += len(listed)
            self._write(listed)

    def finish(self, description: str) -> None:
        """Write the current chunk, rosbag2's description, the summary section and the end of the file."""
        self.flush()
        for piece in ending(self._index, description):
            self._output.write(piece)

    def _put(self, record: bytes) -> None:
        """Write a record that is indexed by its content."""
        self._index.take(Record(self._index.data_end, record[0], record[HEAD_SIZE:]))
        self._output.write(record)

    def _write(self, record: bytes) -> None:
        """Write a record that is already indexed."""
        self._index.crc = zlib.crc32(record, self._index.crc)
        self._index.data_end += len(record)
        self._output.write(record)

"""The index of an MCAP file: its summary section, read, reconstructed by a scan, or written.

The format allows a writer to omit the summary section or parts of it; a scan then reconstructs them. A file whose
writer was killed is scanned from the start up to its last intact record, and `tail` creates its end. A violation of the
format raises `RecordError` with its position in the file.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from swarmabs_bag.mcap.records import (
    HEAD_SIZE,
    MAGIC,
    MAX_SIZE,
    Record,
    RecordError,
    crc_with,
    encoded,
    indexed_channel,
    parse,
    read_record,
    read_records,
    stored_message,
    uncompress,
)
from swarmabs_bag.mcap.stored import ChunkContent
from swarmabs_config.model.errors import show

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

_FOOTER_SIZE = HEAD_SIZE + 20
_FOOTER_HEAD = struct.Struct("<BQQQ")
_DATA_END_SIZE = HEAD_SIZE + 4
_PIECE = 2**20

# The lists in a summary section, and the field of the statistics that counts each.
_COUNTED = {
    "schemas": "schema_count",
    "channels": "channel_count",
    "chunks": "chunk_count",
    "attachments": "attachment_count",
    "metadata": "metadata_count",
}

RECORD_NAME = "rosbag2"
"""Name of the metadata record with rosbag2's description of the file, under the key `RECORD_KEY`."""

RECORD_KEY = "serialized_metadata"

MOST_ENTRIES = 2**18
"""Most chunks, most attachments and most metadata records in an index."""

MOST_DEFINITIONS = 2**26
"""Maximum total size of schemas and channels in an index, bytes."""


def no_statistics() -> Statistics:
    """Return the statistics of a file without records."""
    return Statistics(
        attachment_count=0,
        channel_count=0,
        channel_message_counts=defaultdict(int),
        chunk_count=0,
        message_count=0,
        message_end_time=0,
        message_start_time=0,
        metadata_count=0,
        schema_count=0,
    )


_OWN = "swarmabs"
"""Prefix of the library name in files written by this project."""


@dataclass(slots=True)
class FileIndex:
    """The contents of an MCAP file and their positions: schemas and channels by id, index records in file order.

    Attributes
    ----------
    data_end : int
        Position after the last record of the data section.
    crc : int
        CRC-32 of the file up to `data_end`, or 0 if unknown.
    problem : str or None
        Why the file is incomplete; None if it is complete.
    definitions : int
        Size of all schemas and channels in bytes.
    unknown : int or None
        Opcode of the last record that was skipped because the format does not allow it there.
    """

    header: Header = field(default_factory=lambda: Header(profile="", library=""))
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    statistics: Statistics = field(default_factory=no_statistics)
    data_end: int = len(MAGIC)
    crc: int = 0
    problem: str | None = None
    definitions: int = 0
    unknown: int | None = None

    @property
    def is_own(self) -> bool:
        """Whether this project has written the file, as its header says."""
        return self.header.library.startswith(_OWN)

    def take(self, record: Record, data: bytes | None = None) -> None:
        """Add the record of the data section at `data_end`; `data` is the content of a chunk."""
        opcode, statistics = record.opcode, self.statistics
        if opcode == Opcode.CHUNK:
            self._take_chunk(record, uncompress(record) if data is None else data)
        elif opcode == Opcode.MESSAGE_INDEX:
            channel = indexed_channel(record)
            if self.chunks:
                self.chunks[-1].message_index_offsets[channel] = record.offset
                self.chunks[-1].message_index_length += record.size
        elif opcode == Opcode.ATTACHMENT:
            attachment = read_attachment(record)
            self.attachments.append(
                AttachmentIndex(
                    offset=record.offset,
                    length=record.size,
                    log_time=attachment.log_time,
                    create_time=attachment.create_time,
                    data_size=len(attachment.data),
                    name=attachment.name,
                    media_type=attachment.media_type,
                )
            )
            statistics.attachment_count += 1
        elif opcode == Opcode.METADATA:
            metadata = parse(Metadata, record)
            self.metadata.append(MetadataIndex(offset=record.offset, length=record.size, name=metadata.name))
            statistics.metadata_count += 1
        elif opcode == Opcode.HEADER and record.offset == len(MAGIC):
            self.header = parse(Header, record)
        else:
            self.take_inner(record)
        self.check_number(record.offset)
        self.crc = crc_with(self.crc, record)
        self.data_end = record.end

    def take_inner(self, record: Record) -> None:
        """Add a record that may be inside or outside of a chunk."""
        if record.opcode == Opcode.MESSAGE:
            message, statistics = stored_message(record), self.statistics
            if message.log_time < statistics.message_start_time or statistics.message_count == 0:
                statistics.message_start_time = message.log_time
            statistics.message_end_time = max(statistics.message_end_time, message.log_time)
            statistics.message_count += 1
            statistics.channel_message_counts[message.channel_id] += 1
        elif record.opcode == Opcode.SCHEMA:
            self.define(parse(Schema, record), record.offset)
        elif record.opcode == Opcode.CHANNEL:
            self.define(parse(Channel, record), record.offset)
        else:
            self.unknown = record.opcode

    def define(self, definition: Schema | Channel, offset: int) -> None:
        """Add a schema or a channel; a repeated one replaces the previous."""
        previous: Schema | Channel | None
        if isinstance(definition, Schema):
            previous, self.schemas[definition.id] = self.schemas.get(definition.id), definition
        else:
            previous, self.channels[definition.id] = self.channels.get(definition.id), definition
        if previous != definition:
            self.definitions += len(encoded(definition))
        self.statistics.schema_count, self.statistics.channel_count = len(self.schemas), len(self.channels)
        if self.definitions > MOST_DEFINITIONS:
            raise RecordError(offset, f"schemas and channels of more than {MOST_DEFINITIONS} bytes")

    def entries(self) -> dict[str, Sequence[McapRecord]]:
        """Return the lists of index records by kind."""
        return {"chunks": self.chunks, "attachments": self.attachments, "metadata records": self.metadata}

    def numbers(self) -> dict[str, int]:
        """Return counts and times of messages, chunks and attachments, and the non-zero counts of channels."""
        statistics = self.statistics
        return {
            "message_count": statistics.message_count,
            "message_start_time": statistics.message_start_time,
            "message_end_time": statistics.message_end_time,
            "chunk_count": statistics.chunk_count,
            "attachment_count": statistics.attachment_count,
            **{
                f"messages of channel {channel}": count
                for channel, count in sorted(statistics.channel_message_counts.items())
                if count
            },
        }

    def contradicted_by(self, scanned: FileIndex) -> str | None:
        """Return a contradiction between this summary and a scan of the same file, or None."""
        stated, counted = self.numbers(), scanned.numbers()
        for name in {**counted, **stated}:
            if stated.get(name, 0) != counted.get(name, 0):
                return f"the summary states {name} = {stated.get(name, 0)}, but it is {counted.get(name, 0)}"
        there = scanned.entries()
        for name, entries in self.entries().items():
            if entries != there[name]:
                return f"the summary lists other {name} than those in the file"
        if not (scanned.channels.items() <= self.channels.items() and scanned.schemas.items() <= self.schemas.items()):
            return "the summary describes other topics than those in the file"
        return None

    def add_chunk(self, chunk: Chunk, offset: int, size: int, messages: Statistics) -> None:
        """Add a chunk whose record has this position and size, and the statistics of its messages."""
        self.chunks.append(
            ChunkIndex(
                chunk_length=size,
                chunk_start_offset=offset,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=0,
                message_index_offsets={},
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        self.statistics.chunk_count += 1
        add_messages(self.statistics, messages)

    def check_number(self, offset: int) -> None:
        """Raise `RecordError` for more entries than any useful file has."""
        for name, entries in self.entries().items():
            if len(entries) > MOST_ENTRIES:
                raise RecordError(offset, f"more than {MOST_ENTRIES} {name}")

    def _take_chunk(self, record: Record, data: bytes) -> None:
        chunk = parse(Chunk, record)
        inner = FileIndex()  # complete or an error: a partial chunk must not be in the statistics
        content = ChunkContent.of(data, record.offset)
        for _, other in content.others:
            inner.take_inner(other)
        if content.problem is not None:
            raise content.problem
        content.messages.add_to(inner.statistics)
        self.add_chunk(chunk, record.offset, record.size, inner.statistics)
        for definitions in (inner.schemas.values(), inner.channels.values()):
            for definition in definitions:
                self.define(definition, record.offset)
        self.unknown = self.unknown if inner.unknown is None else inner.unknown


def add_messages(total: Statistics, part: Statistics, numbers: Mapping[int, int] | None = None) -> None:
    """Add the messages of a part to the total; `numbers` maps the part's channels to those of the total."""
    if part.message_count:
        start = part.message_start_time
        total.message_start_time = min(total.message_start_time, start) if total.message_count else start
        total.message_end_time = max(total.message_end_time, part.message_end_time)
    total.message_count += part.message_count
    for own, count in part.channel_message_counts.items():
        if numbers is None or own in numbers:
            total.channel_message_counts[own if numbers is None else numbers[own]] += count


def read_attachment(record: Record) -> Attachment:
    """Read an attachment and check its CRC."""
    if record.opcode != Opcode.ATTACHMENT:
        raise RecordError(record.offset, "the summary states an attachment here, but there is none")
    attachment = parse(Attachment, record)
    crc = int.from_bytes(record.content[-4:], "little")
    if crc and zlib.crc32(memoryview(record.content)[:-4]) != crc:
        raise RecordError(record.offset, f"the CRC of the attachment {show(attachment.name)} does not match")
    return attachment


def scan_index(stream: BinaryIO, size: int) -> FileIndex:
    """Build the index of the first `size` bytes of a file by reading them from the start.

    The scan ends before the first damaged record, with the reason in `FileIndex.problem`, or without a problem at the
    end of the data section. Only a file without a header raises `RecordError`.
    """
    stream.seek(0)
    if stream.read(len(MAGIC)) != MAGIC:
        raise RecordError(0, "not an MCAP file")
    index = FileIndex(crc=zlib.crc32(MAGIC))
    first = read_record(stream, len(MAGIC), size)
    if first.opcode != Opcode.HEADER:
        raise RecordError(first.offset, "no header")
    index.take(first)
    try:
        for record in read_records(stream, first.end, size):
            if record.opcode == Opcode.DATA_END:
                return index
            index.take(record)
    except RecordError as error:
        index.problem = str(error)
    else:
        index.problem = f"at byte {index.data_end}: a footer without an end of the data section"
    return index


def read_index(stream: BinaryIO, size: int) -> FileIndex:
    """Read the summary section at the end of a file of `size` bytes; scan for parts that the writer omitted.

    Raises `RecordError` if the end is missing, the summary section is malformed, or it is missing and the data damaged.
    """
    end_size = _FOOTER_SIZE + len(MAGIC)
    if size < end_size + len(MAGIC):
        raise RecordError(size, "the end of the file, with its summary, is missing")
    stream.seek(size - end_size)
    end = stream.read(end_size)
    if end[-len(MAGIC) :] != MAGIC or end[0] != Opcode.FOOTER:
        raise RecordError(size, "the end of the file, with its summary, is missing")
    footer = parse(Footer, read_record(stream, size - end_size, size))
    if footer.summary_start == 0:
        return _scanned(stream, size, size - end_size)
    if not len(MAGIC) <= footer.summary_start <= size - end_size:
        raise RecordError(size - end_size, f"a summary section cannot begin at byte {footer.summary_start}")
    if size - footer.summary_start > MAX_SIZE:
        raise RecordError(footer.summary_start, f"a summary section of more than {MAX_SIZE} bytes")
    _check_summary_crc(stream, footer, size - end_size)
    index = FileIndex(header=parse(Header, read_record(stream, len(MAGIC), size)))
    index.data_end = footer.summary_start - _DATA_END_SIZE
    before = read_record(stream, index.data_end, size)
    if before.opcode != Opcode.DATA_END or before.end != footer.summary_start:
        raise RecordError(index.data_end, "the data section does not end where the summary section begins")
    return _read_summary(index, stream, size, footer.summary_start)


def _read_summary(index: FileIndex, stream: BinaryIO, size: int, start: int) -> FileIndex:
    """Add the summary section from byte `start` on to the index, completed by a scan if necessary."""
    stated: Statistics | None = None
    for record in read_records(stream, start, size):
        if record.opcode == Opcode.STATISTICS:
            stated = parse(Statistics, record)
        elif record.opcode == Opcode.CHUNK_INDEX:
            index.chunks.append(parse(ChunkIndex, record))
        elif record.opcode == Opcode.ATTACHMENT_INDEX:
            index.attachments.append(parse(AttachmentIndex, record))
        elif record.opcode == Opcode.METADATA_INDEX:
            index.metadata.append(parse(MetadataIndex, record))
        elif record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            index.take_inner(record)
        index.check_number(record.offset)
    if stated is not None:
        _correct_start(stated, index.chunks)
        index.statistics = stated
        if not any(getattr(stated, count) and not getattr(index, kind) for kind, count in _COUNTED.items()):
            return index
    try:
        scanned = _scanned(stream, size, start)
    except RecordError:
        if stated is not None:  # reading the file will report the damage at its position
            return index
        raise
    for kind in _COUNTED:
        setattr(index, kind, getattr(index, kind) or getattr(scanned, kind))
    index.statistics = stated or scanned.statistics
    return index


def _correct_start(stated: Statistics, chunks: Sequence[ChunkIndex]) -> None:
    """Correct the time of the first message as Go's mcap library states it for a file that begins at time 0.

    The library takes 0 for "not known yet" and states the start of a later chunk.
    """
    starts = {chunk.message_start_time for chunk in chunks if chunk.message_end_time or chunk.message_index_offsets}
    if 0 in starts and stated.message_start_time in starts:
        stated.message_start_time = 0


def _scanned(stream: BinaryIO, size: int, end: int) -> FileIndex:
    """Return the index of an intact data section that ends at byte `end`."""
    index = scan_index(stream, size)
    if index.problem is not None:
        raise RecordError(index.data_end, index.problem.removeprefix(f"at byte {index.data_end}: "))
    if index.data_end + _DATA_END_SIZE != end:
        raise RecordError(index.data_end, f"the data section ends here and not at byte {end}, as stated")
    return index


def _check_summary_crc(stream: BinaryIO, footer: Footer, footer_start: int) -> None:
    if footer.summary_crc == 0:
        return
    stream.seek(footer.summary_start)
    left, crc = footer_start - footer.summary_start + _FOOTER_SIZE - 4, 0
    while left:
        piece = stream.read(min(left, _PIECE))
        if not piece:
            raise RecordError(footer.summary_start, "the summary section could not be read")
        left -= len(piece)
        crc = zlib.crc32(piece, crc)
    if crc != footer.summary_crc:
        raise RecordError(footer.summary_start, "the CRC of the summary section does not match")


def ending(index: FileIndex, description: str) -> Iterator[bytes]:
    """Yield the bytes that complete a file with these records: rosbag2's description and the `tail`."""
    record = encoded(Metadata(name=RECORD_NAME, metadata={RECORD_KEY: description}))
    index.take(Record(index.data_end, Opcode.METADATA, record[HEAD_SIZE:]))
    yield record
    yield from tail(index)


def tail(index: FileIndex) -> Iterator[bytes]:
    """Yield the end of a file with the records of `index`: end of the data section, summary section, footer.

    Its position is `FileIndex.data_end`. As by the mcap library, the place of groups without records is stated too.
    """
    data_end = encoded(DataEnd(data_section_crc=index.crc))
    yield data_end
    start = index.data_end + len(data_end)
    groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
        (Opcode.SCHEMA, list(index.schemas.values())),
        (Opcode.CHANNEL, list(index.channels.values())),
        (Opcode.STATISTICS, [index.statistics]),
        (Opcode.CHUNK_INDEX, index.chunks),
        (Opcode.ATTACHMENT_INDEX, index.attachments),
        (Opcode.METADATA_INDEX, index.metadata),
    ]
    summary, offsets = bytearray(), bytearray()
    for opcode, records in groups:
        group = b"".join(map(encoded, records))
        offsets += encoded(
            SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group))
        )
        summary += group
    offsets_start = start + len(summary)
    summary += offsets
    head = _FOOTER_HEAD.pack(Opcode.FOOTER, _FOOTER_SIZE - HEAD_SIZE, start, offsets_start)
    crc = zlib.crc32(head, zlib.crc32(summary))
    yield bytes(summary)
    yield encoded(Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=crc))
    yield MAGIC

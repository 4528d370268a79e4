"""Where everything is in an MCAP file: its summary section, read, gathered by a scan, or written anew.

The format lets a writer leave out the summary section, or any part of it. A file without it is whole nevertheless, and
what is missing is gathered by a scan.

A file whose writer was killed has no summary section. `scan_index` finds out what a file holds by reading it
from the start, as far as its records are whole; `tail` makes the end of the file from that, so such a file
becomes a complete one.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
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

from swarmabs_bag.records import (
    HEAD_SIZE,
    MAGIC,
    MAX_SIZE,
    Record,
    RecordError,
    chunk_head,
    crc_with,
    inner_records,
    parse,
    read_message,
    read_record,
    read_records,
    uncompress,
)
from swarmabs_config.scenario.errors import show

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_FOOTER_SIZE = HEAD_SIZE + 20
_FOOTER_HEAD = struct.Struct("<BQQQ")
_RECORD_HEAD = struct.Struct("<BQ")
_MESSAGE_INDEX_HEAD = struct.Struct("<HI")
_MESSAGE_INDEX_ENTRY = 16
_PIECE = 2**20

MOST_ENTRIES = 2**18
"""Most chunks, attachments and metadata records, of each, that an index holds."""

MOST_DEFINITIONS = 2**26
"""Most bytes of schemas and channels that an index holds."""


def _no_statistics() -> Statistics:
    return Statistics(
        attachment_count=0,
        channel_count=0,
        channel_message_counts=defaultdict(int),
        chunk_count=0,
        message_count=0,
        metadata_count=0,
        message_end_time=0,
        message_start_time=0,
        schema_count=0,
    )


@dataclass(slots=True)
class FileIndex:
    """What an MCAP file holds, and where.

    Attributes
    ----------
    header : Header
        Profile and library.
    schemas, channels : dict
        By id.
    chunks, attachments, metadata : list
        Index records in file order.
    statistics : Statistics
        Numbers of everything.
    data_end : int
        Position behind the last record of the data section.
    crc : int
        CRC-32 of the file up to `data_end`, or 0 if it is not known.
    problem : str or None
        Why the file is not complete; None if it is.
    definitions : int
        Size of all schemas and channels in bytes.
    """

    header: Header = field(default_factory=lambda: Header(profile="", library=""))
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    statistics: Statistics = field(default_factory=_no_statistics)
    data_end: int = len(MAGIC)
    crc: int = 0
    problem: str | None = None
    definitions: int = 0

    def add_metadata(self, metadata: Metadata) -> bytes:
        """Take a metadata record that is to be appended at `data_end` into the index; return its bytes."""
        data = encoded(metadata)
        self.metadata.append(MetadataIndex(offset=self.data_end, length=len(data), name=metadata.name))
        self.statistics.metadata_count += 1
        self.data_end += len(data)
        self.crc = zlib.crc32(data, self.crc)
        return data


def scan_index(stream: BinaryIO, size: int) -> FileIndex:
    """Find out what the first `size` bytes of a file hold by reading them from the start.

    The scan ends before the first record that is not whole or not as the format says; `FileIndex.problem`
    tells of it. It also ends, without a problem, at the end of the data section.

    Parameters
    ----------
    stream : binary file
        The file, open for reading.
    size : int
        Number of bytes to look at.

    Raises
    ------
    RecordError
        If there is not even a header.
    """
    index = FileIndex()
    stream.seek(0)
    magic = stream.read(len(MAGIC))
    if magic != MAGIC:
        raise RecordError(0, "no MCAP file")
    index.crc = zlib.crc32(magic)
    first = read_record(stream, len(MAGIC), size)
    if first.opcode != Opcode.HEADER:
        raise RecordError(first.offset, "no header")
    index.header = parse(Header, first)
    _advance(index, first)
    try:
        for record in read_records(stream, first.end, size):
            if record.opcode == Opcode.DATA_END:
                return index
            _take(index, record)
            _advance(index, record)
    except RecordError as error:
        index.problem = str(error)
    else:
        index.problem = f"at byte {index.data_end}: a footer without an end of the data section"
    return index


def append(index: FileIndex, opcode: int, content: bytes) -> bytes:
    """Take a record that is to be appended at `FileIndex.data_end` into the index; return its bytes."""
    record = Record(index.data_end, opcode, content)
    _take(index, record)
    _advance(index, record)
    return struct.pack("<BQ", opcode, len(content)) + content


def read_attachment(record: Record) -> Attachment:
    """Read an attachment, its CRC checked.

    Raises
    ------
    RecordError
        If the record is no attachment, is malformed, or its CRC does not match.
    """
    if record.opcode != Opcode.ATTACHMENT:
        raise RecordError(record.offset, "no attachment is here, although the summary says so")
    attachment: Attachment = parse(Attachment, record)
    crc = int.from_bytes(record.content[-4:], "little")
    if crc and zlib.crc32(memoryview(record.content)[:-4]) != crc:
        raise RecordError(record.offset, f"CRC of the attachment {show(attachment.name)} does not match")
    return attachment


def _advance(index: FileIndex, record: Record) -> None:
    index.crc = crc_with(index.crc, record)
    index.data_end = record.end


def _indexed_channel(record: Record) -> int:
    """Return the channel of a message index, of which nothing else is needed."""
    entries = len(record.content) - _MESSAGE_INDEX_HEAD.size
    channel, length = _MESSAGE_INDEX_HEAD.unpack_from(record.content) if entries >= 0 else (0, None)
    if length != entries or entries % _MESSAGE_INDEX_ENTRY:
        raise RecordError(record.offset, "malformed MessageIndex record")
    return int(channel)


def _check_number(index: FileIndex, offset: int) -> None:
    for name, entries in (
        ("chunks", index.chunks),
        ("attachments", index.attachments),
        ("metadata records", index.metadata),
    ):
        if len(entries) > MOST_ENTRIES:
            raise RecordError(offset, f"more than {MOST_ENTRIES} {name}")


def _take(index: FileIndex, record: Record) -> None:
    opcode, statistics = record.opcode, index.statistics
    if opcode == Opcode.CHUNK:
        _take_chunk(index, record)
    elif opcode == Opcode.MESSAGE_INDEX and index.chunks:
        index.chunks[-1].message_index_offsets[_indexed_channel(record)] = record.offset
        index.chunks[-1].message_index_length += record.size
    elif opcode == Opcode.ATTACHMENT:
        attachment = read_attachment(record)
        index.attachments.append(
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
        metadata: Metadata = parse(Metadata, record)
        index.metadata.append(MetadataIndex(offset=record.offset, length=record.size, name=metadata.name))
        statistics.metadata_count += 1
    else:
        _take_inner(index, record.opcode, record.content, (0, len(record.content)), record.offset)
    _check_number(index, record.offset)


def _take_chunk(index: FileIndex, record: Record) -> None:
    head, data = chunk_head(record), uncompress(record)
    # Lengths first: a record that reaches beyond the chunk must not leave half of it in the statistics.
    for _ in inner_records(data, record.offset):
        pass
    index.chunks.append(
        ChunkIndex(
            chunk_length=record.size,
            chunk_start_offset=record.offset,
            compression=head.compression,
            compressed_size=len(head.data),
            message_end_time=head.message_end_time,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=head.message_start_time,
            uncompressed_size=head.uncompressed_size,
        )
    )
    index.statistics.chunk_count += 1
    for opcode, begin, end in inner_records(data, record.offset):
        _take_inner(index, opcode, data, (begin, end), record.offset)


def _take_inner(index: FileIndex, opcode: int, data: bytes, span: tuple[int, int], offset: int) -> None:
    statistics = index.statistics
    begin, end = span
    if opcode == Opcode.MESSAGE:
        message = read_message(data, begin, end, offset)
        if statistics.message_count == 0:
            statistics.message_start_time = message.log_time
        statistics.message_start_time = min(statistics.message_start_time, message.log_time)
        statistics.message_end_time = max(statistics.message_end_time, message.log_time)
        statistics.message_count += 1
        statistics.channel_message_counts[message.channel_id] += 1
    elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
        _define(index, Record(offset, opcode, data[begin:end]))


def _define(index: FileIndex, record: Record) -> None:
    """Take a schema or a channel; what is repeated replaces what was before."""
    statistics = index.statistics
    if record.opcode == Opcode.SCHEMA:
        schema: Schema = parse(Schema, record)
        known = index.schemas.get(schema.id) == schema
        index.schemas[schema.id] = schema
        statistics.schema_count = len(index.schemas)
    else:
        channel: Channel = parse(Channel, record)
        known = index.channels.get(channel.id) == channel
        index.channels[channel.id] = channel
        statistics.channel_count = len(index.channels)
    index.definitions += 0 if known else len(record.content)
    if index.definitions > MOST_DEFINITIONS:
        raise RecordError(record.offset, f"schemas and channels of more than {MOST_DEFINITIONS} bytes")


def read_index(stream: BinaryIO, size: int) -> FileIndex:
    """Read the summary section at the end of a file; what the format lets a writer leave out of it, by a scan.

    Parameters
    ----------
    stream : binary file
        The file, open for reading.
    size : int
        Its size in bytes.

    Raises
    ------
    RecordError
        If the file has no end, a summary section that is not as it should be, or none and a data section that is not.
    """
    end_size = _FOOTER_SIZE + len(MAGIC)
    if size < end_size + len(MAGIC):
        raise RecordError(size, "the file ends before it says what it holds")
    stream.seek(size - end_size)
    end = stream.read(end_size)
    if end[-len(MAGIC) :] != MAGIC or end[0] != Opcode.FOOTER:
        raise RecordError(size, "the file ends before it says what it holds")
    footer: Footer = parse(Footer, read_record(stream, size - end_size, size))
    if footer.summary_start == 0:
        return _scanned(stream, size, size - end_size)
    if not len(MAGIC) <= footer.summary_start <= size - end_size:
        raise RecordError(size - end_size, f"the summary section is said to begin at byte {footer.summary_start}")
    if size - footer.summary_start > MAX_SIZE:
        raise RecordError(footer.summary_start, f"a summary section of more than {MAX_SIZE} bytes")
    _check_summary_crc(stream, footer, size - end_size)
    index = FileIndex(header=parse(Header, read_record(stream, len(MAGIC), size)))
    index.data_end = footer.summary_start - len(encoded(DataEnd(0)))
    before = read_record(stream, index.data_end, size)
    if before.opcode != Opcode.DATA_END or before.end != footer.summary_start:
        raise RecordError(index.data_end, "no end of the data section is where the summary section begins")
    stated: Statistics | None = None
    for record in read_records(stream, footer.summary_start, size):
        if record.opcode == Opcode.STATISTICS:
            stated = parse(Statistics, record)
        elif record.opcode == Opcode.CHUNK_INDEX:
            index.chunks.append(parse(ChunkIndex, record))
        elif record.opcode == Opcode.ATTACHMENT_INDEX:
            index.attachments.append(parse(AttachmentIndex, record))
        elif record.opcode == Opcode.METADATA_INDEX:
            index.metadata.append(parse(MetadataIndex, record))
        elif record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            _define(index, record)
        _check_number(index, record.offset)
    if stated is not None:
        index.statistics = stated
    if stated is None or _leaves_out(index):
        _complete(index, stream, size, footer.summary_start, counted=stated is not None)
    return index


def _leaves_out(index: FileIndex) -> bool:
    """Tell whether a summary section counts records of a kind of which it lists none."""
    counted = index.statistics
    return (
        (counted.schema_count > 0 and not index.schemas)
        or (counted.channel_count > 0 and not index.channels)
        or (counted.chunk_count > 0 and not index.chunks)
        or (counted.attachment_count > 0 and not index.attachments)
        or (counted.metadata_count > 0 and not index.metadata)
    )


def _complete(index: FileIndex, stream: BinaryIO, size: int, end: int, *, counted: bool) -> None:
    """Take over from the data section what the summary section leaves out: numbers, and kinds it lists none of."""
    try:
        found = _scanned(stream, size, end)
    except RecordError:
        if counted:  # whoever reads the file finds the damage where it is
            return
        raise
    index.schemas = index.schemas or found.schemas
    index.channels = index.channels or found.channels
    index.chunks = index.chunks or found.chunks
    index.attachments = index.attachments or found.attachments
    index.metadata = index.metadata or found.metadata
    if not counted:
        index.statistics = found.statistics


def _scanned(stream: BinaryIO, size: int, end: int) -> FileIndex:
    """Return what a data section holds that is whole and ends at byte `end`.

    Raises
    ------
    RecordError
        If it is not.
    """
    found = scan_index(stream, size)
    if found.problem is not None:
        raise RecordError(found.data_end, found.problem.removeprefix(f"at byte {found.data_end}: "))
    if found.data_end + len(encoded(DataEnd(0))) != end:
        raise RecordError(found.data_end, f"the data section ends here and not at byte {end}, as the file says")
    return found


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
        raise RecordError(footer.summary_start, "CRC of the summary section does not match")


def tail(index: FileIndex) -> Iterator[bytes]:
    """Yield the end of a file with the records of `index`: end of the data section, summary section, footer.

    It belongs at `FileIndex.data_end`.
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
        if group:
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


def encoded(record: McapRecord) -> bytes:
    """Return a record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())

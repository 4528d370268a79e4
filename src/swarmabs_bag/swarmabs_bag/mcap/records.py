"""The records of an MCAP file in order; lengths are checked before memory is allocated.

A violation of the format raises `RecordError` with its position in the file.
"""

from __future__ import annotations

import struct
import zlib
from contextlib import suppress
from io import BytesIO
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, McapRecord

if TYPE_CHECKING:
    from collections.abc import Iterator

MAGIC = b"\x89MCAP0\r\n"
"""First and last eight bytes of a complete file."""

HEAD_SIZE = 9
"""Bytes of a record before its content: opcode and length."""

MESSAGE_HEAD_SIZE = 22
"""Bytes of a message's content before its payload: channel, sequence number, log and publish time."""

MAX_SIZE = 2**28
"""Size, bytes, above which records and uncompressed chunks count as damaged."""

MAX_PARSED = 2**24
"""Size, bytes, above which records other than chunks and attachments count as damaged."""

MAX_RATIO = 1000
"""Compression ratio above which chunks of more than 1 MiB count as damaged."""

UNREADABLE = (McapError, struct.error, ValueError, OverflowError)
"""Errors of the mcap library's record classes."""

UNCOMPRESSING = (zstandard.ZstdError, RuntimeError, ValueError)
"""Errors of `uncompressed`."""

R = TypeVar("R", bound=McapRecord)

_PIECE = 2**17
_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD_SIZE = 40  # without the name of the compression
_MESSAGE_INDEX_HEAD = struct.Struct("<HI")
_MESSAGE_INDEX_ENTRY = 16


class RecordError(Exception):
    """An MCAP file violates its format."""

    def __init__(self, offset: int, problem: str) -> None:
        super().__init__(f"at byte {offset}: {problem}")
        self.offset = offset


class Record(NamedTuple):
    """A record of the file: position, opcode and content."""

    offset: int
    opcode: int
    content: bytes

    @property
    def size(self) -> int:
        """Size in the file, bytes."""
        return HEAD_SIZE + len(self.content)

    @property
    def end(self) -> int:
        """Position after the record."""
        return self.offset + self.size

    @property
    def stored(self) -> bytes:
        """The record as bytes of the file."""
        return _HEAD.pack(self.opcode, len(self.content)) + self.content


class StoredMessage(NamedTuple):
    """A message as stored in the file."""

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    payload: bytes


def record_length(head: bytes) -> int:
    """Return the length of a record's content, as stated in its head."""
    return int(_HEAD.unpack_from(head)[1])


def crc_with(crc: int, record: Record) -> int:
    """Return the CRC-32 of the bytes before a record and of the record."""
    return zlib.crc32(record.content, zlib.crc32(_HEAD.pack(record.opcode, len(record.content)), crc))


def read_record(stream: BinaryIO, offset: int, size: int) -> Record:
    """Read the record at `offset` of a file of `size` bytes; reject one larger than `MAX_SIZE`."""
    if offset > size:
        raise RecordError(offset, f"a record should be here, but the file has only {size} bytes")
    stream.seek(offset)
    head = stream.read(HEAD_SIZE)
    if len(head) < HEAD_SIZE:
        raise RecordError(offset, "the file ends within the head of a record")
    opcode, length = _HEAD.unpack(head)
    if opcode == 0:
        raise RecordError(offset, "zeros instead of a record")
    if length > size - offset - HEAD_SIZE:
        raise RecordError(offset, f"a record of {length} bytes begins, but {size - offset - HEAD_SIZE} bytes are left")
    if length > MAX_SIZE:
        raise RecordError(offset, f"a record of {length} bytes, more than {MAX_SIZE}")
    try:
        content = stream.read(length)
    except MemoryError as error:
        raise RecordError(offset, f"a record of {length} bytes, for which there is not enough memory") from error
    if len(content) < length:
        raise RecordError(offset, f"a record of {length} bytes, but only {len(content)} could be read")
    return Record(offset, opcode, content)


def read_records(stream: BinaryIO, offset: int, size: int) -> Iterator[Record]:
    """Yield all records from `offset` to the end of the file or section.

    The last record is ``DataEnd`` in the data section and ``Footer`` in the summary section.
    """
    while True:
        record = read_record(stream, offset, size)
        yield record
        if record.opcode in {Opcode.DATA_END, Opcode.FOOTER}:
            return
        offset = record.end


class _Content(ReadDataStream):
    """The content of a record; reading a field beyond its end is an error."""

    def read(self, length: int) -> bytes:
        data = b""
        with suppress(EndOfFile):
            data = super().read(length)
        if len(data) < length:
            raise ValueError(f"a field of {length} bytes, but only {len(data)} are left")
        return data


def parse(record_class: type[R], record: Record) -> R:
    """Parse the content of a record, of up to `MAX_PARSED` bytes, with a record class of the mcap library."""
    if len(record.content) > MAX_PARSED and record_class not in {Attachment, Chunk}:
        raise RecordError(record.offset, f"a {record_class.__name__} record of more than {MAX_PARSED} bytes")
    untyped: Any = record_class
    try:
        parsed: R = untyped.read(_Content(BytesIO(record.content)))
    except MemoryError as error:
        text = f"a {record_class.__name__} record of {len(record.content)} bytes, for which there is not enough memory"
        raise RecordError(record.offset, text) from error
    except UNREADABLE as error:
        raise RecordError(record.offset, f"malformed {record_class.__name__} record: {error}") from error
    return parsed


def uncompress(record: Record) -> bytes:
    """Return the records in a chunk, within `MAX_SIZE` and `MAX_RATIO`, after checking its size and CRC."""
    chunk = parse(Chunk, record)
    size, left = chunk.uncompressed_size, len(record.content) - _CHUNK_HEAD_SIZE - len(chunk.compression.encode())
    if len(chunk.data) != left:
        raise RecordError(record.offset, f"a chunk of {len(chunk.data)} bytes in a record with {left} bytes")
    if size > MAX_SIZE:
        raise RecordError(record.offset, f"a chunk of {size} bytes when uncompressed, more than {MAX_SIZE}")
    if size > max(2**20, MAX_RATIO * len(chunk.data)):
        raise RecordError(record.offset, f"a chunk of {size} bytes uncompressed, but {len(chunk.data)} compressed")
    try:
        data = uncompressed(chunk.compression, chunk.data, size)
    except UNCOMPRESSING as error:
        raise RecordError(record.offset, f"the chunk cannot be uncompressed: {error}") from error
    except MemoryError as error:
        raise RecordError(record.offset, f"a chunk of {size} bytes, for which there is not enough memory") from error
    if len(data) != size:
        raise RecordError(record.offset, f"the chunk contains {len(data)} bytes, but states {size}")
    stated = chunk.uncompressed_crc
    if stated and zlib.crc32(data) != stated:
        raise RecordError(record.offset, f"CRC of the chunk is {zlib.crc32(data):#010x}, but it states {stated:#010x}")
    return data


def uncompressed(compression: str, data: bytes, size: int, *, cut_off: bool = False) -> bytes:
    """Return the uncompressed data of a chunk, of truncated data as far as possible.

    The output is limited to little more than `size` bytes. Errors of the libraries propagate.
    """
    if compression == "":
        return data[:size] if cut_off else data
    if compression == "zstd":
        decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_SIZE)
        if cut_off:
            with decompressor.stream_reader(data) as reader, BytesIO() as whole:
                while whole.tell() < size and (piece := reader.read(min(size - whole.tell(), _PIECE))):
                    whole.write(piece)
                return whole.getvalue()
        stated = zstandard.frame_content_size(data)
        if stated not in {-1, size}:
            raise ValueError(f"its zstd frame states {stated} bytes, the chunk {size}")
        return decompressor.decompress(data, max_output_size=size)
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1 - cut_off))
    raise ValueError(f"unknown compression {compression!r}")


def indexed_channel(record: Record) -> int:
    """Return the channel of a message index, checking only its length."""
    entries = len(record.content) - _MESSAGE_INDEX_HEAD.size
    channel, length = _MESSAGE_INDEX_HEAD.unpack_from(record.content) if entries >= 0 else (0, None)
    if length != entries or entries % _MESSAGE_INDEX_ENTRY:
        raise RecordError(record.offset, "malformed MessageIndex record")
    return int(channel)


def stored_message(record: Record) -> StoredMessage:
    """Return the message in a record."""
    if len(record.content) < MESSAGE_HEAD_SIZE:
        raise RecordError(record.offset, "a message record is cut off")
    channel, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(record.content)
    return StoredMessage(channel, sequence, log_time, publish_time, record.content[MESSAGE_HEAD_SIZE:])


def encoded(record: McapRecord) -> bytes:
    """Return a record as bytes of a file."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())

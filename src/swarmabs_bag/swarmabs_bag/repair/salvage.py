"""Recovery from a damaged MCAP file: intact records, and the complete messages at the start of a truncated chunk."""

from __future__ import annotations

import mmap
import re
import zlib
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, DataEnd

from swarmabs_bag.mcap.index import FileIndex, scan_index
from swarmabs_bag.mcap.records import (
    HEAD_SIZE,
    MAGIC,
    MAX_SIZE,
    UNCOMPRESSING,
    UNREADABLE,
    Record,
    RecordError,
    parse,
    read_record,
    record_length,
    uncompress,
    uncompressed,
)
from swarmabs_bag.mcap.stored import MESSAGE_HEAD, ChunkContent

if TYPE_CHECKING:
    from collections.abc import Iterator

_KINDS: dict[int, str] = {
    Opcode.HEADER: "header",
    Opcode.SCHEMA: "schema",
    Opcode.CHANNEL: "channel",
    Opcode.MESSAGE: "message",
    Opcode.CHUNK: "chunk",
    Opcode.MESSAGE_INDEX: "message index, which is rebuilt",
    Opcode.ATTACHMENT: "attachment",
    Opcode.METADATA: "metadata record",
    Opcode.DATA_END: "end of the data section",
}

# Where a chunk may begin; after damage also an attachment, the end of the data section or (the last pattern) a message.
# The upper bytes of a length below MAX_SIZE are zero.
_CHUNK_MARKS = re.compile(rb"(?=\x06[\s\S]{3}[\x00-\x10]\x00{4})")
_MARKS = re.compile(rb"(?=[\x06\x09\x0f][\s\S]{3}[\x00-\x10]\x00{4})")
_MARKS_WITHOUT_CHUNKS = re.compile(rb"(?=[\x05\x06\x09\x0f][\s\S]{3}[\x00-\x10]\x00{4})")


@dataclass(frozen=True, slots=True)
class Damage:
    """A lost part of a file: position, size in bytes, reason, and its span of log times, s, if stated."""

    offset: int
    bytes: int
    problem: str
    start: float | None = None
    end: float | None = None


class Saved(NamedTuple):
    """An intact record; `data` are the records in a chunk, of a truncated chunk the complete ones."""

    record: Record
    data: bytes = b""
    cut: bool = False


class Salvage:
    """The intact records of a data section, in file order, each checked as far as the format allows.

    After damage the search continues at the next intact chunk, attachment, or end of the data section. In a file with
    chunks, a message outside of them counts only if the CRC of the data section is correct: no other CRC covers it, and
    a single wrong bit turns a message index into a message. The file has `size` bytes.

    Attributes
    ----------
    damage : list of Damage
        The parts left out so far.
    before : FileIndex
        The content before the first damage.
    end : DataEnd or None
        The end of the data section, None if it was not found.
    """

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self._stream = stream
        self._size = size
        self._unchunked = False
        self.damage: list[Damage] = []
        self.before = FileIndex(crc=zlib.crc32(MAGIC))
        self.end: DataEnd | None = None

    def records(self) -> Iterator[Saved]:
        """Yield the intact records."""
        self._stream.seek(0)
        if self._stream.read(len(MAGIC)) != MAGIC:
            self.damage.append(Damage(0, len(MAGIC), "the file does not begin as an MCAP file"))
        offset = len(MAGIC)
        while offset < self._size:
            try:
                saved = self._checked(offset)
            except RecordError as error:
                following = self._following(offset)
                if following is None:
                    yield from self._rest(offset, error)
                    return
                self.damage.append(self._described(offset, following, error))
                offset = following
                continue
            if saved.record.opcode == Opcode.DATA_END:
                self.end = parse(DataEnd, saved.record)
                return
            if not self.damage:
                self.before.take(saved.record, saved.data)
            self._unchunked |= saved.record.opcode == Opcode.MESSAGE
            yield saved
            offset = saved.record.end

    def _checked(self, offset: int) -> Saved:
        """Return the record at `offset`; raise `RecordError` if it is damaged or not allowed here."""
        record = read_record(self._stream, offset, self._size)
        if record.opcode == Opcode.DATA_END:
            parse(DataEnd, record)
            if not self._leads_on(record.end):
                raise RecordError(offset, "an end of the data section without a summary section after it")
            return Saved(record)
        data = uncompress(record) if record.opcode == Opcode.CHUNK else b""
        content = FileIndex()
        content.take(record, data)
        if content.unknown is not None:
            raise RecordError(offset, f"a record of kind {content.unknown:#04x}, which is not allowed here")
        if record.opcode == Opcode.ATTACHMENT and self.before.is_own and not any(record.content[-4:]):
            raise RecordError(offset, "zeros instead of its CRC, which this project always writes")
        if record.opcode == Opcode.MESSAGE and self._has_chunks and not self._section_is_right:
            raise RecordError(offset, "outside of the chunks, where no CRC confirms it")
        return Saved(record, data)

    @cached_property
    def _has_chunks(self) -> bool:
        """Whether the file contains an intact chunk."""
        with mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
            for mark in _CHUNK_MARKS.finditer(content, len(MAGIC)):
                try:
                    self._checked(mark.start())
                except RecordError:
                    continue
                return True
        return False

    @cached_property
    def _section_is_right(self) -> bool:
        """Whether the data section has a correct CRC."""
        try:
            scanned = scan_index(self._stream, self._size)
            end = parse(DataEnd, read_record(self._stream, scanned.data_end, self._size))
        except RecordError:
            return False
        return scanned.problem is None and end.data_section_crc == scanned.crc

    def _leads_on(self, offset: int) -> bool:
        """Return whether a record can begin here, or the file ends here."""
        if offset >= self._size:
            return offset == self._size
        self._stream.seek(offset)
        head = self._stream.read(HEAD_SIZE)
        is_head = len(head) == HEAD_SIZE and Opcode.HEADER <= head[0] <= Opcode.DATA_END
        return is_head and record_length(head) <= self._size - offset - HEAD_SIZE

    def _following(self, offset: int) -> int | None:
        """Return the position of the next record after a damaged one."""
        try:
            end = read_record(self._stream, offset, self._size).end
        except RecordError:
            end = self._size
        if end < self._size and self._leads_on(end):
            return end
        marks = _MARKS_WITHOUT_CHUNKS if self._unchunked else _MARKS
        with mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
            for mark in marks.finditer(content, offset + 1):
                try:
                    record = self._checked(mark.start()).record
                except RecordError:
                    continue
                if record.opcode == Opcode.CHUNK or self._leads_on(record.end):
                    return mark.start()
        return None

    def _described(self, offset: int, end: int, error: RecordError) -> Damage:
        start_time = end_time = None
        with suppress(RecordError):
            record = read_record(self._stream, offset, self._size)
            if record.opcode == Opcode.CHUNK and record.end == end:
                chunk = parse(Chunk, record)
                start_time, end_time = chunk.message_start_time / 1e9, chunk.message_end_time / 1e9
        return Damage(offset, end - offset, self._named(offset, error), start_time, end_time)

    def _named(self, offset: int, error: RecordError) -> str:
        """Describe the problem of a record, and of which kind it seems to be."""
        self._stream.seek(offset)
        kind = _KINDS.get(self._stream.read(1)[0], "record of unknown kind")
        return f"{kind}: {str(error).removeprefix(f'at byte {error.offset}: ')}"

    def _rest(self, offset: int, error: RecordError) -> Iterator[Saved]:
        """Yield the complete records of a chunk that is truncated by the end of the file."""
        cut = _cut_chunk(self._stream, offset, self._size)
        if cut is None:
            self.damage.append(Damage(offset, self._size - offset, self._named(offset, error)))
            return
        data, start_time, end_time = cut
        problem = "chunk: the file ends within it"
        self.damage.append(Damage(offset, self._size - offset, problem, start_time / 1e9, end_time / 1e9))
        if data:
            yield Saved(Record(offset, Opcode.CHUNK, b""), data, cut=True)


def _cut_chunk(stream: BinaryIO, offset: int, size: int) -> tuple[bytes, int, int] | None:
    """Return the complete records at the start of a chunk truncated by the end of the file, and its stated times."""
    stream.seek(offset)
    content = stream.read(min(size - offset, MAX_SIZE))
    if len(content) < HEAD_SIZE or content[0] != Opcode.CHUNK or record_length(content) <= size - offset - HEAD_SIZE:
        return None
    try:  # the library accepts a truncated last field
        chunk = Chunk.read(ReadDataStream(BytesIO(content[HEAD_SIZE:])))
    except UNREADABLE:
        return None
    start, end, stated = chunk.message_start_time, chunk.message_end_time, chunk.uncompressed_size
    if stated > MAX_SIZE or start > end:
        return None
    try:
        data = uncompressed(chunk.compression, chunk.data, stated, cut_off=True)
    except UNCOMPRESSING:
        data = b""
    return data[: _end_of_valid(ChunkContent.of(data, offset), start, end)], start, end


def _end_of_valid(content: ChunkContent, start: int, end: int) -> int:
    """Return where the records of a truncated chunk end that are valid: its messages are from `start` to `end`, ns."""
    messages, valid = content.messages, content.end
    times = messages.heads["log_time"]
    outside = np.flatnonzero((times < start) | (times > end))
    if len(outside):
        valid = int(messages.begins[outside[0]]) - MESSAGE_HEAD.itemsize
    definitions = FileIndex()
    for place, record in content.others:
        try:
            definitions.take_inner(record)
        except RecordError:
            return min(valid, place)
        if definitions.unknown is not None:
            return min(valid, place)
    return valid

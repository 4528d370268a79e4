"""What can be saved of a damaged MCAP file: its whole records, and the whole messages at the start of a cut chunk."""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from functools import cached_property
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Header, Metadata, Schema

from swarmabs_bag.index import FileIndex, read_attachment, scan_index
from swarmabs_bag.records import (
    HEAD_SIZE,
    MAGIC,
    MAX_SIZE,
    UNCOMPRESSING,
    Record,
    RecordError,
    chunk_head,
    indexed_channel,
    inner_records,
    message_head,
    parse,
    read_record,
    uncompress,
    uncompressed,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")

_KINDS: dict[int, str] = {
    Opcode.HEADER: "header",
    Opcode.SCHEMA: "schema",
    Opcode.CHANNEL: "channel",
    Opcode.MESSAGE: "message",
    Opcode.CHUNK: "chunk",
    Opcode.MESSAGE_INDEX: "message index, which is made anew",
    Opcode.ATTACHMENT: "attachment",
    Opcode.METADATA: "metadata record",
    Opcode.DATA_END: "end of the data section",
}

# Where a chunk may begin; behind damage also an attachment, the end of the data section or (the last) a message: the
# upper bytes of a length below MAX_SIZE are zero.
_CHUNK_MARKS = re.compile(rb"(?=\x06[\s\S]{3}[\x00-\x10]\x00{4})")
_MARKS = re.compile(rb"(?=[\x06\x09\x0f][\s\S]{3}[\x00-\x10]\x00{4})")
_MARKS_WITHOUT_CHUNKS = re.compile(rb"(?=[\x05\x06\x09\x0f][\s\S]{3}[\x00-\x10]\x00{4})")


class Damage(NamedTuple):
    """A part of a file that is lost: where, how many bytes, why, and its span of log times in ns where it says one."""

    offset: int
    size: int
    problem: str
    start: int | None = None
    end: int | None = None


class Saved(NamedTuple):
    """A whole record; `data` of a chunk are its records, of one that was cut off those that are whole."""

    record: Record
    data: bytes = b""
    cut: bool = False


class Salvage:
    """The whole records of a file's data section, in file order, each checked as far as the format allows.

    Behind damage the search goes on at the next chunk, attachment, or end of the data section that is whole. Beside
    chunks, a message outside of them is believed only if the CRC of the data section is right: no other CRC covers it,
    and one wrong bit makes a message of a message index.

    Parameters
    ----------
    stream : binary file
        The file, open for reading.
    size : int
        Its size in bytes.

    Attributes
    ----------
    damage : list of Damage
        What was left out so far.
    before : FileIndex
        What stands before the first damage.
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
        """Yield what is whole."""
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
        """Return the record at `offset`.

        Raises
        ------
        RecordError
            If it is not whole, or cannot be here.
        """
        record = read_record(self._stream, offset, self._size)
        opcode = record.opcode
        if opcode == Opcode.CHUNK:
            data = uncompress(record)
            for inner, begin, end in inner_records(data, offset):
                _check_inner(inner, data, (begin, end), offset)
            return Saved(record, data)
        if opcode == Opcode.ATTACHMENT:
            read_attachment(record)
        elif opcode == Opcode.METADATA:
            parse(Metadata, record)
        elif opcode == Opcode.MESSAGE_INDEX:
            indexed_channel(record)
        elif opcode == Opcode.HEADER and offset == len(MAGIC):
            parse(Header, record)
        elif opcode == Opcode.DATA_END:
            parse(DataEnd, record)
            if not self._leads_on(record.end):
                raise RecordError(offset, "an end of the data section behind which no summary section begins")
        else:
            _check_inner(opcode, record.content, (0, len(record.content)), offset)
            if opcode == Opcode.MESSAGE and self._has_chunks and not self._section_is_right:
                raise RecordError(offset, "outside of the chunks, where no CRC says that it is one")
        return Saved(record)

    @cached_property
    def _has_chunks(self) -> bool:
        """Whether there is a whole chunk anywhere."""
        with mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
            for found in _CHUNK_MARKS.finditer(content, len(MAGIC)):
                try:
                    self._checked(found.start())
                except RecordError:
                    continue
                return True
        return False

    @cached_property
    def _section_is_right(self) -> bool:
        """Whether the data section has a CRC, and the right one."""
        try:
            found = scan_index(self._stream, self._size)
            end: DataEnd = parse(DataEnd, read_record(self._stream, found.data_end, self._size))
        except RecordError:
            return False
        return found.problem is None and end.data_section_crc == found.crc

    def _leads_on(self, offset: int) -> bool:
        """Tell whether a record can begin here, or the file ends."""
        if offset >= self._size:
            return offset == self._size
        self._stream.seek(offset)
        head = self._stream.read(HEAD_SIZE)
        if len(head) < HEAD_SIZE:
            return False
        opcode, length = _HEAD.unpack(head)
        return bool(Opcode.HEADER <= opcode <= Opcode.DATA_END and length <= self._size - offset - HEAD_SIZE)

    def _following(self, offset: int) -> int | None:
        """Return where, behind a record that is not whole, the next one begins."""
        try:
            end = read_record(self._stream, offset, self._size).end
        except RecordError:
            end = self._size
        if end < self._size and self._leads_on(end):
            return end
        marks = _MARKS_WITHOUT_CHUNKS if self._unchunked else _MARKS
        with mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
            for found in marks.finditer(content, offset + 1):
                try:
                    record = self._checked(found.start()).record
                except RecordError:
                    continue
                if record.opcode == Opcode.CHUNK or self._leads_on(record.end):
                    return found.start()
        return None

    def _described(self, offset: int, end: int, error: RecordError) -> Damage:
        start_time = end_time = None
        try:
            record = read_record(self._stream, offset, self._size)
            if record.opcode == Opcode.CHUNK and record.end == end:
                head = chunk_head(record)
                start_time, end_time = head.message_start_time, head.message_end_time
        except RecordError:
            pass
        return Damage(offset, end - offset, self._named(offset, error), start_time, end_time)

    def _named(self, offset: int, error: RecordError) -> str:
        """Return what is wrong with a record, and of which kind it seems to be."""
        self._stream.seek(offset)
        kind = _KINDS.get(self._stream.read(1)[0], "record of no known kind")
        return f"{kind}: {str(error).removeprefix(f'at byte {error.offset}: ')}"

    def _rest(self, offset: int, error: RecordError) -> Iterator[Saved]:
        """Yield the whole records of a chunk with which the file breaks off."""
        cut = _cut_chunk(self._stream, offset, self._size)
        if cut is None:
            self.damage.append(Damage(offset, self._size - offset, self._named(offset, error)))
            return
        data, start_time, end_time = cut
        problem = "chunk: the file breaks off within it"
        self.damage.append(Damage(offset, self._size - offset, problem, start_time, end_time))
        if data:
            yield Saved(Record(offset, Opcode.CHUNK, b""), data, cut=True)


def _check_inner(opcode: int, data: bytes, span: tuple[int, int], offset: int) -> None:
    """Check the record of a chunk, or outside of any, whose content lies in the span of the data."""
    begin, end = span
    if opcode == Opcode.MESSAGE:
        message_head(data, begin, end, offset)
    elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
        parse(Schema if opcode == Opcode.SCHEMA else Channel, Record(offset, opcode, data[begin:end]))
    else:
        raise RecordError(offset, f"a record of kind {opcode:#04x}, which cannot be here")


def _cut_chunk(stream: BinaryIO, offset: int, size: int) -> tuple[bytes, int, int] | None:
    """Return the whole records at the start of a chunk that the file's end cuts off, and the times it states."""
    stream.seek(offset)
    content = stream.read(min(size - offset, MAX_SIZE))
    name_start = HEAD_SIZE + _CHUNK_HEAD.size
    if len(content) < name_start or content[0] != Opcode.CHUNK:
        return None
    _, length = _HEAD.unpack_from(content)
    start, end, stated, _, name_length = _CHUNK_HEAD.unpack_from(content, HEAD_SIZE)
    data_start = name_start + name_length + 8
    if length <= size - offset - HEAD_SIZE or stated > MAX_SIZE or start > end:
        return None
    name = content[name_start : name_start + name_length].decode(errors="replace")
    try:
        data = uncompressed(name, content[data_start:], stated, cut_off=True)
    except UNCOMPRESSING:
        data = b""
    whole = 0
    try:
        for opcode, begin, stop in inner_records(data, offset):
            _check_inner(opcode, data, (begin, stop), offset)
            if opcode == Opcode.MESSAGE and not start <= message_head(data, begin, stop, offset)[2] <= end:
                break
            whole = stop
    except RecordError:
        pass
    return data[:whole], start, end

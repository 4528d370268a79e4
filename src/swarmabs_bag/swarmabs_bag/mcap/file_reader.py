"""A single MCAP file of a bag, read in file order, with every length, CRC and count checked.

A contradiction raises `DamagedBagError` after everything before it has been yielded.
"""

from __future__ import annotations

import math
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from mcap.opcode import Opcode
from mcap.records import DataEnd, Metadata

from swarmabs_bag.errors import DamagedBagError, NotABagError, repair_command
from swarmabs_bag.mcap.index import RECORD_KEY, RECORD_NAME, FileIndex, read_attachment, read_index, scan_index
from swarmabs_bag.mcap.records import (
    MAGIC,
    Record,
    RecordError,
    crc_with,
    parse,
    read_record,
    read_records,
    stored_message,
    uncompress,
)
from swarmabs_bag.mcap.stored import ChunkContent, StoredMessages
from swarmabs_config.model.errors import show

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from typing import BinaryIO

_TOGETHER = 10_000
"""Most messages outside of chunks that are read together."""


@dataclass(frozen=True, slots=True)
class BagFile:
    """An MCAP file with its size in bytes and its index; nothing stays open between calls."""

    path: Path
    size: int
    index: FileIndex

    def stored(self) -> Iterator[StoredMessages]:
        """Yield every message in file order, those of a chunk at once."""
        index, latest, count = self.index, 0, 0
        stated = index.statistics.message_count
        most = math.inf if index.problem else stated
        channels = list(index.channels)
        with self._opened(lambda: f"; the messages before it, up to {latest / 1e9:.9g} s, can be read") as stream:
            for messages in self._messages(stream):
                unknown = np.flatnonzero(~np.isin(messages.heads["channel_id"], channels))
                end = int(unknown[0]) if len(unknown) else len(messages)
                end = int(min(end, most - count))
                if end:
                    latest = int(messages.heads["log_time"][end - 1])
                    yield messages[:end]
                count += end
                if len(unknown) and end == unknown[0]:
                    channel = messages.heads["channel_id"][end]
                    raise RecordError(index.data_end, f"channel {channel} of a message is not in the summary")
                if end < len(messages):
                    count += 1
                    break
        if index.problem is None and count != stated:
            counted = f"at least {count}" if count > most else str(count)
            raise DamagedBagError(f"{self.path}: the summary states message_count = {stated}, but it is {counted}")

    def _messages(self, stream: BinaryIO) -> Iterator[StoredMessages]:
        index = self.index
        if index.data_end <= len(MAGIC):
            return
        crc = zlib.crc32(MAGIC)
        single: list[Record] = []
        try:
            # A damaged file ends at data_end; in a complete one, the DataEnd record there ends the loop.
            for record in read_records(stream, len(MAGIC), index.data_end if index.problem else stream.seek(0, 2)):
                if record.opcode == Opcode.MESSAGE:
                    stored_message(record)
                    single.append(record)
                if single and (record.opcode != Opcode.MESSAGE or len(single) == _TOGETHER):
                    together, single = single, []
                    yield _joined(together)
                if record.opcode == Opcode.CHUNK:
                    content = ChunkContent.of(uncompress(record), record.offset)
                    yield content.messages
                    if content.problem is not None:
                        raise content.problem
                elif record.opcode == Opcode.DATA_END:
                    _check_crc(record, crc)
                crc = crc_with(crc, record)
                if index.problem and record.end >= index.data_end:
                    break
        except RecordError:
            yield _joined(single)
            raise
        yield _joined(single)

    def attachments(self, name: str) -> Iterator[bytes]:
        """Yield the contents of all attachments of a name, in file order."""
        for entry in self.index.attachments:
            if entry.name == name:
                with self._opened() as stream:
                    attachment = read_attachment(read_record(stream, entry.offset, self.size))
                    if attachment.name != name:
                        raise RecordError(entry.offset, f"the attachment is not {show(name)}, as the summary states")
                yield attachment.data

    def description(self) -> str:
        """Return rosbag2's description of the bag as YAML text, or an empty string."""
        for entry in reversed(self.index.metadata):  # rosbag2 also writes one at the beginning
            if entry.name == RECORD_NAME:
                with self._opened() as stream:
                    record = parse(Metadata, read_record(stream, entry.offset, self.size))
                return record.metadata.get(RECORD_KEY, "")
        return ""

    def check(self) -> None:
        """Read the whole file and compare it with every CRC and with its summary."""
        with self._opened() as stream:
            scanned = scan_index(stream, self.size)
            if scanned.problem is not None:
                raise DamagedBagError(f"{self.path}: {scanned.problem}{_readable(scanned)}")
            _check_crc(read_record(stream, scanned.data_end, self.size), scanned.crc)
        problem = self.index.contradicted_by(scanned)
        if problem is not None:
            raise DamagedBagError(f"{self.path}: {problem}")

    @contextmanager
    def _opened(self, remedy: Callable[[], str] = str) -> Iterator[BinaryIO]:
        """Open the file; add its name and a remedy to errors."""
        try:
            with self.path.open("rb") as stream:
                yield stream
        except RecordError as error:
            raise DamagedBagError(f"{self.path}: {error}{remedy()}") from error
        except OSError as error:
            raise DamagedBagError(f"{self.path} cannot be read: {error.strerror or error}") from error


def _joined(records: list[Record]) -> StoredMessages:
    """Return messages outside of chunks."""
    return ChunkContent.of(b"".join(record.stored for record in records), 0).messages


def open_file(path: Path, *, damaged: bool) -> BagFile:
    """Open an MCAP file; parameters and errors as for `open_bag`."""
    try:
        with path.open("rb") as stream:
            size = stream.seek(0, 2)
            stream.seek(0)
            magic = stream.read(len(MAGIC))
            if not MAGIC.startswith(magic):
                raise NotABagError(f"{path} is not a bag: it does not begin as an MCAP file")
            if len(magic) < len(MAGIC):
                raise DamagedBagError(f"{path} has only {size} bytes: nothing was written to it")
            try:
                index = read_index(stream, size)
            except RecordError as error:
                index = scan_index(stream, size)
                index.problem = index.problem or str(error)
            if index.problem is None or damaged:
                return BagFile(path, size, index)
            raise DamagedBagError(f"{path} is incomplete: {index.problem}{_readable(index)}; {repair_command(path)}")
    except OSError as error:
        raise NotABagError(f"cannot read {path}: {error.strerror or error}") from error
    except RecordError as error:
        raise DamagedBagError(f"{path}: {error}; nothing can be read") from error


def _readable(index: FileIndex) -> str:
    count, end = index.statistics.message_count, index.statistics.message_end_time
    return (
        f"; {count} messages before it, up to {end / 1e9:.9g} s, can be read" if count else "; no message can be read"
    )


def _check_crc(end: Record, crc: int) -> None:
    """Compare the CRC of the data section with the stated one."""
    stated = parse(DataEnd, end)
    if stated.data_section_crc not in {0, crc}:
        raise RecordError(
            end.offset,
            f"the CRC of the data section is {crc:#010x}, but the file states {stated.data_section_crc:#010x}",
        )

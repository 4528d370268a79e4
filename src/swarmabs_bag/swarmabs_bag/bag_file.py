"""A single MCAP file of a bag, read in file order, with every length, CRC and count checked.

A contradiction raises `DamagedBagError` after everything before it has been yielded.
"""

from __future__ import annotations

import math
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mcap.opcode import Opcode
from mcap.records import DataEnd, Metadata

from swarmabs_bag.errors import DamagedBagError, NotABagError, repair_command
from swarmabs_bag.index import FileIndex, read_attachment, read_index, scan_index
from swarmabs_bag.metadata import RECORD_KEY, RECORD_NAME
from swarmabs_bag.records import (
    MAGIC,
    Record,
    RecordError,
    StoredMessage,
    crc_with,
    inner_messages,
    parse,
    read_record,
    read_records,
    uncompress,
)
from swarmabs_config.model.errors import show

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from typing import BinaryIO


@dataclass(frozen=True, slots=True)
class BagFile:
    """An MCAP file with its size in bytes and its index; nothing stays open between calls."""

    path: Path
    size: int
    index: FileIndex

    def stored(self) -> Iterator[StoredMessage]:
        """Yield every message in file order."""
        index, latest, count = self.index, 0, 0
        stated = index.statistics.message_count
        most = math.inf if index.problem else stated
        with self._opened(lambda: f"; the messages before it, up to {latest / 1e9:.9g} s, can be read") as stream:
            for message in self._messages(stream):
                if message.channel_id not in index.channels:
                    raise RecordError(
                        index.data_end, f"channel {message.channel_id} of a message is not in the summary"
                    )
                latest = message.log_time
                count += 1
                if count > most:
                    break
                yield message
        if index.problem is None and count != stated:
            counted = f"at least {count}" if count > most else str(count)
            raise DamagedBagError(f"{self.path}: the summary states message_count = {stated}, but it is {counted}")

    def _messages(self, stream: BinaryIO) -> Iterator[StoredMessage]:
        index = self.index
        if index.data_end <= len(MAGIC):
            return
        crc = zlib.crc32(MAGIC)
        # A damaged file ends at data_end; in a complete one, the DataEnd record there ends the loop.
        for record in read_records(stream, len(MAGIC), index.data_end if index.problem else stream.seek(0, 2)):
            if record.opcode == Opcode.CHUNK:
                yield from inner_messages(uncompress(record), record.offset)
            elif record.opcode == Opcode.MESSAGE:
                yield from inner_messages(record.stored, record.offset)
            elif record.opcode == Opcode.DATA_END:
                _check_crc(record, crc)
            crc = crc_with(crc, record)
            if index.problem and record.end >= index.data_end:
                return

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
                    record: Metadata = parse(Metadata, read_record(stream, entry.offset, self.size))
                return record.metadata.get(RECORD_KEY, "")
        return ""

    def check(self) -> None:
        """Read the whole file and compare it with every CRC and with its summary."""
        with self._opened() as stream:
            found = scan_index(stream, self.size)
            if found.problem is not None:
                raise DamagedBagError(f"{self.path}: {found.problem}{_readable(found)}")
            _check_crc(read_record(stream, found.data_end, self.size), found.crc)
        problem = self.index.contradicted_by(found)
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
    stated: DataEnd = parse(DataEnd, end)
    if stated.data_section_crc not in {0, crc}:
        raise RecordError(
            end.offset,
            f"the CRC of the data section is {crc:#010x}, but the file states {stated.data_section_crc:#010x}",
        )

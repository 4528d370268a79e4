"""The file under a bag writer, which always ends with a complete record, and the disk space reserved for its end."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_RESERVE_STEP = 2**16


class RecordFile:
    """A new file of complete records, which buffers writes until `commit`.

    A failed commit is undone by truncating the file to the previous one. Between two commits the file therefore always
    ends with a complete record, even if the process is killed. A file that exists, or cannot be created, raises
    `OSError`.
    """

    def __init__(self, path: Path) -> None:
        self.raw = path.open("x+b", buffering=0)
        self._pending: list[bytes] = []
        self.committed = 0

    def write(self, data: bytes) -> None:
        """Buffer the bytes of one or more complete records."""
        self._pending.append(data)

    @property
    def pending(self) -> bool:
        """Whether there are uncommitted writes."""
        return bool(self._pending)

    def commit(self) -> None:
        """Pass all buffered writes to the operating system; after an `OSError` none of them is in the file."""
        data = memoryview(b"".join(self._pending))
        self._pending.clear()
        try:
            self.raw.seek(self.committed)
            done = 0
            while done < len(data):
                done += self.raw.write(data[done:]) or 0
        except OSError:
            self.cut(self.committed)
            raise
        self.committed += len(data)

    def cut(self, end: int) -> None:
        """Truncate the file at `end`, if the disk still allows it."""
        self._pending.clear()
        self.committed = end
        with suppress(OSError):
            self.raw.truncate(end)

    def sync(self) -> None:
        """Wait until all committed data is on the disk."""
        os.fsync(self.raw.fileno())

    def close(self) -> None:
        """Close the file; uncommitted writes are lost."""
        self.raw.close()


class Reserve:
    """Disk space reserved in a folder, to be released when the disk is full.

    An unnamed file reserves it, so nothing remains however the process ends.
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 - held until released
        self._size = 0

    def hold(self, size: int) -> None:
        """Reserve at least `size` bytes, in steps of 64 KiB; after an `OSError` the previous reservation remains."""
        if size <= self._size:
            return
        rounded = -(-size // _RESERVE_STEP) * _RESERVE_STEP
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self._file.fileno(), 0, rounded)
        else:
            self._file.write(bytes(rounded - self._size))
        self._size = rounded

    def release(self) -> None:
        """Release the space."""
        self._file.close()

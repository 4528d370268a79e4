"""The file under a bag writer: it holds whole records only, and disk space is kept back for its end."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_RESERVE_STEP = 2**16


class RecordFile:
    """A new file as output stream of an MCAP writer that collects what is written until `commit`.

    A commit that fails is undone: the file is cut back to where the commit before ended. So between two
    commits it always ends behind a whole record, also when the process is killed. A file that exists, or cannot be
    created, raises `OSError`.
    """

    def __init__(self, path: Path) -> None:
        self.raw = path.open("x+b", buffering=0)
        self._pending: list[bytes] = []
        self._pending_size = 0
        self.committed = 0

    def write(self, data: bytes) -> int:
        """Take over the bytes of one or more complete records."""
        if data:
            self._pending.append(data)
            self._pending_size += len(data)
        return len(data)

    @property
    def pending(self) -> bool:
        """Whether something waits for `commit`."""
        return bool(self._pending)

    def tell(self) -> int:
        """Return the position behind all that was written, committed or not."""
        return self.committed + self._pending_size

    def flush(self) -> None:
        """Do nothing: only `commit` reaches the disk."""

    def commit(self) -> None:
        """Hand all that was written to the operating system; after an `OSError` nothing of it is in the file."""
        data = memoryview(b"".join(self._pending))
        self._pending.clear()
        self._pending_size = 0
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
        """Cut the file off at `end`, as far as the disk still allows."""
        self._pending.clear()
        self._pending_size = 0
        self.committed = end
        with suppress(OSError):
            self.raw.truncate(end)

    def sync(self) -> None:
        """Wait until all that was committed is on the disk."""
        os.fsync(self.raw.fileno())

    def close(self) -> None:
        """Close the file; what was not committed is lost."""
        self.raw.close()


class Reserve:
    """Disk space held back in the folder of a file, to be given up when the disk is full.

    It is held by a file without a name, so nothing of it is left behind, however the process ends.
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 - held until released
        self._size = 0

    def hold(self, size: int) -> None:
        """Hold at least `size` bytes, in steps of 64 KiB; after an `OSError` what was held before still is."""
        if size <= self._size:
            return
        wanted = -(-size // _RESERVE_STEP) * _RESERVE_STEP
        os.posix_fallocate(self._file.fileno(), 0, wanted)
        self._size = wanted

    def release(self) -> None:
        """Give the space back."""
        self._file.close()

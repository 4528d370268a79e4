"""Disks of virtual recorders: writes may be short, the disk full, the power cut.

What was written and not synced may be lost page by page at a power cut; what was passed to the operating system
survives the death of the process. The classes that write bags are those of the product; only what they ask of the
operating system is simulated.
"""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest

from swarmabs_bag.mcap import output
from swarmabs_bag.mcap.output import RecordFile
from swarmabs_bag.recorder import recording
from swarmabs_bag.run import writer
from swarmabs_bag.run.writer import CHUNK_BYTES, BagWriter

PAGE = 4096
RESERVED = 2**18
"""Bytes that a writer reserves at first for the end of its file."""
_IN_MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""Where temporary folders are fast."""


@contextmanager
def own_folder() -> Iterator[None]:
    """Have all temporary folders, also those of processes forked meanwhile, in one that is removed in the end."""
    before, place = tempfile.tempdir, None if "TMPDIR" in os.environ else _IN_MEMORY
    with tempfile.TemporaryDirectory(prefix="virtual-", dir=place) as folder:
        tempfile.tempdir = folder
        try:
            yield
        finally:
            tempfile.tempdir = before


class Disk:
    """A disk: what happens to writes.

    Some writes are short with the probability `short`. So many bytes are `free`, None: there is no end of them. Bags on
    it have chunks of `chunk_bytes`, and `clock` tells the time, s, for which a chunk has been open.
    """

    def __init__(
        self,
        draw: Random,
        clock: Callable[[], float],
        *,
        short: float = 0.0,
        free: int | None = None,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        self._draw, self._short, self._free = draw, short, free
        self.clock, self.chunk_bytes = clock, chunk_bytes
        self.files: dict[int, _Raw] = {}
        self.reserved: dict[int, int] = {}

    @property
    def full(self) -> bool:
        """Whether nothing more can be written."""
        return self._free is not None and self._free <= 0

    def room(self, wanted: int) -> int:
        """Return how many bytes are written of so many; raises `OSError` if the disk is full."""
        if self._free is not None:
            if self._free <= 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            wanted = min(wanted, self._free)
        if wanted > 1 and self._draw.random() < self._short:
            wanted = self._draw.randint(1, wanted)
        if self._free is not None:
            self._free -= wanted
        return wanted

    def reserve(self, number: int, size: int) -> None:
        """Reserve so many bytes for a file, or release them; raises `OSError` if there is no room for them."""
        more = size - self.reserved.get(number, 0)
        if self._free is not None:
            if more > self._free:
                raise OSError(errno.ENOSPC, "No space left on device")
            self._free -= more
        self.reserved[number] = size

    def close(self) -> None:
        """Close all files, as the end of a process does."""
        for file in self.files.values():
            file.close()

    def cut_power(self) -> None:
        """Lose some pages of what was not synced, and maybe the end of each file, or a file that never was."""
        draw = self._draw
        for file in self.files.values():
            if not file.unsynced or not file.path.exists():
                continue
            if not file.synced and draw.random() < 0.1:
                file.path.unlink()
                continue
            if not file.synced and draw.random() < 0.2:  # its length is written after its name
                file.path.write_bytes(b"")
                continue
            data = bytearray(file.path.read_bytes())
            for offset, size in file.unsynced:
                for page in range(offset // PAGE, (offset + size - 1) // PAGE + 1):
                    if draw.random() < 0.2:
                        begin, end = max(offset, page * PAGE), min(offset + size, (page + 1) * PAGE, len(data))
                        data[begin:end] = bytes(max(0, end - begin))
            if draw.random() < 0.7:
                first = min(file.unsynced[0][0], len(data))
                del data[draw.randint(first, len(data)) :]
            file.path.write_bytes(data)


class _Raw:
    """The operating system's side of a file; `unsynced` are the writes (offset, size) since the last sync."""

    def __init__(self, path: Path, actual: Any, disk: Disk, number: int) -> None:
        self.path, self._actual, self._disk, self._number = path, actual, disk, number
        self.unsynced: list[tuple[int, int]] = []
        self.synced = False
        self.seek, self.truncate, self.close = actual.seek, actual.truncate, actual.close

    def write(self, data: Any) -> int:
        written = int(self._actual.write(data[: self._disk.room(len(data))]))
        self.unsynced.append((self._actual.tell() - written, written))
        return written

    def fileno(self) -> int:
        return self._number


class Disks:
    """The disks of this process by the folders on them; other folders are as ever."""

    def __init__(self) -> None:
        self._disks: dict[Path, Disk] = {}
        self._of: dict[int, Disk] = {}
        self._numbers = count(-2, -1)  # no descriptor of the operating system

    def mount(self, folder: Path, disk: Disk) -> None:
        """Let a folder be on a disk."""
        self._disks[folder] = disk

    @contextmanager
    def used(self) -> Iterator[None]:
        """Let writers of bags use these disks."""
        system = SimpleNamespace(fsync=self._sync, posix_fallocate=self._reserve)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(output, "os", system)
            patch.setattr(output, "tempfile", SimpleNamespace(TemporaryFile=self._unnamed))
            patch.setattr(writer, "RecordFile", self._file)
            patch.setattr(recording, "BagWriter", self._writer)
            yield

    def _file(self, path: Path) -> RecordFile:
        file = RecordFile(path)
        if (disk := self._disks.get(path.parent)) is not None:
            number = next(self._numbers)
            file.raw = cast("Any", _Raw(path, file.raw, disk, number))
            disk.files[number] = cast("Any", file.raw)
            self._of[number] = disk
        return file

    def _writer(self, folder: Path, **options: Any) -> BagWriter:
        disk = self._disks[folder]
        return BagWriter(folder, **options, chunk_bytes=disk.chunk_bytes, monotonic=disk.clock)

    def _sync(self, number: int) -> None:
        if (disk := self._of.get(number)) is not None:
            disk.files[number].unsynced.clear()
            disk.files[number].synced = True
        elif number >= 0:
            os.fsync(number)

    def _unnamed(self, *, dir: Path, buffering: int) -> Any:  # noqa: A002 - as `tempfile` has it
        number, disk = next(self._numbers), self._disks.get(dir)
        if disk is None:
            return tempfile.TemporaryFile(dir=dir)
        self._of[number] = disk

        def close() -> None:
            disk.reserve(number, 0)

        return SimpleNamespace(fileno=lambda: number, close=close)

    def _reserve(self, number: int, offset: int, size: int) -> None:
        if (disk := self._of.get(number)) is not None:
            disk.reserve(number, offset + size)

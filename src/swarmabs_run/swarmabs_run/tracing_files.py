"""Shared-memory files of the ROS tracing library, which it makes when rclpy is imported and never removes."""

from __future__ import annotations

import os
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - this is what POSIX shared memory is on Linux
_PATTERN = "lttng-ust-wait-*"


@contextmanager
def tracing_files_removed(*, if_orphaned: bool = False) -> Iterator[None]:
    """Remove at the end of the block this user's files that no other process has mapped.

    The files wake processes when a tracing session starts; without them a process is merely not traced. A process maps
    them when it loads rclpy and keeps them mapped, so a file that is mapped is in use and one that is not is left over.

    With `if_orphaned` that is left to the process that started this one, as long as it lives.
    """
    before, parent = _files(), os.getppid()
    try:
        yield
    finally:
        left = set() if if_orphaned and os.getppid() == parent else _files()
        if left:
            mapped, hidden = mapped_by_others()
            for path in left - mapped:
                # A file that serves all users and was there already may be in use where this user cannot look.
                if path in before and hidden and not path.name.endswith(f"-{os.getuid()}"):
                    continue
                with suppress(OSError):  # removed by another run meanwhile
                    path.unlink()


def _files() -> set[Path]:
    """Return the files that belong to this user."""
    found = set()
    for path in SHARED_MEMORY.glob(_PATTERN):
        with suppress(OSError):
            if path.stat().st_uid == os.getuid():
                found.add(path)
    return found


def mapped_by_others() -> tuple[set[Path], bool]:
    """Return the files that other processes have mapped, and whether other users' processes cannot be examined."""
    mapped, hidden, prefix = set[Path](), False, f"{SHARED_MEMORY}/"
    for process in Path("/proc").iterdir():
        if not process.name.isdigit() or int(process.name) == os.getpid():
            continue
        try:
            maps = (process / "maps").read_text(encoding="utf-8", errors="replace")
        except PermissionError:
            with suppress(OSError):
                hidden |= process.stat().st_uid != os.getuid()
            continue
        except OSError:  # it has ended
            continue
        if prefix in maps:
            # The path is the sixth field; that of a file that was removed ends differently.
            fields = (line.split(maxsplit=5) for line in maps.splitlines() if prefix in line)
            mapped |= {Path(words[5]) for words in fields if len(words) == 6}
    return {path for path in mapped if path.parent == SHARED_MEMORY}, hidden

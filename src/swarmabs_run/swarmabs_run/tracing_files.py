"""Shared-memory files that the ROS tracing library creates when rclpy is imported and never removes."""

from __future__ import annotations

import os
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - the place of POSIX shared memory on Linux
_PATTERN = "lttng-ust-wait-*"


@contextmanager
def tracing_files_removed(*, if_orphaned: bool = False) -> Iterator[None]:
    """At the end of the block, remove this user's files that no other process has mapped.

    The files wake processes when a tracing session starts; without them a process is merely not traced. A process maps
    them when it loads rclpy and keeps them mapped, so a mapped file is in use and any other file is left over.

    With `if_orphaned`, remove them only if the parent process has ended; otherwise the parent removes them.
    """
    before, parent = _files(), os.getppid()
    try:
        yield
    finally:
        left = set() if if_orphaned and os.getppid() == parent else _files()
        if left:
            mapped, hidden = mapped_by_others()
            for path in left - mapped:
                # A pre-existing file for all users may be in use by processes that this user cannot examine.
                if path in before and hidden and not path.name.endswith(f"-{os.getuid()}"):
                    continue
                with suppress(OSError):  # another run has removed it meanwhile
                    path.unlink()


def _files() -> set[Path]:
    """Return the files that belong to this user."""
    own = set()
    for path in SHARED_MEMORY.glob(_PATTERN):
        with suppress(OSError):
            if path.stat().st_uid == os.getuid():
                own.add(path)
    return own


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
        except OSError:  # the process has ended
            continue
        if prefix in maps:
            # The path is the sixth field; the path of a removed file has a suffix, and so does not match.
            fields = (line.split(maxsplit=5) for line in maps.splitlines() if prefix in line)
            mapped |= {Path(words[5]) for words in fields if len(words) == 6}
    return {path for path in mapped if path.parent == SHARED_MEMORY}, hidden

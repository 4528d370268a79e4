"""Shared-memory files of the ROS tracing library, which it makes when rclpy is imported and never removes."""

from __future__ import annotations

from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

_SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - this is what POSIX shared memory is on Linux
_PATTERN = "lttng-ust-wait-*"


@contextmanager
def tracing_files_removed() -> Iterator[None]:
    """Remove at the end of the block the files that were not there at its beginning.

    They wake processes when a tracing session starts; without them a process is merely not traced.
    """
    before = set(_SHARED_MEMORY.glob(_PATTERN))
    try:
        yield
    finally:
        for path in set(_SHARED_MEMORY.glob(_PATTERN)) - before:
            with suppress(OSError):  # another user's, or gone already
                path.unlink()

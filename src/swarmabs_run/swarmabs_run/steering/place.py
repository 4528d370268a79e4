"""Where the socket of a run lies. Every node's process imports this: it needs nothing but the standard library."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

SOCKET = "steer.sock"
"""Name of the socket in the folder of a run."""


@contextmanager
def short_path(folder: Path) -> Iterator[Path]:
    """Give a path of a folder that is short, for as long as the block lasts.

    The path of a socket has 107 characters at most, and that of a folder has not; so the folder is named by a
    descriptor.

    Raises
    ------
    OSError
        If the folder cannot be opened.
    """
    directory = os.open(folder, os.O_PATH | os.O_DIRECTORY)
    try:
        yield Path(f"/proc/self/fd/{directory}")
    finally:
        os.close(directory)

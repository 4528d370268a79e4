"""A machine under load, so that a measurement shows what becomes of it there."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from swarmabs_run.parent_death import die_with_parent

if TYPE_CHECKING:
    from collections.abc import Iterator

PER_CORE = 2


def busy_processes() -> int:
    """Return how many processes keep the machine busy."""
    return PER_CORE * (os.cpu_count() or 1)


@contextmanager
def busy_machine() -> Iterator[None]:
    """Keep every core busy `PER_CORE` times over for the time of the block."""
    busy: list[subprocess.Popen[bytes]] = []
    try:
        for _ in range(busy_processes()):
            busy.append(  # noqa: PERF401 - those that were started must end if one cannot be
                subprocess.Popen(
                    [sys.executable, "-c", "while True: pass"],
                    stdin=subprocess.DEVNULL,
                    start_new_session=True,
                    preexec_fn=partial(die_with_parent, os.getpid()),  # noqa: PLW1509 - it calls nothing but the kernel
                )
            )
        yield
    finally:
        for process in busy:
            process.kill()
        for process in busy:
            process.wait()

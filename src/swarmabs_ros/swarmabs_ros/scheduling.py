"""What a process may ask of the kernel so that its steps come in time: a real-time priority, memory that stays in."""

from __future__ import annotations

import ctypes
import os
import threading
from contextlib import suppress
from pathlib import Path

from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter

SCHEDULING = Parameter(
    "scheduling",
    "other",
    "scheduling of the node's threads: other, or a real-time class",
    choices=("other", "fifo", "rr"),
)
PRIORITY = Parameter(
    "priority",
    50,
    "priority within a real-time class of the thread that makes the steps; all others have one less",
    minimum=2,
    maximum=99,
)
LOCK_MEMORY = Parameter("lock_memory", default=False, description="whether to keep all memory from being paged out")
PARAMETERS = (SCHEDULING, PRIORITY, LOCK_MEMORY)

_CLASSES = {"fifo": os.SCHED_FIFO, "rr": os.SCHED_RR}
_MCL_CURRENT, _MCL_FUTURE = 1, 2  # sys/mman.h on Linux, x86-64 and ARM


def schedule_threads(name: str, priority: int) -> None:
    """Give all threads of this process a scheduling class, the calling one a higher priority; `other` changes nothing.

    The others matter: they bring the messages, and one that has the interpreter keeps the calling thread waiting.

    Raises
    ------
    InputError
        If this process may not; the text says what it needs.
    """
    if name not in _CLASSES:
        return
    own = threading.get_native_id()
    try:
        for entry in Path("/proc/self/task").iterdir():
            thread = int(entry.name)
            with suppress(ProcessLookupError):  # it has ended meanwhile
                os.sched_setscheduler(thread, _CLASSES[name], os.sched_param(priority - (thread != own)))
    except OSError as error:
        raise InputError(
            f"parameter {SCHEDULING.name}: this process may not have {name} priority {priority} ({error.strerror}); "
            f"allow it (systemd: LimitRTPRIO={priority}; otherwise the capability CAP_SYS_NICE), or give 'other'"
        ) from error


def lock_memory() -> None:
    """Keep all memory of this process, present and future, from being paged out.

    Raises
    ------
    InputError
        If this process may not; the text says what it needs.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        raise InputError(
            f"parameter {LOCK_MEMORY.name}: this process may not lock its memory ({os.strerror(ctypes.get_errno())}); "
            "allow it (systemd: LimitMEMLOCK=infinity; otherwise the capability CAP_IPC_LOCK), or give false"
        )

"""How much memory there is for what is read."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import psutil

_GROUP = Path("/sys/fs/cgroup")


def available_memory() -> int:
    """Return the bytes that this process may still take: of the machine, its control group and its limits."""
    machine = int(psutil.virtual_memory().available)
    return max(0, min(machine, _of_group(machine), _of_limit(machine)))


def _of_group(otherwise: int) -> int:
    """Return what is left of the limit of the control group, such as that of a container."""
    try:
        most, used = ((_GROUP / name).read_text(encoding="ascii") for name in ("memory.max", "memory.current"))
        return int(most) - int(used)
    except (OSError, ValueError):  # ValueError: the text "max"
        return otherwise


def _of_limit(otherwise: int) -> int:
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return otherwise if limit == resource.RLIM_INFINITY else limit - psutil.Process(os.getpid()).memory_info().vms

"""What a result depends on besides the code."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import psutil

from swarmabs_bag.provenance import versions


def machine_facts() -> dict[str, object]:
    """Return processor, kernel, memory, versions, limits and the load of the last minute."""
    return {
        "processor": _processor(),
        "architecture": platform.machine(),
        "cores": os.cpu_count(),
        "usable_cores": len(os.sched_getaffinity(0)),
        "memory_bytes": psutil.virtual_memory().total,
        "kernel": platform.release(),
        "receive_buffer_max": _number("/proc/sys/net/core/rmem_max"),
        "load_before": round(os.getloadavg()[0], 2),
        "versions": {**versions(), **_version_of("pyzmq"), **_version_of("scipy")},
    }


def _processor() -> str | None:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        name, _, text = line.partition(":")
        if name.strip() == "model name":
            return text.strip()
    return None


def _number(path: str) -> int | None:
    try:
        return int(Path(path).read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None


def _version_of(name: str) -> dict[str, str]:
    try:
        return {name: version(name)}
    except PackageNotFoundError:
        return {}

"""What the tests of sweeps look at: the folder of a sweep that goes on, and its worker processes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq


def finished(folder: Path) -> int:
    """Return how many cases of a sweep that goes on are finished."""
    try:
        return (folder / "cases.jsonl").read_bytes().count(b"\n")
    except FileNotFoundError:
        return 0


def summary(folder: Path) -> Any:
    return json.loads((folder / "summary.json").read_text())


def rows(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = pq.read_table(folder / "results.parquet").to_pylist()
    return found


def workers(pid: int) -> list[psutil.Process]:
    """Return the worker processes of a local sweep."""
    children = psutil.Process(pid).children()
    return [child for child in children if any("spawn_main" in part for part in child.cmdline())]

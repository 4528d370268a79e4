"""A bag as a file of numpy arrays."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmabs_analysis.export.tables import TABLES, row_of
from swarmabs_bag.arrays import arrays_since, available_memory, load_tables
from swarmabs_bag.attached import step_period
from swarmabs_bag.errors import BagTooLargeError
from swarmabs_bag.reader import open_bag
from swarmabs_core.arrays import MessageArrays
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import EVENTS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from swarmabs_bag.reader import BagReader
    from swarmabs_core.arrays import RunArrays

_EVENT_BYTES = 500
"""Memory that a decoded event takes, without a long text."""


def export_arrays(path: Path | str, file: Path, *, namespace: str | None = None) -> Path:
    """Write the arrays of a bag (`load_arrays`) and its events into a new ``.npz`` file, whole or not at all.

    Names are those of `RunArrays` and of the fields, joined by underscores, such as ``agents_position`` of shape (n+1,
    N); the fields of the E events, in the order of the bag, are ``events_step``, ``events_detail`` and so on of shape
    (E,), texts as fixed-width unicode; ``units`` is a JSON text of the units. Nothing in it is pickled.

    Raises
    ------
    InputError
        If it is no bag of a swarm, its arrays do not fit into memory, or the file is there already.
    RunError
        If the bag is damaged, or the file cannot be written.
    """
    if file.suffix != ".npz":
        raise InputError(f"{file} does not end in .npz; name a file such as {file.with_suffix('.npz')} with -o")
    if file.exists():
        raise InputError(f"{file} is there already; name another with -o, or remove it")
    bag = open_bag(path, namespace=namespace)
    run, start = arrays_since(bag, load_tables(bag))
    arrays: dict[str, NDArray[Any]] = {**dict(_named(run)), **_events(bag, start)}
    units = {name: unit for name, unit in _units().items() if name in arrays}
    part = file.with_name(f".{file.name}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as stream:
            np.savez(stream, units=np.array(json.dumps(units)), **arrays)  # type: ignore[arg-type]
        part.replace(file)
    except OSError as error:
        raise RunError(f"cannot write {file}: {error.strerror or error}; name another file with -o") from error
    finally:
        part.unlink(missing_ok=True)
    return file


def _named(run: RunArrays) -> Iterator[tuple[str, NDArray[Any]]]:
    for field in fields(run):
        value = getattr(run, field.name)
        if isinstance(value, MessageArrays):
            yield from ((f"{field.name}_{name}", array) for name, array in value.items())
        else:
            yield field.name, value


def _events(bag: BagReader, start: float) -> dict[str, NDArray[Any]]:
    """Return the events' fields, each of shape (E,), times since `start` (s); a bag without the topic has none."""
    (table,) = (table for table in TABLES if table.topic is EVENTS)
    count = sum(channel.message_count for channel in bag.channels if channel.topic is EVENTS)
    _check_memory(bag, count * _EVENT_BYTES)
    row = row_of(table, step_period(bag))
    rows = [row(message) for _, _, message in bag.decoded((EVENTS,))]
    columns = zip(*rows, strict=True) if rows else ((),) * len(table.columns)
    arrays = {}
    for column, values in zip(table.columns, columns, strict=True):
        kind: str = column.type
        if kind == "string":
            widest = max(map(len, values), default=0)
            _check_memory(bag, len(rows) * widest * np.dtype("U1").itemsize)
            kind = f"U{max(widest, 1)}"
        arrays[f"events_{column.name}"] = np.array(values, dtype=kind)
    arrays["events_time"] -= start
    return arrays


def _check_memory(bag: BagReader, needed: int) -> None:
    available = available_memory()
    if needed > available:
        raise BagTooLargeError(
            f"{bag.path}: its events take about {needed / 1e6:.0f} MB as arrays, but {available / 1e6:.0f} MB are free;"
            " export it with --format csv or parquet"
        )


def _units() -> dict[str, str]:
    """Return the units by the names of arrays: those of the plane have no prefix."""
    units = {"agents_ids": "1"}
    for table in TABLES:
        for column in table.columns:
            if column.name == "stamp" and table.topic is not EVENTS:
                continue
            plain = table.name == "plane" or (column.name in {"step", "time"} and table.topic is not EVENTS)
            units[column.name if plain else f"{table.name}_{column.name}"] = column.unit
    return units

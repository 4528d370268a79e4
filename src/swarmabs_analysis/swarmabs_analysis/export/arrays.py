"""A bag as a file of arrays, for numpy or MATLAB."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import IO, TYPE_CHECKING, Any, Literal

import numpy as np

from swarmabs_analysis.export.matlab import write_mat
from swarmabs_analysis.export.tables import WORD, tables_of
from swarmabs_bag.arrays import arrays_since, available_memory, load_messages
from swarmabs_bag.attached import event_time
from swarmabs_bag.errors import BagTooLargeError
from swarmabs_bag.reader import open_bag
from swarmabs_config.files import whole_file
from swarmabs_core.arrays import MessageArrays
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import EVENTS, Field, SwarmEvent, fields_of, word

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from swarmabs_analysis.export.tables import BagTable
    from swarmabs_bag.reader import BagReader
    from swarmabs_core.arrays import RunArrays


ArrayFormat = Literal["numpy", "mat"]
_VECTORS = {"parent": "state"}
"""The vector of a message by the name of its array in `RunArrays`, where they differ."""
SUFFIXES: dict[ArrayFormat, str] = {"numpy": ".npz", "mat": ".mat"}
"""Endings of the files of arrays."""


def export_arrays(
    path: Path | str, file: Path, array_format: ArrayFormat = "numpy", *, namespace: str | None = None
) -> Path:
    """Write the arrays of a bag (`load_arrays`), its events and summary to a new file, complete or not at all.

    Names are those of `RunArrays` and of the fields, joined by underscores, such as ``agents_position`` of shape (n+1,
    N); the fields of the E events, in the order of the bag, are ``events_step``, ``events_detail`` and so on of shape
    (E,). On another parent system than the plane, they are named by table and column,
    such as ``parent_roll`` and ``agents_position``. There are also ``units``, ``words`` (the names of the values in
    arrays of constants such as ``agents_kind``) and ``summary``: in a ``.npz`` file as JSON texts, in a ``.mat`` file
    as structs. Strings are fixed-width unicode in numpy, cells in MATLAB. Nothing is pickled.

    Raises
    ------
    InputError
        If it is not the bag of a swarm, its arrays do not fit into memory, or the file exists.
    RunError
        If the bag is damaged, or the file cannot be written.
    """
    suffix = SUFFIXES[array_format]
    if file.suffix != suffix:
        raise InputError(f"{file} does not end in {suffix}; name a file such as {file.with_suffix(suffix)} with -o")
    if file.exists():
        raise InputError(f"{file} exists; name another file with -o, or remove it")
    bag = open_bag(path, namespace=namespace)
    messages = load_messages(bag)
    run, start = arrays_since(bag, messages)
    tables = tables_of(bag)
    arrays: dict[str, NDArray[np.generic]] = {**dict(_named(run, tables)), **_events(bag, messages.events, start)}
    units = {name: unit for name, unit in _units(tables).items() if name in arrays}
    described = {"units": units, "words": _words(tables), "summary": run.summary()}
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as stream:
            (_write_npz if array_format == "numpy" else _write_mat)(stream, {**described, **arrays})
    except OSError as error:
        raise RunError(f"cannot write {file}: {error.strerror or error}; name another file with -o") from error
    return file


def _write_npz(stream: IO[bytes], content: Mapping[str, Any]) -> None:
    texts = {name: np.array(json.dumps(value)) for name, value in content.items() if isinstance(value, dict)}
    np.savez(stream, **{**content, **texts})


def _write_mat(stream: IO[bytes], content: Mapping[str, Any]) -> None:
    words = {array: {name: value for value, name in names.items()} for array, names in content["words"].items()}
    write_mat(stream, {**content, "words": words})  # the fields of a struct are names


def _named(run: RunArrays, tables: Sequence[BagTable]) -> Iterator[tuple[str, NDArray[np.generic]]]:
    """Yield the arrays of a run, an array for each component of a vector."""
    by_name = {table.name: table for table in tables}
    for key, value in ({field.name: getattr(run, field.name) for field in fields(run)} | {**run.further}).items():
        if isinstance(value, MessageArrays):
            table = by_name[key]
            vectors = dict.fromkeys(vector for vector, _ in table.vectors.values())
            yield from ((f"{key}_{name}", array) for name, array in value.items() if name not in vectors)
            for vector in vectors:
                yield from _components(table, vector, getattr(value, vector))
        elif isinstance(value, np.ndarray) and value.ndim == 1:
            yield key, value
        elif isinstance(value, np.ndarray) and "parent" not in by_name:  # the plane, whose numbers are fields
            yield from zip((row.name for row in run.description.parent), value.T, strict=True)
        elif isinstance(value, np.ndarray):
            yield from _components(by_name["parent"], _VECTORS.get(key, key), value)


def _components(table: BagTable, vector: str, values: NDArray[np.generic]) -> Iterator[tuple[str, NDArray[np.generic]]]:
    """Yield the components of a vector by the names of their columns."""
    for name, (of, index) in table.vectors.items():
        if of == vector and index < values.shape[-1]:
            yield f"{table.name}_{name}", values[..., index]


def _events(bag: BagReader, events: Sequence[SwarmEvent], start: float) -> dict[str, NDArray[np.generic]]:
    """Return the events' fields, each of shape (E,), with times since `start` (s)."""
    time = event_time(bag)
    widest = max((len(event.detail) for event in events), default=1)
    _check_memory(bag, len(events) * widest * np.dtype("U1").itemsize)
    stamps = np.array([event.stamp for event in events], dtype=np.float64) / 1e9
    times = np.array([time(event) for event in events], dtype=np.float64)
    arrays: dict[str, NDArray[np.generic]] = {"events_stamp": stamps, "events_time": times - start}
    for name, field in fields_of(SwarmEvent).items():
        if name != "stamp" and isinstance(field, Field):
            kind = f"U{max(widest, 1)}" if field.ros_type == "string" else field.ros_type
            arrays[f"events_{name}"] = np.array([getattr(event, name) for event in events], dtype=kind)
    return arrays


def _words(tables: Sequence[BagTable]) -> dict[str, dict[int, str]]:
    """Return the names of the values in arrays of constants."""
    return {
        f"{table.name}_{name}": {value.value: word(value) for value in field.constants}
        for table in tables
        for name, field in fields_of(table.topic.message).items()
        if isinstance(field, Field) and field.constants is not None
    }


def _check_memory(bag: BagReader, needed: int) -> None:
    available = available_memory()
    if needed > available:
        raise BagTooLargeError(
            f"{bag.path}: its events need about {needed / 1e6:.0f} MB as arrays, but only {available / 1e6:.0f} MB are"
            " free; use --format csv or parquet"
        )


def _units(tables: Sequence[BagTable]) -> dict[str, str]:
    """Return the units by name of the array; arrays of the plane have no prefix."""
    units = {"agents_ids": "1"}
    for table in tables:
        for column in table.columns:
            if column.name == "stamp" and table.topic is not EVENTS:
                continue
            plain = table.name == "plane" or (column.name in {"step", "time"} and table.topic is not EVENTS)
            units[column.name if plain else f"{table.name}_{column.name}"] = "1" if column.type == WORD else column.unit
    return units

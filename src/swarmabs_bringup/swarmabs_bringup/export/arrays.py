"""A bag as a file of numpy arrays."""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmabs_bringup.bag import load_arrays
from swarmabs_bringup.export.columns import TABLES
from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray


def export_arrays(path: Path | str, file: Path, *, namespace: str | None = None) -> Path:
    """Write the arrays of a bag (`load_arrays`) into a new ``.npz`` file, whole or not at all, and return it.

    Names are those of `RunArrays` joined by underscores, such as ``agents_position`` of shape (n+1, N); ``units`` is a
    JSON text of their units. Nothing in it is pickled.

    Parameters
    ----------
    path : Path or str
        A run folder, its ``bag/``, or an MCAP file.
    file : Path
        The file, which must not exist.
    namespace : str, optional
        Which swarm to export if the bag holds several.

    Raises
    ------
    InputError
        If it is no bag of a swarm, or the file is there already or cannot be made.
    RunError
        If the bag is damaged or the disk fails.
    """
    if file.suffix != ".npz":
        raise InputError(f"{file} does not end in .npz; name a file such as {file.with_suffix('.npz')} with -o")
    if file.exists():
        raise InputError(f"{file} is there already; name another with -o, or remove it")
    arrays: dict[str, NDArray[Any]] = dict(_named(load_arrays(path, namespace=namespace), ""))
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


def _named(group: Any, prefix: str) -> Iterator[tuple[str, NDArray[Any]]]:
    for field in fields(group):
        value = getattr(group, field.name)
        name = f"{prefix}{field.name}"
        if is_dataclass(value):
            yield from _named(value, f"{name}_")
        else:
            yield name, value


def _units() -> dict[str, str]:
    """Return the units by the names of arrays: those of the plane have no prefix."""
    return {
        (
            column.name if table.name == "plane" or column.name in {"step", "time"} else f"{table.name}_{column.name}"
        ): column.unit
        for table in TABLES
        for column in table.columns
    } | {"agents_ids": "1"}

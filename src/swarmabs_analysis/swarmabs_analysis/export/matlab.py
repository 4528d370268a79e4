"""MATLAB files (MAT, level 5), which MATLAB, Octave and SciPy read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import IO, TYPE_CHECKING

import numpy as np

from swarmabs_config.installation import lacking
from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable

LARGEST = 2**31
"""Size of a variable that the format cannot hold, bytes."""
_LONGEST = 63
"""Characters of a name in MATLAB."""
_HEAD = b"MATLAB 5.0 MAT-file, written by swarmabs".ljust(116)
"""Description at the beginning of a file, without the time at which it was written."""


def write_mat(stream: IO[bytes], variables: Mapping[str, object]) -> None:
    """Write variables by name to a seekable stream; the same variables give the same bytes.

    A mapping becomes a struct, an array of texts a cell array, None an empty array, an array (n,) a column. In a name,
    each character that MATLAB does not allow becomes ``_``, such as in ``plane_angle``.

    Raises
    ------
    InputError
        If an array is too large for the format.
    """
    try:
        from scipy.io import savemat  # noqa: PLC0415 - may be missing
    except ModuleNotFoundError as error:
        raise lacking(error, "a MAT file") from None

    start = stream.tell()
    savemat(stream, _fields(variables), long_field_names=True, oned_as="column")
    stream.seek(start)
    stream.write(_HEAD)
    stream.seek(0, 2)


def _fields(values: Mapping[str, object]) -> dict[str, object]:
    """Return values as SciPy writes them, by their names in MATLAB."""
    return {name: _value(name, value) for name, value in zip(_names(values), values.values(), strict=True)}


def _value(name: str, value: object) -> object:
    if isinstance(value, Mapping):
        return _fields(value)
    if value is None:
        return np.empty((0, 0))
    if isinstance(value, np.ndarray):
        if value.nbytes >= LARGEST:
            raise InputError(f"{name} has {value.nbytes / 1e9:.1f} GB, too much for a MAT file; use --format numpy")
        return value.astype(object) if value.dtype.kind == "U" else value
    return value


def _names(names: Iterable[str]) -> list[str]:
    """Return different names that MATLAB allows."""
    distinct: dict[str, None] = {}
    for text in names:
        name = re.sub(r"^(?=[^a-zA-Z])", "x", re.sub(r"\W", "_", text, flags=re.ASCII))[:_LONGEST]
        number = 1
        while (unused := name if number == 1 else f"{name[: _LONGEST - 4]}_{number}") in distinct:
            number += 1
        distinct[unused] = None
    return list(distinct)

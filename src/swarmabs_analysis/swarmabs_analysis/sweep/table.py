"""``results.parquet``: one row per case, in order of the cases."""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from swarmabs_analysis.sweep.study import Study

_TYPES = {
    "case": pa.int64(),
    "status": pa.string(),
    "outcome": pa.string(),
    "reason": pa.string(),
    "seed": pa.int64(),
    "digest": pa.string(),
    "settled_at": pa.float64(),
    "final_error": pa.float64(),
    "rms_error": pa.float64(),
    "max_abs_position": pa.float64(),
    "max_abs_angle": pa.float64(),
    "messages": pa.int64(),
    "initial_error_squared": pa.float64(),
    "in_printed_estimate": pa.bool_(),
    "in_corrected_estimate": pa.bool_(),
}


def parquet(study: Study, rows: Mapping[int, Mapping[str, Any]]) -> bytes:
    """Return the table of all cases as the content of a Parquet file.

    Columns are ``case``, the parameters by their paths, the results, ``status``, ``outcome``, ``reason``, ``seed`` and
    ``digest``. A parameter whose values are not all numbers, or not all texts, is written as JSON. The file's metadata
    hold the sweep and its scenario. Equal sweeps give equal bytes.

    Parameters
    ----------
    study : Study
        The sweep.
    rows : mapping of int to mapping
        The finished cases by index, all of them.
    """
    order = range(study.sweep.count)
    cases = [study.case(index) for index in order]
    columns = {"case": pa.array(order, _TYPES["case"])}
    for path in study.sweep.parameters:
        columns[path] = _parameter([case.values[path] for case in cases])
    for name in (*study.sweep.results, "status", "outcome", "reason"):
        columns[name] = pa.array([rows[index].get(name) for index in order], _TYPES[name])
    columns["seed"] = pa.array([case.seed for case in cases], _TYPES["seed"])
    columns["digest"] = pa.array([rows[index].get("digest") for index in order], _TYPES["digest"])
    described = {"swarmabs.sweep": study.sweep_text, "swarmabs.scenario": study.scenario}
    file = io.BytesIO()
    pq.write_table(pa.table(columns).replace_schema_metadata(described), file, compression="zstd")
    return file.getvalue()


def _parameter(values: Sequence[Any]) -> Any:
    """Return the column of a parameter in the simplest type that holds all its values."""
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int} and all(abs(value) < 2**63 for value in values if value is not None):
        return pa.array(values, pa.int64())
    if kinds and kinds <= {int, float}:
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    if kinds in ({bool}, {str}):
        return pa.array(values)
    return pa.array([json.dumps(value) for value in values], pa.string())

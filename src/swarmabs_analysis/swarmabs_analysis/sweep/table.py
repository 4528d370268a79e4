"""The table of a sweep, one row per case, in the formats of exports, and the units of its columns."""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow.csv import write_csv

from swarmabs_analysis.export.matlab import write_mat
from swarmabs_analysis.export.tables import COLUMNS_FILE, Column, described_columns
from swarmabs_analysis.sweep.folder import RESULTS_FILE
from swarmabs_bag.run.figures import tracking_of
from swarmabs_config.model.declared import unit_at
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.systems.interface import Quantity

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from swarmabs_analysis.sweep.evaluate import Row
    from swarmabs_analysis.sweep.study import Study
    from swarmabs_bag.run.figures import Tracking
    from swarmabs_config.scenario import Scenario

_TYPES = {"double": "float64"}
"""Types of Arrow that exports name otherwise."""
_COLUMNS = {
    "case": (pa.int64(), "number of the case"),
    "settled_at": (
        pa.float64(),
        "first time after which the error stays within the tolerance; missing if it does not",
    ),
    "final_error": (pa.float64(), "reference minus state at the end"),
    "rms_error": (pa.float64(), "root mean square of the error"),
    "max_abs_position": (pa.float64(), "largest distance of a robot from the origin"),
    "max_abs_angle": (pa.float64(), "largest absolute value of the tracked quantity"),
    "messages": (pa.int64(), "number of messages"),
    "initial_error_squared": (pa.float64(), "square of z at the start"),
    "in_printed_estimate": (pa.bool_(), "whether the start is within the estimate as printed"),
    "in_corrected_estimate": (pa.bool_(), "whether the start is within the corrected estimate"),
    "status": (pa.string(), "ok, failed or refused"),
    "outcome": (pa.string(), "settled, unsettled, off_plane, failed or refused"),
    "reason": (pa.string(), "why it failed or was refused; otherwise missing"),
    "seed": (pa.int64(), "seed of the scenario"),
    "digest": (pa.string(), "digest of the run"),
}
"""Type and meaning of the columns that are no parameters."""


def table_files(study: Study, rows: Mapping[int, Row]) -> dict[str, bytes]:
    """Return the files of the table by name: Parquet, CSV, MATLAB, and the description of its columns."""
    table = results_table(study, rows)
    columns = _columns(study, table)
    return {
        "results.csv": csv(table),
        "results.mat": _mat(study, table, columns),
        COLUMNS_FILE: described_columns([("results", columns)]).encode(),
        RESULTS_FILE: parquet(_with_units(table, columns)),
    }


def unit_of(scenario: Scenario, path: str) -> str:
    """Return the unit of the parameter at a path of a scenario, empty if it has none."""
    return unit_at(scenario, path).replace("^2", "²")


def metrics_of(tracking: Tracking) -> dict[str, str]:
    """Return the results that can be drawn, with their units, by their names."""
    largest = Quantity(f"max |{tracking.name}|", tracking.unit)
    labels = {name: figure.label for name, figure in (tracking.figures | {"max_abs_angle": largest}).items()}
    return labels | {"initial_error_squared": "|z|² at the start"}


def results_table(study: Study, rows: Mapping[int, Row]) -> pa.Table:
    """Return the results as a table of Arrow: one row per case in order; all cases must be finished.

    Columns are ``case``, the parameters by their paths, the results, ``status``, ``outcome``, ``reason``, ``seed`` and
    ``digest``. A parameter whose values are neither all numbers nor all strings is written as JSON. The metadata
    contains the sweep and its scenario.
    """
    cases = list(study.cases())
    complete = [{**rows[case.index], "case": case.index, "seed": case.seed} for case in cases]

    def column(name: str) -> pa.Array:
        kind, _ = _COLUMNS[name]
        return pa.array([row.get(name) for row in complete], kind)

    columns = {"case": column("case")}
    columns |= {path: _parameter([case.values[path] for case in cases]) for path in study.sweep.parameters}
    names = (*study.sweep.results, "status", "outcome", "reason", "seed", "digest")
    columns |= {name: column(name) for name in names}
    described = {"swarmabs.sweep": study.sweep_text, "swarmabs.scenario": study.scenario}
    return pa.table(columns).replace_schema_metadata(described)


def parquet(table: pa.Table) -> bytes:
    """Return ``results.parquet``; equal tables give equal bytes."""
    file = io.BytesIO()
    pq.write_table(table, file, compression="zstd")
    return file.getvalue()


def csv(table: pa.Table) -> bytes:
    """Return ``results.csv``: a line of names, then one per case; numbers with every digit, null as an empty field."""
    file = io.BytesIO()
    write_csv(table, file)
    return file.getvalue()


def _columns(study: Study, table: pa.Table) -> list[Column]:
    """Return type, unit and meaning of each column."""
    scenario = parse_scenario(study.scenario)
    metrics = metrics_of(tracking_of(scenario))
    units = {name: label.partition(", ")[2] for name, label in metrics.items()}
    columns = []
    for field in table.schema:
        kind, name = _TYPES.get(str(field.type), str(field.type)), field.name
        if name in study.sweep.parameters:
            unit, meaning = unit_of(scenario, name), "parameter"
        else:
            unit, (_, meaning) = units.get(name, ""), _COLUMNS[name]
        columns.append(Column(name, kind, unit, meaning))
    return columns


def _with_units(table: pa.Table, columns: Sequence[Column]) -> pa.Table:
    """Return a table of Arrow with unit and meaning in the metadata of each column, as exports have them."""
    fields = [field.with_metadata(column.metadata) for field, column in zip(table.schema, columns, strict=True)]
    return table.cast(pa.schema(fields, table.schema.metadata))


def _mat(study: Study, table: pa.Table, columns: Sequence[Column]) -> bytes:
    """Return ``results.mat``: the columns in a struct, their units in another, and the texts of sweep and scenario."""
    file = io.BytesIO()
    write_mat(
        file,
        {
            "results": {name: _array(table[name]) for name in table.column_names},
            "units": {column.name: column.unit for column in columns},
            "sweep": study.sweep_text,
            "scenario": study.scenario,
        },
    )
    return file.getvalue()


def _array(column: pa.ChunkedArray) -> NDArray[np.generic]:
    """Return a column as an array; a missing number is NaN, a missing text empty."""
    values = column.to_pylist()
    if pa.types.is_string(column.type):
        return np.array(["" if value is None else value for value in values], dtype=str)
    return np.array([np.nan if value is None else value for value in values])


def _parameter(values: Sequence[Any]) -> pa.Array:
    """Return the column of a parameter in the simplest type that fits all its values."""
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int} and all(abs(value) < 2**63 for value in values if value is not None):
        return pa.array(values, pa.int64())
    if kinds and kinds <= {int, float}:
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    if kinds in ({bool}, {str}):
        return pa.array(values)
    return pa.array([json.dumps(value) for value in values], pa.string())

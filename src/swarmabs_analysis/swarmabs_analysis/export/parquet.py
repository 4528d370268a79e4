"""Tables as Parquet files, some rows at a time."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from swarmabs_analysis.export.tables import AddRow, BagTable

_ROWS = 16_384
"""Rows of a row group; more are never in memory."""


@contextmanager
def parquet_file(folder: Path, table: BagTable) -> Iterator[AddRow]:
    """Yield what adds a row to a table's file; each column's metadata has its unit and meaning."""
    schema = pa.schema(
        pa.field(
            column.name,
            pa.type_for_alias(column.type),
            nullable=False,
            metadata={name: text for name, text in (("unit", column.unit), ("meaning", column.meaning)) if text},
        )
        for column in table.columns
    )
    rows: list[Sequence[Any]] = []
    with pq.ParquetWriter(folder / f"{table.name}.parquet", schema, compression="zstd") as writer:

        def write() -> None:
            columns = zip(zip(*rows, strict=True), schema, strict=True)
            arrays = [pa.array(values, field.type) for values, field in columns]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            rows.clear()

        def add(row: Sequence[Any]) -> None:
            rows.append(row)
            if len(rows) == _ROWS:
                write()

        yield add
        if rows:
            write()

"""Tables as Parquet files, some rows at a time."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from swarmabs_analysis.export.columns import BagTable

_ROWS = 16_384
"""Rows of a row group; more are never in memory."""


@contextmanager
def parquet_sink(folder: Path, table: BagTable) -> Iterator[_ParquetSink]:
    """Yield what writes a table's file; each column's metadata has its unit and meaning."""
    schema = pa.schema(
        pa.field(
            column.name,
            pa.type_for_alias(column.type),
            nullable=False,
            metadata=_described(column.unit, column.meaning),
        )
        for column in table.columns
    )
    with pq.ParquetWriter(folder / f"{table.name}.parquet", schema, compression="zstd") as writer:
        sink = _ParquetSink(writer, schema)
        yield sink
        sink.flush()


def _described(unit: str, meaning: str) -> dict[str, str]:
    return {name: text for name, text in (("unit", unit), ("meaning", meaning)) if text}


class _ParquetSink:
    """Gathers rows and writes them as row groups."""

    def __init__(self, writer: Any, schema: Any) -> None:
        self._writer = writer
        self._schema = schema
        self._rows: list[Sequence[Any]] = []

    def add(self, row: Sequence[Any]) -> None:
        """Take the next row."""
        self._rows.append(row)
        if len(self._rows) == _ROWS:
            self.flush()

    def flush(self) -> None:
        """Write what has been gathered."""
        if self._rows:
            columns = [
                pa.array(values, field.type)
                for values, field in zip(zip(*self._rows, strict=True), self._schema, strict=True)
            ]
            self._writer.write_table(pa.Table.from_arrays(columns, schema=self._schema))
            self._rows = []

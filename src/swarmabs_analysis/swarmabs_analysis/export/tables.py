"""A bag as a folder of tables, written row by row in bounded memory."""

from __future__ import annotations

import csv
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Protocol

from swarmabs_analysis.export.columns import TABLES, row_of
from swarmabs_bag.attached import step_period
from swarmabs_bag.errors import NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import new_folder
from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from swarmabs_analysis.export.columns import BagTable, TableFormat

COLUMNS_FILE = "columns.csv"


class Sink(Protocol):
    """Where the rows of a table go."""

    def add(self, row: Sequence[Any], /) -> object:
        """Take the next row."""
        ...


def export_tables(
    path: Path | str, folder: Path, table_format: TableFormat, *, namespace: str | None = None
) -> tuple[Path, ...]:
    """Write the tables of a bag into a new folder, whole or not at all, and return the files.

    Parameters
    ----------
    path : Path or str
        A run folder, its ``bag/``, or an MCAP file.
    folder : Path
        What must not exist, or be empty.
    table_format : {"csv", "parquet"}
        Kind of the files. Numbers in CSV have the digits that lead back to the same float64.
    namespace : str, optional
        Which swarm to export if the bag holds several.

    Raises
    ------
    InputError
        If it is no bag of a swarm, the folder is there already, or pyarrow is not installed.
    RunError
        If the bag is damaged or the disk fails.
    """
    bag = open_bag(path, namespace=namespace)
    if bag.namespace is None:
        raise NotABagError(f"{bag.path} is no bag of a swarm: it has no topic of one; name another bag")
    opened = _parquet() if table_format == "parquet" else _csv
    with new_folder(folder) as part, ExitStack() as stack:
        sinks = {table.topic: stack.enter_context(opened(part, table)) for table in TABLES}
        period = step_period(bag)
        rows = {table.topic: row_of(table, period) for table in TABLES}
        for topic, _, message in bag.decoded(tuple(sinks)):
            sinks[topic].add(rows[topic](message))
        _write_columns(part / COLUMNS_FILE)
    return tuple(sorted(folder.iterdir()))


@contextmanager
def _csv(folder: Path, table: BagTable) -> Iterator[Sink]:
    with (folder / f"{table.name}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([column.name for column in table.columns])
        yield _CsvSink(writer.writerow)


class _CsvSink:
    def __init__(self, write: Callable[[Sequence[Any]], object]) -> None:
        self.add = write


def _parquet() -> Callable[[Path, BagTable], AbstractContextManager[Sink]]:
    try:
        from swarmabs_analysis.export.parquet import parquet_sink  # noqa: PLC0415 - pyarrow may be missing
    except ImportError as error:
        raise InputError(
            f"Parquet needs the package pyarrow ({error}); install it, or use --format csv or numpy"
        ) from error
    return parquet_sink


def _write_columns(path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["table", "column", "type", "unit", "meaning"])
        writer.writerows([table.name, *column] for table in TABLES for column in table.columns)

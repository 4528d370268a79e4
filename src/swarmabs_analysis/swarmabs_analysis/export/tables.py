"""The tables of a bag, one per topic with one row per message, written row by row in bounded memory."""

from __future__ import annotations

import csv
import io
import json
from contextlib import ExitStack, contextmanager
from functools import cache, partial
from math import isnan
from operator import itemgetter
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from swarmabs_bag.attached import description_of, step_period
from swarmabs_bag.bag_summary import reference_of_bag, summarise_bag
from swarmabs_bag.errors import NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import new_folder
from swarmabs_config.installation import lacking
from swarmabs_core.errors import InputError
from swarmabs_core.messages import (
    EVENTS,
    PLANE_FAMILY,
    SYSTEM_FAMILY,
    Field,
    PlaneState,
    Topic,
    fields_of,
    word,
    word_of,
)
from swarmabs_core.systems import Quantity
from swarmabs_core.systems.components import MAIN_FIELDS, REFERENCE, components

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from swarmabs_bag.reader import BagReader
    from swarmabs_core.messages import Family, Message
    from swarmabs_core.systems import Vector

    Cell: TypeAlias = float | int | str | None
    """A value in a table; None if it is missing."""
    Row: TypeAlias = Sequence[Cell]
    AddRow: TypeAlias = Callable[[Row], object]

COLUMNS_FILE = "columns.csv"
SUMMARY_FILE = "summary.json"
PARQUET_ROWS = 16_384
"""Rows of a Parquet row group; at most this many are in memory."""
TableFormat = Literal["csv", "parquet"]
FILE_SUFFIXES = frozenset((".csv", ".parquet", ".npz", ".mat"))
"""Endings by which a reader takes a name for that of one file, which a folder of tables is not."""


class Column(NamedTuple):
    """A column: name, type, unit (1 for dimensionless numbers, empty for text) and meaning, unless the name says it."""

    name: str
    type: str
    unit: str
    meaning: str = ""

    @property
    def metadata(self) -> dict[str, str]:
        """Unit and meaning, as far as it has them, for Parquet."""
        return {name: text for name, text in (("unit", self.unit), ("meaning", self.meaning)) if text}


class BagTable(NamedTuple):
    """A topic as a table: time, stamp, the fields of the message by name, and for the parent also the reference.

    Constants appear as words; a value that means "none" is missing. `vectors` are field and index of the columns that
    contain a component of a vector, or of the reference.
    """

    name: str
    topic: Topic
    columns: tuple[Column, ...]
    vectors: Mapping[str, tuple[str, int]]


_TIME = Column("time", "float64", "s", "time of the step; in real time the stamp")
WORD = "word"
"""Type of columns of constants: text, in Parquet dictionary-encoded."""


def _table(name: str, topic: Topic, parts: Mapping[str, Sequence[Quantity]]) -> BagTable:
    """Return a topic as a table: step, time, robot, the fields of the message in order, and the stamp last.

    The `parts` are the components of the message's vectors, and the references.
    """
    declared = {name: field for name, field in fields_of(topic.message).items() if name != "system"}
    columns = {"time": _TIME} | {name: _column(name, field) for name, field in declared.items() if name not in parts}
    vectors = {}
    for field, several in parts.items():
        for index, (quantity, unit, *_) in enumerate(several):
            key = quantity if field in MAIN_FIELDS else "_".join(filter(None, (field, quantity)))
            while key in columns or key in declared:
                key = f"{field}_{key}"
            what = "reference with its offsets; missing if unknown" if field == REFERENCE else f"{field}[{index}]"
            columns[key] = Column(key, "float64", unit, what)
            vectors[key] = field, index
    stamp = columns.pop("stamp")
    first = [columns.pop(key) for key in ("step", "time", "agent_id") if key in columns]
    return BagTable(name, topic, (*first, *columns.values(), stamp), vectors)


def _column(name: str, field: Field | type[Message]) -> Column:
    assert isinstance(field, Field)  # noqa: S101 - recorded messages are never nested
    if field.ros_type == "time":
        return Column(name, "float64", "s", field.meaning)
    if field.constants is not None:
        return Column(name, WORD, "", f"one of {', '.join(map(word, field.constants))}")
    none = "; missing if none" if field.missing is not None else ""
    return Column(name, field.ros_type, field.unit, field.meaning + none)


def _tables(
    family: Family, parent: str, parts_of: Callable[[type[Message]], Mapping[str, Sequence[Quantity]]]
) -> tuple[BagTable, ...]:
    topics = dict(zip(("agents", parent, "abstract", "auxiliary", "desired"), family.main, strict=True))
    topics |= {topic.identifier: topic for topic in family.further} | {"events": EVENTS}
    return tuple(_table(name, topic, parts_of(topic.message)) for name, topic in topics.items())


TABLES = _tables(
    PLANE_FAMILY, "plane", lambda message: {REFERENCE: (Quantity("", "rad"),)} if message is PlaneState else {}
)
"""All tables of a swarm on the plane, in the order of a bag."""


def tables_of(bag: BagReader) -> tuple[BagTable, ...]:
    """Return all tables of a bag.

    On another parent system than the plane, a column is named after its quantity, such as ``roll``; if the field is not
    the quantity itself, or the name is taken, after field and quantity, such as ``rate_torque``.
    """
    if bag.family is PLANE_FAMILY:
        return TABLES
    return _tables(SYSTEM_FAMILY, "parent", partial(components, description_of(bag)))


def _row_of(
    table: BagTable, period: int | None, reference: Callable[[int], float | Vector]
) -> Callable[[Message], Row]:
    """Return a function that turns a message into a row; `reference` returns the reference (rad) of a step.

    For another parent system than the plane, `reference` returns a tuple. The time is that of the step, because a
    robot's clock may be wrong in lockstep; without a period (ns), as in real time, it is the stamp.
    """
    fields = table.topic.message._fields
    names = [column.name for column in table.columns]
    wanted = [(names.index(name), index) for name, (field, index) in table.vectors.items() if field == REFERENCE]
    taken = [table.vectors.get(name, (name, 0))[0] for name in names]
    pick = itemgetter(*(fields.index(field) if field in fields else 0 for field in taken))
    time, stamp = names.index("time"), names.index("stamp")
    shown = [(names.index(name), show) for name, show in _shown(table)]

    def row(message: Message) -> Row:
        picked = list(pick(message))
        picked[time] = (message.stamp if period is None else message.step * period) / 1e9
        picked[stamp] = message.stamp / 1e9
        if wanted:
            values = reference(message.step)
            for place, index in wanted:
                value = _component(index, values if isinstance(values, tuple) else (values,))
                picked[place] = None if value is None or isnan(value) else value
        for place, show in shown:
            picked[place] = show(picked[place])
        return picked

    return row


def _shown(table: BagTable) -> Iterator[tuple[str, Callable[..., Cell]]]:
    """Yield the columns whose values are not shown as such, with a function that returns what to show."""
    for name, (vector, index) in table.vectors.items():
        if vector != REFERENCE:
            yield name, partial(_component, index)
    for name, field in fields_of(table.topic.message).items():
        assert isinstance(field, Field)  # noqa: S101 - recorded messages are never nested
        if field.constants is not None:
            yield name, cache(partial(word_of, field.constants))
        elif field.missing is not None:
            yield name, partial(_unless, field.missing)


def _unless(missing: int, value: int) -> int | None:
    return None if value == missing else value


def _component(index: int, vector: Sequence[float]) -> float | None:
    return vector[index] if index < len(vector) else None


def export_tables(
    path: Path | str, folder: Path, table_format: TableFormat, *, namespace: str | None = None
) -> tuple[Path, ...]:
    """Write the tables of a bag and its summary to a new folder, completely or not at all, and return the files.

    Numbers in CSV have enough digits to restore the same float64; a missing value is empty in CSV, null in Parquet.

    Raises
    ------
    InputError
        If it is not the bag of a swarm, the folder exists or is named like a file, or pyarrow is not installed.
    RunError
        If the bag is damaged or the disk fails.
    """
    if folder.suffix in FILE_SUFFIXES:
        raise InputError(
            f"{folder} is named like a file, and tables are written to a folder",
            f"name one with -o, such as {folder.with_suffix('')}, and the format with --format csv or parquet",
        )
    bag = open_bag(path, namespace=namespace)
    if bag.namespace is None:
        raise NotABagError(f"{bag.path} is not the bag of a swarm: it has none of its topics; name another bag")
    opened = _parquet if table_format == "parquet" else _csv
    with new_folder(folder) as part, ExitStack() as stack:
        period, reference, tables = step_period(bag), reference_of_bag(bag), tables_of(bag)
        files = {
            table.topic: (stack.enter_context(opened(part, table)), _row_of(table, period, reference))
            for table in tables
        }
        for topic, _, message in bag.decoded(tuple(files)):
            add, row = files[topic]
            add(row(message))
        write_columns(part / COLUMNS_FILE, tables)
        summary = json.dumps(summarise_bag(bag.path, bag.namespace), indent=2)
        (part / SUMMARY_FILE).write_text(summary + "\n", encoding="utf-8")
    return tuple(sorted(folder.iterdir()))


@contextmanager
def _csv(folder: Path, table: BagTable) -> Iterator[AddRow]:
    with (folder / f"{table.name}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([column.name for column in table.columns])
        yield writer.writerow


@contextmanager
def _parquet(folder: Path, table: BagTable) -> Iterator[AddRow]:
    """Yield a function that adds a row to the file of a table; the metadata of each column has its unit and meaning."""
    try:
        import pyarrow as pa  # noqa: PLC0415 - may be missing
        from pyarrow.parquet import ParquetWriter  # noqa: PLC0415 - may be missing
    except ModuleNotFoundError as error:
        raise lacking(error, "Parquet") from None
    optional = (name for name, field in fields_of(table.topic.message).items() if _may_be_missing(field))
    nullable = {*table.vectors, *optional}
    schema = pa.schema(
        pa.field(
            column.name,
            pa.dictionary(pa.int32(), pa.string()) if column.type == WORD else pa.type_for_alias(column.type),
            nullable=column.name in nullable,
            metadata=column.metadata,
        )
        for column in table.columns
    )
    rows: list[Row] = []
    with ParquetWriter(folder / f"{table.name}.parquet", schema, compression="zstd") as writer:

        def write() -> None:
            columns = zip(zip(*rows, strict=True), schema, strict=True)
            arrays = [pa.array(values, field.type) for values, field in columns]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            rows.clear()

        def add(row: Row) -> None:
            rows.append(row)
            if len(rows) == PARQUET_ROWS:
                write()

        yield add
        if rows:
            write()


def _may_be_missing(field: Field | type[Message]) -> bool:
    return isinstance(field, Field) and field.missing is not None


def write_columns(path: Path, tables: Sequence[BagTable] = TABLES) -> None:
    """Write the description of the columns of tables."""
    path.write_text(described_columns([(table.name, table.columns) for table in tables]), encoding="utf-8", newline="")


def described_columns(tables: Iterable[tuple[str, Iterable[Column]]]) -> str:
    """Return the description of the columns of tables, given by name, as CSV."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["table", "column", "type", "unit", "meaning"])
    writer.writerows([name, *column] for name, columns in tables for column in columns)
    return file.getvalue()

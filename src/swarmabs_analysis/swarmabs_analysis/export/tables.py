"""The tables of a bag, one per topic with one row per message, written row by row in bounded memory."""

from __future__ import annotations

import csv
import json
from contextlib import ExitStack, contextmanager
from functools import cache, partial
from math import isnan
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from swarmabs_bag.attached import step_period
from swarmabs_bag.bag_summary import desired_angle, summarise_bag
from swarmabs_bag.errors import NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import new_folder
from swarmabs_core.errors import InputError
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    Field,
    Topic,
    fields_of,
    word,
    word_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from swarmabs_core.messages import Message

    AddRow = Callable[[Sequence[Any]], object]

COLUMNS_FILE = "columns.csv"
SUMMARY_FILE = "summary.json"
PARQUET_ROWS = 16_384
"""Rows of a Parquet row group; at most this many are in memory."""
TableFormat = Literal["csv", "parquet"]


class Column(NamedTuple):
    """A column: name, type, unit (1 for dimensionless numbers, empty for text) and meaning, unless the name says it."""

    name: str
    type: str
    unit: str
    meaning: str = ""


class BagTable(NamedTuple):
    """A topic as a table: time, stamp, the fields of the message by name, and for the plane also the reference.

    Constants appear as words; a value that means "none" is missing.
    """

    name: str
    topic: Topic
    columns: tuple[Column, ...]


_TIME = Column("time", "float64", "s", "time of the step; in real time the stamp")
_REFERENCE = Column("reference", "float64", "rad", "desired angle with its offsets; missing if unknown")
WORD = "word"
"""Type of columns of constants: text, in Parquet dictionary-encoded."""


def _table(name: str, topic: Topic) -> BagTable:
    """Return a topic as a table: step, time, robot, the fields of the message in order, and the stamp last."""
    stamp, *others = _columns(topic)
    added = (_REFERENCE,) if topic is PLANE_STATE else ()
    columns = {column.name: column for column in (_TIME, *others, *added, stamp)}
    first = [columns.pop(key) for key in ("step", "time", "agent_id") if key in columns]
    return BagTable(name, topic, (*first, *columns.values()))


def _columns(topic: Topic) -> Iterator[Column]:
    for name, field in fields_of(topic.message).items():
        assert isinstance(field, Field)  # noqa: S101 - recorded messages are never nested
        if field.ros_type == "time":
            yield Column(name, "float64", "s", field.meaning)
        elif field.constants is not None:
            yield Column(name, WORD, "", f"one of {', '.join(map(word, field.constants))}")
        else:
            none = "; missing if none" if field.missing is not None else ""
            yield Column(name, field.ros_type, field.unit, field.meaning + none)


TABLES = (
    _table("agents", AGENT_STATE),
    _table("plane", PLANE_STATE),
    _table("abstract", ABSTRACT_STATE),
    _table("auxiliary", AUXILIARY_STATE),
    _table("desired", DESIRED_ABSTRACT_STATE),
    _table("events", EVENTS),
)
"""All tables, in the order of a bag."""


def _row_of(
    table: BagTable, period: int | None, reference: Callable[[int], float]
) -> Callable[[Message], Sequence[Any]]:
    """Return a function that turns a message into a row; `reference` returns the desired angle (rad) of a step.

    The time is that of the step, because a robot's clock may be wrong in lockstep; without a period (ns), as in real
    time, it is the stamp.
    """
    fields = table.topic.message._fields
    names = [column.name for column in table.columns]
    computed = {"time", "stamp", _REFERENCE.name}
    pick = itemgetter(*(0 if name in computed else fields.index(name) for name in names))
    time, stamp = names.index("time"), names.index("stamp")
    wanted = names.index(_REFERENCE.name) if _REFERENCE in table.columns else None
    shown = [(names.index(name), show) for name, show in _shown(table.topic)]

    def row(message: Message) -> Sequence[Any]:
        picked = list(pick(message))
        picked[time] = (message.stamp if period is None else message.step * period) / 1e9
        picked[stamp] = message.stamp / 1e9
        if wanted is not None:
            angle = reference(message.step)
            picked[wanted] = None if isnan(angle) else angle
        for place, show in shown:
            picked[place] = show(picked[place])
        return picked

    return row


def _shown(topic: Topic) -> Iterator[tuple[str, Callable[[int], Any]]]:
    """Yield the fields whose numbers are not shown as such, with a function that returns what to show."""
    for name, field in fields_of(topic.message).items():
        assert isinstance(field, Field)  # noqa: S101 - recorded messages are never nested
        if field.constants is not None:
            yield name, cache(partial(word_of, field.constants))
        elif field.missing is not None:
            yield name, partial(_unless, field.missing)


def _unless(missing: int, value: int) -> int | None:
    return None if value == missing else value


def export_tables(
    path: Path | str, folder: Path, table_format: TableFormat, *, namespace: str | None = None
) -> tuple[Path, ...]:
    """Write the tables of a bag and its summary to a new folder, completely or not at all, and return the files.

    Numbers in CSV have enough digits to restore the same float64; a missing value is empty in CSV, null in Parquet.

    Raises
    ------
    InputError
        If it is not the bag of a swarm, the folder exists, or pyarrow is not installed.
    RunError
        If the bag is damaged or the disk fails.
    """
    bag = open_bag(path, namespace=namespace)
    if bag.namespace is None:
        raise NotABagError(f"{bag.path} is not the bag of a swarm: it has none of its topics; name another bag")
    opened = _parquet if table_format == "parquet" else _csv
    with new_folder(folder) as part, ExitStack() as stack:
        period, reference = step_period(bag), desired_angle(bag)
        files = {
            table.topic: (stack.enter_context(opened(part, table)), _row_of(table, period, reference))
            for table in TABLES
        }
        for topic, _, message in bag.decoded(tuple(files)):
            add, row = files[topic]
            add(row(message))
        write_columns(part / COLUMNS_FILE)
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
    except ImportError as error:
        raise InputError(
            f"Parquet needs the package pyarrow ({error}); install it, or use --format csv or numpy"
        ) from error
    optional = (name for name, field in fields_of(table.topic.message).items() if _may_be_missing(field))
    nullable = {_REFERENCE.name, *optional}
    schema = pa.schema(
        pa.field(
            column.name,
            pa.dictionary(pa.int32(), pa.string()) if column.type == WORD else pa.type_for_alias(column.type),
            nullable=column.name in nullable,
            metadata={name: text for name, text in (("unit", column.unit), ("meaning", column.meaning)) if text},
        )
        for column in table.columns
    )
    rows: list[Sequence[Any]] = []
    with ParquetWriter(folder / f"{table.name}.parquet", schema, compression="zstd") as writer:

        def write() -> None:
            columns = zip(zip(*rows, strict=True), schema, strict=True)
            arrays = [pa.array(values, field.type) for values, field in columns]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            rows.clear()

        def add(row: Sequence[Any]) -> None:
            rows.append(row)
            if len(rows) == PARQUET_ROWS:
                write()

        yield add
        if rows:
            write()


def _may_be_missing(field: Field | type[Message]) -> bool:
    return isinstance(field, Field) and field.missing is not None


def write_columns(path: Path) -> None:
    """Write the description of the columns of all tables."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["table", "column", "type", "unit", "meaning"])
        writer.writerows([table.name, *column] for table in TABLES for column in table.columns)

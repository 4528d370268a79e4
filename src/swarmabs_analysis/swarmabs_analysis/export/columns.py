"""The tables of a bag: one per topic, one row per message, and what is in each column."""

from __future__ import annotations

from operator import itemgetter
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

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
    said,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from swarmabs_core.messages import Message

TableFormat = Literal["csv", "parquet"]


class Column(NamedTuple):
    """A column: name, type, unit (1 for numbers without one, empty for texts) and, where the name is short, meaning."""

    name: str
    type: str
    unit: str
    meaning: str = ""


class BagTable(NamedTuple):
    """A topic as a table; the columns are time, stamp, and fields of the message by their names."""

    name: str
    topic: Topic
    columns: tuple[Column, ...]


_TIME = Column("time", "float64", "s", "time of the step; in real time the stamp")


def _table(name: str, topic: Topic) -> BagTable:
    """Return a topic as a table: step, time, robot, then the fields of the message in their order, last the stamp."""
    stamp, *others = _columns(topic)
    columns = {column.name: column for column in (_TIME, *others, stamp)}
    first = [columns.pop(key) for key in ("step", "time", "agent_id") if key in columns]
    return BagTable(name, topic, (*first, *columns.values()))


def _columns(topic: Topic) -> Iterator[Column]:
    for name, field in fields_of(topic.message).items():
        assert isinstance(field, Field)  # noqa: S101 - no message that is recorded consists of others
        if field.ros_type == "time":
            yield Column(name, "float64", "s", field.meaning)
        else:
            constants = ", ".join(f"{value.value}: {said(value)}" for value in field.constants or ())
            yield Column(name, field.ros_type, field.unit, constants or field.meaning)


TABLES = (
    _table("agents", AGENT_STATE),
    _table("plane", PLANE_STATE),
    _table("abstract", ABSTRACT_STATE),
    _table("auxiliary", AUXILIARY_STATE),
    _table("desired", DESIRED_ABSTRACT_STATE),
    _table("events", EVENTS),
)
"""All tables, in the order of a bag."""


def time_of(message: Message, period: int | None) -> int:
    """Return the time of a message's step, ns; where there is no period (ns), as in real time, its stamp.

    In lockstep a robot's clock may be wrong, and nobody uses it.
    """
    return message.stamp if period is None else message.step * period


def row_of(table: BagTable, period: int | None) -> Callable[[Message], Sequence[Any]]:
    """Return what makes a row of a message; `period` (ns) as of `time_of`."""
    fields = table.topic.message._fields
    names = [column.name for column in table.columns]
    time, stamp = names.index("time"), names.index("stamp")
    pick = itemgetter(*(0 if name in {"time", "stamp"} else fields.index(name) for name in names))

    def row(message: Message) -> Sequence[Any]:
        picked = list(pick(message))
        picked[time], picked[stamp] = time_of(message, period) / 1e9, message.stamp / 1e9
        return picked

    return row

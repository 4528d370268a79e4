"""The tables of a bag: one per topic, one row per message, and what is in each column."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    EventKind,
    Kind,
    Mode,
    Status,
    Topic,
    said,
)

if TYPE_CHECKING:
    from enum import IntEnum

    from swarmabs_core.messages import Message

TableFormat = Literal["csv", "parquet"]
ColumnType = Literal["uint8", "uint16", "uint64", "float64", "string"]


class Column(NamedTuple):
    """A column: name, type, unit (1 for numbers without one, empty for texts) and, where the name is short, meaning."""

    name: str
    type: ColumnType
    unit: str
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class BagTable:
    """A topic as a table; the columns are time, stamp, and fields of the message by their names."""

    name: str
    topic: Topic
    columns: tuple[Column, ...]


_STEP = Column("step", "uint64", "1", "number of the control period")
_TIME = Column("time", "float64", "s", "time of the step; in real time the stamp")
_STAMP = Column("stamp", "float64", "s", "when it was made, by the clock of who made it")
_AGENT = Column("agent_id", "uint16", "1", "robot")


def _float(name: str, unit: str, meaning: str = "") -> Column:
    return Column(name, "float64", unit, meaning)


def _constant(name: str, constants: type[IntEnum]) -> Column:
    return Column(name, "uint8", "1", ", ".join(f"{value.value}: {said(value)}" for value in constants))


TABLES = (
    BagTable(
        "agents",
        AGENT_STATE,
        (
            _STEP,
            _TIME,
            _AGENT,
            Column("broadcast_step", "uint64", "1", "step of the broadcasts used; 18446744073709551615: none"),
            _constant("kind", Kind),
            _constant("status", Status),
            _float("mass", "kg"),
            _float("damping", "N s/m"),
            _float("position", "m"),
            _float("velocity", "m/s"),
            _float("command", "m/s or N", "held over the step before; m/s of single, N of double integrators"),
            _STAMP,
        ),
    ),
    BagTable("plane", PLANE_STATE, (_STEP, _TIME, _float("angle", "rad"), _float("angular_velocity", "rad/s"), _STAMP)),
    BagTable(
        "abstract",
        ABSTRACT_STATE,
        (
            _STEP,
            _TIME,
            Column("agent_count", "uint16", "1", "robots whose weight is in the sums"),
            _float("torque", "N m"),
            _float("inertia", "kg m^2"),
            _float("torque_rate", "N m/s"),
            _float("inertia_rate", "kg m^2/s"),
            _STAMP,
        ),
    ),
    BagTable(
        "auxiliary",
        AUXILIARY_STATE,
        (
            _STEP,
            _TIME,
            _float("s0", "kg^2", "sum of m^2"),
            _float("s1", "kg^2 m", "sum of m^2 p"),
            _float("s2", "kg^2 m^2", "sum of m^2 p^2"),
            _float("s3", "kg^4 m^2", "s0 s2 - s1^2"),
            _float("d0", "kg^2/s", "sum of m (c + ksd)"),
            _float("d1", "kg^2 m/s", "sum of m (c + ksd) p"),
            _float("d2", "kg^2 m^2/s", "sum of m (c + ksd) p^2"),
            _float("q", "kg m^2/s^2", "sum of m v^2"),
            _STAMP,
        ),
    ),
    BagTable(
        "desired",
        DESIRED_ABSTRACT_STATE,
        (
            _STEP,
            _TIME,
            _constant("mode", Mode),
            _float("torque", "N m"),
            _float("inertia", "kg m^2"),
            _float("torque_rate", "N m/s"),
            _float("inertia_rate", "kg m^2/s"),
            _float("mean_torque_rate", "N m/s", "mean over the step"),
            _float("mean_inertia_rate", "kg m^2/s", "mean over the step"),
            _float("torque_acceleration", "N m/s^2", "mean over the step"),
            _float("inertia_acceleration", "kg m^2/s^2"),
            _STAMP,
        ),
    ),
    BagTable(
        "events",
        EVENTS,
        (
            _STEP,
            _TIME,
            _AGENT,
            _constant("kind", EventKind),
            _float("value", "by kind"),
            Column("detail", "string", "", "for people"),
            _STAMP,
        ),
    ),
)
"""All tables, in the order of a bag."""


def time_of(message: Message, period: int | None) -> int:
    """Return the time of a message's step, ns; where there is no period (ns), as in real time, its stamp.

    In lockstep a robot's clock may be wrong, and nobody uses it.
    """
    return message.stamp if period is None else message.step * period

"""A run as numpy arrays, for plots, notebooks and tests."""

from __future__ import annotations

from collections.abc import ItemsView, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarmabs_core.cdr import places
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    DESIRED_ABSTRACT_STATE,
    MAIN_TOPICS,
    PLANE_STATE,
    Field,
    Topic,
    fields_of,
)

Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]

PADDING = "padding"
"""How the names of a layout's padding bytes begin."""

_NUMPY = {"i": "<i4", "I": "<u4", "B": "u1", "H": "<u2", "Q": "<u8", "d": "<f8"}

LAYOUT: dict[Topic, np.dtype[np.void]] = {
    topic: np.dtype(
        [
            (place.name or f"{PADDING}{number}", _NUMPY.get(place.code, f"V{place.size}"))
            for number, place in enumerate(places(topic.message))
        ]
    )
    for topic in MAIN_TOPICS
}
"""Canonical CDR of the main topics' messages, field by field; names of padding bytes begin with `PADDING`."""


class MessageArrays:
    """The fields of a topic's messages as arrays, by name: ``arrays.torque``; units are those of the message.

    Each is of shape (n+1,), those of the robots (n+1, N). Numbers are NaN, integers 0 where there is no message. Fields
    that refer to another step are left out.
    """

    __slots__ = ("_columns",)

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self._columns = dict(columns)

    def __getattr__(self, name: str) -> NDArray[Any]:
        columns = {} if name == "_columns" else self._columns  # not there while it is unpickled
        if name not in columns:
            raise AttributeError(f"no field {name!r}; there are {', '.join(columns)}")
        return columns[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._columns]

    def items(self) -> ItemsView[str, NDArray[Any]]:
        """Return names and arrays."""
        return self._columns.items()


@dataclass(frozen=True, slots=True)
class RunArrays:
    """The five main topics of a run, row by row in step order.

    Attributes
    ----------
    step : ndarray, (n+1,)
        Steps of which there is any message, ascending.
    time : ndarray, (n+1,)
        Their times in s.
    angle, angular_velocity : ndarray, (n+1,)
        Of the plane, in rad and rad/s.
    abstract, auxiliary, desired : MessageArrays
        The broadcasts.
    agents : MessageArrays
        The robots' states; ``agents.ids`` of shape (N,) has their ids, ascending, which are the columns of the others.
    """

    step: Integers
    time: Floats
    angle: Floats
    angular_velocity: Floats
    abstract: MessageArrays
    auxiliary: MessageArrays
    desired: MessageArrays
    agents: MessageArrays


Tables = Mapping[Topic, "NDArray[np.void]"]
"""The messages of each main topic as rows of a structured array."""


def table(topic: Topic, payloads: bytes | bytearray) -> NDArray[np.void]:
    """Return a main topic's messages, given as canonical CDR one after the other, as a structured array."""
    return np.frombuffer(payloads, dtype=LAYOUT[topic])


def run_arrays(tables: Tables) -> RunArrays:
    """Arrange the messages of a run, which `table` has returned in any order, by step, the robots' by step and id."""
    # The first message of a step tells its time; robots come last, since their clocks may be wrong.
    ordered = sorted(tables, key=lambda topic: topic is AGENT_STATE)
    step, first = np.unique(np.concatenate([tables[topic]["step"] for topic in ordered]), return_index=True)
    stamps = np.concatenate([tables[topic]["sec"] * 1e9 + tables[topic]["nanosec"] for topic in ordered])
    rows = {topic: np.searchsorted(step, table["step"]) for topic, table in tables.items()}
    filled = {topic: _columns(topic, tables[topic], rows[topic], (len(step),)) for topic in MAIN_TOPICS[1:]}
    plane = filled[PLANE_STATE]
    return RunArrays(
        step=step.astype(np.int64),
        time=stamps[first] / 1e9,
        angle=plane["angle"],
        angular_velocity=plane["angular_velocity"],
        abstract=MessageArrays(filled[ABSTRACT_STATE]),
        auxiliary=MessageArrays(filled[AUXILIARY_STATE]),
        desired=MessageArrays(filled[DESIRED_ABSTRACT_STATE]),
        agents=_agents(tables[AGENT_STATE], rows[AGENT_STATE], len(step)),
    )


def _columns(
    topic: Topic, table: NDArray[np.void], places: Integers | tuple[Integers, Integers], shape: tuple[int, ...]
) -> dict[str, NDArray[Any]]:
    """Return the fields of a topic's table, put into arrays of a shape at the places of its messages."""
    columns: dict[str, NDArray[Any]] = {}
    for name, field in fields_of(topic.message).items():
        if isinstance(field, Field) and field.ros_type not in {"time", "uint64"} and name != "agent_id":
            real = field.ros_type == "float64"
            columns[name] = np.full(shape, np.nan) if real else np.zeros(shape, dtype=np.int64)
            columns[name][places] = table[name]
    return columns


def _agents(table: NDArray[np.void], rows: Integers, steps: int) -> MessageArrays:
    ids, columns = np.unique(table["agent_id"], return_inverse=True)
    filled = _columns(AGENT_STATE, table, (rows, columns), (steps, len(ids)))
    return MessageArrays({"ids": ids.astype(np.int64), **filled})

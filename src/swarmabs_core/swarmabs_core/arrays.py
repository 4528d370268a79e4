"""A run as numpy arrays, for plots, notebooks and tests."""

from __future__ import annotations

from collections.abc import Callable, ItemsView, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarmabs_core.cdr import SECOND, canonical, decode, lengths_of, places
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import (
    FAMILIES,
    MAIN_TOPICS,
    PLANE_FAMILY,
    EventKind,
    Family,
    Field,
    SwarmEvent,
    Topic,
    fields_of,
    word_of,
)

if TYPE_CHECKING:
    from swarmabs_core.systems.interface import Row, SystemTables

Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]
Column: TypeAlias = NDArray[Any]
"""A field of messages as an array: of floats or of integers."""
Figures: TypeAlias = dict[str, Any]
"""The key figures of a run by name, as plain data."""

PADDING = "padding"
"""Prefix of the names of padding bytes in a layout."""

_NUMPY = {"i": "<i4", "I": "<u4", "B": "u1", "H": "<u2", "Q": "<u8", "d": "<f8"}

_LONGEST = 4096
"""More bytes than a message of a main topic has."""
LENGTH = "length of list "
"""Prefix of the names of lengths of lists in a layout."""


@lru_cache(maxsize=64)
def _layout(topic: Topic, lengths: tuple[int, ...]) -> np.dtype[np.void]:
    """Return the canonical CDR of a topic's messages with lists of these lengths, field by field."""
    fields: list[tuple[object, ...]] = []
    for number, (name, code, size, elements) in enumerate(places(topic.message, lengths)):
        unique = {"": f"{PADDING}{number}", "count": f"{LENGTH}{number}"}.get(name, name)
        element = _NUMPY.get(code, f"V{size}")
        fields.append((unique, element, (elements,)) if elements and code in _NUMPY else (unique, element))
    return np.dtype(fields)


LAYOUT = {topic: _layout(topic, ()) for topic in MAIN_TOPICS}
"""Canonical CDR of the messages on the main topics of the plane."""


def layout_of(topic: Topic, payload: bytes | bytearray) -> np.dtype[np.void]:
    """Return the layout of a topic's messages, with lists as long as in a payload; an empty list has no field."""
    return _layout(topic, lengths_of(topic.message, payload))


def raw(table: NDArray[np.void]) -> NDArray[np.uint8]:
    """Return the rows of a contiguous table as bytes, with one more axis."""
    return table.view(np.uint8).reshape(*table.shape, table.itemsize)


def is_canonical(topic: Topic, table: NDArray[np.void]) -> bool:
    """Return whether every message of a contiguous table has the head, padding and list lengths of its layout."""
    rows = raw(table).reshape(-1, table.itemsize)
    first = rows[0].tobytes()
    try:
        decode(topic.message, first)
    except MalformedMessageError:
        return False
    same = canonical(topic.message, first) == first and not ((rows ^ rows[0]) & constant(table.dtype)).any()
    return same and bool((table["nanosec"] < SECOND).all())


@lru_cache(maxsize=64)
def constant(layout: np.dtype[np.void]) -> NDArray[np.uint8]:
    """Return 255 for each byte of a message that the layout determines, 0 for the others."""
    mask = np.zeros(layout.itemsize, dtype=np.uint8)
    for name, (kind, offset, *_) in (layout.fields or {}).items():
        if name in {"encapsulation", "frame"} or name.startswith((PADDING, LENGTH)):
            mask[offset : offset + kind.itemsize] = 255
    return mask


def canonical_table(topic: Topic, payloads: bytes | bytearray | memoryview) -> NDArray[np.void] | None:
    """Return joined payloads of at least one message as a table, None if they are not canonical or not equally long."""
    try:
        table = np.frombuffer(payloads, layout_of(topic, bytes(payloads[:_LONGEST])))
    except (MalformedMessageError, ValueError):
        return None
    return table if len(table) and is_canonical(topic, table) else None


class MessageArrays:
    """The fields of a topic's messages as arrays, by name: ``arrays.torque``; units are those of the message.

    Arrays have shape (n+1,), or (n+1, N) for the robots. Where there is no message, floats are NaN and integers 0.
    ``broadcast_step`` is an array of floats, which is also NaN where the robot has used no broadcast.
    """

    __slots__ = ("_columns", "_vectors")

    def __init__(self, columns: Mapping[str, Column], vectors: Mapping[str, tuple[str, ...]]) -> None:
        self._columns = dict(columns)
        self._vectors = vectors

    def __getattr__(self, name: str) -> Column:
        columns = {} if name == "_columns" else self._columns  # unset during unpickling
        if name not in columns:
            raise AttributeError(f"no field {name!r}; the fields are {', '.join(columns)}")
        return columns[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._columns]

    def items(self) -> ItemsView[str, Column]:
        """Return names and arrays."""
        return self._columns.items()

    def vector(self, name: str) -> Floats:
        """Return a list of the messages of any parent system, such as ``value``, in the last axis.

        The plane's messages have its elements by name; see `Family.vectors`.
        """
        if name not in self._vectors:
            return self._columns[name]
        return np.stack([self._columns[element] for element in self._vectors[name]], axis=-1)

    def converted(self, convert: Callable[[Column], Column]) -> MessageArrays:
        """Return them with each array converted."""
        return MessageArrays({name: convert(column) for name, column in self.items()}, self._vectors)


class RunEvent(NamedTuple):
    """An event of a run.

    Attributes
    ----------
    step : int
        First step at which it takes effect.
    time : float
        Time of the step, s; in real time, time of the message since the first step.
    kind : str
        Lower-case name of a constant of `EventKind`, such as ``limit_hit``.
    agent : int or None
        Id of the robot, None if it concerns no single robot.
    value : float
        Its meaning and unit depend on the kind.
    detail : str
        Human-readable text.
    """

    step: int
    time: float
    kind: str
    agent: int | None
    value: float
    detail: str


@dataclass(frozen=True, slots=True)
class RunArrays:
    """A run as arrays by step; ``run["angle"]`` is a quantity by its name.

    Attributes
    ----------
    step : ndarray, (n+1,)
        Steps with at least one message, ascending.
    time : ndarray, (n+1,)
        Times of the steps, s.
    parent : ndarray, (n+1, P)
        State of the parent system; of the plane its angle in rad and angular velocity in rad/s.
    reference : ndarray, (n+1,) or (n+1, T)
        Reference angle of the plane in rad, or those of all that another parent system tracks, including offsets by
        faults and steering; NaN where unknown.
    abstract, auxiliary, desired : MessageArrays
        The broadcasts. The lists of parent systems other than the plane are the last axis.
    agents : MessageArrays
        States of the robots. ``agents.ids`` of shape (N,) contains their ids in ascending order; column i of the other
        arrays belongs to ``ids[i]``.
    description : SystemTables
        Names, units and scales of the quantities, and settings of the system.
    events : tuple of RunEvent
        All events, ordered by step.
    figures : callable
        Computes the result of `summary` on demand.
    further : mapping of str to MessageArrays
        The messages on further topics by the name of the topic, with ``_`` for ``/``.
    """

    step: Integers
    time: Floats
    parent: Floats
    reference: Floats
    abstract: MessageArrays
    auxiliary: MessageArrays
    desired: MessageArrays
    agents: MessageArrays
    description: SystemTables
    events: tuple[RunEvent, ...]
    figures: Callable[[], Figures] = field(repr=False, compare=False)
    further: Mapping[str, MessageArrays] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Floats:
        """Return a quantity of the parent or of the abstract state, (n+1,), or of the robots, (n+1, N)."""
        described = self.description
        tables: tuple[tuple[Sequence[Row], Callable[[], Floats]], ...] = (
            (described.parent, lambda: self.parent),
            (described.abstract, lambda: self.abstract.vector("value")),
            (described.robot, lambda: self.agents.vector("coordinates")),
            (described.constants, lambda: self.agents.vector("constants")),
        )
        for rows, values in tables:  # only the vector of the quantity is put together
            names = [row.name for row in rows]
            if name in names:
                return values()[..., names.index(name)]
        raise KeyError(f"no quantity {name!r}; see `description`")

    @property
    def angle(self) -> Floats:
        """Angle of the plane, rad, (n+1,); ``run["angle"]``."""
        return self["angle"]

    @property
    def angular_velocity(self) -> Floats:
        """Angular velocity of the plane, rad/s, (n+1,); ``run["angular_velocity"]``."""
        return self["angular_velocity"]

    @property
    def references(self) -> Floats:
        """The references of all that is tracked, (n+1, T), with T = 1 on the plane."""
        return self.reference.reshape(len(self.step), len(self.description.tracked))

    def summary(self) -> Figures:
        """Return the key figures of the run, named as in ``summary.json``.

        Returns
        -------
        dict
            ``settled_at`` (s), the time from which the plane stays within 0.01 rad of its reference; ``final_error``
            and ``rms_error`` (rad); ``max_abs_position`` (m) of any robot; ``messages``; ``digest``; and, for a run in
            real time, ``realtime``. Unknown and non-finite values are None.

        Notes
        -----
        For arrays loaded from a bag, this reads the whole bag, even if only some of its steps were loaded.
        """
        return self.figures()


Tables = Mapping[Topic, "NDArray[np.void]"]
"""The messages of each topic that has some in every step, as rows of a structured array."""


def table(topic: Topic, payloads: bytes | bytearray) -> NDArray[np.void]:
    """Return messages of a topic, given as concatenated canonical CDR, as a structured array.

    Lists have the same lengths in all of them.
    """
    return np.frombuffer(payloads, dtype=layout_of(topic, payloads))


def run_event(event: SwarmEvent, time: float) -> RunEvent:
    """Convert an event message at a time (s)."""
    return RunEvent(event.step, time, word_of(EventKind, event.kind), event.agent_id or None, event.value, event.detail)


def run_arrays(
    tables: Tables,
    *,
    reference: Callable[[int], float | tuple[float, ...]],
    events: Iterable[RunEvent],
    figures: Callable[[], Figures],
    description: SystemTables,
) -> RunArrays:
    """Arrange the tables of a run, whose rows may be in any order, by step, those of the robots by step and id.

    `reference` returns the reference (rad) of a step, or the references of a system; `events`, `figures` and
    `description` are those of `RunArrays`.
    """
    family = next(family for family in FAMILIES if family.robot in tables)
    # The first message of a step determines its time. Robots come last, since their clocks may be wrong.
    ordered = sorted(tables, key=lambda topic: topic is family.robot)
    step, first = np.unique(np.concatenate([tables[topic]["step"] for topic in ordered]), return_index=True)
    stamps = np.concatenate([tables[topic]["sec"] * 1e9 + tables[topic]["nanosec"] for topic in ordered])
    rows = {topic: np.searchsorted(step, table["step"]) for topic, table in tables.items()}
    filled = {
        topic: MessageArrays(_columns(topic, table, rows[topic], (len(step),)), family.vectors)
        for topic, table in tables.items()
        if topic is not family.robot
    }
    goals = np.array([reference(number) for number in step.tolist()], dtype=np.float64)
    columns = goals if goals.ndim > 1 else goals[:, np.newaxis]  # one number holds for all that is tracked
    references = np.array(np.broadcast_to(columns, (len(step), len(description.tracked))))
    return RunArrays(
        step=step.astype(np.int64),
        time=stamps[first] / 1e9,
        parent=filled[family.parent].vector("state"),
        reference=references[:, 0] if family is PLANE_FAMILY else references,
        abstract=filled[family.abstract],
        auxiliary=filled[family.auxiliary],
        desired=filled[family.desired],
        agents=_agents(family, tables[family.robot], rows[family.robot], len(step)),
        description=description,
        events=tuple(sorted(events, key=lambda event: event.step)),
        figures=figures,
        further={topic.identifier: filled[topic] for topic in family.further if topic in filled},
    )


def _columns(
    topic: Topic, table: NDArray[np.void], places: Integers | tuple[Integers, Integers], shape: tuple[int, ...]
) -> dict[str, Column]:
    """Scatter the fields of a topic's table into arrays of a shape, at the indices of its messages."""
    columns: dict[str, Column] = {}
    for name, declared in fields_of(topic.message).items():
        if isinstance(declared, Field) and name not in {"stamp", "step", "agent_id", "system"}:
            values = table[name] if name in (table.dtype.names or ()) else np.empty((len(table), 0))
            real = declared.ros_type.startswith("float64") or declared.missing is not None
            filled = (*shape, *values.shape[1:])
            columns[name] = np.full(filled, np.nan) if real else np.zeros(filled, dtype=np.int64)
            if declared.missing is not None:
                values = np.where(values == declared.missing, np.nan, values.astype(np.float64))
            columns[name][places] = values
    return columns


def _agents(family: Family, table: NDArray[np.void], rows: Integers, steps: int) -> MessageArrays:
    ids, columns = np.unique(table["agent_id"], return_inverse=True)
    filled = _columns(family.robot, table, (rows, columns), (steps, len(ids)))
    return MessageArrays({"ids": ids.astype(np.int64), **filled}, family.vectors)

"""A run as numpy arrays, for plots, notebooks and tests."""

from __future__ import annotations

from collections.abc import Callable, ItemsView, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

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
    EventKind,
    Field,
    SwarmEvent,
    Topic,
    fields_of,
    word_of,
)

Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]

PADDING = "padding"
"""Prefix of the names of padding bytes in a layout."""

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
"""Canonical CDR of the main topics' messages, field by field; names of padding bytes start with `PADDING`."""


class MessageArrays:
    """The fields of a topic's messages as arrays, by name: ``arrays.torque``; units are those of the message.

    Arrays have shape (n+1,), or (n+1, N) for the robots. Where there is no message, floats are NaN and integers 0.
    ``broadcast_step`` is an array of floats, which is also NaN where the robot has used no broadcast.
    """

    __slots__ = ("_columns",)

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self._columns = dict(columns)

    def __getattr__(self, name: str) -> NDArray[Any]:
        columns = {} if name == "_columns" else self._columns  # unset during unpickling
        if name not in columns:
            raise AttributeError(f"no field {name!r}; the fields are {', '.join(columns)}")
        return columns[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._columns]

    def items(self) -> ItemsView[str, NDArray[Any]]:
        """Return names and arrays."""
        return self._columns.items()


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
    """A run as arrays by step, with its events and its summary.

    Attributes
    ----------
    step : ndarray, (n+1,)
        Steps with at least one message, ascending.
    time : ndarray, (n+1,)
        Times of the steps, s.
    angle, angular_velocity : ndarray, (n+1,)
        Of the plane, in rad and rad/s.
    reference : ndarray, (n+1,)
        Desired angle in rad, including offsets by faults and steering; NaN where unknown.
    abstract, auxiliary, desired : MessageArrays
        The broadcasts.
    agents : MessageArrays
        States of the robots. ``agents.ids`` of shape (N,) contains their ids in ascending order; column i of the other
        arrays belongs to ``ids[i]``.
    events : tuple of RunEvent
        All events, ordered by step.
    figures : callable
        Computes the result of `summary` on demand.
    """

    step: Integers
    time: Floats
    angle: Floats
    angular_velocity: Floats
    reference: Floats
    abstract: MessageArrays
    auxiliary: MessageArrays
    desired: MessageArrays
    agents: MessageArrays
    events: tuple[RunEvent, ...]
    figures: Callable[[], dict[str, Any]] = field(repr=False, compare=False)

    def summary(self) -> dict[str, Any]:
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
"""The messages of each main topic as rows of a structured array."""


def table(topic: Topic, payloads: bytes | bytearray) -> NDArray[np.void]:
    """Return messages of a main topic, given as concatenated canonical CDR, as a structured array."""
    return np.frombuffer(payloads, dtype=LAYOUT[topic])


def run_event(event: SwarmEvent, time: float) -> RunEvent:
    """Convert an event message at a time (s)."""
    return RunEvent(event.step, time, word_of(EventKind, event.kind), event.agent_id or None, event.value, event.detail)


def run_arrays(
    tables: Tables,
    *,
    reference: Callable[[int], float],
    events: Iterable[RunEvent],
    figures: Callable[[], dict[str, Any]],
) -> RunArrays:
    """Arrange the tables of a run, whose rows may be in any order, by step, those of the robots by step and id.

    `reference` returns the desired angle (rad) of a step; `events` and `figures` are those of `RunArrays`.
    """
    # The first message of a step determines its time. Robots come last, since their clocks may be wrong.
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
        reference=np.array([reference(number) for number in step.tolist()], dtype=np.float64),
        abstract=MessageArrays(filled[ABSTRACT_STATE]),
        auxiliary=MessageArrays(filled[AUXILIARY_STATE]),
        desired=MessageArrays(filled[DESIRED_ABSTRACT_STATE]),
        agents=_agents(tables[AGENT_STATE], rows[AGENT_STATE], len(step)),
        events=tuple(sorted(events, key=lambda event: event.step)),
        figures=figures,
    )


def _columns(
    topic: Topic, table: NDArray[np.void], places: Integers | tuple[Integers, Integers], shape: tuple[int, ...]
) -> dict[str, NDArray[Any]]:
    """Scatter the fields of a topic's table into arrays of a shape, at the indices of its messages."""
    columns: dict[str, NDArray[Any]] = {}
    for name, declared in fields_of(topic.message).items():
        if isinstance(declared, Field) and name not in {"stamp", "step", "agent_id"}:
            real = declared.ros_type == "float64" or declared.missing is not None
            columns[name] = np.full(shape, np.nan) if real else np.zeros(shape, dtype=np.int64)
            found = table[name]
            columns[name][places] = found if declared.missing is None else _known(found, declared.missing)
    return columns


def _known(values: NDArray[Any], missing: int) -> Floats:
    return np.where(values == missing, np.nan, values.astype(np.float64))


def _agents(table: NDArray[np.void], rows: Integers, steps: int) -> MessageArrays:
    ids, columns = np.unique(table["agent_id"], return_inverse=True)
    filled = _columns(AGENT_STATE, table, (rows, columns), (steps, len(ids)))
    return MessageArrays({"ids": ids.astype(np.int64), **filled})

"""A run as numpy arrays, for plots, notebooks and tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    DESIRED_ABSTRACT_STATE,
    FRAME_ID,
    MAIN_TOPICS,
    PLANE_STATE,
    Topic,
)

Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]

_AUXILIARY_FIELDS = ("s0", "s1", "s2", "s3", "d0", "d1", "d2", "q")
_DESIRED_FIELDS = (
    "torque",
    "inertia",
    "torque_rate",
    "inertia_rate",
    "mean_torque_rate",
    "mean_inertia_rate",
    "torque_acceleration",
    "inertia_acceleration",
)

_FRAME = FRAME_ID.encode() + b"\0"
_ENCAPSULATION = b"\0\1"

# The canonical CDR of a message of fixed size, field by field; `pad...` are padding bytes.
_HEAD = [
    ("encapsulation", "V2"),
    ("options", "V2"),
    ("sec", "<i4"),
    ("nanosec", "<u4"),
    ("frame_length", "<u4"),
    ("frame", f"V{len(_FRAME)}"),
    ("pad_head", "V6"),
    ("step", "<u8"),
]
LAYOUT: dict[Topic, np.dtype[np.void]] = {
    PLANE_STATE: np.dtype([*_HEAD, ("angle", "<f8"), ("angular_velocity", "<f8")]),
    AGENT_STATE: np.dtype(
        [
            *_HEAD,
            ("broadcast_step", "<u8"),
            ("agent_id", "<u2"),
            ("kind", "u1"),
            ("status", "u1"),
            ("pad", "V4"),
            *((name, "<f8") for name in ("mass", "damping", "position", "velocity", "command")),
        ]
    ),
    ABSTRACT_STATE: np.dtype(
        [
            *_HEAD,
            ("agent_count", "<u2"),
            ("pad", "V6"),
            *((name, "<f8") for name in ("torque", "inertia", "torque_rate", "inertia_rate")),
        ]
    ),
    AUXILIARY_STATE: np.dtype([*_HEAD, *((name, "<f8") for name in _AUXILIARY_FIELDS)]),
    DESIRED_ABSTRACT_STATE: np.dtype(
        [
            *_HEAD,
            ("mode", "u1"),
            ("pad", "V7"),
            *((name, "<f8") for name in _DESIRED_FIELDS),
        ]
    ),
}


@dataclass(frozen=True, slots=True)
class AbstractArrays:
    """Abstract state, each (n+1,): number of robots, torque (N m), inertia (kg m^2), and their rates.

    NaN, for the number of robots 0, where a step has no message.
    """

    agent_count: Integers
    torque: Floats
    inertia: Floats
    torque_rate: Floats
    inertia_rate: Floats


@dataclass(frozen=True, slots=True)
class AuxiliaryArrays:
    """Auxiliary state, each (n+1,), in the units of `swarmabs_core.messages.AuxiliaryState`.

    NaN where a step has no message.
    """

    s0: Floats
    s1: Floats
    s2: Floats
    s3: Floats
    d0: Floats
    d1: Floats
    d2: Floats
    q: Floats


@dataclass(frozen=True, slots=True)
class DesiredArrays:
    """Desired abstract state, each (n+1,), in SI units.

    NaN, for the mode 0, where a step has no message.
    """

    mode: Integers
    torque: Floats
    inertia: Floats
    torque_rate: Floats
    inertia_rate: Floats
    mean_torque_rate: Floats
    mean_inertia_rate: Floats
    torque_acceleration: Floats
    inertia_acceleration: Floats


@dataclass(frozen=True, slots=True)
class AgentArrays:
    """States of all robots.

    Attributes
    ----------
    ids : ndarray, (N,)
        Ids of the robots, ascending: the columns of the other arrays.
    kind, status : ndarray, (n+1, N)
        Values of `swarmabs_core.messages.Kind` and `Status`, 0 where a robot has no message.
    mass, damping, position, velocity, command : ndarray, (n+1, N)
        In SI units, NaN where a robot has no message.
    """

    ids: Integers
    kind: Integers
    status: Integers
    mass: Floats
    damping: Floats
    position: Floats
    velocity: Floats
    command: Floats


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
    abstract, auxiliary, desired, agents
        The other topics.
    """

    step: Integers
    time: Floats
    angle: Floats
    angular_velocity: Floats
    abstract: AbstractArrays
    auxiliary: AuxiliaryArrays
    desired: DesiredArrays
    agents: AgentArrays


Tables = Mapping[Topic, "NDArray[np.void]"]
"""The messages of each main topic as rows of a structured array."""


def table(topic: Topic, payloads: bytes | bytearray) -> NDArray[np.void]:
    """Return a main topic's messages, given as canonical CDR one after the other, as a structured array."""
    return np.frombuffer(payloads, dtype=LAYOUT[topic])


def run_arrays(tables: Tables) -> RunArrays:
    """Arrange the messages of a run by step, the robots' by step and id.

    Parameters
    ----------
    tables : mapping
        For each main topic its messages in any order, as `table` returns them.
    """
    # The first message of a step tells its time; robots come last, since their clocks may be wrong.
    ordered = sorted(tables, key=lambda topic: topic is AGENT_STATE)
    step, first = np.unique(np.concatenate([tables[topic]["step"] for topic in ordered]), return_index=True)
    stamps = np.concatenate([tables[topic]["sec"] * 1e9 + tables[topic]["nanosec"] for topic in ordered])
    rows = {topic: np.searchsorted(step, table["step"]) for topic, table in tables.items()}
    filled = {topic: _Columns(tables[topic], rows[topic], (len(step),)) for topic in MAIN_TOPICS[1:]}
    plane, abstract = filled[PLANE_STATE], filled[ABSTRACT_STATE]
    auxiliary, desired = filled[AUXILIARY_STATE], filled[DESIRED_ABSTRACT_STATE]
    return RunArrays(
        step=step.astype(np.int64),
        time=stamps[first] / 1e9,
        angle=plane.floats("angle"),
        angular_velocity=plane.floats("angular_velocity"),
        abstract=AbstractArrays(
            abstract.integers("agent_count"),
            *map(abstract.floats, ("torque", "inertia", "torque_rate", "inertia_rate")),
        ),
        auxiliary=AuxiliaryArrays(*map(auxiliary.floats, _AUXILIARY_FIELDS)),
        desired=DesiredArrays(desired.integers("mode"), *map(desired.floats, _DESIRED_FIELDS)),
        agents=_agents(tables[AGENT_STATE], rows[AGENT_STATE], len(step)),
    )


class _Columns:
    """Columns of a topic's table, put into arrays of a shape at the places of its messages."""

    def __init__(
        self, table: NDArray[np.void], places: Integers | tuple[Integers, Integers], shape: tuple[int, ...]
    ) -> None:
        self._table = table
        self._places = places
        self._shape = shape

    def floats(self, name: str) -> Floats:
        column = np.full(self._shape, np.nan)
        column[self._places] = self._table[name]
        return column

    def integers(self, name: str) -> Integers:
        column = np.zeros(self._shape, dtype=np.int64)
        column[self._places] = self._table[name]
        return column


def _agents(table: NDArray[np.void], rows: Integers, steps: int) -> AgentArrays:
    ids, columns = np.unique(table["agent_id"], return_inverse=True)
    filled = _Columns(table, (rows, columns), (steps, len(ids)))
    return AgentArrays(
        ids.astype(np.int64),
        filled.integers("kind"),
        filled.integers("status"),
        *map(filled.floats, ("mass", "damping", "position", "velocity", "command")),
    )

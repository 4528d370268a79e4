"""What robots pass on to each other in real time, where each of them sums up the swarm by itself (`Relay.content`).

A robot knows of every robot its newest state, and a newer one replaces it; so loss, repetition and order of messages do
not matter. Constants of a robot - kind, mass, damping - are passed on only to those who do not hold a state of it, and
once more where a tag shows that they have changed. All numbers are little-endian; docs/explanation/decentralised.md
describes the layout.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple
from zlib import crc32

import numpy as np

from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import NEVER, AgentState, PlaneState, Relay
from swarmabs_core.realtime.controller import LawView
from swarmabs_core.realtime.modes import Orders

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from swarmabs_core.realtime.base import Schedule

_HEADER = struct.Struct("<qqqqqqBHHH")
_PLANE = struct.Struct("<qqdd")
_CONSTANTS = struct.Struct("<HBdd")
_MOTION = struct.Struct("<HBiHdd")
_ITSELF = struct.Struct("<Bdd")
BUDGET = 1_300
"""Size of a content, bytes, beyond which states wait for the next period: with its headers, a relay is one datagram."""
FOLLOWS = 0x80
"""Added to the status of a robot that follows what the swarm is asked for."""
_NOTHING = 255
_OLDEST = 254
_AHEAD = 16
"""The age of what is held, in steps, is written with this offset: clocks differ, so it may be negative."""


class Constants(NamedTuple):
    """What of a robot changes rarely: kind, mass (kg), damping (N s/m)."""

    kind: int
    mass: float
    damping: float

    @property
    def tag(self) -> int:
        """A number that almost certainly differs from that of other constants."""
        return _tag(self)


@lru_cache(maxsize=4096)
def _tag(constants: Constants) -> int:
    return crc32(_ITSELF.pack(*constants)) & 0xFFFF


@dataclass(frozen=True, slots=True)
class Told:
    """What a relay tells.

    Attributes
    ----------
    orders : Orders
        STOP and RESET as far as the sender knows.
    law : LawView
        Its instance of the law.
    electing : tuple
        Since when which robots count for a majority: a step, and a set as bits by rank.
    plane_step : int
        Step of the newest state of the plane that it holds; -1: none.
    plane : PlaneState or None
        This state, if it passes it on.
    held : ndarray of int, (N,)
        By rank, the step of the newest state that it holds; -1: none.
    constants : mapping
        Constants by rank.
    motions : sequence of Motion
        The states that it passes on.
    """

    orders: Orders
    law: LawView
    electing: tuple[int, int]
    plane_step: int
    plane: PlaneState | None
    held: NDArray[np.int64]
    constants: Mapping[int, Constants]
    motions: Sequence[Motion]


class Motion(NamedTuple):
    """A state without its constants.

    Attributes
    ----------
    rank : int
        Rank of the robot by id.
    status : int
        Its status, plus `FOLLOWS` if it follows what the swarm is asked for.
    age : int
        Steps from the state to the relay.
    tag : int
        Tag of the constants.
    position, velocity : float
        In m and m/s.
    """

    rank: int
    status: int
    age: int
    tag: int
    position: float
    velocity: float

    def state(self, agent_id: int, constants: Constants, step: int, schedule: Schedule) -> AgentState:
        """Return it as the message of a step, with the time of that step."""
        return AgentState(
            schedule.begin(step),
            step,
            step if self.status & FOLLOWS else NEVER,
            agent_id,
            constants.kind,
            self.status & ~FOLLOWS,
            constants.mass,
            constants.damping,
            self.position,
            self.velocity,
            0.0,
        )


def constants_of(state: AgentState) -> Constants:
    """Return the constants of a robot."""
    return Constants(state.kind, state.mass, state.damping)


def motion_of(rank: int, state: AgentState, step: int) -> Motion:
    """Return a state without its constants, for a relay of a step."""
    status = state.status | (FOLLOWS if state.broadcast_step != NEVER else 0)
    return Motion(rank, status, step - state.step, constants_of(state).tag, state.position, state.velocity)


def room(budget: int, constants: int, motions: int) -> bool:
    """Return whether so many records of each kind fit into a number of bytes."""
    return constants * _CONSTANTS.size + motions * _MOTION.size <= budget


def overhead(robots: int, memory: int, *, plane: bool) -> int:
    """Return the size of a content without states."""
    return _HEADER.size + 8 * memory + _PLANE.size * plane + robots + -(-robots // 8)


def written(step: int, told: Told, robots: int) -> bytes:
    """Return the content of a relay of a step that tells this to a swarm of so many robots."""
    orders, law, plane = told.orders, told.law, told.plane
    since, counted = told.electing
    head = _HEADER.pack(
        *orders,
        law.begun,
        law.step,
        since,
        told.plane_step,
        plane is not None,
        len(law.memory),
        len(told.constants),
        len(told.motions),
    )
    return b"".join(
        (
            head,
            counted.to_bytes(-(-robots // 8), "little"),
            np.where(told.held < 0, _NOTHING, np.clip(step + _AHEAD - told.held, 0, _OLDEST))
            .astype(np.uint8)
            .tobytes(),
            struct.pack(f"<{len(law.memory)}d", *law.memory),
            b"" if plane is None else _PLANE.pack(*plane),
            *(_CONSTANTS.pack(rank, *constants) for rank, constants in told.constants.items()),
            *(_MOTION.pack(*motion) for motion in told.motions),
        )
    )


def read(relay: Relay, robots: int) -> Told:
    """Return what a relay tells in a swarm of so many robots.

    Raises
    ------
    MalformedMessageError
        If its content is not of this form.
    """
    content, step = relay.content, relay.step
    try:
        *head, with_plane, remembered, introduced, moved = _HEADER.unpack_from(content)
        stop, reset, begun, law_step, since, plane_step = head
        place = _HEADER.size + -(-robots // 8)
        counted = int.from_bytes(content[_HEADER.size : place], "little")
        ages = np.frombuffer(content[place : place + robots], np.uint8)
        place += robots
        memory = struct.unpack_from(f"<{remembered}d", content, place)
        place += 8 * remembered
        plane = PlaneState(*_PLANE.unpack_from(content, place)) if with_plane else None
        place += _PLANE.size * with_plane
        middle = place + introduced * _CONSTANTS.size
        if len(ages) != robots or len(content) != middle + moved * _MOTION.size:
            raise _malformed(f"{len(content)} bytes")
    except struct.error as error:
        raise _malformed(f"{len(content)} bytes") from error
    constants = {rank: Constants(*one) for rank, *one in _CONSTANTS.iter_unpack(content[place:middle])}
    motions = list(map(Motion._make, _MOTION.iter_unpack(content[middle:])))
    ranks = [*constants, *(motion.rank for motion in motions)]
    if max(ranks, default=0) >= robots or counted.bit_length() > robots:
        raise _malformed("robots that do not exist")
    if not all(map(isfinite, memory)):
        raise _malformed("numbers that are not finite")
    held = np.where(ages == _NOTHING, -1, step + _AHEAD - ages.astype(np.int64))
    law = LawView(begun, law_step, memory)
    return Told(Orders(stop, reset), law, (since, counted), plane_step, plane, held, constants, motions)


def _malformed(problem: str) -> MalformedMessageError:
    return MalformedMessageError(Relay.__name__, f"content: {problem}")

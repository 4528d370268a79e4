"""What robots pass on to each other in real time, where each of them sums up the swarm by itself (`Relay.content`).

A robot knows of every robot its newest state, and a newer one replaces it; so loss, repetition and order of messages do
not matter. Constants of a robot - kind, mass, damping - are passed on only to those who do not hold a state of it, and
once more where a tag shows that they have changed. For recordings it also tells what it has computed from which states,
as the `Basis` of an observer and of a parent controller does, in few bytes: most states are those that it holds. In a
sealed swarm each state is followed by its author's signature. All numbers are little-endian;
docs/explanation/decentralised_realtime.md describes the layout.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple
from zlib import crc32

import numpy as np

from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import NEVER, PARENT, AgentState, Basis, PlaneState, Relay, Source
from swarmabs_core.rank_sets import ranks, set_of
from swarmabs_core.realtime.controller import LawView
from swarmabs_core.realtime.modes import Orders

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from swarmabs_core.realtime.base import Schedule

_HEADER = struct.Struct("<qqqqqqBBHHH")
_PLANE = struct.Struct("<qqdd")
_CONSTANTS = struct.Struct("<HBdd")
_MOTION = struct.Struct("<HBiHdd")
_ITSELF = struct.Struct("<Bdd")
_ANSWER = struct.Struct("<BBBB")
_USED = struct.Struct("<HiB")
_PROGRESS = struct.Struct("<dddd")
SIGNATURE = 64
"""Size of a signature, bytes."""
_WITH_PLANE, _WITH_PROGRESS, _AFRESH, _SEALED = 1, 2, 4, 8
"""Flags of the header: which parts follow, that the desired state begins with the law's next torque, and that states
have signatures."""
MOST_ANSWERS, _MOST_USED = 12, 40
"""Answers in a relay, and states in one that are not those expected: of more, it is not told which they are."""
_NOT_TOLD = 254
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


class Answer(NamedTuple):
    """What a robot has computed for a step: sums, a desired abstract state, or both.

    Attributes
    ----------
    step : int
        The step.
    summed : bool
        Whether it has summed up the swarm.
    states : mapping or None
        The states in the sums: steps by rank; None if that is not told.
    resting : frozenset of int
        Ranks of the robots assumed at rest although their states are recent.
    since : int or None
        The step of the law from which it continued; `NEVER` if it began; None if there is no desired state.
    division : int or None
        The step of the sums whose division the desired state allows for.
    """

    step: int
    summed: bool = False
    states: Mapping[int, int] | None = None
    resting: frozenset[int] = frozenset()
    since: int | None = None
    division: int | None = None


def answers_of(bases: Iterable[Basis], rank: Mapping[int, int], age: int) -> list[Answer]:
    """Return the newest answers, given their provenances; robots are silent from an age in steps on."""
    answers: dict[int, Answer] = {}
    for basis in bases:
        answer = answers.pop(basis.step, Answer(basis.step))
        if basis.source == Source.OBSERVER:
            states = {rank[i]: step for i, step in zip(basis.agent_ids, basis.state_steps, strict=True)}
            standing = {rank[i] for i, mark in zip(basis.agent_ids, basis.standing, strict=True) if mark}
            resting = frozenset(one for one in standing if basis.step - states[one] <= age)
            answer = answer._replace(summed=True, states=states, resting=resting)
        else:
            answer = answer._replace(since=basis.since, division=next(iter(basis.state_steps), None))
        answers[basis.step] = answer
    return list(answers.values())[-MOST_ANSWERS:]


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
        Since when which robots count for a majority: a step (0: the start, -1: before it), and a set as bits by rank.
    plane_step : int
        Step of the newest state of the plane that it holds; -1: none.
    plane : PlaneState or None
        This state, if it passes it on.
    held : ndarray of int, (N,)
        By rank, the step of the newest state that it holds; -1: none.
    constants : mapping
        Constants by rank.
    answers : sequence of Answer
        What it has computed since its relay before.
    progress : tuple of float or None
        The desired state from which it continues, as in `DesiredStateGenerator.progress`; None if that is not told.
    motions : sequence of Motion
        The states that it passes on.
    sealed : bool
        Whether states have signatures.
    plane_signature : bytes
        That of the plane's state.
    """

    orders: Orders
    law: LawView
    electing: tuple[int, int]
    plane_step: int
    plane: PlaneState | None
    held: NDArray[np.int64]
    answers: Sequence[Answer] = ()
    progress: tuple[float, ...] | None = None
    constants: Mapping[int, Constants] = field(default_factory=dict)
    motions: Sequence[Motion] = ()
    sealed: bool = False
    plane_signature: bytes = b""


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
    signature : bytes
        That of the state, in a sealed swarm.
    """

    rank: int
    status: int
    age: int
    tag: int
    position: float
    velocity: float
    signature: bytes = b""

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


def motion_of(rank: int, state: AgentState, step: int, signature: bytes = b"") -> Motion:
    """Return a state without its constants, for a relay of a step."""
    status = state.status | (FOLLOWS if state.broadcast_step != NEVER else 0)
    tag = constants_of(state).tag
    return Motion(rank, status, step - state.step, tag, state.position, state.velocity, signature)


def room(budget: int, constants: int, motions: int, *, sealed: bool = False) -> bool:
    """Return whether so many records of each kind fit into a number of bytes."""
    return constants * _CONSTANTS.size + motions * (_MOTION.size + SIGNATURE * sealed) <= budget


def passed_on(state: AgentState, schedule: Schedule) -> AgentState:
    """Return a robot's state as others know it: with the time of its step, and without its command."""
    following = state.step if state.broadcast_step != NEVER else NEVER
    return state._replace(stamp=schedule.begin(state.step), broadcast_step=following, command=0.0)


def plane_relay(state: PlaneState, signature: bytes) -> Relay:
    """Return the message by which the plane's node tells a state with its signature."""
    return Relay(state.stamp, state.step, PARENT, 0, 0, 0, _PLANE.pack(*state) + signature)


def read_plane(relay: Relay) -> tuple[PlaneState, bytes]:
    """Return the state of the plane and its signature in a message of its node.

    Raises
    ------
    MalformedMessageError
        If its content is not of this form.
    """
    content = relay.content
    if len(content) != _PLANE.size + SIGNATURE:
        raise _malformed(f"{len(content)} bytes")
    return PlaneState(*_PLANE.unpack_from(content)), content[_PLANE.size :]


def written(step: int, told: Told, robots: int) -> bytes:
    """Return the content of a relay of a step that tells this to a swarm of so many robots."""
    orders, law, plane, progress = told.orders, told.law, told.plane, told.progress
    since, counted = told.electing
    flags = _WITH_PLANE * (plane is not None) + _WITH_PROGRESS * bool(progress) + _AFRESH * (progress == ())
    ages = np.where(told.held < 0, _NOTHING, np.clip(step + _AHEAD - told.held, 0, _OLDEST)).astype(np.uint8)
    head = _HEADER.pack(
        *orders,
        law.begun,
        law.step,
        since,
        told.plane_step,
        flags | _SEALED * told.sealed,
        len(told.answers),
        len(law.memory),
        len(told.constants),
        len(told.motions),
    )
    return b"".join(
        (
            head,
            counted.to_bytes(-(-robots // 8), "little"),
            ages.tobytes(),
            struct.pack(f"<{len(law.memory)}d", *law.memory),
            b"" if plane is None else _PLANE.pack(*plane) + told.plane_signature,
            _PROGRESS.pack(*progress) if progress else b"",
            *(_written_answer(step, answer, ages) for answer in told.answers),
            *(_CONSTANTS.pack(rank, *constants) for rank, constants in told.constants.items()),
            *(_MOTION.pack(*motion[:-1]) + motion.signature for motion in told.motions),
        )
    )


def _expected(step: int, age: int) -> int | None:
    """Return the step of the state that most likely was summed up, by the age of what is held at the end of a period.

    What has the step of the relay itself, as a robot's own state has, was not there yet.
    """
    return None if age in {_OLDEST, _NOTHING} else min(step + _AHEAD - age, step - 1)


def _written_answer(step: int, answer: Answer, ages: NDArray[np.uint8]) -> bytes:
    since, division = answer.since, answer.division
    states, resting = answer.states or {}, answer.resting
    used = [
        (rank, step - of, rank in resting)
        for rank, of in states.items()
        if rank in resting or of != _expected(step, int(ages[rank]))
    ]
    told = answer.states is not None and len(used) <= _MOST_USED
    head = _ANSWER.pack(
        min(max(step + _AHEAD - answer.step, 0), _OLDEST),
        _NOTHING if since is None else 0 if since == NEVER else answer.step - since,
        _NOTHING if division is None else min(max(step + _AHEAD - division, 0), _OLDEST),
        (len(used) if told else _NOT_TOLD) if answer.summed else _NOTHING,
    )
    if not told:
        return head
    there = set_of(states).to_bytes(-(-len(ages) // 8), "little")
    return b"".join((head, there, *(_USED.pack(*one) for one in used)))


def _read_answer(content: bytes, place: int, step: int, ages: NDArray[np.uint8]) -> tuple[Answer, int]:
    """Return the answer at a place of a content, and the place behind it."""
    age, since, division, differing = _ANSWER.unpack_from(content, place)
    place += _ANSWER.size
    of = step + _AHEAD - age
    states: dict[int, int] | None = None
    resting: set[int] = set()
    if differing < _NOT_TOLD:
        end = place + -(-len(ages) // 8)
        there = int.from_bytes(content[place:end], "little")
        unlike = {}
        for number in range(differing):
            rank, steps, rests = _USED.unpack_from(content, end + number * _USED.size)
            unlike[rank] = step - steps
            if rests:
                resting.add(rank)
        place = end + differing * _USED.size
        present = [*ranks(there)]
        if there.bit_length() > len(ages) or not unlike.keys() <= {*present}:
            raise _malformed("robots that do not exist")
        found = {rank: unlike.get(rank, _expected(step, int(ages[rank]))) for rank in present}
        states = {rank: held for rank, held in found.items() if held is not None}
        if len(states) < len(found):
            raise _malformed("states that are not held")
    answer = Answer(
        of,
        differing != _NOTHING,
        states,
        frozenset(resting),
        None if since == _NOTHING else of - since if since else NEVER,
        None if division == _NOTHING else step + _AHEAD - division,
    )
    return answer, place


def _behind_answer(content: bytes, place: int, robots: int) -> int:
    """Return the place behind an answer at a place of a content."""
    *_, differing = _ANSWER.unpack_from(content, place)
    told = -(-robots // 8) + differing * _USED.size if differing < _NOT_TOLD else 0
    return place + _ANSWER.size + told


def read(relay: Relay, robots: int, *, answers: bool = True) -> Told:
    """Return what a relay tells in a swarm of so many robots; its `answers`, which no robot needs, if they are wanted.

    Raises
    ------
    MalformedMessageError
        If its content is not of this form.
    """
    content, step = relay.content, relay.step
    progress: tuple[float, ...] | None = None
    try:
        *head, flags, answered, remembered, introduced, moved = _HEADER.unpack_from(content)
        signed = SIGNATURE if flags & _SEALED else 0
        stop, reset, begun, law_step, since, plane_step = head
        place = _HEADER.size + -(-robots // 8)
        counted = int.from_bytes(content[_HEADER.size : place], "little")
        ages = np.frombuffer(content[place : place + robots], np.uint8)
        place += robots
        memory = struct.unpack_from(f"<{remembered}d", content, place)
        place += 8 * remembered
        plane, plane_signature = None, b""
        if flags & _WITH_PLANE:
            plane = PlaneState(*_PLANE.unpack_from(content, place))
            place += _PLANE.size + signed
            plane_signature = content[place - signed : place]
        if flags & _WITH_PROGRESS:
            progress = _PROGRESS.unpack_from(content, place)
            place += _PROGRESS.size
        elif flags & _AFRESH:
            progress = ()
        if len(ages) != robots:
            raise _malformed(f"{len(content)} bytes")
        computed = []
        for _ in range(answered):
            if answers:
                answer, place = _read_answer(content, place, step, ages)
                computed.append(answer)
            else:
                place = _behind_answer(content, place, robots)
        middle = place + introduced * _CONSTANTS.size
        size = middle + moved * (_MOTION.size + signed)
        if len(content) != size or (moved and size > BUDGET):
            raise _malformed(f"{len(content)} bytes")
    except struct.error as error:
        raise _malformed(f"{len(content)} bytes") from error
    constants = {rank: Constants(*one) for rank, *one in _CONSTANTS.iter_unpack(content[place:middle])}
    if signed:
        motions = [
            Motion._make((*_MOTION.unpack_from(content, end - _MOTION.size), content[end : end + signed]))
            for end in range(middle + _MOTION.size, size, _MOTION.size + signed)
        ]
    else:
        motions = [Motion(*one) for one in _MOTION.iter_unpack(content[middle:])]
    named = [*constants, *(motion.rank for motion in motions)]
    if max(named, default=0) >= robots or counted.bit_length() > robots:
        raise _malformed("robots that do not exist")
    if not all(map(isfinite, (*memory, *(progress or ())))):
        raise _malformed("numbers that are not finite")
    held = np.where(ages == _NOTHING, -1, step + _AHEAD - ages.astype(np.int64))
    law = LawView(begun, law_step, memory)
    return Told(
        Orders(stop, reset),
        law,
        (since, counted),
        plane_step,
        plane,
        held,
        computed,
        progress,
        constants,
        motions,
        bool(signed),
        plane_signature,
    )


def law_time(relay: Relay) -> tuple[int, int]:
    """Return the last step that the sender's law has computed, and its step 0; -1 for both if there are none."""
    try:
        _, _, begun, step, *_ = _HEADER.unpack_from(relay.content)
    except struct.error:
        return -1, -1
    return (step, begun) if begun >= 0 else (-1, -1)


def _malformed(problem: str) -> MalformedMessageError:
    return MalformedMessageError(Relay.__name__, f"content: {problem}")

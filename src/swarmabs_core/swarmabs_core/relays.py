"""What robots pass on to each other where each of them sums up the swarm by itself (`Relay.content`).

Knowledge of a step is a set of states, one of each robot, and it only grows: loss, repetition and order of messages do
not matter. A state is passed on as its motion only, coordinates and velocities, because its constants are those of the
step before, which whoever takes part in a step knows completely. Only if they have changed it is passed on as a whole.

The content begins with three sets: the robots that took part in the step before (see `Knowledge.before`), those whose
states of this step the sender holds, and those whose motion follows. Bit i of a set, from the lowest bit of the first
byte on, stands for the i-th robot of the run by ascending id. Then follow the sizes of three parts (uint32), the motion
of one robot after the other (float64), and the parts: whole states and the state of the parent in the step before, both
as serialized messages, and votes, each the rank of its robot (uint16) and four sets. All numbers are little-endian.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar, cast

from swarmabs_core.agreement import Vote
from swarmabs_core.cdr import decode, encode, split
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import (
    NEVER,
    AgentState,
    AnyParentState,
    AnyRobotState,
    Family,
    Relay,
    RobotState,
    Vector,
    coordinates_of,
    vector_of,
)
from swarmabs_core.rank_sets import ranks

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_SIZES = struct.Struct("<III")
_RANK = struct.Struct("<H")

T = TypeVar("T")


class Knowledge(NamedTuple):
    """What a message tells of a step.

    Attributes
    ----------
    before : int
        Set of the robots that took part in the step before, as bits by rank. A robot that has yet to join is in it if
        it was dropped in that step: so the set tells whoever knows what was planned which robots were dropped.
    held : int
        Set of the robots whose states the sender holds, as bits by rank.
    states : tuple of AgentState or RobotState
        States that it passes on.
    parent : PlaneState, ParentState or None
        State of the parent in the step before, if it passes it on.
    votes : dict
        The votes that it knows, by rank.
    """

    before: int
    held: int
    states: tuple[AnyRobotState, ...]
    parent: AnyParentState | None
    votes: dict[int, Vote]


def reduced(state: AnyRobotState) -> AnyRobotState:
    """Return a state as others get to know it: without the command that led to it."""
    if isinstance(state, AgentState):
        return state._replace(broadcast_step=NEVER, command=0.0)
    return state._replace(broadcast_step=NEVER, command=(0.0,) * len(state.command))


class Content:
    """Writes and reads the contents of relays of a swarm.

    Parameters
    ----------
    members : iterable of int
        Ids of all robots that ever take part.
    family : Family
        Topics of the swarm.
    """

    def __init__(self, members: Iterable[int], family: Family) -> None:
        self._family = family
        self._ids = tuple(sorted(members))
        self._size = -(-len(self._ids) // 8)
        self._bit = {agent_id: 1 << rank for rank, agent_id in enumerate(self._ids)}

    def set_of(self, robots: Iterable[int]) -> int:
        """Return a set of robots as bits by rank."""
        bits = 0
        for robot in robots:
            bits |= self._bit[robot]
        return bits

    def robots_in(self, bits: int) -> tuple[int, ...]:
        """Return the ids of the robots in a set, ascending."""
        return tuple(self._ids[rank] for rank in ranks(bits))

    def rank(self, robot: int) -> int:
        """Return the rank of a robot."""
        return self._bit[robot].bit_length() - 1

    def written(
        self,
        took_part: int,
        held: int,
        states: Iterable[AnyRobotState],
        parent: AnyParentState | None,
        before: Mapping[int, AnyRobotState],
        votes: Mapping[int, Vote],
    ) -> bytes:
        """Return a content.

        Parameters
        ----------
        took_part : int
            Who took part in the step before, as `Knowledge.before`.
        held : int
            Set of the robots whose states the sender holds.
        states : iterable of AgentState or RobotState
            What it passes on, by ascending id.
        parent : PlaneState, ParentState or None
            The parent's state in the step before, if it passes it on.
        before : mapping
            The states of the step before by id.
        votes : mapping
            The votes that it knows, by rank.
        """
        carried, numbers, whole = 0, list[float](), list[bytes]()
        for state in states:
            if _continues(state, before.get(state.agent_id)):
                carried |= self._bit[state.agent_id]
                numbers += _motion(state)
            else:
                whole.append(encode(state))
        introduced = b"".join(whole)
        measured = b"" if parent is None else encode(parent)
        voted = b"".join(_RANK.pack(rank) + self._sets(*vote) for rank, vote in sorted(votes.items()))
        return b"".join(
            (
                self._sets(took_part, held, carried),
                _SIZES.pack(len(introduced), len(measured), len(voted)),
                _numbers(len(numbers)).pack(*numbers),
                introduced,
                measured,
                voted,
            )
        )

    def _sets(self, *sets: int) -> bytes:
        return b"".join(bits.to_bytes(self._size, "little") for bits in sets)

    def _sets_in(self, content: bytes, place: int, count: int) -> tuple[int, ...]:
        """Return so many sets from a place on; raises `MalformedMessageError` if there are robots that do not exist."""
        size = self._size
        sets = tuple(
            int.from_bytes(content[at : at + size], "little") for at in range(place, place + count * size, size)
        )
        if any(bits.bit_length() > len(self._ids) for bits in sets):
            raise self._malformed("robots that do not exist")
        return sets

    def before(self, relay: Relay) -> int:
        """Return who took part, as the sender knows, in the step before that of a relay (`Knowledge.before`).

        Raises
        ------
        MalformedMessageError
            If its content is not of this form.
        """
        if len(relay.content) < self._size:
            raise self._malformed(f"{len(relay.content)} bytes")
        return self._sets_in(relay.content, 0, 1)[0]

    def votes(self, relay: Relay) -> dict[int, Vote]:
        """Return the votes that a relay passes on, by rank; errors as for `before`."""
        content, start = relay.content, 3 * self._size
        if len(content) < start + _SIZES.size:
            raise self._malformed(f"{len(content)} bytes")
        length = _SIZES.unpack_from(content, start)[2]
        each = _RANK.size + len(Vote._fields) * self._size
        if length % each or length > len(content):
            raise self._malformed(f"votes of {length} bytes")
        votes = {}
        for place in range(len(content) - length, len(content), each):
            (rank,) = _RANK.unpack_from(content, place)
            if rank >= len(self._ids):
                raise self._malformed("robots that do not exist")
            votes[rank] = Vote(*self._sets_in(content, place + _RANK.size, len(Vote._fields)))
        return votes

    def read(self, relay: Relay, before: Mapping[int, AnyRobotState], known: int = 0) -> Knowledge:
        """Return what a relay tells beyond the known states, given the states of the step before by id.

        Raises
        ------
        MalformedMessageError
            If its content is not of this form.
        """
        content, size = relay.content, self._size
        votes = self.votes(relay)
        earlier, held, carried = self._sets_in(content, 0, 3)
        introduced, measured, voted = _SIZES.unpack_from(content, 3 * size)
        place = 3 * size + _SIZES.size
        robots = self.robots_in(carried)
        unknown = [robot for robot in robots if robot not in before]
        if unknown:
            raise self._malformed(f"motion of robot {unknown[0]}, whose constants are not known")
        numbers = _numbers(2 * sum(len(coordinates_of(before[robot])) for robot in robots))
        end = place + numbers.size
        if len(content) != end + introduced + measured + voted:
            raise self._malformed(f"{len(content)} bytes")
        values, states, first = numbers.unpack_from(content, place), list[AnyRobotState](), 0
        for robot in robots:
            length = len(coordinates_of(before[robot]))
            middle, last = first + length, first + 2 * length
            if not known & self._bit[robot]:
                states.append(_continued(before[robot], relay, values[first:middle], values[middle:last]))
            first = last
        kind = self._family.robot.message
        for payload in split(kind, content[end : end + introduced]):
            states.append(cast("AnyRobotState", decode(kind, payload)))
        parent = content[end + introduced : end + introduced + measured]
        measured_state = cast("AnyParentState", decode(self._family.parent.message, parent)) if parent else None
        if any(state.step != relay.step for state in states):
            raise self._malformed(f"states of other steps than {relay.step}")
        if measured_state is not None and measured_state.step != relay.step - 1:
            raise self._malformed(f"a state of the parent of another step than {relay.step - 1}")
        return Knowledge(earlier, held, tuple(states), measured_state, votes)

    @staticmethod
    def _malformed(problem: str) -> MalformedMessageError:
        return MalformedMessageError(Relay.__name__, f"content: {problem}")


class StepRelays(Generic[T]):
    """The relays of a step, in any form, by robot and round.

    A robot's relays are whole if that of each round is there up to one that is its last. Where robots vote, one that
    tells votes may end them too.

    Parameters
    ----------
    content : Content
        Reads the contents of the swarm.

    Attributes
    ----------
    voted : bool
        Whether any of them tells votes. Which relays a robot sends then depends on time.
    """

    def __init__(self, content: Content) -> None:
        self._content = content
        self.voted = False
        self._by_robot: dict[int, dict[int, T]] = {}
        self._ends: dict[int, int] = {}
        self._whole: set[int] = set()

    def put(self, relay: Relay, form: T) -> T:
        """Add a relay in a form unless there is one in its place; return the one there is."""
        robot = relay.agent_id
        rounds = self._by_robot.setdefault(robot, {})
        there = rounds.setdefault(relay.round, form)
        if relay.last:
            self._ends.setdefault(robot, relay.round)
        voted = self._votes(relay)
        self.voted |= voted
        if voted or len(rounds) == self._ends.get(robot, -2) + 1:
            self._whole.add(robot)
        return there

    def _votes(self, relay: Relay) -> bool:
        try:
            return bool(self._content.votes(relay))
        except MalformedMessageError:
            return False

    def __len__(self) -> int:
        """Return the number of relays."""
        return sum(map(len, self._by_robot.values()))

    def lacking(self, robots: Iterable[int]) -> list[int]:
        """Return those of the robots whose relays are not whole."""
        return [robot for robot in robots if robot not in self._whole]

    def ordered(self) -> list[T]:
        """Return the relays by round and robot."""
        places = ((number, robot, form) for robot, rounds in self._by_robot.items() for number, form in rounds.items())
        return [form for _, _, form in sorted(places, key=lambda place: place[:2])]


@lru_cache(maxsize=1024)
def _numbers(count: int) -> struct.Struct:
    return struct.Struct(f"<{count}d")


def _motion(state: AnyRobotState) -> Vector:
    return (*vector_of(state, "coordinates"), *vector_of(state, "velocities"))


def _continues(state: AnyRobotState, before: AnyRobotState | None) -> bool:
    """Return whether a state has the constants of the one before."""
    return before is not None and _constants(state) == _constants(before)


def _constants(state: AnyRobotState) -> tuple[object, ...]:
    return state.kind, state.status, vector_of(state, "constants"), len(coordinates_of(state))


def _continued(before: AnyRobotState, relay: Relay, coordinates: Vector, velocities: Vector) -> AnyRobotState:
    """Return the state of a robot with this motion and the constants of its state before."""
    if isinstance(before, RobotState):
        return before._replace(stamp=relay.stamp, step=relay.step, coordinates=coordinates, velocities=velocities)
    return before._replace(stamp=relay.stamp, step=relay.step, position=coordinates[0], velocity=velocities[0])

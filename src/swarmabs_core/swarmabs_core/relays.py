"""What robots pass on to each other where each of them sums up the swarm by itself (`Relay.content`).

Knowledge of a step is a set of states, one of each robot, and it only grows: loss, repetition and order of messages do
not matter. A state is passed on as its motion only, coordinates and velocities, because its constants are those of the
step before, which whoever takes part in a step knows completely. Only if they have changed it is passed on as a whole.

The content begins with the set of robots whose states the sender holds, and the set of those whose motion follows; bit
i of a set, from the lowest bit of the first byte on, stands for the i-th robot of the run by ascending id. Then follow
the sizes of two parts (uint32), the motion of one robot after the other (float64), whole states and the state of the
parent, both as serialized messages. All numbers are little-endian.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar, cast

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

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_SIZES = struct.Struct("<II")

T = TypeVar("T")


class Knowledge(NamedTuple):
    """What a message tells of a step.

    Attributes
    ----------
    held : int
        Set of the robots whose states the sender holds, as bits by rank.
    states : tuple of AgentState or RobotState
        States that it passes on.
    parent : PlaneState, ParentState or None
        State of the parent, if it passes it on.
    """

    held: int
    states: tuple[AnyRobotState, ...]
    parent: AnyParentState | None


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
        robots = []
        while bits:
            robots.append(self._ids[(bits & -bits).bit_length() - 1])
            bits &= bits - 1
        return tuple(robots)

    def written(
        self,
        held: int,
        states: Iterable[AnyRobotState],
        parent: AnyParentState | None,
        before: Mapping[int, AnyRobotState],
    ) -> bytes:
        """Return a content.

        Parameters
        ----------
        held : int
            Set of the robots whose states the sender holds.
        states : iterable of AgentState or RobotState
            What it passes on, by ascending id.
        parent : PlaneState, ParentState or None
            The parent's state, if it passes it on.
        before : mapping
            The states of the step before by id.
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
        return b"".join(
            (
                held.to_bytes(self._size, "little"),
                carried.to_bytes(self._size, "little"),
                _SIZES.pack(len(introduced), len(measured)),
                _numbers(len(numbers)).pack(*numbers),
                introduced,
                measured,
            )
        )

    def read(self, relay: Relay, before: Mapping[int, AnyRobotState], known: int = 0) -> Knowledge:
        """Return what a relay tells beyond the known states, given the states of the step before by id.

        Raises
        ------
        MalformedMessageError
            If its content is not of this form.
        """
        content, size = relay.content, self._size
        if len(content) < 2 * size + _SIZES.size:
            raise self._malformed(f"{len(content)} bytes")
        held, carried = (int.from_bytes(content[at : at + size], "little") for at in (0, size))
        introduced, measured = _SIZES.unpack_from(content, 2 * size)
        place = 2 * size + _SIZES.size
        if (held | carried).bit_length() > len(self._ids):
            raise self._malformed("robots that do not exist")
        robots = self.robots_in(carried)
        unknown = [robot for robot in robots if robot not in before]
        if unknown:
            raise self._malformed(f"motion of robot {unknown[0]}, whose constants are not known")
        numbers = _numbers(2 * sum(len(coordinates_of(before[robot])) for robot in robots))
        end = place + numbers.size
        if len(content) != end + introduced + measured:
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
        parent = content[end + introduced :]
        measured_state = cast("AnyParentState", decode(self._family.parent.message, parent)) if parent else None
        told = (*states, *(() if measured_state is None else (measured_state,)))
        if any(state.step != relay.step for state in told):
            raise self._malformed(f"states of other steps than {relay.step}")
        return Knowledge(held, tuple(states), measured_state)

    @staticmethod
    def _malformed(problem: str) -> MalformedMessageError:
        return MalformedMessageError(Relay.__name__, f"content: {problem}")


class StepRelays(Generic[T]):
    """The relays of a step, in any form, by robot and round.

    A robot's relays are whole if that of each round is there up to one that is its last.
    """

    def __init__(self) -> None:
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
        if len(rounds) == self._ends.get(robot, -2) + 1:
            self._whole.add(robot)
        return there

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

"""Who takes part in which step, as the events of a swarm say."""

from __future__ import annotations

from bisect import bisect_right, insort
from operator import itemgetter
from typing import TYPE_CHECKING, Literal, NamedTuple

from swarmabs_core.messages import EventKind

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_core.messages import SwarmEvent


class Out(NamedTuple):
    """How a robot is out; `place` (m) is where the weight of a dead one stands."""

    status: Literal["absent", "dead", "left"]
    place: float = 0.0


class Members(NamedTuple):
    """Ids of the robots that are commanded; ids and places (m) of those whose weights stand still on the plane."""

    moving: tuple[int, ...]
    standing: tuple[tuple[int, float], ...]


class MembershipTimeline:
    """Which robots are in and out by step; events may come in any order, and more than once.

    Only the observer knows which robots are dead, and announces when one is back. What a robot says of itself after
    its end changes nothing, except that it leaves and joins.

    Parameters
    ----------
    robots : iterable of int
        Ids of the robots that are known beforehand.
    absent : iterable of int
        Those of them that take part only from when they have joined.
    most : int, optional
        Changes of a robot that are kept, the latest.
    """

    def __init__(self, robots: Iterable[int] = (), absent: Iterable[int] = (), *, most: int | None = None) -> None:
        self._robots = tuple(robots)
        self._most = most
        self._changes: dict[int, list[tuple[int, Out | None]]] = {robot: [(-1, Out("absent"))] for robot in absent}
        self._steps: list[int] | None = None
        self._members: dict[int, Members] = {}

    def __len__(self) -> int:
        return len(self._changes)

    def take(self, event: SwarmEvent) -> None:
        """Take an event; those of other kinds change nothing."""
        if event.kind == EventKind.JOINED:
            out = None
        elif event.kind == EventKind.DEAD:
            out = Out("dead", event.value)
        elif event.kind == EventKind.LEFT:
            out = Out("left")
        else:
            return
        changes = self._changes.setdefault(event.agent_id, [])
        insort(changes, (event.step, out), key=itemgetter(0))
        if self._most is not None:
            del changes[: -self._most]
        self._steps = None

    def out(self, robot: int, step: int) -> Out | None:
        """Return how a robot is out at a step, None if it is in."""
        changes = self._changes.get(robot)
        if changes is None:
            return None
        place = bisect_right(changes, step, key=itemgetter(0))
        return changes[place - 1][1] if place else None

    def changes(self, robot: int) -> tuple[tuple[int, Out | None], ...]:
        """Return the steps at which a robot goes out (how) or comes in (None), ascending."""
        return tuple(self._changes.get(robot, ()))

    def members(self, step: int) -> Members:
        """Return who takes part at a step, of the robots that are known beforehand."""
        if self._steps is None:
            self._steps = sorted({step for known in self._changes.values() for step, _ in known})
            self._members.clear()
        place = bisect_right(self._steps, step)
        found = self._members.get(place)
        if found is None:
            outs = [(robot, self.out(robot, step)) for robot in self._robots]
            found = self._members[place] = Members(
                tuple(robot for robot, out in outs if out is None),
                tuple((robot, out.place) for robot, out in outs if out is not None and out.status == "dead"),
            )
        return found

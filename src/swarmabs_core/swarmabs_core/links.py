"""Who hears whom, where each robot sums up the swarm by itself, and which messages the links lose."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count as counted
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.declaration import setting
from swarmabs_core.errors import InputError
from swarmabs_core.faults import fraction

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

Pair = tuple[int, int]


CENTRAL, EACH_ROBOT = "central", "each_robot"
"""Who sums up the swarm and controls it: observer and parent controller, or each robot by itself."""


COPIES = 16
"""Neighbours from which a robot hears a state in a round or period, if it has so many; fewer lose more of it."""


class Link(NamedTuple):
    """A pair of robots that hear each other, the lower id first."""

    one: int
    other: int

    def __str__(self) -> str:
        return f"{self.one} {self.other}"

    @classmethod
    def parse(cls, text: str) -> Link:
        """Read ``ONE OTHER``, such as ``1 4``; raises `InputError` if the text is not of this form."""
        try:
            one, other = map(int, text.split())
        except ValueError:
            raise InputError(f"link {text!r} is not of the form 'ONE OTHER', the ids of two robots") from None
        if one == other:
            raise InputError(f"link {text!r} joins a robot to itself")
        return cls(min(one, other), max(one, other))


@dataclass(frozen=True, slots=True)
class Coordination:
    """Where the swarm is summed up and controlled."""

    coordination: str = setting(
        CENTRAL,
        "where the swarm is summed up and controlled: by observer and parent controller, or by each robot for itself",
        choices=(CENTRAL, EACH_ROBOT),
    )


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Who hears whom, and what gets lost."""

    type: str = setting(
        "all",
        "which robots hear each other: all; ring: neighbours by id; random: `degree` of each; listed: `pairs`",
        choices=("all", "ring", "random", "listed"),
    )
    degree: int = setting(6, "number of robots that each robot hears with `type: random`", minimum=2)
    seed: int = setting(1, "seed of random links and losses", minimum=0, below=2**63)
    pairs: tuple[Link, ...] = setting((), "pairs of robots that hear each other, each 'ONE OTHER'", make=Link.parse)
    loss: float = setting(0.0, "share of the messages that a link loses, each way, 0 to 1", minimum=0.0, below=1.0)
    sensing: tuple[int, ...] = setting(
        (), "ids of the robots that hear the parent's state; none: all robots", item=0, minimum=1, maximum=65535
    )


class Links:
    """The links of a swarm.

    Parameters
    ----------
    settings : LinkSettings
        Which robots hear each other.
    members : iterable of int
        Ids of all robots that ever take part.

    Raises
    ------
    InputError
        If there are no such links, or robots without any way to each other.
    """

    def __init__(self, settings: LinkSettings, members: Iterable[int]) -> None:
        self._loss, self._seed = settings.loss, settings.seed
        ids = tuple(sorted(members))
        self._neighbours = _neighbours(ids, _pairs(settings, ids))
        self._sensing = frozenset(settings.sensing or ids)
        if strangers := sorted({*self._sensing} - {*ids}):
            raise InputError(f"links.sensing: there is no robot {strangers[0]}")
        if cut := self.apart(ids):
            raise InputError(
                f"robot {cut[0]} hears robot {ids[0]} on no way", "add links, or use `type: all` or `ring`"
            )

    def of(self, robot: int) -> tuple[int, ...]:
        """Return the ids of the robots that a robot hears, ascending."""
        return tuple(sorted(self._neighbours[robot]))

    def senses(self, robot: int) -> bool:
        """Return whether a robot hears the parent's state itself."""
        return robot in self._sensing

    def apart(self, robots: Iterable[int]) -> tuple[int, ...]:
        """Return those robots that the first one does not reach through the others, ascending."""
        return _apart(self._neighbours, robots)

    def loses(self, step: int, turn: int, sender: int, receiver: int) -> bool:
        """Return whether the message of a round of a step is lost on its way."""
        return lost(self._seed, self._loss, step, turn, sender, receiver)


def lost(seed: int, loss: float, step: int, turn: int, sender: int, receiver: int) -> bool:
    """Return whether a link that loses a share of its messages loses that of a round of a step."""
    return loss > 0.0 and fraction(f"{seed}:{step}:{turn}:{sender}:{receiver}") < loss


def _pairs(settings: LinkSettings, ids: tuple[int, ...]) -> Iterator[Pair]:
    """Return the pairs of robots that hear each other."""
    count = len(ids)
    if settings.type == "listed":
        for link in settings.pairs:
            if strangers := {*link} - {*ids}:
                raise InputError(f"links.pairs: there is no robot {min(strangers)}")
        return iter(settings.pairs)
    if settings.type == "random" and settings.degree < count - 1:
        return ((ids[one], ids[other]) for one, other in _random_pairs(count, settings.degree, settings.seed))
    if settings.type == "ring":
        return ((ids[n], ids[(n + 1) % count]) for n in range(count if count > 2 else count - 1))
    return ((one, other) for n, one in enumerate(ids) for other in ids[n + 1 :])


_MIXING = 10
"""Attempts per pair to exchange its ends with those of another pair."""


def _random_pairs(count: int, degree: int, seed: int) -> list[Pair]:
    """Return the pairs of a connected graph in which each of `count` vertices has `degree` neighbours.

    Pairs of a circle with chords exchange their ends at random; what cuts the graph apart is drawn anew.

    Raises
    ------
    InputError
        If there is no such graph: one of `count` and `degree` must be even.
    """
    if count * degree % 2:
        raise InputError(
            f"links.degree: {count} robots cannot each hear {degree} others", f"use {degree + 1}, an even number"
        )
    draws = (fraction(f"links:{seed}:{number}") for number in counted())
    while True:
        pairs = _circle(count, degree)
        present = {*pairs}
        for _ in range(_MIXING * len(pairs)):
            m, n = int(next(draws) * len(pairs)), int(next(draws) * len(pairs))
            (a, b), (c, d) = pairs[m], pairs[n]
            if next(draws) < 0.5:
                c, d = d, c
            one, other = _ordered(a, d), _ordered(c, b)
            if len({a, b, c, d}) == 4 and one not in present and other not in present:
                present -= {pairs[m], pairs[n]}
                present |= {one, other}
                pairs[m], pairs[n] = one, other
        if not _apart(_neighbours(range(count), pairs), range(count)):
            return sorted(pairs)


def _circle(count: int, degree: int) -> list[Pair]:
    """Return the pairs of a circle in which each vertex is next to `degree` others."""
    pairs = [_ordered(n, (n + away) % count) for away in range(1, degree // 2 + 1) for n in range(count)]
    if degree % 2:
        pairs += [(n, n + count // 2) for n in range(count // 2)]
    return pairs


def _ordered(one: int, other: int) -> Pair:
    return (one, other) if one < other else (other, one)


def _neighbours(robots: Iterable[int], pairs: Iterable[Pair]) -> dict[int, set[int]]:
    """Return the robots that each robot hears."""
    neighbours: dict[int, set[int]] = {robot: set() for robot in robots}
    for one, other in pairs:
        neighbours[one].add(other)
        neighbours[other].add(one)
    return neighbours


def _apart(neighbours: Mapping[int, set[int]], robots: Iterable[int]) -> tuple[int, ...]:
    """Return those robots that the first one does not reach through the others, ascending."""
    left = {*robots}
    reached = [min(left)] if left else []
    left -= {*reached}
    while reached:
        near = neighbours[reached.pop()] & left
        left -= near
        reached += near
    return tuple(sorted(left))

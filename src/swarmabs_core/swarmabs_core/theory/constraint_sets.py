r"""Abstract states that the robots can realise without leaving the plane (def. absConstrained to partConstrained).

The preimage of a state (tau, J) is the set of all positions with g sum m p = tau and sum m p^2 = J. With
T = tau/g, M = sum m, h = L/2 and the box |p_i| <= h, three curves over T divide the abstract space:

.. math::

    J_{min} = T^2/M \qquad J_A = J_{min} + (h - |T|/M)^2 / (1/m_{min} - 1/M) \qquad
    J_{max} = \max \{ \sum m p^2 : |p_i| \le h, \sum m p = T \}

Below J_min the preimage is empty. Up to J_A the whole preimage is in the box (A_A), up to J_max a part of it (A_P), and
above, or for |T| > M h, no part (A_U). A state on a curve, within rounding, belongs to the set below it.

J_max is attained at a vertex of the box's slice, where at most one robot is not at an end of the plane. It is thus the
upper envelope of the edges of the box, each of which is a parabola in the abstract space, and requires a signed sum of
masses near a given value. The result is exact for up to 21 different masses, and for any number of equal ones;
otherwise it is bracketed by a nearly optimal vertex and M h^2.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from math import copysign, fsum, inf, prod, sqrt
from typing import NamedTuple

_ROUNDING = 1e-12
"""Tolerance relative to M h^2 or M: a state that is beyond a boundary by less counts as on it."""
_MOST_SUMS = 1 << 15
"""Largest number of sums of masses that are searched at a torque for an exact J_max."""
_FREE = 14
"""Number of robots whose signs are all tried if there are too many robots for an exact result."""
_MOST_EDGES = 1 << 16
"""Largest number of edges of the box that are searched to follow a curve below their envelope."""


class StateClass(Enum):
    """Location of an abstract state's preimage relative to the plane."""

    ADMISSIBLE = "A_A"
    """All positions in the preimage are on the plane."""
    PARTIAL = "A_P"
    """Some positions in the preimage are on the plane, others are not."""
    UNREACHABLE = "A_U"
    """The preimage is not empty, but no position in it is on the plane."""
    EMPTY = "empty"
    """No positions have this torque and inertia, on the plane or off it."""
    UNDECIDED = "A_P or A_U"
    """One of these two: there are too many robots for an exact answer, and the state is in the bracket of J_max."""


class Bracket(NamedTuple):
    """Lower and upper bound of a number, equal if it is known exactly."""

    lower: float
    upper: float


class Edge(NamedTuple):
    """An edge of the box: one robot moves across the plane while all others are at its ends.

    For x from -1 to 1, T = h (rest + mass x) and J = h^2 (M - mass (1 - x^2)).
    """

    mass: float  # of the robot that moves, kg
    rest: float  # sum of the other masses, kg, negative for those at the negative end


class ManifoldReach(NamedTuple):
    """The |tau| (N m) up to which a manifold J = curvature tau^2 + offset stays in each set, starting at tau = 0.

    It is -inf if the manifold is outside at tau = 0, inf if it never leaves the set.
    """

    admissible: float  # in A_A
    reachable: Bracket  # in A_A or A_P; exact for up to 13 different masses
    nonempty: float  # where the preimage is not empty


@dataclass(frozen=True, slots=True)
class ConstraintSets:
    """The constraint sets of robots on a plane; abstract states are tau_s in N m and Js in kg m^2."""

    masses: Sequence[float]  # kg; most sets need at least two robots
    length: float  # of the plane, m
    gravity: float  # m/s^2

    @property
    def total(self) -> float:
        """The mass of all robots, kg; raises ValueError if there are fewer than two."""
        if len(self.masses) < 2:
            raise ValueError(f"the constraint sets need at least two robots, got {len(self.masses)}")
        return fsum(self.masses)

    @property
    def largest_torque(self) -> float:
        """The torque (N m) with all robots at one end of the plane."""
        return self.gravity * fsum(self.masses) * self.length / 2

    def largest_position(self, torque: float, inertia: float) -> float:
        """Return the largest |p_i| (m) of any robot in the preimage of an abstract state.

        With T = torque/g and M = sum m this is ``|T|/M + sqrt((Js - T^2/M) (1/m_min - 1/M))``, which is exact and
        attained; it is infinite if the preimage is empty.
        """
        total = fsum(self.masses)
        moment = torque / self.gravity
        free = inertia - moment * moment / total
        if free < 0:
            return inf
        return abs(moment) / total + sqrt(free * max(0.0, 1 / min(self.masses) - 1 / total))

    def smallest_inertia(self, torque: float) -> float:
        """Return J_min = T^2/M (kg m^2), below which the preimage is empty at this torque (N m)."""
        moment = torque / self.gravity
        return moment * moment / fsum(self.masses)

    def largest_admissible_inertia(self, torque: float) -> float:
        """Return J_A (kg m^2), the upper boundary of A_A, at a torque (N m); -inf if A_A has no state with this torque.

        At J_A, `largest_position` equals L/2.
        """
        total = self.total
        left = self.length / 2 - abs(torque) / (self.gravity * total)
        if left < -_ROUNDING * self.length:
            return -inf
        return self.smallest_inertia(torque) + max(left, 0.0) ** 2 / (1 / min(self.masses) - 1 / total)

    def largest_inertia(self, torque: float) -> Bracket:
        """Return J_max (kg m^2), the largest inertia of robots on the plane at a torque (N m).

        It is exact for up to 21 different masses, for any number of equal ones, and for torques so large that few
        robots can be on the other side. Both bounds are -inf if no positions on the plane have this torque.
        """
        half, total = self.length / 2, self.total
        wanted = abs(torque) / (self.gravity * half)
        if wanted > total * (1 + _ROUNDING):
            return Bracket(-inf, -inf)
        wanted = min(wanted, total)
        members = sorted(self.masses)
        if len(set(members)) * min(_sums(part) for part in _halves(members)) <= _MOST_SUMS:
            exact, missing = True, _least_missing(wanted, tuple(members))
        else:
            # If the torque is large enough, every robot that can be on the other side is among the lightest. Otherwise
            # robots of all masses are free, and the others are placed so that little torque is left for these.
            exact = total - wanted <= 2 * members[_FREE - 1]
            free = range(_FREE) if exact else range(0, len(members), len(members) // _FREE)[:_FREE]
            left = wanted
            for index in reversed(range(len(members))):
                if index not in free:
                    left -= members[index] if left >= 0 else -members[index]
            least = _least_missing(left, tuple(members[index] for index in free))
            missing = min(least, _missing(wanted, _chain(members, total), _ROUNDING * total))
        lower = half * half * (total - missing)
        return Bracket(lower, lower if exact else half * half * total)

    def classify(self, torque: float, inertia: float) -> StateClass:
        """Return the class of an abstract state; UNDECIDED occurs only where `largest_inertia` is not exact."""
        slack = _ROUNDING * self.length * self.length * self.total / 4
        if inertia < self.smallest_inertia(torque) - slack:
            return StateClass.EMPTY
        if inertia <= self.largest_admissible_inertia(torque) + slack:
            return StateClass.ADMISSIBLE
        if inertia <= self._chain_inertia(torque):
            return StateClass.PARTIAL  # most states are decided here, without a search
        bound = self.largest_inertia(torque)
        if inertia <= bound.lower + slack:
            return StateClass.PARTIAL
        return StateClass.UNREACHABLE if inertia > bound.upper + slack else StateClass.UNDECIDED

    def admissible_reach(self, curvature: float, offset: float) -> float:
        """Return only `ManifoldReach.admissible` of a manifold, which is fast for any number of robots."""
        total, (rise, start, unit) = self.total, self._scaled(curvature, offset)
        shortage = 1 / total - rise
        factor = 1 / min(self.masses) - 1 / total
        # (1 - s/M)^2 - factor (start - shortage s^2) >= 0, on s <= M.
        inside = _nonnegative(1 / total**2 + factor * shortage, -2 / total, 1 - factor * start, 0.0, total)
        return unit * min(_first_gap(inside, total), sqrt(start / shortage) if shortage > 0 else inf)

    def manifold_reach(self, curvature: float, offset: float) -> ManifoldReach:
        """Return how far the states along a manifold J = curvature tau^2 + offset stay in A_A, and in A_A or A_P.

        The curvature (kg m^2/(N m)^2) must not be negative, the offset (kg m^2) must be positive.
        """
        total, (rise, start, unit) = self.total, self._scaled(curvature, offset)
        shortage = 1 / total - rise
        nonempty = sqrt(start / shortage) if shortage > 0 else inf
        ceiling = total if start <= total else -inf
        if rise > 0 and start <= total:
            ceiling = min(ceiling, sqrt((total - start) / rise))
        complete = _edge_count(self.masses) <= _MOST_EDGES
        edges = box_edges(self.masses) if complete else _chains(sorted(self.masses))
        below = (
            interval
            for mass, rest in edges
            for interval in _nonnegative(
                1 / mass - rise,
                -2 * rest / mass,
                rest * rest / mass + total - mass - start,
                max(rest - mass, 0.0),
                rest + mass,
            )
        )
        lower = min(_first_gap(below, total), nonempty)
        upper = lower if complete else min(ceiling, nonempty)
        admissible = self.admissible_reach(curvature, offset)
        return ManifoldReach(admissible, Bracket(unit * lower, unit * upper), unit * nonempty)

    def _scaled(self, curvature: float, offset: float) -> tuple[float, float, float]:
        """Return a manifold over s = T/h in kg, with inertias divided by h^2, and the torque (N m) at s = 1."""
        half = self.length / 2
        return curvature * self.gravity**2, offset / half**2, self.gravity * half

    def _chain_inertia(self, torque: float) -> float:
        """Return a lower bound of J_max (kg m^2) at a torque (N m) from one chain of edges; -inf off the plane."""
        half, total = self.length / 2, fsum(self.masses)
        chain = _chain(sorted(self.masses), total)
        return half * half * (total - _missing(abs(torque) / (self.gravity * half), chain, 0.0))


def box_edges(masses: Sequence[float]) -> Iterator[Edge]:
    """Yield all N 2^(N-1) edges of the box of positions, without duplicates for robots of equal mass."""
    groups = Counter(masses)
    for mass in groups:
        for rest in _signed_sums(groups - Counter((mass,))):
            yield Edge(mass, rest)


def _signed_sums(groups: Counter[float]) -> list[float]:
    """Return the different sums of +-mass over groups of equal masses, ascending; kg."""
    sums = {0.0}
    for mass, count in sorted(groups.items()):
        sums = {rest + mass * (2 * positive - count) for rest in sums for positive in range(count + 1)}
    return sorted(sums)


def _sums(groups: Counter[float]) -> int:
    return prod(count + 1 for count in groups.values())


def _edge_count(masses: Sequence[float]) -> int:
    groups = Counter(masses)
    sums = _sums(groups)
    return sum(sums // (count + 1) * count for count in groups.values())


def _halves(masses: Sequence[float]) -> tuple[Counter[float], Counter[float]]:
    """Split the robots so that both parts have about equally many signed sums; equal masses stay together."""
    halves: tuple[Counter[float], Counter[float]] = (Counter(), Counter())
    for mass, count in sorted(Counter(masses).items(), key=lambda group: (-group[1], group[0])):
        min(halves, key=_sums)[mass] = count
    return halves


@lru_cache(maxsize=16)
def _rests(masses: tuple[float, ...]) -> tuple[tuple[float, list[float], list[float]], ...]:
    """Return two lists for each different mass; sums of one item of each are the signed sums of all other masses."""
    parts = _halves(masses)
    lists = [_signed_sums(part) for part in parts]
    rests = []
    for part, other in ((parts[0], lists[1]), (parts[1], lists[0])):
        for mass in part:
            shorter, longer = sorted((_signed_sums(part - Counter((mass,))), other), key=len)
            rests.append((mass, shorter, longer))
    return tuple(rests)


def _least_missing(wanted: float, masses: tuple[float, ...]) -> float:
    """Return the smallest (M h^2 - J)/h^2 (kg) over all vertices of a slice T = h wanted; inf if there is none."""
    slack = _ROUNDING * fsum(masses)
    least = inf
    for mass, some, others in _rests(masses):
        # The moving robot must be near an end: the rest is just above wanted - mass, or just below wanted + mass.
        low, high = wanted - mass - slack, wanted + mass + slack
        for rest in some:
            near = []
            if (after := bisect_left(others, low - rest)) < len(others):
                near.append(Edge(mass, rest + others[after]))
            if (before := bisect_right(others, high - rest)) > 0:
                near.append(Edge(mass, rest + others[before - 1]))
            least = min(least, _missing(wanted, near, slack))
    return least


def _missing(wanted: float, edges: Iterable[Edge], slack: float) -> float:
    """Return the smallest (M h^2 - J)/h^2 (kg) over the edges that have a point with T = h wanted."""
    least = inf
    for mass, rest in edges:
        moment = abs(wanted - rest)
        if moment <= mass + slack:
            moment = min(moment, mass)
            least = min(least, (mass - moment) * (mass + moment) / mass)
    return least


def _chain(masses: Iterable[float], total: float) -> Iterator[Edge]:
    """Yield the edges from the corner with all robots at the negative end to the opposite corner, robot by robot."""
    moment = -total
    for mass in masses:
        yield Edge(mass, moment + mass)
        moment += 2 * mass


def _chains(masses: Sequence[float]) -> Iterator[Edge]:
    """Yield the edges of chains in which the robots move in turn, each chain starting with a different robot."""
    total = fsum(masses)
    for first in range(max(1, min(len(masses), _MOST_EDGES // len(masses)))):
        yield from _chain([*masses[first:], *masses[:first]], total)


def _nonnegative(a: float, b: float, c: float, low: float, high: float) -> Iterator[tuple[float, float]]:
    """Yield the intervals of [low, high] in which a s^2 + b s + c >= 0."""
    discriminant = b * b - 4 * a * c
    if a == 0 != b:
        ends = [(-c / b, high)] if b > 0 else [(low, -c / b)]
    elif a == 0 or discriminant < 0:
        ends = [(low, high)] if c >= 0 else []
    else:
        q = -(b + copysign(sqrt(discriminant), b)) / 2
        first, last = sorted((q / a, c / q if q else 0.0))
        ends = [(low, first), (last, high)] if a > 0 else [(first, last)]
    for start, end in ends:
        if max(start, low) <= min(end, high):
            yield max(start, low), min(end, high)


def _first_gap(intervals: Iterable[tuple[float, float]], scale: float) -> float:
    """Return the point up to which the intervals cover the axis from 0 without a gap, -inf if they do not cover 0."""
    covered = -inf
    for start, end in sorted(intervals):
        if start > max(covered, 0.0) + _ROUNDING * scale:
            break
        covered = max(covered, end)
    return covered

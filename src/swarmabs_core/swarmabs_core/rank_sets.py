"""Sets of robots: as bits by rank, the order of ascending ids, as robots tell them; and what a majority of one is."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Set as AbstractSet


def ranks(bits: int) -> Iterator[int]:
    """Return the ranks in a set, ascending."""
    while bits:
        yield (bits & -bits).bit_length() - 1
        bits &= bits - 1


def set_of(members: Iterable[int]) -> int:
    """Return the set with these ranks."""
    bits = 0
    for rank in members:
        bits |= 1 << rank
    return bits


def is_majority(there: AbstractSet[int], counted: AbstractSet[int]) -> bool:
    """Return whether robots, by ranks or ids, are more than half of those that count, or half with the lowest one."""
    inside = counted & there
    return 2 * len(inside) > len(counted) or (2 * len(inside) == len(counted) and min(counted, default=0) in inside)

"""Which robots count for a majority, where there is no coordinator: those that a majority last heard."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.rank_sets import is_majority
from swarmabs_core.realtime.base import FEWEST

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

SETTLED = 1.0
"""Time, s, for which a majority hears the same robots until they are those that count."""


class Electorate:
    """The robots that count, and whether those that this one hears are a majority of them.

    A majority is more than half of those that count, or half with the lowest id of them. Only a majority that has heard
    the same robots for `settling` steps makes these the ones that count, with the step as a version; everybody adopts
    the newest version. So a swarm of which more and more robots die goes on, but no side of a partition that has ever
    been a minority counts by itself. Those heard at the start are version 0, which one that restarts adopts.

    Attributes
    ----------
    since : int
        The version: the step since which these count; 0 for those heard at the start, -1 before that.
    counted : frozenset of int
        The ids of the robots that count.
    """

    def __init__(self, members: Collection[int], settling: int) -> None:
        self.since = -1
        self.counted = frozenset(members)
        self._settling = settling
        self._heard: frozenset[int] = frozenset()
        self._heard_since = 0

    def begin(self, heard: Collection[int]) -> None:
        """Let those count that are heard at the start, all if they are too few, unless others have begun before."""
        if self.since < 0:
            self.since = 0
            if len(heard) >= FEWEST:
                self.counted = frozenset(heard)

    def learn(self, since: int, counted: Iterable[int]) -> None:
        """Adopt a newer version; those who count are looked up for such a one only."""
        if since > self.since:
            self.since, self.counted = since, frozenset(counted)

    def hears_majority(self, heard: Collection[int], step: int) -> bool:
        """Return whether the robots that are heard in a step, itself included, are a majority."""
        now = frozenset(heard)
        majority = is_majority(now, self.counted)
        if not majority or now != self._heard or step < self._heard_since:
            self._heard, self._heard_since = now, step
        elif now != self.counted and step - self._heard_since >= self._settling:
            self.since, self.counted = step, now
        return majority

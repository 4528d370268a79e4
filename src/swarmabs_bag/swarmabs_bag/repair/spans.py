"""Sets of steps, stored as spans: a recording without a gap is one span, however long it is."""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


class Spans:
    """A set of steps, iterated over as its first and last step of each span, ascending."""

    __slots__ = ("_firsts", "_lasts")

    def __init__(self) -> None:
        self._firsts: list[int] = []
        self._lasts: list[int] = []

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Yield first and last step of each span."""
        return zip(self._firsts, self._lasts, strict=True)

    @property
    def first(self) -> int:
        """The first step, 0 without any."""
        return self._firsts[0] if self._firsts else 0

    @property
    def last(self) -> int:
        """The last step, -1 without any."""
        return self._lasts[-1] if self._lasts else -1

    def add(self, step: int) -> None:
        """Add a step, which may be contained already."""
        firsts, lasts = self._firsts, self._lasts
        place = bisect_right(firsts, step)  # of the first span after the step
        if place and step <= lasts[place - 1]:
            return
        follows = place > 0 and lasts[place - 1] == step - 1
        precedes = place < len(firsts) and firsts[place] == step + 1
        if follows and precedes:
            del firsts[place], lasts[place - 1]
        elif follows:
            lasts[place - 1] = step
        elif precedes:
            firsts[place] = step
        else:
            firsts.insert(place, step)
            lasts.insert(place, step)

    def first_missing(self, start: int) -> int:
        """Return the first missing step from `start` on."""
        place = bisect_right(self._firsts, start)
        return max(start, self._lasts[place - 1] + 1) if place else start

    def missing(self, first: int, last: int) -> Iterator[tuple[int, int]]:
        """Yield first and last step of each span that is missing between two steps, both included."""
        begin = first
        for start, end in self:
            if start > last:
                break
            if start > begin:
                yield begin, start - 1
            begin = max(begin, end + 1)
        if begin <= last:
            yield begin, last

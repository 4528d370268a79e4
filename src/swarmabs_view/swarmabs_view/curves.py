"""The curves over time of a swarm that is running: never more points than a screen can show."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_view.frame import curves_of

if TYPE_CHECKING:
    from swarmabs_bag.swarm_state import Instant
    from swarmabs_view.protocol import Curves

MOST = 4000
"""Points that are kept; when there are more, every second one goes."""


class CurveBuffer:
    """Keeps the points of a run that grows: those whose step is a multiple of a stride that doubles when needed.

    Attributes
    ----------
    epoch : int
        Changes whenever points that were there are gone.
    """

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._stride = 1
        self._points: list[Instant] = []
        self.epoch = 0

    def __len__(self) -> int:
        return len(self._points)

    def add(self, point: Instant) -> None:
        """Take a point; one that is not later than the last is left out."""
        if point.step % self._stride or (self._points and point.step <= self._points[-1].step):
            return
        self._points.append(point)
        if len(self._points) > self._most:
            self._stride *= 2
            self._points = [kept for kept in self._points if kept.step % self._stride == 0]
            self.epoch += 1

    def since(self, epoch: int, count: int) -> Curves | None:
        """Return what someone lacks who has this many points of an epoch; None if nothing."""
        replace = epoch != self.epoch
        missing = self._points if replace else self._points[count:]
        return curves_of(missing, replace=replace) if missing or replace else None

"""When each message of a playback is due: pure, on any clock that does not jump."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Pace:
    """Which part of a bag is played, how fast, and how often.

    Parameters
    ----------
    rate : float
        Recorded time per time of the clock.
    start : float
        Where in the bag to begin, s after its first message.
    duration : float, optional
        How much of it to play, s of recorded time; by default all.
    loop : bool
        Whether to begin again at the end, for ever.
    """

    rate: float = 1.0
    start: float = 0.0
    duration: float | None = None
    loop: bool = False

    def schedule(self, first: int, read: Callable[[], Iterable[tuple[int, T]]]) -> Iterator[tuple[float, T]]:
        """Yield what is played with the time at which it is due, s after the begin of the playback.

        All times come from the recording and the begin, none from when something was published: there is no drift.

        Parameters
        ----------
        first : int
            Log time of the bag's first message, ns.
        read : callable
            Returns the messages of the bag with their log times, ns, in order.
        """
        begin = first + round(self.start * 1e9)
        end = None if self.duration is None else begin + round(self.duration * 1e9)
        offset = 0.0
        while True:
            due, found = offset, False
            for log_time, item in read():
                if log_time < begin or (end is not None and log_time > end):
                    continue
                found = True
                due = max(due, offset + (log_time - begin) / 1e9 / self.rate)
                yield due, item
            if not self.loop or not found:
                return
            offset = due

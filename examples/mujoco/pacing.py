"""How the time of a simulated world follows the clock."""

from __future__ import annotations

from collections import deque

SLACK = 0.02
"""Delay that the world makes up for, s; beyond it, the world's time falls behind the clock for good."""
WINDOW = 1_000_000_000
"""Time over which the real-time factor is taken, ns."""


class Pacing:
    """Decides when the world is due, and tells how fast it runs.

    A world that is late by no more than `SLACK` catches up. If the machine is slower than the world, nothing is left
    out and nothing jumps: every step is made, later than due, and the world's time passes more slowly than the clock.

    Parameters
    ----------
    now : int
        Time of the clock at which the world is at `time`, ns.
    time : float
        Time of the world, s.
    speed : float
        Time of the world by time of the clock that is aimed at.
    """

    def __init__(self, now: int, time: float = 0.0, speed: float = 1.0) -> None:
        self._begin, self._time, self._speed = now, time, speed
        self._reached: deque[tuple[int, float]] = deque([(now, time)])

    def due(self, time: float) -> int:
        """Return the time of the clock, ns, at which the world must reach a time, s."""
        return self._begin + round((time - self._time) / self._speed * 1e9)

    def reached(self, time: float, now: int) -> None:
        """Note that the world has reached a time, s; the clock says `now`, ns."""
        late = now - self.due(time)
        if late > SLACK * 1e9:
            self._begin, self._time = now - round(SLACK * 1e9), time
        self._reached.append((now, time))
        while len(self._reached) > 2 and self._reached[1][0] <= now - WINDOW:
            self._reached.popleft()

    @property
    def factor(self) -> float:
        """The real-time factor over the last `WINDOW`: time that passed in the world by time that passed."""
        (before, earlier), (now, time) = self._reached[0], self._reached[-1]
        return (time - earlier) / ((now - before) / 1e9) if now > before else 1.0

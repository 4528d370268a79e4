"""When to send again, and how much: no quality of service is trusted, so whoever waits too long repeats itself."""

from __future__ import annotations

FIRST = 0.05
"""Shortest wait before a repetition, s."""
LONGEST = 1.0
"""Longest wait between repetitions, s."""
WINDOW = 128
"""Most steps that are repeated: more than a run may be ahead of its recorder."""


class Repeater:
    """Decides on repetitions from the times at which there was progress.

    The first repetition comes after four usual step times and repeats one step; if it does not help, ever more steps
    are repeated at ever longer intervals, because what somebody lacks may be older than the current step. The fifth
    repetition covers them all, and comes before the silence counts as a stall.

    Parameters
    ----------
    now : float
        Current time, s, of any clock that does not jump.
    first : float
        Shortest wait before a repetition, s. In a large swarm a step takes longer than a small one's patience, and
        whoever repeats itself before it can be answered adds to what makes the step long.
    most : int
        Most steps that are repeated.
    """

    def __init__(self, now: float, *, first: float = FIRST, most: int = WINDOW) -> None:
        self._first = first
        self._longest = max(LONGEST, 4.0 * first)
        self._most = most
        self._usual = first
        self._last = now
        self._interval = 4.0 * first
        self._window = 1
        self._due = now + self._interval

    def progress(self, now: float) -> None:
        """Note that a step was made."""
        # This follows the step time that four steps of five keep to: a lost message, which delays a step by this very
        # wait, must not make the next wait longer. All would wait ever longer for each other.
        self._usual = min(self._usual * (1.1 if now - self._last > self._usual else 0.98), self._longest)
        self._interval = min(max(self._first, 4.0 * self._usual), self._longest)
        self._last = now
        self._window = 1
        self._due = now + self._interval

    def wait(self, now: float) -> float:
        """Return the time until the next repetition, s."""
        return max(0.0, self._due - now)

    def due(self, now: float) -> int:
        """Return how many of the latest steps to repeat now, 0 for none."""
        if now < self._due:
            return 0
        window = self._window
        self._window = 4 * window if window < self._most else 1
        self._interval = min(1.5 * self._interval, self._longest)
        self._due = now + self._interval
        return min(window, self._most)

    def silence(self, now: float) -> float:
        """Return the time since the last progress, s."""
        return now - self._last

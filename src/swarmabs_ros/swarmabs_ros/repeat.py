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
    """

    def __init__(self, now: float) -> None:
        self._usual = FIRST
        self._last = now
        self._interval = 4.0 * FIRST
        self._window = 1
        self._due = now + self._interval

    def progress(self, now: float) -> None:
        """Note that a step was made."""
        # This follows the step time that four steps of five keep to: a lost message, which delays a step by this very
        # wait, must not make the next wait longer. All would wait ever longer for each other.
        self._usual = min(self._usual * (1.1 if now - self._last > self._usual else 0.98), LONGEST)
        self._interval = min(max(FIRST, 4.0 * self._usual), LONGEST)
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
        self._window = 4 * window if window < WINDOW else 1
        self._interval = min(1.5 * self._interval, LONGEST)
        self._due = now + self._interval
        return min(window, WINDOW)

    def silence(self, now: float) -> float:
        """Return the time since the last progress, s."""
        return now - self._last

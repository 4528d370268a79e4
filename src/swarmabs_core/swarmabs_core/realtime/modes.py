"""Whether the swarm is stopped: the same for the same messages, in whatever order and however often they arrive."""

from __future__ import annotations

_LONG_AGO = -(2**62)


class ModeLatch:
    """What STOP closes and RESET opens.

    Only the newest step of each counts, so loss, repetition and order make no difference. A RESET wins only if it is
    more than `guard` steps newer than the newest STOP: whoever says RESET from as far in the future as is allowed does
    not overrule one who goes on to say STOP. A controller whose operator resets says no STOP any more, and RESET for
    long enough to come beyond the guard.

    Parameters
    ----------
    guard : int
        Steps.

    Attributes
    ----------
    reset_step : int
        Newest step of a RESET.
    """

    def __init__(self, guard: int) -> None:
        self._guard = guard
        self._stop_step: int | None = None
        self.reset_step = _LONG_AGO

    @property
    def stopped(self) -> bool:
        """Whether STOP was heard and no RESET that opens it."""
        return self._stop_step is not None and self.reset_step - self._stop_step <= self._guard

    def stop(self, step: int) -> None:
        """Take a STOP of a step."""
        self._stop_step = step if self._stop_step is None else max(self._stop_step, step)

    def reset(self, step: int) -> None:
        """Take a RESET of a step, which must have been found good."""
        self.reset_step = max(self.reset_step, step)

    def forget(self, step: int) -> None:
        """Forget the steps since they were counted by another clock; who is stopped, is so as of now."""
        self._stop_step = step if self.stopped else None
        self.reset_step = _LONG_AGO

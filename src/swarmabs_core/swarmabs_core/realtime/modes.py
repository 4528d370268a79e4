"""STOP and RESET in real time: what a receiver makes of them, and what a parent controller publishes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.messages import Mode

if TYPE_CHECKING:
    from swarmabs_core.realtime.base import Schedule

RESET_SECONDS = 1.0
"""Time for which RESET is published before RUN, s, so that every robot hears it."""
MOST_LATE = 3.0
"""Age, s, up to which a robot obeys an outdated RESET: at an overload it may reach all robots late."""
MOST_GUARD = 0.5
"""Upper limit of the guard time between the last STOP and an effective RESET, s: half of the duration of RESET."""
_LONG_AGO = -(2**62)


class ModeLatch:
    """Whether the swarm is stopped: STOP sets the latch, RESET releases it.

    Order and repetition of messages do not matter: only the newest step of each mode counts. A RESET is effective only
    if it is newer than the newest STOP by more than a guard time, the age limit (s) and the tolerance (s), so that a
    forged RESET from the allowed future cannot override a controller that keeps publishing STOP. After a reset by the
    operator, a controller no longer publishes STOP, and publishes RESET for longer than the guard.

    Attributes
    ----------
    reset_step : int
        Newest step of a RESET.
    """

    def __init__(self, schedule: Schedule, age_limit: float, clock_tolerance: float) -> None:
        guard = schedule.steps(age_limit) + schedule.ahead(clock_tolerance)
        self._guard = min(guard, schedule.steps(MOST_GUARD))
        self._stop_step: int | None = None
        self.reset_step = _LONG_AGO

    @property
    def stopped(self) -> bool:
        """Whether a STOP was received and no effective RESET."""
        return self._stop_step is not None and self.reset_step - self._stop_step <= self._guard

    def stop(self, step: int) -> None:
        """Record a STOP of a step."""
        self._stop_step = step if self._stop_step is None else max(self._stop_step, step)

    def reset(self, step: int) -> None:
        """Record a validated RESET of a step."""
        self.reset_step = max(self.reset_step, step)

    def open(self) -> None:
        """Release the latch at once: the operator asks for it."""
        self._stop_step = None

    def forget(self, step: int) -> None:
        """Discard steps of the old clock; if the latch is set, it is set as of `step`."""
        self._stop_step = step if self.stopped else None
        self.reset_step = _LONG_AGO


class PublishedMode:
    """The mode that a parent controller publishes: what an operator commands at it or, if it has a peer, at the peer.

    Attributes
    ----------
    now : Mode
        The mode.
    why : str
        Why it is this one.
    told : bool
        Whether operator or peer have told the mode since a start in STOP.
    """

    def __init__(self, start: Mode, latch: ModeLatch, schedule: Schedule) -> None:
        self.now = start
        self.told = start is not Mode.STOP
        self.why = "waiting for a reset" if start is Mode.STOP else ""
        self._latch = latch
        self._lasting = schedule.steps(RESET_SECONDS)
        self._reset_since = 0
        self._commanded: tuple[Mode, int] | None = None
        self._newest = _LONG_AGO

    @property
    def told_to_stop(self) -> bool:
        """Whether an operator's STOP may be known to this controller only."""
        return self.now is Mode.STOP and self._commanded is not None and self._commanded[0] is Mode.STOP

    def stop(self, step: int) -> None:
        """Stop the swarm until `reset`: the operator asks for it in a step."""
        self.told = True
        self._commanded = Mode.STOP, step
        self._latch.stop(step)
        self.publish_stop("stop commanded")

    def publish_stop(self, why: str) -> None:
        """Publish STOP, unless it does so already."""
        if self.now is not Mode.STOP:
            self.now, self.why = Mode.STOP, why

    def reset(self, step: int) -> None:
        """Publish RESET for a while, then RUN: the operator asks for it in a step."""
        self.told = True
        self._commanded = Mode.RESET, step
        self._latch.open()
        self._begin_reset(step, "reset commanded")

    def run(self) -> None:
        """End the RESET."""
        self.now, self.why = Mode.RUN, "reset is over"

    def is_over(self, step: int) -> bool:
        """Return whether RESET has been published for long enough."""
        return self.now is Mode.RESET and step - self._reset_since >= self._lasting

    def hear(self, mode: Mode, step: int, *, leading: bool) -> None:
        """Take over the mode that the peer has published in a step.

        A STOP counts whoever leads, unless a later RESET was commanded here or heard; RUN and RESET count only while
        this controller does not lead, and once the latch is open.
        """
        self.told = True
        commanded, since = self._commanded or (mode, _LONG_AGO)
        if mode is Mode.STOP:
            if commanded is Mode.RESET and step <= since:
                return
            self._latch.stop(step)
            if step >= since:  # the peer has heard of what was commanded here
                self._commanded = None
            if self._latch.stopped:
                self.publish_stop("stopped by the other controller")
            return
        if mode is Mode.RESET:
            self._latch.reset(step)
        if leading or step <= self._newest:
            return
        self._newest = step
        if self._latch.stopped:
            self.publish_stop("stop commanded")
            return
        self._commanded = None
        if mode is Mode.RUN:
            self.now, self.why = Mode.RUN, "as the other controller"
        elif self.now is not Mode.RESET:
            self._begin_reset(step, "as the other controller")

    def forget(self, step: int) -> None:
        """Discard steps of the old clock."""
        self._latch.forget(step)
        self._newest = _LONG_AGO
        self._reset_since = min(self._reset_since, step)
        if self._commanded is not None:
            self._commanded = self._commanded[0], min(self._commanded[1], step)

    def _begin_reset(self, step: int, why: str) -> None:
        self._reset_since = step
        self.now, self.why = Mode.RESET, why

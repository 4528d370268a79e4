"""STOP and RESET in real time: what a receiver makes of them, and what a parent controller publishes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

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


class Orders(NamedTuple):
    """The newest steps of STOP and RESET that operators ordered anywhere, as robots pass them on; -1: none yet.

    Both only grow, so order and repetition of what robots hear from each other do not matter.
    """

    stop: int = -1
    reset: int = -1

    def stopped(self, step: int) -> Orders:
        """Return the orders after a STOP of a step, which holds against every RESET that is known where it is given."""
        return self._replace(stop=max(self.stop, self.reset, step))

    def released(self, step: int, guard: int) -> Orders:
        """Return the orders after a RESET of a step, which holds against every STOP that is known where it is given."""
        return self._replace(reset=max(self.reset, self.stop + guard + 1 if self.stop >= 0 else step, step))

    def joined(self, other: Orders) -> Orders:
        """Return what somebody knows who has heard of both."""
        return Orders(max(self.stop, other.stop), max(self.reset, other.reset))

    def stops(self, guard: int) -> bool:
        """Return whether the swarm is stopped: of a STOP and a RESET within a guard time, in steps, the STOP holds."""
        return 0 <= self.stop >= self.reset - guard


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
    guard : int
        The guard time, in steps.
    """

    def __init__(self, schedule: Schedule, age_limit: float, clock_tolerance: float) -> None:
        guard = schedule.steps(age_limit) + schedule.ahead(clock_tolerance)
        self.guard = min(guard, schedule.steps(MOST_GUARD))
        self._stop_step: int | None = None
        self.reset_step = _LONG_AGO

    @property
    def stopped(self) -> bool:
        """Whether a STOP was received and no effective RESET."""
        return self._stop_step is not None and self.reset_step - self._stop_step <= self.guard

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
    orders : Orders
        What was ordered here and, among robots without a parent controller, anywhere.
    """

    def __init__(self, start: Mode, latch: ModeLatch, schedule: Schedule) -> None:
        self.now = start
        self.told = start is not Mode.STOP
        self.why = "waiting for a reset" if start is Mode.STOP else ""
        self.orders = Orders()
        self._latch = latch
        self._lasting = schedule.steps(RESET_SECONDS)
        self._reset_since = 0
        self._commanded: tuple[Mode, int] | None = None
        self._newest = _LONG_AGO
        self._peer_resets = _LONG_AGO, _LONG_AGO

    @property
    def guard(self) -> int:
        """Steps by which a RESET must be newer than a STOP that is not known where it is ordered."""
        return self._latch.guard

    @property
    def told_to_stop(self) -> bool:
        """Whether an operator's STOP may be known to this controller only."""
        return self.now is Mode.STOP and self._commanded is not None and self._commanded[0] is Mode.STOP

    def stop(self, step: int) -> None:
        """Stop the swarm until `reset`: the operator asks for it in a step."""
        self.told = True
        self._commanded = Mode.STOP, step
        self._latch.stop(step)
        self.fail(step, "stop commanded")

    def fail(self, step: int, why: str) -> None:
        """Stop the swarm until `reset`: the operator asks for it in a step, or there is nothing to ask for."""
        self.orders = self.orders.stopped(step)
        self.publish_stop(why)

    def obey(self, orders: Orders, step: int, begun: int | None) -> None:
        """Take over in a step what was ordered at other robots; the law began in a step, if it has."""
        known, self.orders = self.orders, self.orders.joined(orders)
        if self.orders == known:
            return
        self.told = True
        outlasted = begun is not None and begun <= orders.reset
        if self.orders.stops(self._latch.guard):
            self.publish_stop("stop commanded at another robot")
        elif self.orders.reset > known.reset and (self.now is not Mode.RUN or known != Orders() or outlasted):
            # One that starts in RUN, among robots that were reset long ago, need not wait.
            self._begin_reset(step, "reset commanded at another robot")

    def publish_stop(self, why: str) -> None:
        """Publish STOP, unless it does so already."""
        if self.now is not Mode.STOP:
            self.now, self.why = Mode.STOP, why

    def reset(self, step: int) -> None:
        """Publish RESET for a while, then RUN: the operator asks for it in a step."""
        self.told = True
        self._commanded = Mode.RESET, step
        self.orders = self.orders.released(step, self._latch.guard)
        self._latch.open()
        self._begin_reset(step, "reset commanded")

    def run(self) -> None:
        """End the RESET."""
        self.now, self.why = Mode.RUN, "reset is over"

    def prolong(self, missed: int, step: int) -> None:
        """Let a RESET last longer, up to a step, by the periods in which it was not published: nobody heard it then."""
        self._reset_since = min(self._reset_since + max(0, missed), step)

    def is_over(self, step: int) -> bool:
        """Return whether RESET has been published for long enough."""
        return self.now is Mode.RESET and step - self._reset_since >= self._lasting

    def hear(self, mode: Mode, step: int, *, leading: bool) -> None:
        """Take over the mode that the peer has published in a step.

        A STOP counts whoever leads, unless a later RESET was commanded here or heard; RUN and RESET count only while
        this controller does not lead, and once the latch is open. It stays closed in a RESET that had begun when STOP
        was commanded here: the peer has not heard of that.
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
            first, last = self._peer_resets
            first = first if first <= step <= last + self._latch.guard else step
            self._peer_resets = first, max(last, step)
            if commanded is not Mode.STOP or first > since:
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
        self.orders = Orders(step) if self.now is Mode.STOP and self.orders.stop >= 0 else Orders()
        self._newest = _LONG_AGO
        self._peer_resets = _LONG_AGO, _LONG_AGO
        self._reset_since = min(self._reset_since, step)
        if self._commanded is not None:
            self._commanded = self._commanded[0], min(self._commanded[1], step)

    def _begin_reset(self, step: int, why: str) -> None:
        self._reset_since = step
        self.now, self.why = Mode.RESET, why

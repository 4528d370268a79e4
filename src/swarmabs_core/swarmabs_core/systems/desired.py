"""From the state of any parent system to the desired abstract state: controller, limits, command filter, completion."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from swarmabs_core.desired_state import CommandFilter
from swarmabs_core.errors import RunError
from swarmabs_core.messages import EventKind, Messages, Mode, SwarmDesired, SwarmEvent

if TYPE_CHECKING:
    from swarmabs_core.messages import ParentState
    from swarmabs_core.systems.interface import NamedSystem, Vector

NEED_LIMITED = "{} limited"
"""`SwarmEvent.detail` where the limit of a need begins to act."""
_SHORT = 0.1
"""Time, in control periods, over which the completion is differentiated; exact where it has degree 2."""


class SystemDesiredState:
    """Asks the controller for its needs, limits and filters them, and completes them, once per period (ns).

    `filtered` are values and rates of the filtered needs, none before the first step.
    """

    no_offset = "the controller has no method offset_ask"
    """Why the reference of a controller cannot be offset."""

    def __init__(self, period_ns: int, system: NamedSystem) -> None:
        self._system = system
        self._period = period_ns / 1e9
        self.controller = system.made.controller(self._period)
        self._filter = CommandFilter(self._period)
        self.filtered: list[tuple[float, float]] | None = None
        self._clipped = [False] * len(system.made.needs)

    @property
    def offsettable(self) -> bool:
        """Whether the reference of the controller can be offset."""
        return hasattr(self.controller, "offset_ask")

    def advance(self, time_ns: int, parent: ParentState, *, offset: float = 0.0) -> tuple[Messages, SwarmDesired]:
        """Return events, and the desired abstract state for a state of the parent, with the same step.

        The controller is evaluated at a time (ns); `offset` is added to its reference.

        Raises
        ------
        RunError
            If the run cannot continue from this state, or the needs of the controller are not finite.
        """
        made, period, step = self._system.made, self._period, parent.step
        failed = getattr(made, "failed", None)
        if failed is not None and (problem := failed(parent.state)):
            raise RunError(f"step {step}: {problem}")
        before = self.filtered
        known = self._clip((0.0,) * len(made.needs)) if before is None else tuple(value for value, _ in before)
        ask = time_ns / 1e9, parent.state, tuple(made.complete(known))
        asked: Any = (
            self.controller.offset_ask(*ask, offset)  # type: ignore[attr-defined]  # the scenario's check has looked
            if offset
            else self.controller.ask(*ask)
        )
        if not isinstance(asked, (tuple, list)) or len(asked) != len(made.needs) or not all(map(isfinite, asked)):
            wanted = ", ".join(need.name for need in made.needs)
            raise RunError(
                f"step {step}: the controller of {self._system.type} returned {asked}; it must return {wanted}"
            )
        raw: Vector = tuple(asked)
        command = self._clip(raw)
        now = [(value, 0.0) for value in command] if before is None else before
        after = [self._filter.advance(x, v, u) for (x, v), u in zip(now, command, strict=True)]
        self.filtered = after
        values = tuple(made.complete(tuple(x for x, _ in now)))
        end = made.complete(tuple(x for x, _ in after))
        rate, end_rate = self._rate(now), self._rate(after)
        desired = SwarmDesired(
            time_ns,
            step,
            self._system.hash,
            Mode.RUN,
            values,
            rate,
            # A robot holds its command for a period, so it needs means over the period, not initial values.
            tuple((b - a) / period for a, b in zip(values, end, strict=True)),
            end_rate,
            tuple((b - a) / period for a, b in zip(rate, end_rate, strict=True)),
        )
        return self._limits(raw, command, time_ns, step), desired

    def _clip(self, needs: Vector) -> Vector:
        return tuple(min(max(x, need.low), need.high) for x, need in zip(needs, self._system.made.needs, strict=True))

    def _rate(self, filtered: list[tuple[float, float]]) -> Vector:
        """Return the derivative of the completion along the filter's motion, (k,)."""
        h = _SHORT * self._period
        ahead, behind = (self._system.made.complete(tuple(x + s * v for x, v in filtered)) for s in (h, -h))
        return tuple((a - b) / (2.0 * h) for a, b in zip(ahead, behind, strict=True))

    def _limits(self, raw: Vector, command: Vector, stamp: int, step: int) -> Messages:
        """Report the steps in which limiting of a need begins."""
        events = []
        for n, need in enumerate(self._system.made.needs):
            before, self._clipped[n] = self._clipped[n], raw[n] != command[n]
            if self._clipped[n] and not before:
                detail = NEED_LIMITED.format(need.name)
                events.append(SwarmEvent(stamp, step, 0, EventKind.LIMIT_HIT, raw[n], detail))
        return tuple(events)

"""From the state of any parent system to the desired abstract state: controller, limits, command filter, completion."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt
from typing import TYPE_CHECKING, cast

from swarmabs_core.declaration import setting
from swarmabs_core.desired_state import BANDWIDTH, GROWTH, TRANSITION, CommandFilter
from swarmabs_core.errors import RunError
from swarmabs_core.events import EventCode
from swarmabs_core.messages import Messages, Mode, SwarmDesired
from swarmabs_core.systems.interface import Standing
from swarmabs_core.systems.law import Remainder, by_row

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_core.messages import AnyParentState, ParentState, StandingState
    from swarmabs_core.systems.interface import NamedSystem, Need, ParentSystem, Vector
    from swarmabs_core.systems.law import SystemGains

_SHORT = 0.1
"""Time, in control periods, over which the completion is differentiated; exact where it has degree 2."""


FASTEST = 0.3
"""Root mean square of velocities by the rows that are completed, weighted by W, in units of the coordinates per s."""
_CLOSED = 1e-12


@dataclass(frozen=True, slots=True)
class Requests:
    """How the needs of a controller become requests: limited to ranges, and filtered."""

    bandwidth: float = setting(
        BANDWIDTH, "corner frequency of the critically damped filter of the needs", unit="rad/s", above=0.0
    )
    low: tuple[float, ...] = setting(
        (), "lowest needs, within the ranges of the system; none: those of the system", item=0.0
    )
    high: tuple[float, ...] = setting(
        (), "highest needs, within the ranges of the system; none: those of the system", item=0.0
    )

    def needs(self, instance: ParentSystem) -> tuple[Need, ...]:
        """Return the needs of a system with the ranges to which they are limited."""
        low, high = (
            self.low or [need.low for need in instance.needs],
            self.high or [need.high for need in instance.needs],
        )
        return tuple(need._replace(low=a, high=b) for need, a, b in zip(instance.needs, low, high, strict=True))


_REQUESTS = Requests()


class SystemDesiredState:
    """Asks the controller for its needs, limits and filters them, and completes them, once per period (ns).

    `filtered` are values and rates of the filtered needs, none before the first step; `standing` is what the desired
    state is completed around. The gains are those of the robots.
    """

    def __init__(
        self, period_ns: int, system: NamedSystem, gains: SystemGains, *, requests: Requests = _REQUESTS
    ) -> None:
        self._system = system
        self._gains = gains
        self._needs = requests.needs(system.instance)
        self._period = period_ns / 1e9
        size = len(system.instance.abstract)
        self.standing = system.nobody
        self._transition = CommandFilter(self._period, TRANSITION)
        # Distances of the desired state from the completion, and their rates, since robots stand or return.
        self._gaps = [(0.0, 0.0)] * size
        self._free: list[int] = []
        self._divided: StandingState | None = None
        self.controller = system.instance.controller(self._period)
        self._filter = CommandFilter(self._period, requests.bandwidth)
        self.filtered: list[tuple[float, float]] | None = None
        self._clipped = [False] * len(system.instance.needs)

    @property
    def no_offset(self) -> str:
        """Why the reference of the controller cannot be offset; empty if it can."""
        return "" if hasattr(self.controller, "offset_ask") else "the controller has no method offset_ask"

    def advance(self, time_ns: int, parent: AnyParentState, *, offset: float = 0.0) -> tuple[Messages, SwarmDesired]:
        """Return events, and the desired abstract state for a state of the parent, with the same step.

        The controller is evaluated at a time (ns); `offset` is added to its reference.

        Raises
        ------
        RunError
            If the run cannot continue from this state, or the needs of the controller are not finite.
        """
        parent = cast("ParentState", parent)
        instance, period, step = self._system.instance, self._period, parent.step
        failed = getattr(instance, "failed", None)
        if failed is not None and (problem := failed(parent.state)):
            raise RunError(f"step {step}: {problem}")
        before = self.filtered
        needs = self._clip((0.0,) * len(instance.needs)) if before is None else tuple(value for value, _ in before)
        ask = time_ns / 1e9, parent.state, self._completed(needs)
        if offset:
            asked: object = self.controller.offset_ask(*ask, offset)  # type: ignore[attr-defined]  # by the check
        else:
            asked = self.controller.ask(*ask)
        if not isinstance(asked, (tuple, list)) or len(asked) != len(instance.needs) or not all(map(isfinite, asked)):
            wanted = ", ".join(need.name for need in instance.needs)
            raise RunError(
                f"step {step}: the controller of {self._system.type} returned {asked}; it must return {wanted}"
            )
        raw: Vector = tuple(asked)
        command = self._clip(raw)
        now = [(value, 0.0) for value in command] if before is None else before
        after = [self._filter.advance(x, v, u) for (x, v), u in zip(now, command, strict=True)]
        self.filtered = after
        values = self._completed(tuple(x for x, _ in now))
        end = self._completed(tuple(x for x, _ in after))
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
        divided, self._divided = self._divided, None
        if any(gap != (0.0, 0.0) for gap in self._gaps):
            desired = self._with_gaps(desired)
        if divided is not None and divided.moving_weight and self._free:
            desired = self._bounded(desired, divided)
        return self._limits(raw, command, time_ns, step), desired

    def divide(self, divided: StandingState) -> None:
        """Complete the desired state of the next step around the robots that stand.

        If these have changed, the desired state continues without a jump, and moves to the new completion.
        """
        self._divided = divided
        standing = Standing.of(divided)
        before, self.standing = self.standing, standing
        if (before, before.robots) == (standing, standing.robots) or self.filtered is None:
            return
        needs = tuple(value for value, _ in self.filtered)
        old, new = (self._system.complete(needs, robots) for robots in (before, standing))
        self._free = sorted({*self._free, *(row for row, (a, b) in enumerate(zip(old, new, strict=True)) if a != b)})
        self._gaps = [(gap + a - b, rate) for (gap, rate), a, b in zip(self._gaps, old, new, strict=True)]

    def _completed(self, needs: Vector) -> Vector:
        return self._system.complete(needs, self.standing)

    def _with_gaps(self, desired: SwarmDesired) -> SwarmDesired:
        """Return a desired state at its distance from the completion, and bring the next one closer."""
        period, now = self._period, self._gaps
        after = [self._transition.advance(gap, rate, 0.0) if gap or rate else (0.0, 0.0) for gap, rate in now]
        rows = self._system.instance.abstract
        closed = [max(abs(gap), abs(rate)) <= _CLOSED * row.scale for (gap, rate), row in zip(after, rows, strict=True)]
        self._gaps = [(0.0, 0.0) if done else pair for pair, done in zip(after, closed, strict=True)]
        both = list(zip(now, after, strict=True))

        def added(values: Vector, others: Sequence[float]) -> Vector:
            return tuple(a + b for a, b in zip(values, others, strict=True))

        return desired._replace(
            value=added(desired.value, [gap for gap, _ in now]),
            rate=added(desired.rate, [rate for _, rate in now]),
            mean_rate=added(desired.mean_rate, [(b[0] - a[0]) / period for a, b in both]),
            end_rate=added(desired.end_rate, [rate for _, rate in after]),
            mean_acceleration=added(desired.mean_acceleration, [(b[1] - a[1]) / period for a, b in both]),
        )

    def _bounded(self, desired: SwarmDesired, divided: StandingState) -> SwarmDesired:
        """Return a desired state whose rates ask for no more effort in the completed rows than robots can well supply.

        These rows are satisfied after all others; what they ask for on top has an effort of its own.
        """
        size, gains, free = len(desired.value), self._gains, self._free
        k, kp, kd = (by_row(gain, size) for gain in (gains.k, gains.kp, gains.kd))
        error = [a - b - c for a, b, c in zip(desired.value, divided.standing, divided.moving, strict=True)]
        error_rate = [a - b for a, b in zip(desired.rate, divided.moving_rate, strict=True)]
        velocity = [a * e + v for a, e, v in zip(k, error, desired.mean_rate, strict=True)]
        acceleration = [
            p * e + d * de + w - h
            for p, e, d, de, w, h in zip(
                kp, error, kd, error_rate, desired.mean_acceleration, divided.moving_curvature, strict=True
            )
        ]
        remainder = Remainder(divided.moving_gram, self._system.instance.abstract, free)
        most = FASTEST * sqrt(divided.moving_weight)
        slower = remainder.excess(velocity, most)
        weaker = remainder.excess(acceleration, GROWTH * most)
        return desired._replace(
            mean_rate=_less(desired.mean_rate, free, slower),
            end_rate=_less(desired.end_rate, free, slower),
            mean_acceleration=_less(desired.mean_acceleration, free, weaker),
        )

    def _clip(self, needs: Vector) -> Vector:
        return tuple(min(max(x, need.low), need.high) for x, need in zip(needs, self._needs, strict=True))

    def _rate(self, filtered: list[tuple[float, float]]) -> Vector:
        """Return the derivative of the completion along the filter's motion, (k,)."""
        h = _SHORT * self._period
        ahead, behind = (self._completed(tuple(x + s * v for x, v in filtered)) for s in (h, -h))
        return tuple((a - b) / (2.0 * h) for a, b in zip(ahead, behind, strict=True))

    def _limits(self, raw: Vector, command: Vector, stamp: int, step: int) -> Messages:
        """Report the steps in which limiting of a need begins."""
        events = []
        for n, need in enumerate(self._needs):
            before, self._clipped[n] = self._clipped[n], raw[n] != command[n]
            if self._clipped[n] and not before:
                events.append(EventCode.NEED_LIMITED.event(stamp, step, raw[n], need=need.name))
        return tuple(events)


def _less(values: Vector, rows: Sequence[int], excess: Sequence[float]) -> Vector:
    """Return values without what is in excess in some rows."""
    off = dict(zip(rows, excess, strict=True))
    return tuple(value - off.get(row, 0.0) for row, value in enumerate(values))

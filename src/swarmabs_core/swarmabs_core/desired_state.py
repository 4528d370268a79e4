"""From the plane's state to the desired abstract state of the swarm: law, limit, command filter, manifold."""

from __future__ import annotations

from math import exp, isfinite
from typing import TYPE_CHECKING

from swarmabs_core.controllers import OffsetController
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import DesiredAbstractState, EventKind, Messages, Mode, PlaneState, SwarmEvent
from swarmabs_core.plant import STEEPEST

if TYPE_CHECKING:
    from swarmabs_core.controllers import ParentController
    from swarmabs_core.manifold import Manifold

FALLEN = (
    "the swarm cannot hold the plane in this scenario; reduce its initial angle or the disturbance, raise "
    "manifold.torque_max, or set a plane.end_stop below that angle"
)
"""Why a run ends at `STEEPEST`, and the remedy."""
TORQUE_LIMITED = "torque limited to torque_max"
"""`SwarmEvent.detail` where the controller begins to limit the torque."""
BANDWIDTH = 50.0
"""Corner frequency of the filter between parent controller and manifold, rad/s."""


def fallen(plane: PlaneState) -> str:
    """Return why a run cannot continue from this state of the plane; empty if it can."""
    if abs(plane.angle) < STEEPEST:
        return ""
    return f"step {plane.step}: the plane's angle is {plane.angle:.4g} rad and a run ends at {STEEPEST} rad: {FALLEN}"


class CommandFilter:
    """Critically damped filter, x'' = w^2 (u - x) - 2 w x', exact for a held command u; period in s, w in rad/s."""

    def __init__(self, period: float, bandwidth: float = BANDWIDTH) -> None:
        wt = bandwidth * period
        decay = exp(-wt)
        self._a11 = (1.0 + wt) * decay
        self._a12 = period * decay
        self._a21 = -bandwidth * wt * decay
        self._a22 = (1.0 - wt) * decay

    def advance(self, value: float, rate: float, command: float) -> tuple[float, float]:
        """Return value and rate one period later, with the command held."""
        offset = value - command  # the filter moves towards the command: integrate the distance to it
        return command + self._a11 * offset + self._a12 * rate, self._a21 * offset + self._a22 * rate


class DesiredStateGenerator:
    """Asks the law for a torque, limits and filters it, and lifts it onto the manifold, once per period (ns)."""

    no_offset = "the law has no method offset_torque"
    """Why the reference of a law cannot be offset."""

    def __init__(self, period_ns: int, manifold: Manifold, law: ParentController) -> None:
        self._manifold = manifold
        self._law = law
        self._period = period_ns / 1e9
        self._filter = CommandFilter(self._period)
        self._state: tuple[float, float] | None = None
        self._clipped = False

    @property
    def offsettable(self) -> bool:
        """Whether the reference of the law can be offset."""
        return isinstance(self._law, OffsetController)

    def resume(self, torque: float, rate: float) -> None:
        """Continue from this state of the filter: torque (N m) and its rate (N m/s)."""
        self._state = (torque, rate)

    def follow(self, desired: DesiredAbstractState) -> None:
        """Continue from the desired state that another generator has computed for the latest step."""
        torque = desired.torque + desired.mean_torque_rate * self._period
        self.resume(torque, desired.torque_rate + desired.torque_acceleration * self._period)

    def advance(self, time_ns: int, plane: PlaneState, *, offset: float = 0.0) -> tuple[Messages, DesiredAbstractState]:
        """Return events, and the desired abstract state for a state of the plane, with the same step.

        The law is evaluated at a time (ns); `offset` (rad) is added to its reference.

        Raises
        ------
        RunError
            If the plane is too steep, or the torque of the law is not finite.
        InputError
            If there is an offset and the law does not support one.
        """
        manifold, period, step = self._manifold, self._period, plane.step
        if problem := fallen(plane):
            raise RunError(problem)
        raw = self._torque(time_ns / 1e9, plane, offset)
        if not isfinite(raw):
            raise RunError(
                f"step {step}: the parent controller returned a torque of {raw} N m at an angle of "
                f"{plane.angle:.4g} rad; its law must return a finite number"
            )
        command = manifold.clip(raw)
        torque, rate = self._state or (command, 0.0)
        next_torque, next_rate = self._filter.advance(torque, rate, command)
        self._state = (next_torque, next_rate)
        acceleration = (next_rate - rate) / period
        desired = DesiredAbstractState(
            time_ns,
            step,
            Mode.RUN,
            torque,
            manifold.inertia(torque),
            rate,
            manifold.inertia_rate(torque, rate),
            # A robot holds its command for a period, so it needs means over the period, not initial values.
            (next_torque - torque) / period,
            manifold.curvature * (next_torque * next_torque - torque * torque) / period,
            acceleration,
            manifold.inertia_acceleration(torque, rate, acceleration),
        )
        return self._limit(raw, command, time_ns, step), desired

    def _torque(self, time: float, plane: PlaneState, offset: float) -> float:
        if not offset:
            return self._law.torque(time, plane)
        if not isinstance(self._law, OffsetController):
            raise InputError("the parent controller's law has no method offset_torque: its reference cannot be offset")
        return self._law.offset_torque(time, plane, offset)

    def _limit(self, raw: float, command: float, stamp: int, step: int) -> Messages:
        """Report the step in which limiting of the torque begins."""
        before, self._clipped = self._clipped, raw != command
        if self._clipped and not before:
            return (SwarmEvent(stamp, step, 0, EventKind.LIMIT_HIT, raw, TORQUE_LIMITED),)
        return ()

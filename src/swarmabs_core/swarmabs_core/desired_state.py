"""From the plane's state to the desired abstract state of the swarm: law, limit, command filter, manifold."""

from __future__ import annotations

from math import isfinite, sqrt
from typing import TYPE_CHECKING, NamedTuple, cast

from swarmabs_core.controllers import OffsetController, RememberingController
from swarmabs_core.elementary import exp, sin_cos
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.events import EventCode
from swarmabs_core.manifold import Load
from swarmabs_core.messages import DesiredAbstractState, Messages, Mode, PlaneState
from swarmabs_core.plant import STEEPEST

if TYPE_CHECKING:
    from swarmabs_core.controllers import ParentController
    from swarmabs_core.manifold import Manifold
    from swarmabs_core.messages import AnyParentState, StandingState
    from swarmabs_core.swarm_law import SwarmGains

FALLEN = (
    "the swarm cannot hold the plane in this scenario; reduce its initial angle or the disturbance, raise "
    "manifold.torque_max, or set a plane.end_stop below that angle"
)
"""Why a run ends at `STEEPEST`, and the remedy."""
BANDWIDTH = 50.0
"""Corner frequency of the filter between parent controller and manifold, rad/s."""


def fallen(plane: PlaneState) -> str:
    """Return why a run cannot continue from this state of the plane; empty if it can."""
    if abs(plane.angle) < STEEPEST:
        return ""
    return f"step {plane.step}: the plane's angle is {plane.angle:.4g} rad and a run ends at {STEEPEST} rad: {FALLEN}"


TRANSITION = 3.0
"""Corner frequency with which the desired abstract state moves to its curve after the swarm has changed, rad/s."""
CLOSEST, WIDEST = 0.25, 4.0
"""Second moment that is desired right after a change, in units of that of the robots, is within these bounds."""
FASTEST, GROWTH = 0.1, 10.0
"""Root mean square of speeds about the centre, m/s, and relative rate of the spread, 1/s, after a change."""
_CLOSED = 1e-12


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


class SwarmOnPlane(NamedTuple):
    """What the desired state allows for of the swarm: gravity (m/s^2) and the gains of the robots' laws.

    `compensated` is the first moment H (kg m) whose weight the desired torque compensates.
    """

    gravity: float
    gains: SwarmGains
    compensated: float = 0.0


def tipping(weight: float, angle: float) -> float:
    """Return the torque g H tan(th), N m, that holds a weight g H (N m) above the axis at an angle (rad)."""
    sine, cosine = sin_cos(angle)
    return weight * sine / cosine


class DesiredStateGenerator:
    """Asks the law for a torque, limits and filters it, and lifts it onto the manifold, once per period (ns)."""

    def __init__(self, period_ns: int, manifold: Manifold, law: ParentController, plane: SwarmOnPlane) -> None:
        self._manifold = manifold
        self._gravity, self._gains, compensated = plane
        self._weight = plane.gravity * compensated
        self._curve = manifold.curve
        self._divided: StandingState | None = None
        self._known: tuple[object, ...] = ()
        # Distance of the desired inertia from the curve, and its rate, since the swarm has changed.
        self._gap = (0.0, 0.0)
        self._law = law
        self._period = period_ns / 1e9
        self._filter = CommandFilter(self._period)
        self._transition = CommandFilter(self._period, TRANSITION)
        self._state: tuple[float, float] | None = None
        self._clipped = False

    @property
    def no_offset(self) -> str:
        """Why the reference of the law cannot be offset; empty if it can."""
        return "" if isinstance(self._law, OffsetController) else "the law has no method offset_torque"

    @property
    def on_curve(self) -> bool:
        """Whether the desired state is on the curve again after a change of the swarm."""
        return self._gap == (0.0, 0.0)

    @property
    def law_memory(self) -> tuple[float, ...]:
        """What the law remembers, if other instances of it can continue from that; else empty."""
        return self._law.memory if isinstance(self._law, RememberingController) else ()

    def recall(self, memory: tuple[float, ...]) -> None:
        """Let the law continue from a memory that is as long as its own, or that it has not begun to fill."""
        if isinstance(self._law, RememberingController) and memory:
            self._law.recall(memory)

    @property
    def progress(self) -> tuple[float, ...]:
        """Filtered torque and rate, distance from the curve and rate of the next step; empty before the first one."""
        return () if self._state is None else (*self._state, *self._gap)

    def restore(self, progress: tuple[float, ...], divided: StandingState) -> None:
        """Continue from the progress of another generator, whose latest step was completed around these robots."""
        self.divide(divided)
        self._divided = None
        torque, rate, *gap = progress
        self._state, self._gap = (torque, rate), (gap[0], gap[1])

    def resume(self, desired: DesiredAbstractState) -> None:
        """Continue with the step of this desired state, as if it had been computed here."""
        self._state = (desired.torque, desired.torque_rate)
        curve = self._curve
        self._set_gap(
            desired.inertia - curve.inertia(desired.torque),
            desired.inertia_rate - curve.rate(desired.torque, desired.torque_rate),
        )

    def follow(self, desired: DesiredAbstractState) -> None:
        """Continue from the desired state that another generator has computed for the latest step."""
        period = self._period
        torque = desired.torque + desired.mean_torque_rate * period
        rate = desired.torque_rate + desired.torque_acceleration * period
        self._state = (torque, rate)
        self._set_gap(
            desired.inertia + desired.mean_inertia_rate * period - self._curve.inertia(torque),
            desired.inertia_rate + desired.inertia_acceleration * period - self._curve.rate(torque, rate),
        )

    def divide(self, divided: StandingState) -> None:
        """Complete the desired state of the next step around the robots that stand.

        If these have changed, the desired inertia continues without a jump, unless that would ask for much more or much
        less spread than the robots have: these would be flung. From there it moves to the new curve.
        """
        self._divided = divided
        division, self._known = self._known, (divided.standing_count, divided.moving_count, divided.standing)
        if self._known == division or not divided.moving_count:
            return
        torque, rate = self._state or (0.0, 0.0)
        before = self._curve.inertia(torque) + self._gap[0]
        before_rate = self._curve.rate(torque, rate) + self._gap[1]
        curve = self._curve = self._manifold.around(divided, self._gravity)
        still = Load.of(divided.standing, divided.standing_constants)
        moving = Load.of(divided.moving, divided.moving_constants)
        needed = torque - still.torque
        least = still.inertia + needed * needed / (self._gravity * self._gravity * moving.mass)
        spread = moving.around_centre(self._gravity)
        if CLOSEST * spread <= before - least <= WIDEST * spread:
            self._set_gap(before - curve.inertia(torque), before_rate - curve.rate(torque, rate))
        else:
            within = min(max(before - least, CLOSEST * spread), WIDEST * spread)
            self._set_gap(least + within - curve.inertia(torque), 0.0)

    def _set_gap(self, gap: float, rate: float) -> None:
        closed = max(abs(gap), abs(rate) / TRANSITION) <= _CLOSED
        self._gap = (0.0, 0.0) if closed else (gap, rate)

    def advance(
        self, time_ns: int, parent: AnyParentState, *, offset: float = 0.0
    ) -> tuple[Messages, DesiredAbstractState]:
        """Return events, and the desired abstract state for a state of the plane, with the same step.

        The law is evaluated at a time (ns); `offset` (rad) is added to its reference.

        Raises
        ------
        RunError
            If the plane is too steep, or the torque of the law is not finite.
        InputError
            If there is an offset and the law does not support one.
        """
        plane = cast("PlaneState", parent)
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
        curve = self._curve
        desired = DesiredAbstractState(
            time_ns,
            step,
            Mode.RUN,
            torque,
            curve.inertia(torque),
            rate,
            curve.rate(torque, rate),
            # A robot holds its command for a period, so it needs means over the period, not initial values.
            (next_torque - torque) / period,
            curve.mean_rate(torque, next_torque, period),
            acceleration,
            curve.acceleration(torque, rate, acceleration),
        )
        divided, self._divided = self._divided, None
        beside = not self.on_curve
        if beside:
            desired = self._beside_curve(desired)
        if divided is not None and divided.moving_count and (curve.slope or beside):
            desired = self._bounded(desired, divided)
        return self._limit(raw, command, time_ns, step), desired

    def _bounded(self, desired: DesiredAbstractState, divided: StandingState) -> DesiredAbstractState:
        r"""Return a desired state whose rates ask for no more motion about the centre than robots can well perform.

        While the laws let torque and inertia approach the desired ones in a straight line, the inertia of the centre is
        quadratic in the torque; so the robots would have to spread and contract on the way, without bounds where they
        are close together. With :math:`b = 2 (\tau_d - \tau_s)/(g^2 M_A)`, :math:`a = 1/(g^2 M_A)` and the error e of
        the torque, the error of the inertia is that of the second moment about the centre plus :math:`b e - a e^2`.
        The rates let the former decay as the laws prescribe it for the inertia; then they are bounded.
        """
        gains = self._gains
        mass, still = divided.moving_constants[0], divided.standing[0]
        a = 1.0 / (self._gravity * self._gravity * mass)
        b = 2.0 * a * (desired.torque - still)
        e = desired.torque - (still + divided.moving[0])
        de = desired.torque_rate - divided.moving_rate[0]
        (k0, k1), (kp0, kp1), (kd0, kd1) = gains.k, gains.kp, gains.kd
        velocity = (k1 - k0) * b * e + a * (2.0 * k0 - k1) * e * e
        squares = 2.0 * de * de + 2.0 * (kd1 - kd0) * e * de + (kp1 - 2.0 * kp0) * e * e
        acceleration = b * ((kd1 - kd0) * de + (kp1 - kp0) * e) - a * squares
        desired = desired._replace(
            mean_inertia_rate=desired.mean_inertia_rate - velocity,
            inertia_acceleration=desired.inertia_acceleration - acceleration,
        )
        g00, g10, g11 = divided.moving_gram
        slope, pivot = g10 / g00, max(0.0, g11 - g10 * g10 / g00)
        reach = sqrt(divided.moving_weight * pivot)
        spread = Load.of(divided.moving, divided.moving_constants).around_centre(self._gravity)
        error = desired.inertia - (divided.standing[1] + divided.moving[1])
        error_rate = desired.inertia_rate - divided.moving_rate[1]
        z = k1 * error + desired.mean_inertia_rate - slope * (k0 * e + desired.mean_torque_rate)
        w = kp1 * error + kd1 * error_rate + desired.inertia_acceleration - divided.moving_curvature[1]
        w -= slope * (kp0 * e + kd0 * de + desired.torque_acceleration)
        # Robots that drift apart must be able to contract as fast as they can, as long as they do not meet.
        least, least_w = -2.0 * GROWTH * spread, -2.0 * GROWTH * GROWTH * spread
        most, most_w = min(FASTEST * reach, -least), min(GROWTH * FASTEST * reach, -least_w)
        return desired._replace(
            mean_inertia_rate=desired.mean_inertia_rate + min(max(z, least), most) - z,
            inertia_acceleration=desired.inertia_acceleration + min(max(w, least_w), most_w) - w,
        )

    def _beside_curve(self, desired: DesiredAbstractState) -> DesiredAbstractState:
        """Return a desired state at its distance from the curve, and bring the next one closer."""
        (gap, rate), period = self._gap, self._period
        next_gap, next_rate = self._transition.advance(gap, rate, 0.0)
        self._set_gap(next_gap, next_rate)
        return desired._replace(
            inertia=desired.inertia + gap,
            inertia_rate=desired.inertia_rate + rate,
            mean_inertia_rate=desired.mean_inertia_rate + (next_gap - gap) / period,
            inertia_acceleration=desired.inertia_acceleration + (next_rate - rate) / period,
        )

    def _torque(self, time: float, plane: PlaneState, offset: float) -> float:
        """Return the torque of the law, with the compensation of heights."""
        torque = self._of_law(time, plane, offset)
        return torque + tipping(self._weight, plane.angle) if self._weight else torque

    def _of_law(self, time: float, plane: PlaneState, offset: float) -> float:
        if not offset:
            return self._law.torque(time, plane)
        if not isinstance(self._law, OffsetController):
            raise InputError("the parent controller's law has no method offset_torque: its reference cannot be offset")
        return self._law.offset_torque(time, plane, offset)

    def _limit(self, raw: float, command: float, stamp: int, step: int) -> Messages:
        """Report the step in which limiting of the torque begins."""
        before, self._clipped = self._clipped, raw != command
        if self._clipped and not before:
            return (EventCode.TORQUE_LIMITED.event(stamp, step, raw),)
        return ()

"""The final limit between a command and a robot's body: for any command, the robot stays in its lane.

A forged or foreign broadcast can make a robot move, but neither beyond its limits nor off the plane.
"""

from __future__ import annotations

from math import copysign, inf, sqrt
from typing import TYPE_CHECKING

from swarmabs_core.drive import SingleIntegratorDrive
from swarmabs_core.summation import exact_sum

if TYPE_CHECKING:
    from swarmabs_core.robot_controller import RobotController

LATENCY = 2
"""Number of periods for which a command may be held: its own, and one more if the next command is late."""
_HALVINGS = 40


class Unmeasured:
    """How far commands have moved a single integrator while its sensor was silent.

    A robot acts on a measurement until that is outdated. What it does meanwhile counts for the room that is left: the
    periods, each of the length `period` (s), after the first one in which it had the measurement.

    Attributes
    ----------
    gap : bool
        Whether the robot has told nothing of some of these periods, so that commands in between may be unknown.
    """

    def __init__(self, controller: RobotController, period: float) -> None:
        self._moves = isinstance(controller.ideal, SingleIntegratorDrive)
        self._period = period
        self._parts: list[float] = []
        self._stamp = self._step = -1
        self.gap = False

    def note(self, step: int, stamp: int, command: float) -> None:
        """Note the newest measurement (ns) in a step, and the command (m/s) that was held until then."""
        if stamp != self._stamp:
            self._parts.clear()
            self.gap = False
        elif self._moves:
            passed = max(0, step - self._step)
            self._parts.append(command * passed * self._period)
            self.gap = self.gap or passed > 1
        self._stamp, self._step = stamp, step

    @property
    def distance(self) -> float:
        """That distance, m; 0 while there is a new measurement in each period, and for robots driven by a force."""
        return exact_sum(self._parts)


class LaneEnvelope:
    """Limits commands so that a robot comes to rest before the end of its lane, -limit to +limit (m).

    A new command is due every `period` (s). The base of a single integrator brakes with a deceleration (m/s^2), which
    is infinite if it stops instantly.
    """

    def __init__(
        self, controller: RobotController, period: float, lane_limit: float, deceleration: float = inf
    ) -> None:
        self._controller = controller
        self._period = period
        self._limit = lane_limit
        self._deceleration = deceleration
        # A shorter braking time would reverse a robot that holds the braking force for all these periods.
        self._braking_time = max(controller.braking_time, LATENCY * period)

    def apply(self, position: float, velocity: float, command: float) -> float:
        """Return the command, or the nearest one that keeps the robot in its lane.

        Position in m, velocity in m/s; the command is in m/s or N, within the drive's limits.
        """
        if isinstance(self._controller.ideal, SingleIntegratorDrive):
            return min(max(command, -self._fastest(position + self._limit)), self._fastest(self._limit - position))
        if self._fits(position, velocity, command):
            return command
        return self._nearest(position, velocity, command)

    def _fastest(self, room: float) -> float:
        """Return the largest safe speed (m/s) towards an end of the lane at this distance (m)."""
        if room <= 0.0:
            return 0.0
        # v T LATENCY + v^2 / (2 a) = room
        delay, a = self._period * LATENCY, self._deceleration
        return room / delay if a == inf else a * (sqrt(delay * delay + 2.0 * room / a) - delay)

    def _fits(self, position: float, velocity: float, force: float) -> bool:
        """Return whether the robot can still stop in its lane after any admissible duration of this force (N)."""
        farthest = max(self._limit, abs(position))
        for _ in range(LATENCY):
            position, velocity = self._controller.ideal.advance(position, velocity, force)
            if abs(position) > farthest:
                return False
            ahead = position if velocity > 0.0 else -position
            if velocity and ahead + self._braking_distance(abs(velocity)) > self._limit:
                return False
        return True

    def _braking_distance(self, velocity: float) -> float:
        """Return an upper bound of the braking distance (m)."""
        mass, tau, force = self._controller.mass, self._braking_time, self._braking_force(velocity)
        if not force:  # so slow that the brake's force vanishes
            return 0.0
        # The brake applies its full force, then, below the velocity F tau / m, one proportional to the velocity.
        return 0.5 * (mass * velocity * velocity / force + force * tau * tau / mass)

    def _braking_force(self, velocity: float) -> float:
        """Return the magnitude (N) of the braking force, given that each command may be held for some periods."""
        controller = self._controller
        return min(controller.braking_force(velocity), controller.mass * abs(velocity) / self._braking_time)

    def _nearest(self, position: float, velocity: float, force: float) -> float:
        """Return the force nearest to the requested one with which the robot can stop in time, else the full brake."""
        brake = -copysign(self._braking_force(velocity), velocity)
        if not self._fits(position, velocity, brake):
            return brake
        allowed, refused = brake, force
        for _ in range(_HALVINGS):
            middle = 0.5 * (allowed + refused)
            if self._fits(position, velocity, middle):
                allowed = middle
            else:
                refused = middle
        return allowed

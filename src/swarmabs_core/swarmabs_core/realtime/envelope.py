"""The last thing between a command and a robot's body: whatever is asked, the robot stays in its lane.

A forged or foreign broadcast can make a robot move, but not beyond its limits and not off the plane.
"""

from __future__ import annotations

from math import copysign, inf, sqrt
from typing import TYPE_CHECKING

from swarmabs_core.drive import SingleIntegratorDrive

if TYPE_CHECKING:
    from swarmabs_core.robot_controller import RobotController

LATENCY = 2
"""Periods for which a command may be held: the one it is meant for, and one in which the next is late."""
_HALVINGS = 40


class LaneEnvelope:
    """Limits commands so that a robot comes to rest before the end of its lane, -limit to +limit (m).

    A new command is due every `period` (s). The base of a single integrator brakes with a deceleration (m/s^2),
    infinite if it stops at once.
    """

    def __init__(
        self, controller: RobotController, period: float, lane_limit: float, deceleration: float = inf
    ) -> None:
        self._controller = controller
        self._period = period
        self._limit = lane_limit
        self._deceleration = deceleration
        # A brake that takes less time reverses a robot that holds its force for all these periods.
        self._braking_time = max(controller.braking_time, LATENCY * period)

    def apply(self, position: float, velocity: float, command: float) -> float:
        """Return the command, or the nearest that keeps the robot in its lane.

        Position in m, velocity in m/s; the command is in m/s or N, within the drive's limits.
        """
        if isinstance(self._controller.ideal, SingleIntegratorDrive):
            return min(max(command, -self._fastest(position + self._limit)), self._fastest(self._limit - position))
        if self._fits(position, velocity, command):
            return command
        return self._nearest(position, velocity, command)

    def _fastest(self, room: float) -> float:
        """Return the greatest speed (m/s) towards an end of the lane that is this far away (m)."""
        if room <= 0.0:
            return 0.0
        # v T LATENCY + v^2 / (2 a) = room
        delay, a = self._period * LATENCY, self._deceleration
        return room / delay if a == inf else a * (sqrt(delay * delay + 2.0 * room / a) - delay)

    def _fits(self, position: float, velocity: float, force: float) -> bool:
        """Tell whether the robot can still come to rest in its lane, however long it was under this force (N)."""
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
        """Return a bound of the way (m) in which the brake stops the robot."""
        mass, tau, force = self._controller.mass, self._braking_time, self._braking_force(velocity)
        if not force:  # so slow that the brake's force vanishes
            return 0.0
        # First the brake's full force, then, below the velocity F tau / m, one that follows the velocity.
        return 0.5 * (mass * velocity * velocity / force + force * tau * tau / mass)

    def _braking_force(self, velocity: float) -> float:
        """Return the size (N) of the force with which the robot brakes if each command may be held for some periods."""
        controller = self._controller
        return min(controller.braking_force(velocity), controller.mass * abs(velocity) / self._braking_time)

    def _nearest(self, position: float, velocity: float, force: float) -> float:
        """Return the force nearest to the one asked for that still lets the robot stop in time, else the full brake."""
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

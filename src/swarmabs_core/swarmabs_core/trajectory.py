"""Reference trajectories of the plane's angle, with the derivatives that ARISE feeds forward."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

Derivatives = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Sine:
    """th_d = amplitude sin(angular_frequency t), in rad and rad/s."""

    amplitude: float
    angular_frequency: float

    def derivatives(self, time: float) -> Derivatives:
        """Return th_d and its first four derivatives at a time in s."""
        w = self.angular_frequency
        s = self.amplitude * sin(w * time)
        c = self.amplitude * cos(w * time)
        return s, w * c, -w * w * s, -w * w * w * c, w * w * w * w * s


@dataclass(frozen=True, slots=True)
class Constant:
    """th_d = angle, in rad."""

    angle: float

    def derivatives(self, time: float) -> Derivatives:  # noqa: ARG002
        """Return the angle and four zeros."""
        return self.angle, 0.0, 0.0, 0.0, 0.0


@dataclass(frozen=True, slots=True)
class QuinticStep:
    """From one angle (rad) to another, with rate and acceleration 0 at both ends.

    th_d = start_angle + (end_angle - start_angle) (10 s^3 - 15 s^4 + 6 s^5), s = (t - start_time)/duration in [0, 1].
    """

    start_angle: float
    end_angle: float
    start_time: float
    duration: float

    def derivatives(self, time: float) -> Derivatives:
        """Return th_d and its first four derivatives at a time in s; third and fourth jump at both ends."""
        s = (time - self.start_time) / self.duration
        if not 0.0 <= s < 1.0:
            return self.start_angle if s < 0.0 else self.end_angle, 0.0, 0.0, 0.0, 0.0
        rise, rate = self.end_angle - self.start_angle, 1.0 / self.duration
        rest = 1.0 - s
        return (
            self.start_angle + rise * s * s * s * (10.0 - s * (15.0 - 6.0 * s)),
            rise * rate * 30.0 * s * s * rest * rest,
            rise * rate * rate * 60.0 * s * rest * (1.0 - 2.0 * s),
            rise * rate * rate * rate * 60.0 * (1.0 - 6.0 * s * rest),
            rise * rate * rate * rate * rate * 360.0 * (2.0 * s - 1.0),
        )

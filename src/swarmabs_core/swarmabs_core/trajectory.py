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

"""Reference trajectories of the plane's angle, with the derivatives that ARISE feeds forward."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import ClassVar

from swarmabs_core.declaration import setting
from swarmabs_core.plant import STEEPEST

Derivatives = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Sine:
    """The paper's reference, th_d = amplitude sin(angular_frequency t)."""

    type: ClassVar[str] = "sine"
    description: ClassVar[str] = "th_d = amplitude sin(angular_frequency t)"

    amplitude: float = setting(0.7, "amplitude of the reference angle, rad", above=-STEEPEST, below=STEEPEST)
    angular_frequency: float = setting(0.0471238898038469, "angular frequency of the reference, rad/s")

    def derivatives(self, time: float) -> Derivatives:
        """Return th_d and its first four derivatives at a time in s."""
        w = self.angular_frequency
        s = self.amplitude * sin(w * time)
        c = self.amplitude * cos(w * time)
        return s, w * c, -w * w * s, -w * w * w * c, w * w * w * w * s


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant reference, th_d = angle."""

    type: ClassVar[str] = "constant"
    description: ClassVar[str] = "th_d = angle"

    angle: float = setting(0.0, "reference angle, rad", above=-STEEPEST, below=STEEPEST)

    def derivatives(self, time: float) -> Derivatives:  # noqa: ARG002
        """Return the angle and four zeros."""
        return self.angle, 0.0, 0.0, 0.0, 0.0


@dataclass(frozen=True, slots=True)
class QuinticStep:
    """A step along a polynomial of degree 5, with rate and acceleration 0 at both ends.

    th_d = start_angle + (end_angle - start_angle) (10 s^3 - 15 s^4 + 6 s^5), s = (t - start_time)/duration in [0, 1].
    """

    type: ClassVar[str] = "quintic"
    description: ClassVar[str] = "from start_angle to end_angle along a polynomial of degree 5"

    start_angle: float = setting(0.0, "angle before the step, rad", above=-STEEPEST, below=STEEPEST)
    end_angle: float = setting(0.2, "angle after the step, rad", above=-STEEPEST, below=STEEPEST)
    start_time: float = setting(1.0, "time at which the step begins, s", minimum=0.0)
    duration: float = setting(5.0, "duration of the step, s", above=0.0)

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

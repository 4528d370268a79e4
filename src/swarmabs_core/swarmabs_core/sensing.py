"""Sensor models: noise and finite resolution, reproducible in every run and every process."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from math import remainder
from statistics import NormalDist

from swarmabs_core.declaration import setting

Pair = tuple[float, float]

_STANDARD = NormalDist()


def standard_normal(text: str) -> float:
    """Return a draw from the normal distribution with mean 0 and variance 1 that depends only on a string.

    With n, the first 52 of the 64 bits of the string's BLAKE2b hash, the draw is the quantile at ``(n + 1/2) / 2**52``,
    which is never 0 or 1.
    """
    digest = blake2b(text.encode(), digest_size=8).digest()
    return _STANDARD.inv_cdf(((int.from_bytes(digest, "big") >> 12) + 0.5) * 2.0**-52)


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor of a position or an angle and of its rate; without arguments it is perfect.

    White Gaussian noise is added, given by standard deviations in the units of value and rate. Then both are rounded to
    a resolution, where 0 means no rounding.
    """

    noise: Pair = (0.0, 0.0)
    resolution: Pair = (0.0, 0.0)

    @property
    def perfect(self) -> bool:
        """Whether the sensor adds neither noise nor rounding."""
        return not (any(self.noise) or any(self.resolution))

    def measure(self, value: float, rate: float, draw: str) -> Pair:
        """Return the measured value and rate, with noise drawn from the strings ``draw:value`` and ``draw:rate``."""
        return self._one(0, value, f"{draw}:value"), self._one(1, rate, f"{draw}:rate")

    def _one(self, index: int, true: float, text: str) -> float:
        sigma, step = self.noise[index], self.resolution[index]
        measured = true + sigma * standard_normal(text) if sigma else true
        # The IEEE 754 remainder is exact and refers to the nearest multiple, ties to even.
        return measured - remainder(measured, step) if step else measured


def measured_plane(sensor: Sensor, angle: float, angular_velocity: float, seed: int, step: int) -> Pair:
    """Return a sensor's measurement of the plane's angle (rad) and angular velocity (rad/s) at a step."""
    if sensor.perfect:
        return angle, angular_velocity
    return sensor.measure(angle, angular_velocity, f"{seed}:{step}:plane")


@dataclass(frozen=True, slots=True)
class PlaneSensor(Sensor):
    """Measurement of the plane's angle and angular velocity: noise is added, then the sum is rounded."""

    noise: Pair = setting(
        (0.0, 0.0),
        "standard deviations of white noise on angle, rad, and angular velocity, rad/s",
        minimum=0.0,
        length=2,
    )
    resolution: Pair = setting(
        (0.0, 0.0),
        "resolutions to which angle, rad, and angular velocity, rad/s, are rounded; 0: not rounded",
        minimum=0.0,
        length=2,
    )


@dataclass(frozen=True, slots=True)
class RobotSensor(Sensor):
    """Measurement of a robot's position and velocity: noise is added, then the sum is rounded."""

    noise: Pair = setting(
        (0.0, 0.0),
        "standard deviations of white noise on its own position, m, and velocity, m/s",
        minimum=0.0,
        length=2,
    )
    resolution: Pair = setting(
        (0.0, 0.0),
        "resolutions to which its own position, m, and velocity, m/s, are rounded; 0: not rounded",
        minimum=0.0,
        length=2,
    )

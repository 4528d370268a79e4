"""Sensor models: noise and finite resolution, reproducible in every run and every process."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from math import remainder
from typing import TYPE_CHECKING

from swarmabs_core.declaration import setting
from swarmabs_core.elementary import normal_quantile

if TYPE_CHECKING:
    from collections.abc import Sequence

Pair = tuple[float, float]


def standard_normal(text: str) -> float:
    """Return a draw from the normal distribution with mean 0 and variance 1 that depends only on a string.

    With n, the first 52 of the 64 bits of the string's BLAKE2b hash, the draw is the quantile at ``(n + 1/2) / 2**52``,
    which is never 0 or 1.
    """
    digest = blake2b(text.encode(), digest_size=8).digest()
    return normal_quantile(((int.from_bytes(digest, "big") >> 12) + 0.5) * 2.0**-52)


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor of some quantities, such as a position and its rate; without arguments it is perfect.

    White Gaussian noise is added, given by standard deviations in the units of the quantities. Then all are rounded to
    a resolution, where 0 means no rounding. No numbers mean zeros.
    """

    noise: tuple[float, ...] = (0.0, 0.0)
    resolution: tuple[float, ...] = (0.0, 0.0)

    @property
    def perfect(self) -> bool:
        """Whether the sensor adds neither noise nor rounding."""
        return not (any(self.noise) or any(self.resolution))

    def measure(self, value: float, rate: float, draw: str) -> Pair:
        """Return the measured value and rate, with noise drawn from the strings ``draw:value`` and ``draw:rate``."""
        measured, measured_rate = self.measure_all((value, rate), draw, ("value", "rate"))
        return measured, measured_rate

    def measure_all(self, values: Sequence[float], draw: str, names: Sequence[str]) -> tuple[float, ...]:
        """Return the measured values of quantities, with noise drawn from the strings ``draw:NAME``."""
        pairs = enumerate(zip(values, names, strict=True))
        return tuple(self._one(index, value, f"{draw}:{name}") for index, (value, name) in pairs)

    def _one(self, index: int, true: float, text: str) -> float:
        sigma, step = (numbers[index] if numbers else 0.0 for numbers in (self.noise, self.resolution))
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
class ParentSensor(Sensor):
    """Measurement of the state of any parent system: noise is added, then the sum is rounded."""

    noise: tuple[float, ...] = setting(
        (), "standard deviations of white noise on the quantities of the parent; none: 0", item=0.0, minimum=0.0
    )
    resolution: tuple[float, ...] = setting(
        (), "resolutions to which the quantities of the parent are rounded; none: not rounded", item=0.0, minimum=0.0
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

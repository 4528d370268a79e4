r"""Reference trajectories of the plane's angle, with the derivatives that ARISE feeds forward.

The smooth curve through the rows of a table is a quintic spline at rest at both ends: the interpolant with continuous
derivatives up to the fourth that minimises :math:`\int (y''')^2`, with first and second derivative 0 at both ends. Two
rows give the quintic step. The unknowns are the first and second derivatives at the inner knots. Continuity of the
third and fourth derivatives there is a symmetric, positive definite, block tridiagonal system, which Gaussian
elimination without pivoting solves by basic arithmetic only: the same bits on every machine.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, cast

from swarmabs_core.declaration import made_of, parameters_of, setting
from swarmabs_core.elementary import sin_cos
from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter
from swarmabs_core.plant import STEEPEST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_core.parameters import Settings

Derivatives = tuple[float, float, float, float, float]
Pair = tuple[float, float]
Coefficients = tuple[float, float, float, float, float, float]

SHORTEST = 1e-3
"""Shortest time between two rows, s: the coefficients are divided by its fifth power."""


class Trajectory(Protocol):
    """Reference trajectory of the plane's angle."""

    def derivatives(self, time: float) -> Derivatives:
        """Return th_d and its first four derivatives (rad, rad/s, ... rad/s^4) at a time in s."""
        ...


@dataclass(frozen=True, slots=True)
class Sine:
    """The paper's reference, th_d = amplitude sin(angular_frequency t)."""

    type: ClassVar[str] = "sine"
    description: ClassVar[str] = "th_d = amplitude sin(angular_frequency t)"

    amplitude: float = setting(0.7, "amplitude of the reference angle", unit="rad", above=-STEEPEST, below=STEEPEST)
    angular_frequency: float = setting(0.0471238898038469, "angular frequency of the reference", unit="rad/s")

    def derivatives(self, time: float) -> Derivatives:
        """Return th_d and its first four derivatives at a time in s."""
        w = self.angular_frequency
        sine, cosine = sin_cos(w * time)
        s, c = self.amplitude * sine, self.amplitude * cosine
        return s, w * c, -w * w * s, -w * w * w * c, w * w * w * w * s


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant reference, th_d = angle."""

    type: ClassVar[str] = "constant"
    description: ClassVar[str] = "th_d = angle"

    angle: float = setting(0.0, "reference angle", unit="rad", above=-STEEPEST, below=STEEPEST)

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

    start_angle: float = setting(0.0, "angle before the step", unit="rad", above=-STEEPEST, below=STEEPEST)
    end_angle: float = setting(0.2, "angle after the step", unit="rad", above=-STEEPEST, below=STEEPEST)
    start_time: float = setting(1.0, "time at which the step begins", unit="s", minimum=0.0)
    duration: float = setting(5.0, "duration of the step", unit="s", above=0.0)

    def derivatives(self, time: float) -> Derivatives:
        """Return th_d and its first four derivatives at a time in s; the third and fourth jump at both ends."""
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


class QuinticSpline:
    """The curve y(t) through rows (t, y); it is constant before the first and after the last.

    There must be at least two rows of finite numbers, with times that increase by at least `SHORTEST` s; otherwise an
    `InputError` is raised.
    """

    def __init__(self, times: Sequence[float], values: Sequence[float]) -> None:
        if len(times) != len(values) or len(times) < 2:
            raise InputError(
                f"{len(times)} times and {len(values)} values do not define a curve", "give equally many, at least two"
            )
        for earlier, later in pairwise(times):
            if not later - earlier >= SHORTEST:
                raise InputError(
                    f"time {later!r} s follows {earlier!r} s", f"times must increase by at least {SHORTEST} s"
                )
        if not all(isfinite(number) for number in (*times, *values)):
            raise InputError("a time or a value is not finite", "give finite numbers")
        self._times = tuple(times)
        slopes = _slopes(times, values)
        self._pieces = [
            _piece(t1 - t0, (y0, *s0), (y1, *s1))
            for t0, t1, y0, y1, s0, s1 in zip(times, times[1:], values, values[1:], slopes, slopes[1:], strict=False)
        ]
        self._ends = values[0], values[-1]

    def derivatives(self, time: float) -> Derivatives:
        """Return y and its first four derivatives at a time in s."""
        index = bisect_right(self._times, time) - 1
        if index < 0 or index >= len(self._pieces):
            return self._ends[0 if index < 0 else 1], 0.0, 0.0, 0.0, 0.0
        x = time - self._times[index]
        c0, c1, c2, c3, c4, c5 = self._pieces[index]
        return (
            c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5)))),
            c1 + x * (2.0 * c2 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5))),
            2.0 * c2 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5)),
            6.0 * c3 + x * (24.0 * c4 + x * 60.0 * c5),
            24.0 * c4 + x * 120.0 * c5,
        )


class _Matrix(NamedTuple):
    """A 2x2 matrix, row by row."""

    a: float
    b: float
    c: float
    d: float

    def times(self, x: Pair) -> Pair:
        return self.a * x[0] + self.b * x[1], self.c * x[0] + self.d * x[1]

    def product(self, other: _Matrix) -> _Matrix:
        a, c = self.times((other.a, other.c))
        b, d = self.times((other.b, other.d))
        return _Matrix(a, b, c, d)

    def inverse(self) -> _Matrix:
        det = self.a * self.d - self.b * self.c
        return _Matrix(self.d / det, -self.b / det, -self.c / det, self.a / det)

    def transposed(self) -> _Matrix:
        return _Matrix(self.a, self.c, self.b, self.d)


def _piece(h: float, start: tuple[float, float, float], end: tuple[float, float, float]) -> Coefficients:
    """Return the quintic over an interval of length h from value and first two derivatives at both ends."""
    y0, v0, a0 = start
    rise = end[0] - y0 - h * (v0 + 0.5 * h * a0)
    slope = h * (end[1] - v0 - h * a0)
    bend = h * h * (end[2] - a0)
    cube = h * h * h
    return (
        y0,
        v0,
        0.5 * a0,
        (10.0 * rise - 4.0 * slope + 0.5 * bend) / cube,
        (-15.0 * rise + 7.0 * slope - bend) / (cube * h),
        (6.0 * rise - 3.0 * slope + 0.5 * bend) / (cube * h * h),
    )


def _slopes(times: Sequence[float], values: Sequence[float]) -> list[Pair]:
    """Return the first and second derivatives at every knot by block elimination and back substitution."""
    inner = range(1, len(times) - 1)
    eliminated: list[tuple[_Matrix, Pair]] = []
    previous, shift = _Matrix(0.0, 0.0, 0.0, 0.0), (0.0, 0.0)
    for i in inner:
        h, k = times[i] - times[i - 1], times[i + 1] - times[i]
        rise, next_rise = (values[i] - values[i - 1]) / h, (values[i + 1] - values[i]) / k
        h, k = 1.0 / h, 1.0 / k
        mixed = -36.0 * (h * h - k * k)
        diagonal = _Matrix(192.0 * (h * h * h + k * k * k), mixed, mixed, 9.0 * (h + k))
        right = (
            360.0 * (rise * h * h * h + next_rise * k * k * k),
            -60.0 * (rise * h * h - next_rise * k * k),
        )
        below = _coupling(h).transposed()
        taken, carried = below.product(previous), below.times(shift)
        pivot = _Matrix(
            diagonal.a - taken.a, diagonal.b - taken.b, diagonal.c - taken.c, diagonal.d - taken.d
        ).inverse()
        shift = pivot.times((right[0] - carried[0], right[1] - carried[1]))
        previous = pivot.product(_coupling(k))
        eliminated.append((previous, shift))
    slopes: list[Pair] = [(0.0, 0.0)]
    for factor, constant in reversed(eliminated):
        shift = factor.times(slopes[-1])
        slopes.append((constant[0] - shift[0], constant[1] - shift[1]))
    return [(0.0, 0.0), *reversed(slopes)]


def _coupling(k: float) -> _Matrix:
    """Return the coefficients of the derivatives at the end of an interval of length 1/k in its first equations."""
    return _Matrix(168.0 * k * k * k, -24.0 * k * k, 24.0 * k * k, -3.0 * k)


_DECLARED: tuple[type[Sine | Constant | QuinticStep], ...] = (Sine, Constant, QuinticStep)

TRAJECTORY = (
    Parameter(
        "trajectory.type",
        Sine.type,
        "reference trajectory of the angle",
        choices=(*(kind.type for kind in _DECLARED), "csv"),
    ),
    *(parameter for kind in _DECLARED for parameter in parameters_of(kind, prefix="trajectory.")),
    Parameter("trajectory.times", (0.0, 1.0), "times of the rows of csv, increasing", unit="s", minimum=0.0),
    Parameter(
        "trajectory.angles", (0.0, 0.0), "angles of the rows of csv", unit="rad", minimum=-STEEPEST, maximum=STEEPEST
    ),
)
"""Settings of a controller that follows a trajectory; they appear in a scenario as ``controller.trajectory``."""


def make_trajectory(settings: Settings) -> Trajectory:
    """Create the trajectory described by the settings of a controller with `TRAJECTORY`.

    Raises
    ------
    InputError
        If the rows of a csv trajectory do not define a curve.
    """
    for kind in _DECLARED:
        if settings["trajectory.type"] == kind.type:
            return made_of(kind, settings, "trajectory.")
    times, angles = (cast("tuple[float, ...]", settings[f"trajectory.{name}"]) for name in ("times", "angles"))
    return QuinticSpline(times, angles)

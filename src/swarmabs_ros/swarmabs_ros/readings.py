"""Readings of the sensors of robots and planes as immutable values without ROS, and their validation.

Frames follow REP 103: right-handed, x forward, y left, z up. A rotation is a unit quaternion (x, y, z, w) that rotates
a vector from the body to the frame of the message. Stamps are ns since 1970. Rejected readings raise
`RefusedReadingError`.
"""

from __future__ import annotations

from math import atan2, expm1, hypot, isfinite, pi, remainder
from typing import NamedTuple, TypeAlias

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

UNIT_TOLERANCE = 0.01
"""Largest difference of a quaternion's norm from 1."""


class Odometry(NamedTuple):
    """``nav_msgs/Odometry``: position (m) and rotation in the frame, velocity (m/s) in the body's axes."""

    stamp: int
    frame: str
    position: Vector
    rotation: Quaternion
    velocity: Vector


class Joints(NamedTuple):
    """``sensor_msgs/JointState``: positions (rad or m) and velocities (rad/s or m/s, or none) by name."""

    stamp: int
    names: tuple[str, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...]


class Imu(NamedTuple):
    """``sensor_msgs/Imu``: rotation of the body in the world, angular velocity (rad/s) in the body's axes.

    Either is None if the sensor does not measure it according to the message.
    """

    stamp: int
    frame: str
    rotation: Quaternion | None
    angular_velocity: Vector | None


Reading: TypeAlias = Odometry | Joints | Imu


class RefusedReadingError(Exception):
    """A reading that is rejected; rejections are counted by reason."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


def signed_axis(name: str) -> tuple[int, float]:
    """Return number (0, 1, 2) and sign of an axis in `AXES`."""
    return "xyz".index(name[1]), -1.0 if name[0] == "-" else 1.0


def check_finite(*values: float) -> None:
    """Reject values that are infinite or NaN."""
    for value in values:
        if not isfinite(value):
            raise RefusedReadingError("not finite", f"a value is {value}")


def check_frame(frame: str, wanted: str) -> None:
    """Reject a frame other than `wanted`; an empty string allows all."""
    if wanted and frame != wanted:
        raise RefusedReadingError("frame", f"frame {frame[:80]!r}, not {wanted!r}")


def normalised(rotation: Quaternion) -> Quaternion:
    """Return a rotation as an exact unit quaternion; reject a quaternion that is not a rotation."""
    check_finite(*rotation)
    norm = hypot(*rotation)
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise RefusedReadingError("orientation", f"a quaternion of norm {norm:.3g} is not a rotation")
    x, y, z, w = rotation
    return x / norm, y / norm, z / norm, w / norm


def rotation_row(rotation: Quaternion, row: int) -> Vector:
    """Return a row of the matrix that rotates vectors from body to frame: the frame's axis in body coordinates."""
    x, y, z, w = rotation
    if row == 0:
        return 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    if row == 1:
        return 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


def wrapped(angle: float) -> float:
    """Return the same angle (rad) within -pi and pi."""
    return remainder(angle, 2.0 * pi)


def tilt(rotation: Quaternion, axis: int) -> float:
    """Return the rotation of a body about one of its axes, which must be level (rad, -pi to pi).

    It follows from the direction of gravity alone and does not depend on the drifting heading. For axis x (0) or y (1)
    it is 0 if the body's z axis points up, for axis z (2) if its y axis does.
    """
    up = rotation_row(rotation, 2)
    if axis == 0:
        return atan2(up[1], up[2])
    if axis == 1:
        return atan2(-up[0], up[2])
    return atan2(up[0], up[1])


def joint_values(reading: Joints, joint: str) -> tuple[float, float | None]:
    """Return position and velocity of a joint (None if the message has no velocity); reject it without a position."""
    if joint not in reading.names:
        joints = ", ".join(reading.names[:8])[:200]
        raise RefusedReadingError("joint", f"no joint {joint!r}, only {joints or 'none'}")
    place = reading.names.index(joint)
    if place >= len(reading.positions):
        raise RefusedReadingError("joint", f"joint {joint!r} has no position")
    return reading.positions[place], reading.velocities[place] if place < len(reading.velocities) else None


def imu_values(reading: Imu, axis: int, sign: float) -> tuple[float, float]:
    """Return angle (rad) and rate (rad/s) of the tilt about a signed axis of the sensor; reject it if it lacks one."""
    if reading.rotation is None or reading.angular_velocity is None:
        raise RefusedReadingError("orientation", "the IMU measures no orientation, or no angular velocity")
    check_finite(*reading.angular_velocity)
    return sign * tilt(normalised(reading.rotation), axis), sign * reading.angular_velocity[axis]


class Sample(NamedTuple):
    """Time (ns since 1970), value and rate of change (per s)."""

    stamp: int
    value: float
    rate: float


SETTLING = 5.0
"""Number of time constants after which a differentiated rate is used: less than 1 % of its initial error remains."""


class Track:
    r"""The newest plausible sample.

    A value further away than rate and jump allow is rejected. The allowed distance increases with the time since the
    last valid value, so the readings of a body that was moved are accepted again after some time.

    Parameters
    ----------
    max_rate : float
        Largest rate of change, per s.
    max_jump : float
        Further difference of two values that is allowed because of noise.
    clock_tolerance : float
        How far a stamp may be in the future, s.
    bandwidth : float
        Readings without a rate are differentiated: :math:`\dot r = \omega (\dot x - r)` with this :math:`\omega` in
        rad/s, solved exactly for linear interpolation between readings. The rate starts at 0 and is used once the
        initial error has decayed.
    """

    def __init__(self, max_rate: float, max_jump: float, clock_tolerance: float, bandwidth: float) -> None:
        self._max_rate = max_rate
        self._max_jump = max_jump
        self._tolerance = round(clock_tolerance * 1e9)
        self._bandwidth = bandwidth
        self._last: Sample | None = None
        self._believed_from = 0
        self._moved = False

    @property
    def newest(self) -> Sample | None:
        """The newest sample; None before the first, and while its rate is not yet known."""
        last = self._last
        return None if last is None or last.stamp < self._believed_from else last

    def offer(self, stamp: int, value: float, rate: float | None, now: int) -> None:
        """Add a reading, with rate None if the sensor has none; if it is rejected, the newest sample remains."""
        check_finite(value, 0.0 if rate is None else rate)
        latest = now + self._tolerance
        if stamp <= 0:
            raise RefusedReadingError("no stamp", "the message has no time stamp")
        if stamp > latest:
            raise RefusedReadingError("future", f"{(stamp - now) / 1e9:.3f} s from the future")
        last = self._last
        if last is not None and last.stamp > latest:  # the clock was set back: earlier samples are void
            last = None
        if last is not None:
            if stamp <= last.stamp:
                raise RefusedReadingError("order", f"{(last.stamp - stamp) / 1e9:.6f} s older than the last one")
            if abs(value - last.value) > self._max_rate * (stamp - last.stamp) / 1e9 + self._max_jump:
                self._moved = True
                raise RefusedReadingError("jump", f"from {last.value:.4g} to {value:.4g}")
        believed_from = 0
        if rate is None:
            if last is None or self._moved:
                rate, believed_from = 0.0, stamp + round(SETTLING / self._bandwidth * 1e9)
            else:
                rate, believed_from = self._differentiate(last, stamp, value), self._believed_from
        if abs(rate) > self._max_rate:
            raise RefusedReadingError("speed", f"rate {rate:.4g}, at most {self._max_rate:.4g} is plausible")
        self._last, self._believed_from, self._moved = Sample(stamp, value, rate), believed_from, False

    def _differentiate(self, last: Sample, stamp: int, value: float) -> float:
        elapsed = (stamp - last.stamp) / 1e9
        return last.rate - expm1(-self._bandwidth * elapsed) * ((value - last.value) / elapsed - last.rate)


class RefusedReadings:
    """Counts of rejected readings by reason, and the last rejection."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.last = ""

    def add(self, error: RefusedReadingError) -> None:
        """Count a rejection."""
        self.counts[error.reason] = self.counts.get(error.reason, 0) + 1
        self.last = str(error)

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the counts as values for a health status."""
        counts = tuple((f"readings refused, {reason}", str(count)) for reason, count in sorted(self.counts.items()))
        return (*counts, ("last reading refused", self.last)) if self.last else counts

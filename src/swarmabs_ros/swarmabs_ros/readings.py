"""What the sensors of robots and planes say, as immutable values without ROS, and what of it is believed.

Frames are those of REP 103: right-handed, x forward, y left, z up. A rotation is a unit quaternion (x, y, z, w) that
turns a vector of the body into the frame of the message. Stamps are ns since 1970. What is refused raises
`RefusedReadingError`.
"""

from __future__ import annotations

from math import atan2, expm1, hypot, isfinite, pi, remainder
from typing import NamedTuple, TypeAlias

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

UNIT_TOLERANCE = 0.01
"""By how much the norm of a quaternion may differ from 1."""


class Odometry(NamedTuple):
    """``nav_msgs/Odometry``: position (m) and rotation in the frame, velocity (m/s) in the body's own axes."""

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
    """``sensor_msgs/Imu``: rotation of the body in the world, angular velocity (rad/s) in the body's own axes.

    Either is None if the message says that the sensor does not measure it.
    """

    stamp: int
    frame: str
    rotation: Quaternion | None
    angular_velocity: Vector | None


Reading: TypeAlias = Odometry | Joints | Imu


class RefusedReadingError(Exception):
    """A reading that nothing is taken from; such refusals are counted under the reason."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


def signed_axis(name: str) -> tuple[int, float]:
    """Return number (0, 1, 2) and sign of an axis out of `AXES`."""
    return "xyz".index(name[1]), -1.0 if name[0] == "-" else 1.0


def check_finite(*values: float) -> None:
    """Refuse values that are infinite or not a number."""
    for value in values:
        if not isfinite(value):
            raise RefusedReadingError("not finite", f"a value is {value}")


def check_frame(found: str, wanted: str) -> None:
    """Refuse a frame other than the one that is wanted; an empty text allows all."""
    if wanted and found != wanted:
        raise RefusedReadingError("frame", f"frame {found[:80]!r}, not {wanted!r}")


def normalised(rotation: Quaternion) -> Quaternion:
    """Return a rotation as an exact unit quaternion; refuse what is no rotation."""
    check_finite(*rotation)
    norm = hypot(*rotation)
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise RefusedReadingError("orientation", f"a quaternion of norm {norm:.3g} is no rotation")
    x, y, z, w = rotation
    return x / norm, y / norm, z / norm, w / norm


def rotation_row(rotation: Quaternion, row: int) -> Vector:
    """Return a row of the matrix that turns the body's vectors into the frame: the frame's axis as the body sees it."""
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
    """Return by how much a body is turned about one of its own axes, which is level (rad, -pi to pi).

    It is read from the direction of gravity alone, so the heading of the body, which drifts, does not enter. With axis
    x (0) or y (1) it is 0 where the body's z points up, with axis z (2) where its y does.
    """
    up = rotation_row(rotation, 2)
    if axis == 0:
        return atan2(up[1], up[2])
    if axis == 1:
        return atan2(-up[0], up[2])
    return atan2(up[0], up[1])


def joint_values(reading: Joints, joint: str) -> tuple[float, float | None]:
    """Return position and velocity of a joint, which is None if the message has none; refuse it without a position."""
    if joint not in reading.names:
        known = ", ".join(reading.names[:8])[:200]
        raise RefusedReadingError("joint", f"no joint {joint!r}, only {known or 'none'}")
    place = reading.names.index(joint)
    if place >= len(reading.positions):
        raise RefusedReadingError("joint", f"joint {joint!r} has no position")
    return reading.positions[place], reading.velocities[place] if place < len(reading.velocities) else None


def imu_values(reading: Imu, axis: int, sign: float) -> tuple[float, float]:
    """Return angle (rad) and rate (rad/s) of tilting about a signed axis of the sensor; refuse it if it lacks one."""
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
"""Time constants after which a differentiated rate is believed: less than 1 % of its first error is left."""


class Track:
    r"""The newest plausible sample.

    A value further away than rate and jump allow is refused, but the longer the last good one is ago, the further it
    may be: what has really been moved is believed again after a while.

    Parameters
    ----------
    max_rate : float
        Largest rate of change, per s.
    max_jump : float
        By how much two values may differ beyond that, because of noise.
    clock_tolerance : float
        How far a stamp may lie in the future, s.
    bandwidth : float
        Where a reading brings no rate, it is differentiated: :math:`\dot r = \omega (\dot x - r)` with this
        :math:`\omega` in rad/s, solved exactly for values that lie on straight lines between readings. It begins with 0
        and is believed when that is forgotten.
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
        """Take over a reading, rate None if the sensor brings none; if it is refused, the newest sample stays."""
        check_finite(value, 0.0 if rate is None else rate)
        latest = now + self._tolerance
        if stamp <= 0:
            raise RefusedReadingError("no stamp", "the message has no time stamp")
        if stamp > latest:
            raise RefusedReadingError("future", f"{(stamp - now) / 1e9:.3f} s from the future")
        last = self._last
        if last is not None and last.stamp > latest:  # the clock was set back: what came before tells nothing now
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
    """How often readings were refused, by reason, and the last of them."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.last = ""

    def add(self, error: RefusedReadingError) -> None:
        """Count a refusal."""
        self.counts[error.reason] = self.counts.get(error.reason, 0) + 1
        self.last = str(error)

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the counts as figures of a state of health."""
        counts = tuple((f"readings refused, {reason}", str(count)) for reason, count in sorted(self.counts.items()))
        return (*counts, ("last reading refused", self.last)) if self.last else counts

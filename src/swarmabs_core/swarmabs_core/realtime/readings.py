"""What the sensors of robots and planes say, as immutable values without ROS, and the geometry to read it by.

Frames are those of REP 103: right-handed, x forward, y left, z up. A rotation is a unit quaternion (x, y, z, w) that
turns a vector of the body into the frame of the message. Stamps are ns since 1970.
"""

from __future__ import annotations

from math import atan2, hypot, isfinite, pi, remainder
from typing import NamedTuple, TypeAlias

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

AXES = ("+x", "+y", "+z", "-x", "-y", "-z")
"""Names of signed axes; the sign is always there, since YAML, and so ROS, takes a bare y for yes."""

STAMPS = ("header", "arrival")
"""What the time of a reading may be: its header's, or that of its arrival."""

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
    """A reading that nothing is taken from.

    Parameters
    ----------
    reason : str
        Word under which such refusals are counted.
    detail : str
        What was found, in one line.
    """

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


def signed_axis(name: str) -> tuple[int, float]:
    """Return number (0, 1, 2) and sign of an axis out of `AXES`."""
    return "xyz".index(name[1]), -1.0 if name[0] == "-" else 1.0


def check_finite(*values: float) -> None:
    """Refuse values that are no numbers.

    Raises
    ------
    RefusedReadingError
        If one is infinite or not a number.
    """
    for value in values:
        if not isfinite(value):
            raise RefusedReadingError("not finite", f"a value is {value}")


def check_frame(found: str, wanted: str) -> None:
    """Refuse a frame other than the one that is wanted; an empty wish allows all.

    Raises
    ------
    RefusedReadingError
        If it is another one.
    """
    if wanted and found != wanted:
        raise RefusedReadingError("frame", f"frame {found[:80]!r}, not {wanted!r}")


def normalised(rotation: Quaternion) -> Quaternion:
    """Return a rotation as an exact unit quaternion.

    Raises
    ------
    RefusedReadingError
        If it is no rotation.
    """
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
    """Return position and velocity of a joint; the velocity is None if the message has none.

    Raises
    ------
    RefusedReadingError
        If there is no such joint, or its position is missing.
    """
    if joint not in reading.names:
        known = ", ".join(reading.names[:8])[:200]
        raise RefusedReadingError("joint", f"no joint {joint!r}, only {known or 'none'}")
    place = reading.names.index(joint)
    if place >= len(reading.positions):
        raise RefusedReadingError("joint", f"joint {joint!r} has no position")
    return reading.positions[place], reading.velocities[place] if place < len(reading.velocities) else None

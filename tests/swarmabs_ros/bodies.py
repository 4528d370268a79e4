"""Robots on a tilted plane in space, by vectors and rotation matrices: what their sensors say."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from swarmabs_ros.readings import Imu, Odometry

SECOND = 1_000_000_000
EPOCH = 1_700_000_000 * SECOND
UP = np.array([0.0, 0.0, 1.0])


def lane(angle: float) -> NDArray[np.float64]:
    """Return the direction in which positions grow, in a world with z up: it rises where the angle is positive."""
    return np.array([np.cos(angle), 0.0, np.sin(angle)])


def attitude(angle: float, facing: float, heading: float = 0.0, yaw: float = 0.0) -> Rotation:
    """Return how a robot stands that faces along (1) or against (-1) the lane, turned by `heading` on the plane.

    `yaw` turns the whole world, as a compass would that is off.
    """
    forward = facing * lane(angle)
    normal = np.cross(lane(angle), np.array([0.0, 1.0, 0.0]))
    body = Rotation.from_matrix(np.column_stack([forward, np.cross(normal, forward), normal]))
    return Rotation.from_rotvec(yaw * UP) * body * Rotation.from_rotvec(heading * UP)


def imu(stamp: int, angle: float, rate: float, facing: float, yaw: float = 0.0, frame: str = "imu_link") -> Imu:
    stands = attitude(angle, facing, yaw=yaw)
    turning = Rotation.from_rotvec(yaw * UP).apply(np.array([0.0, -rate, 0.0]))  # from x to z is against y
    return Imu(stamp, frame, tuple(stands.as_quat()), tuple(stands.inv().apply(turning)))


def odometry(
    stamp: int,
    position: float,
    velocity: float,
    *,
    axis: int = 0,
    sign: float = 1.0,
    facing: float = 1.0,
    heading: float = 0.0,
    frame: str = "odom",
) -> Odometry:
    """Return what a localisation says whose axis with this number and sign is the lane; z is normal to the plane."""
    along = np.zeros(3)
    along[axis] = sign
    forward = Rotation.from_rotvec(heading * UP).apply(facing * along)
    stands = Rotation.from_matrix(np.column_stack([forward, np.cross(UP, forward), UP]))
    across = np.cross(UP, along)
    return Odometry(
        stamp,
        frame,
        tuple(position * along + 0.3 * across),
        tuple(stands.as_quat()),
        tuple(stands.inv().apply(velocity * along)),
    )

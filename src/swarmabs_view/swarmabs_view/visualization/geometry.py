"""Where things are, and how large they are drawn: a plane that turns on a level axis, robots in lanes side by side.

The frame `world` stands still: x along the level plane, z up, origin on the plane's axis. The frame `plane` turns with
the plane. A positive angle lifts the end of positive positions, so the axis points along -y: the weight of a robot
there, and a positive torque of the swarm, lower the angle (equation plane-dynamics).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable

WORLD, PLANE = "world", "plane"
JOINT = "plane_tilt"
AXIS = (0.0, -1.0, 0.0)
_THICKNESS = 0.02
_LARGEST_ROBOT = 0.08
_NARROWEST = 0.2
"""Thickness of the plane, edge of the heaviest robot, and least width of the plane, as parts of its length."""
_LANE = 1.25
"""Width of a lane, as a multiple of the edge of the heaviest robot."""


class Vector(NamedTuple):
    """Coordinates, m."""

    x: float
    y: float
    z: float


class Quaternion(NamedTuple):
    """A rotation."""

    x: float
    y: float
    z: float
    w: float


class Pose(NamedTuple):
    """Position, m, and rotation."""

    position: Vector
    orientation: Quaternion


def tilt(angle: float) -> Quaternion:
    """Return the rotation of the plane at an angle (rad)."""
    half = angle / 2.0
    x, y, z = (sin(half) * part for part in AXIS)
    return Quaternion(x, y, z, cos(half))


def tilted(point: Vector, angle: float) -> Vector:
    """Return where in the world a point of the plane is at an angle (rad)."""
    c, s = cos(angle), sin(angle)
    return Vector(c * point.x - s * point.z, point.y, s * point.x + c * point.z)


@dataclass(frozen=True, slots=True)
class Robot:
    """A robot as it is drawn: its lane's y (m) and the edge of its body (m)."""

    agent_id: int
    kind: int
    lane: float
    size: float


@dataclass(frozen=True, slots=True)
class Layout:
    """What is drawn where.

    Parameters
    ----------
    length, width, thickness : float
        Of the plane, m.
    robots : dict
        The robots by id.
    lane_width : float
        m.
    """

    length: float
    width: float
    thickness: float
    robots: dict[int, Robot]
    lane_width: float

    @classmethod
    def of(cls, length: float, robots: Iterable[tuple[int, int, float]]) -> Layout:
        """Lay out a plane of some length (m) with robots of id, kind and mass (kg), whose volume goes with the mass."""
        listed = sorted(robots)
        heaviest = max((mass for _, _, mass in listed), default=1.0)
        edge = _LARGEST_ROBOT * length
        lane_width = _LANE * edge
        first = -lane_width * (len(listed) - 1) / 2.0
        return cls(
            length,
            max(_NARROWEST * length, lane_width * len(listed)),
            _THICKNESS * length,
            {
                agent_id: Robot(agent_id, kind, first + index * lane_width, edge * (mass / heaviest) ** (1.0 / 3.0))
                for index, (agent_id, kind, mass) in enumerate(listed)
            },
            lane_width,
        )

    def on_plane(self, robot: Robot, position: float) -> Vector:
        """Return the middle of a robot's body in the frame of the plane, at a position along its lane (m)."""
        return Vector(position, robot.lane, (self.thickness + robot.size) / 2.0)

    def lane_ends(self, lane: float) -> tuple[Vector, Vector]:
        """Return both ends of a lane on the surface, in the frame of the plane."""
        above = 0.505 * self.thickness  # else the surface would hide it
        return Vector(-self.length / 2.0, lane, above), Vector(self.length / 2.0, lane, above)

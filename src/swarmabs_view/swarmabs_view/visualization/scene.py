"""The scene of a swarm: shapes in the frame `world`, without ROS and without a clock.

The frame `world` is fixed: x along the level plane, z up, origin on the plane's axis. The frame `plane` turns with the
plane. A positive angle lifts the end of positive positions, so the axis points along -y: the weight of a robot there,
and a positive torque of the swarm, lower the angle (equation plane-dynamics). Robots are in parallel lanes.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, nan, sin
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_bag.shown import colours
from swarmabs_config.scenario import on_plane
from swarmabs_core.messages import Kind
from swarmabs_core.plant import STEEPEST
from swarmabs_core.systems.kinds import KINDS
from swarmabs_run.rendering import templates

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from swarmabs_bag.shown.swarm_state import RobotStatus, ShownRobot, ShownVector, SwarmState
    from swarmabs_config.scenario import Scenario

WORLD, PLANE = "world", "plane"
JOINT = "plane_tilt"
AXIS = (0.0, -1.0, 0.0)
_THICKNESS = 0.02
_LARGEST_ROBOT = 0.08
_NARROWEST = 0.2
"""Thickness of the plane, edge of the heaviest robot, and minimum width of the plane, as fractions of its length."""
_LANE = 1.25
"""Width of a lane, as a multiple of the edge of the heaviest robot."""
LABELLED = 50
"""Most robots that are labelled."""

CUBE, CYLINDER, ARROW, LINES, TEXT = "cube", "cylinder", "arrow", "lines", "text"


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


NO_TURN = Quaternion(0.0, 0.0, 0.0, 1.0)


class Colour(NamedTuple):
    """Red, green, blue and opacity from 0 to 1."""

    r: float
    g: float
    b: float
    a: float


def _solid(colour: str) -> Colour:
    return Colour(*colours.parts(colour), 1.0)


GREY, DEAD, SAFE_STOP = _solid(colours.ABSENT), _solid(colours.FAILED), _solid(colours.SAFE_STOP)
PLATE = _solid(colours.tint(colours.PLANE, 0.25))
RAIL = Colour(0.35, 0.35, 0.35, 1.0)
REFERENCE = DESIRED = _solid(colours.REFERENCE)
ACTUAL = _solid(colours.TORQUE)
INK = Colour(0.10, 0.10, 0.10, 1.0)
COLOURS = {kind: _solid(one.colour) for kind, one in KINDS.items()}
"""Colours of the kinds, which also differ in shape."""
_STATUS_COLOURS: dict[RobotStatus | None, Colour] = {"dead": DEAD, "silent": GREY, "safe_stop": SAFE_STOP}
"""Colours of a status, which replace that of the kind."""
_DASHES = 16
"""Dashes of the reference line."""
_OUTLINE = 1.25
"""Extent of the dark base under a robot in a safe stop, as a multiple of the edge of its body."""


def tilt(angle: float) -> Quaternion:
    """Return the rotation of the plane at an angle (rad)."""
    half = angle / 2.0
    x, y, z = (sin(half) * part for part in AXIS)
    return Quaternion(x, y, z, cos(half))


def tilted(point: Vector, angle: float) -> Vector:
    """Return where in the world a point of the plane is at an angle (rad)."""
    c, s = cos(angle), sin(angle)
    return Vector(c * point.x - s * point.z, point.y, s * point.x + c * point.z)


class RobotGeometry(NamedTuple):
    """Geometry of a robot: kind, y of its lane (m) and edge of its body (m)."""

    kind: int
    lane: float
    size: float


@dataclass(frozen=True, slots=True)
class Shape:
    """A shape in the frame `world`.

    Group and number identify it: a shape with the same two in the next frame replaces it. The pose is that of its
    centre, or of the tail of an arrow (along x); `points` are pairs, relative to the pose of lines. The size is the
    extent, m; for lines x is the width, for text z the height.
    """

    group: str
    number: int
    kind: str
    pose: Pose
    size: Vector
    colour: Colour
    points: tuple[Vector, ...] = ()
    text: str = ""


class Frame(NamedTuple):
    """A swarm in one step: stamp (ns), angle (rad) and rate (rad/s) of the plane, torque of the robots on it (N m).

    `gone` contains group and number of shapes to remove; `places` the positions of the robots in the frame `plane`, m,
    by id.
    """

    step: int
    stamp: int
    angle: float
    rate: float
    effort: float | None
    shapes: tuple[Shape, ...]
    gone: tuple[tuple[str, int], ...]
    places: dict[int, Vector]


class Scene:
    """Converts the state of a swarm to frames, and remembers the shapes drawn.

    The plane is given by its length (m) and moment of inertia (kg m^2), the robots by id, kind and mass (kg); their
    volume is proportional to the mass. The arrow of the torque `torque_max`, N m, is as long as half the plane.
    """

    def __init__(
        self, length: float, inertia: float, robots: Iterable[tuple[int, int, float]], torque_max: float
    ) -> None:
        listed = sorted(robots)
        heaviest = max((mass for _, _, mass in listed), default=1.0)
        edge = _LARGEST_ROBOT * length
        self.lane_width = _LANE * edge
        first = -self.lane_width * (len(listed) - 1) / 2.0
        self.robots = {
            agent_id: RobotGeometry(kind, first + index * self.lane_width, edge * (mass / heaviest) ** (1.0 / 3.0))
            for index, (agent_id, kind, mass) in enumerate(listed)
        }
        self.length, self.inertia = length, inertia
        self.width = max(_NARROWEST * length, self.lane_width * len(listed))
        self.thickness = _THICKNESS * length
        self._torque_max = torque_max
        self._drawn: set[tuple[str, int]] = set()

    @classmethod
    def of(cls, scenario: Scenario) -> Scene:
        """Return the scene of a scenario; raise `InputError` if its parent system is not the plane."""
        drawn = on_plane(scenario, "the RViz scene")
        robots = [(agent.id, int(Kind.of(agent.kind)), agent.mass) for agent in drawn.agents]
        return cls(drawn.plane.length, drawn.plane.inertia, robots, drawn.manifold.torque_max)

    def frame(self, swarm: SwarmState) -> Frame | None:
        """Return the current frame, None before the first state of the plane."""
        instant = swarm.instant()
        if instant is None:
            return None
        angle, rate = instant.parent
        if angle is None:
            return None
        robots = {
            identity.id: shown
            for identity, shown in zip(swarm.robots, swarm.shown_robots(instant.step), strict=True)
            if identity.id in self.robots
        }
        places = self._places(robots)
        torque = _first(instant.abstract)
        shapes = (
            *self._still(angle),
            *self._reference(_first(instant.reference)),
            *self._bodies(angle, robots, places),
            *self._torques(torque, _first(instant.desired)),
        )
        drawn = {(shape.group, shape.number) for shape in shapes}
        gone, self._drawn = tuple(sorted(self._drawn - drawn)), drawn
        effort = None if torque is None else -cos(angle) * torque
        return Frame(instant.step, instant.stamp, angle, nan if rate is None else rate, effort, shapes, gone, places)

    def _places(self, robots: Mapping[int, ShownRobot]) -> dict[int, Vector]:
        """Return the centres of the robots on the plane, in its frame."""
        places = {}
        for agent_id, shown in robots.items():
            position = _first(shown.coordinates)
            if position is not None:
                robot = self.robots[agent_id]
                places[agent_id] = Vector(position, robot.lane, (self.thickness + robot.size) / 2.0)
        return places

    def _lane_ends(self, lane: float) -> tuple[Vector, Vector]:
        """Return both ends of a lane on the surface, in the frame of the plane."""
        above = 0.505 * self.thickness  # otherwise the surface hides it
        return Vector(-self.length / 2.0, lane, above), Vector(self.length / 2.0, lane, above)

    def _still(self, angle: float) -> tuple[Shape, ...]:
        """Return the shapes that only turn with the plane."""
        pose = Pose(Vector(0.0, 0.0, 0.0), tilt(angle))
        ends = [end for robot in self.robots.values() for end in self._lane_ends(robot.lane)]
        plate = Vector(self.length, self.width, self.thickness)
        rail = Vector(0.05 * self.lane_width, 0.0, 0.0)
        return (
            Shape("plane", 0, CUBE, pose, plate, PLATE),
            Shape("lanes", 0, LINES, pose, rail, RAIL, tuple(ends)),
        )

    def _reference(self, reference: float | None) -> tuple[Shape, ...]:
        """Return the dashed lines of the reference (rad), on both sides of the plane."""
        if reference is None:
            return ()
        sides = [
            end._replace(x=self.length * (place / (2 * _DASHES - 1) - 0.5))
            for side in (-0.52, 0.52)
            for place, end in enumerate(self._lane_ends(side * self.width) * _DASHES)
        ]
        pose = Pose(Vector(0.0, 0.0, 0.0), tilt(reference))
        return (Shape("reference", 0, LINES, pose, Vector(0.1 * self.lane_width, 0.0, 0.0), REFERENCE, tuple(sides)),)

    def _bodies(self, angle: float, robots: Mapping[int, ShownRobot], places: dict[int, Vector]) -> list[Shape]:
        shapes = []
        turn = tilt(angle)
        labelled = len(self.robots) <= LABELLED
        for agent_id, place in places.items():
            robot = self.robots[agent_id]
            pose = Pose(tilted(place, angle), turn)
            body = CYLINDER if KINDS[robot.kind].shape == "circle" else CUBE
            size = Vector(robot.size, robot.size, robot.size)
            status = robots[agent_id].status
            colour = _STATUS_COLOURS.get(status) or COLOURS[robot.kind]
            shapes.append(Shape("robots", agent_id, body, pose, size, colour))
            if status == "safe_stop":
                base = Vector(_OUTLINE * robot.size, _OUTLINE * robot.size, 0.1 * robot.size)
                foot = tilted(place._replace(z=0.5 * (self.thickness + base.z)), angle)
                shapes.append(Shape("outlines", agent_id, body, Pose(foot, turn), base, INK))
            if labelled:
                above = tilted(place._replace(z=place.z + robot.size), angle)
                height = Vector(0.0, 0.0, 0.6 * self.lane_width)
                shapes.append(Shape("labels", agent_id, TEXT, Pose(above, NO_TURN), height, INK, (), str(agent_id)))
        return shapes

    def _torques(self, actual: float | None, desired: float | None) -> list[Shape]:
        """Return the arrows of the actual and the desired torque, which point to the end that is pushed down."""
        shapes = []
        for number, (torque, colour) in enumerate(((actual, ACTUAL), (desired, DESIRED))):
            if not torque:
                continue
            length = self.length / 2.0 * min(abs(torque) / self._torque_max, 1.0)
            turn = NO_TURN if torque > 0.0 else Quaternion(0.0, 0.0, 1.0, 0.0)
            tail = Vector(0.0, 0.0, self.length * (0.35 + 0.06 * number))
            thick = 0.03 * self.length
            shapes.append(Shape("torque", number, ARROW, Pose(tail, turn), Vector(length, thick, thick), colour))
        return shapes


def plane_urdf(scene: Scene) -> str:
    """Return the plane as URDF: a plate on a horizontal joint, with its moment of inertia about its axis.

    Its mass is that of a uniform plate with this moment of inertia, 12 J / (l^2 + t^2).
    """
    length, width, thickness, inertia = scene.length, scene.width, scene.thickness, scene.inertia
    mass = 12.0 * inertia / (length**2 + thickness**2)
    return (
        templates("swarmabs_view.visualization")
        .get_template("plane.urdf.j2")
        .render(
            world=WORLD,
            plane=PLANE,
            joint=JOINT,
            axis=_numbers(*AXIS),
            colour=_numbers(*(round(part, 4) for part in PLATE)),
            limit=_numbers(STEEPEST),
            size=_numbers(length, width, thickness),
            mass=_numbers(mass),
            ixx=_numbers(mass * (width**2 + thickness**2) / 12.0),
            iyy=_numbers(inertia),
            izz=_numbers(mass * (length**2 + width**2) / 12.0),
        )
    )


def _first(vector: ShownVector) -> float | None:
    """Return the first number of a vector of the plane, None if it is unknown."""
    return vector[0] if vector else None


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)

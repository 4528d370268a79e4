"""What is drawn of a swarm: shapes in the frame `world`. It knows neither ROS nor a clock.

The frame `world` stands still: x along the level plane, z up, origin on the plane's axis. The frame `plane` turns with
the plane. A positive angle lifts the end of positive positions, so the axis points along -y: the weight of a robot
there, and a positive torque of the swarm, lower the angle (equation plane-dynamics). Robots are in lanes side by side.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, nan, sin
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_bag import colours
from swarmabs_core.messages import Kind
from swarmabs_run.rendering import templates

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from swarmabs_bag.swarm_state import RobotStatus, ShownRobot, SwarmState
    from swarmabs_config.scenario import Scenario

WORLD, PLANE = "world", "plane"
JOINT = "plane_tilt"
AXIS = (0.0, -1.0, 0.0)
LARGEST_ANGLE = 1.5
"""rad; every run ends there."""
_THICKNESS = 0.02
_LARGEST_ROBOT = 0.08
_NARROWEST = 0.2
"""Thickness of the plane, edge of the heaviest robot, and least width of the plane, as parts of its length."""
_LANE = 1.25
"""Width of a lane, as a multiple of the edge of the heaviest robot."""
LABELLED = 50
"""More robots than these have no labels."""

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
KINDS = {kind: _solid(colour) for kind, colour in colours.KINDS.items()}
"""Colours of the kinds, whose shapes differ as well."""
_STATUS_COLOURS: dict[RobotStatus | None, Colour] = {"dead": DEAD, "silent": GREY, "safe_stop": SAFE_STOP}
"""Colours that tell more than the kind."""
_DASHES = 16
"""Dashes of the line of the reference."""
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


class Robot(NamedTuple):
    """A robot as it is drawn: kind, its lane's y (m) and the edge of its body (m)."""

    kind: int
    lane: float
    size: float


@dataclass(frozen=True, slots=True)
class Shape:
    """Something to draw, in the frame `world`.

    Group and number say which one it is: the next frame's shape with the same two takes its place. The pose is that of
    its middle, of an arrow (along x) its tail; `points` are pairs, in the pose of lines. The size is the extent, m; of
    lines x is the width, of a text z the height.
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

    `gone` has group and number of what was drawn before and no longer is; `places` where each robot is in the frame
    `plane`, m, by id.
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
    """Draws what is shown of a swarm, and remembers what it has drawn.

    The plane has some length (m), and robots by id, kind and mass (kg), whose volume goes with the mass. An arrow is as
    long as half the plane at the torque `torque_max`, N m.
    """

    def __init__(self, length: float, robots: Iterable[tuple[int, int, float]], torque_max: float) -> None:
        listed = sorted(robots)
        heaviest = max((mass for _, _, mass in listed), default=1.0)
        edge = _LARGEST_ROBOT * length
        self.lane_width = _LANE * edge
        first = -self.lane_width * (len(listed) - 1) / 2.0
        self.robots = {
            agent_id: Robot(kind, first + index * self.lane_width, edge * (mass / heaviest) ** (1.0 / 3.0))
            for index, (agent_id, kind, mass) in enumerate(listed)
        }
        self.length = length
        self.width = max(_NARROWEST * length, self.lane_width * len(listed))
        self.thickness = _THICKNESS * length
        self._torque_max = torque_max
        self._drawn: set[tuple[str, int]] = set()

    @classmethod
    def of(cls, scenario: Scenario) -> Scene:
        """Return the scene of a scenario whose robots are listed."""
        robots = [(agent.id, int(Kind[agent.kind.upper()]), agent.mass) for agent in scenario.agents]
        return cls(scenario.plane.length, robots, scenario.manifold.torque_max)

    def frame(self, swarm: SwarmState) -> Frame | None:
        """Return what to draw now, None before the first state of the plane."""
        instant = swarm.instant()
        if instant is None or instant.angle is None:
            return None
        robots = {
            identity.id: shown
            for identity, shown in zip(swarm.robots, swarm.shown_robots(instant.step), strict=True)
            if identity.id in self.robots
        }
        places = self._places(robots)
        shapes = (
            *self._still(instant.angle),
            *self._wanted(instant.reference),
            *self._bodies(instant.angle, robots, places),
            *self._torques(instant.abstract.torque, instant.desired.torque),
        )
        drawn = {(shape.group, shape.number) for shape in shapes}
        gone, self._drawn = tuple(sorted(self._drawn - drawn)), drawn
        torque = instant.abstract.torque
        effort = None if torque is None else -cos(instant.angle) * torque
        rate = nan if instant.angular_velocity is None else instant.angular_velocity
        return Frame(instant.step, instant.stamp, instant.angle, rate, effort, shapes, gone, places)

    def _places(self, robots: Mapping[int, ShownRobot]) -> dict[int, Vector]:
        """Return where the middle of the robots that are on the plane is, in its frame."""
        found = {}
        for agent_id, shown in robots.items():
            if shown.position is not None:
                robot = self.robots[agent_id]
                found[agent_id] = Vector(shown.position, robot.lane, (self.thickness + robot.size) / 2.0)
        return found

    def _lane_ends(self, lane: float) -> tuple[Vector, Vector]:
        """Return both ends of a lane on the surface, in the frame of the plane."""
        above = 0.505 * self.thickness  # else the surface would hide it
        return Vector(-self.length / 2.0, lane, above), Vector(self.length / 2.0, lane, above)

    def _still(self, angle: float) -> tuple[Shape, ...]:
        """Return what only turns with the plane."""
        pose = Pose(Vector(0.0, 0.0, 0.0), tilt(angle))
        ends = [end for robot in self.robots.values() for end in self._lane_ends(robot.lane)]
        plate = Vector(self.length, self.width, self.thickness)
        rail = Vector(0.05 * self.lane_width, 0.0, 0.0)
        return (
            Shape("plane", 0, CUBE, pose, plate, PLATE),
            Shape("lanes", 0, LINES, pose, rail, RAIL, tuple(ends)),
        )

    def _wanted(self, wanted: float | None) -> tuple[Shape, ...]:
        """Return the dashed line along which the plane should lie, at both its sides."""
        if wanted is None:
            return ()
        sides = [
            end._replace(x=self.length * (place / (2 * _DASHES - 1) - 0.5))
            for side in (-0.52, 0.52)
            for place, end in enumerate(self._lane_ends(side * self.width) * _DASHES)
        ]
        pose = Pose(Vector(0.0, 0.0, 0.0), tilt(wanted))
        return (Shape("reference", 0, LINES, pose, Vector(0.1 * self.lane_width, 0.0, 0.0), REFERENCE, tuple(sides)),)

    def _bodies(self, angle: float, robots: Mapping[int, ShownRobot], places: dict[int, Vector]) -> list[Shape]:
        shapes = []
        turn = tilt(angle)
        labelled = len(self.robots) <= LABELLED
        for agent_id, place in places.items():
            robot = self.robots[agent_id]
            pose = Pose(tilted(place, angle), turn)
            body = CYLINDER if robot.kind == Kind.SINGLE_INTEGRATOR else CUBE
            size = Vector(robot.size, robot.size, robot.size)
            status = robots[agent_id].status
            colour = _STATUS_COLOURS.get(status) or KINDS[Kind(robot.kind)]
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
        """Return the arrows of the swarm's torque, actual and wanted: they point to the end that is pushed down."""
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


def plane_urdf(scene: Scene, inertia: float) -> str:
    """Return the plane as URDF: a plate on a level joint, with a moment of inertia (kg m^2) about its axis.

    Its mass is that of a uniform plate with this moment of inertia, 12 J / (l^2 + t^2).
    """
    length, width, thickness = scene.length, scene.width, scene.thickness
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
            limit=_numbers(LARGEST_ANGLE),
            size=_numbers(length, width, thickness),
            mass=_numbers(mass),
            ixx=_numbers(mass * (width**2 + thickness**2) / 12.0),
            iyy=_numbers(inertia),
            izz=_numbers(mass * (length**2 + width**2) / 12.0),
        )
    )


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)

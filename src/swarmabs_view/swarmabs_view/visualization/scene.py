"""What is drawn of a swarm: shapes in the frame `world`. It knows neither ROS nor a clock."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, nan
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.messages import Kind
from swarmabs_view.visualization.geometry import Layout, Pose, Quaternion, Vector, tilt, tilted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_bag.swarm_state import RobotStatus, ShownRobot, SwarmState
    from swarmabs_config.scenario import Scenario

LABELLED = 50
"""More robots than these have no labels."""

CUBE, CYLINDER, ARROW, LINES, TEXT = "cube", "cylinder", "arrow", "lines", "text"

NO_TURN = Quaternion(0.0, 0.0, 0.0, 1.0)


class Colour(NamedTuple):
    """Red, green, blue and opacity from 0 to 1."""

    r: float
    g: float
    b: float
    a: float


GREY = Colour(0.55, 0.55, 0.55, 1.0)
PLATE = Colour(0.80, 0.78, 0.72, 1.0)
RAIL = Colour(0.35, 0.35, 0.35, 1.0)
REFERENCE = Colour(0.10, 0.60, 0.20, 1.0)
ACTUAL, DESIRED = Colour(0.12, 0.35, 0.75, 1.0), Colour(0.95, 0.60, 0.10, 0.9)
SAFE_STOP = Colour(0.95, 0.80, 0.10, 1.0)
INK = Colour(0.10, 0.10, 0.10, 1.0)
KINDS = {Kind.SINGLE_INTEGRATOR: Colour(0.12, 0.47, 0.71, 1.0), Kind.DOUBLE_INTEGRATOR: Colour(0.84, 0.37, 0.00, 1.0)}
"""Blue and vermilion, which colour-blind people tell apart too; the shapes differ as well."""
_STATUS_COLOURS: dict[RobotStatus | None, Colour] = {"dead": GREY, "silent": GREY, "safe_stop": SAFE_STOP}
"""Colours that tell more than the kind."""


@dataclass(frozen=True, slots=True)
class Shape:
    """Something to draw, in the frame `world`.

    Parameters
    ----------
    group, number : str, int
        Which one it is: the next frame's shape with the same two takes its place.
    kind : str
        ``cube``, ``cylinder``, ``arrow`` (along x of its pose), ``lines`` (pairs of points in its pose) or ``text``.
    pose : Pose
        Of its middle, of an arrow its tail.
    size : Vector
        Extent, m; of lines x is the width, of a text z the height.
    colour : Colour
        Its colour.
    points : tuple of Vector
        Of lines.
    text : str
        Of a text.
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
    """A swarm at one moment.

    Parameters
    ----------
    step, stamp : int
        Of the plane's state; the stamp in ns.
    angle, rate : float
        Of the plane, rad and rad/s.
    effort : float, optional
        Torque of the robots about the joint, N m.
    shapes : tuple of Shape
        All there is to draw.
    gone : tuple of tuple
        Group and number of what was drawn before and no longer is.
    places : dict
        Pose of each robot in the frame `plane`, by id.
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

    Parameters
    ----------
    layout : Layout
        What is where.
    torque_max : float
        Torque, N m, at which an arrow is as long as half the plane.
    """

    def __init__(self, layout: Layout, torque_max: float) -> None:
        self.layout = layout
        self._torque_max = torque_max
        self._drawn: set[tuple[str, int]] = set()

    @classmethod
    def of(cls, scenario: Scenario) -> Scene:
        """Return the scene of a scenario whose robots are listed."""
        robots = [(agent.id, int(Kind[agent.kind.upper()]), agent.mass) for agent in scenario.agents]
        return cls(Layout.of(scenario.plane.length, robots), scenario.manifold.torque_max)

    def frame(self, swarm: SwarmState) -> Frame | None:
        """Return what to draw now, None before the first state of the plane."""
        instant = swarm.instant()
        if instant is None or instant.angle is None:
            return None
        robots = {
            identity.id: shown
            for identity, shown in zip(swarm.robots, swarm.shown_robots(instant.step), strict=True)
            if identity.id in self.layout.robots
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
        """Return where the robots are that are on the plane."""
        return {
            agent_id: self.layout.on_plane(self.layout.robots[agent_id], robot.position)
            for agent_id, robot in robots.items()
            if robot.position is not None
        }

    def _still(self, angle: float) -> tuple[Shape, ...]:
        """Return what only turns with the plane."""
        layout = self.layout
        pose = Pose(Vector(0.0, 0.0, 0.0), tilt(angle))
        ends = [end for robot in layout.robots.values() for end in layout.lane_ends(robot.lane)]
        plate = Vector(layout.length, layout.width, layout.thickness)
        rail = Vector(0.05 * layout.lane_width, 0.0, 0.0)
        return (
            Shape("plane", 0, CUBE, pose, plate, PLATE),
            Shape("lanes", 0, LINES, pose, rail, RAIL, tuple(ends)),
        )

    def _wanted(self, wanted: float | None) -> tuple[Shape, ...]:
        """Return the line along which the plane should lie, at both its sides."""
        if wanted is None:
            return ()
        layout = self.layout
        sides = [end for side in (-0.52, 0.52) for end in layout.lane_ends(side * layout.width)]
        pose = Pose(Vector(0.0, 0.0, 0.0), tilt(wanted))
        return (Shape("reference", 0, LINES, pose, Vector(0.1 * layout.lane_width, 0.0, 0.0), REFERENCE, tuple(sides)),)

    def _bodies(self, angle: float, robots: Mapping[int, ShownRobot], places: dict[int, Vector]) -> list[Shape]:
        shapes = []
        turn = tilt(angle)
        labelled = len(self.layout.robots) <= LABELLED
        for agent_id, place in places.items():
            robot = self.layout.robots[agent_id]
            pose = Pose(tilted(place, angle), turn)
            body = CYLINDER if robot.kind == Kind.SINGLE_INTEGRATOR else CUBE
            size = Vector(robot.size, robot.size, robot.size)
            colour = _STATUS_COLOURS.get(robots[agent_id].status) or KINDS[Kind(robot.kind)]
            shapes.append(Shape("robots", agent_id, body, pose, size, colour))
            if labelled:
                above = tilted(place._replace(z=place.z + robot.size), angle)
                height = Vector(0.0, 0.0, 0.6 * self.layout.lane_width)
                shapes.append(Shape("labels", agent_id, TEXT, Pose(above, NO_TURN), height, INK, (), str(agent_id)))
        return shapes

    def _torques(self, actual: float | None, desired: float | None) -> list[Shape]:
        """Return the arrows of the swarm's torque, actual and wanted: they point to the end that is pushed down."""
        layout = self.layout
        shapes = []
        for number, (torque, colour) in enumerate(((actual, ACTUAL), (desired, DESIRED))):
            if not torque:
                continue
            length = layout.length / 2.0 * min(abs(torque) / self._torque_max, 1.0)
            turn = NO_TURN if torque > 0.0 else Quaternion(0.0, 0.0, 1.0, 0.0)
            tail = Vector(0.0, 0.0, layout.length * (0.35 + 0.06 * number))
            thick = 0.03 * layout.length
            shapes.append(Shape("torque", number, ARROW, Pose(tail, turn), Vector(length, thick, thick), colour))
        return shapes

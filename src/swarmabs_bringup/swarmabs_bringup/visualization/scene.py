"""What is drawn of a swarm: takes its messages, gives shapes in the frame `world`. It knows neither ROS nor a clock."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, isfinite
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from swarmabs_bringup.visualization.geometry import Layout, Pose, Quaternion, Robot, Vector, tilt, tilted
from swarmabs_core import configure
from swarmabs_core.messages import (
    AbstractState,
    AgentState,
    DesiredAbstractState,
    EventKind,
    Kind,
    PlaneState,
    Status,
    SwarmEvent,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.messages import Message
    from swarmabs_core.scenario import Scenario

SILENT_STEPS = 50
"""A robot whose latest state is older than so many steps is drawn as silent."""
LABELLED = 50
"""More robots than these have no labels."""

CUBE, CYLINDER, ARROW, LINES, TEXT = "cube", "cylinder", "arrow", "lines", "text"
_Known = TypeVar("_Known", PlaneState, AbstractState, DesiredAbstractState, AgentState)

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
    stamp : int
        Time of the plane's state, ns.
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

    stamp: int
    angle: float
    rate: float
    effort: float | None
    shapes: tuple[Shape, ...]
    gone: tuple[tuple[str, int], ...]
    places: dict[int, Vector]


class Scene:
    """Keeps the newest of every message and draws it.

    Parameters
    ----------
    layout : Layout
        What is where.
    torque_max : float
        Torque, N m, at which an arrow is as long as half the plane.
    reference : callable, optional
        Angle, rad, that the plane should have at a time, s.
    """

    def __init__(self, layout: Layout, torque_max: float, reference: Callable[[float], float] | None = None) -> None:
        self.layout = layout
        self._torque_max = torque_max
        self._reference = reference
        self._plane: PlaneState | None = None
        self._abstract: AbstractState | None = None
        self._desired: DesiredAbstractState | None = None
        self._robots: dict[int, AgentState] = {}
        self._dead: set[int] = set()
        self._drawn: set[tuple[str, int]] = set()

    @classmethod
    def of(cls, scenario: Scenario) -> Scene:
        """Return the scene of a scenario whose robots are listed."""
        robots = [(agent.id, int(Kind[agent.kind.upper()]), agent.mass) for agent in scenario.agents]
        layout = Layout.of(scenario.plane.length, robots)
        return cls(layout, scenario.manifold.torque_max, configure.parent_controller(scenario).reference)

    @property
    def step(self) -> int | None:
        """The step of the newest state of the plane."""
        return None if self._plane is None else self._plane.step

    def hear(self, message: Message) -> None:
        """Take a message; older ones than those that are known, and robots that do not belong here, are left out."""
        if isinstance(message, PlaneState):
            self._plane = _newer(self._plane, message)
        elif isinstance(message, AbstractState):
            self._abstract = _newer(self._abstract, message)
        elif isinstance(message, DesiredAbstractState):
            self._desired = _newer(self._desired, message)
        elif isinstance(message, AgentState) and message.agent_id in self.layout.robots:
            self._robots[message.agent_id] = _newer(self._robots.get(message.agent_id), message)
        elif isinstance(message, SwarmEvent):
            if message.kind == EventKind.DEAD:
                self._dead.add(message.agent_id)
            elif message.kind == EventKind.JOINED:
                self._dead.discard(message.agent_id)

    def frame(self) -> Frame | None:
        """Return what to draw now, None before the first state of the plane."""
        plane = self._plane
        if plane is None or not isfinite(plane.angle):
            return None
        places = self._places()
        shapes = (
            *self._still(plane.angle),
            *self._wanted(plane),
            *self._bodies(plane, places),
            *self._torques(),
        )
        drawn = {(shape.group, shape.number) for shape in shapes}
        gone, self._drawn = tuple(sorted(self._drawn - drawn)), drawn
        torque = self._abstract.torque if self._abstract is not None else None
        effort = None if torque is None else -cos(plane.angle) * torque
        return Frame(plane.stamp, plane.angle, plane.angular_velocity, effort, shapes, gone, places)

    def _places(self) -> dict[int, Vector]:
        """Return where the robots are that are on the plane."""
        return {
            agent_id: self.layout.on_plane(robot, state.position)
            for agent_id, robot in self.layout.robots.items()
            if (state := self._robots.get(agent_id)) is not None
            and state.status != Status.LEFT
            and isfinite(state.position)
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

    def _wanted(self, plane: PlaneState) -> tuple[Shape, ...]:
        """Return the line along which the plane should lie, at both its sides."""
        if self._reference is None:
            return ()
        wanted = self._reference(plane.stamp / 1e9)
        if not isfinite(wanted):
            return ()
        layout = self.layout
        sides = [end for side in (-0.52, 0.52) for end in layout.lane_ends(side * layout.width)]
        pose = Pose(Vector(0.0, 0.0, 0.0), tilt(wanted))
        return (Shape("reference", 0, LINES, pose, Vector(0.1 * layout.lane_width, 0.0, 0.0), REFERENCE, tuple(sides)),)

    def _bodies(self, plane: PlaneState, places: dict[int, Vector]) -> list[Shape]:
        shapes = []
        turn = tilt(plane.angle)
        labelled = len(self.layout.robots) <= LABELLED
        for agent_id, place in places.items():
            robot, state = self.layout.robots[agent_id], self._robots[agent_id]
            pose = Pose(tilted(place, plane.angle), turn)
            body = CYLINDER if robot.kind == Kind.SINGLE_INTEGRATOR else CUBE
            size = Vector(robot.size, robot.size, robot.size)
            shapes.append(Shape("robots", agent_id, body, pose, size, self._colour(robot, state, plane.step)))
            if labelled:
                above = tilted(place._replace(z=place.z + robot.size), plane.angle)
                height = Vector(0.0, 0.0, 0.6 * self.layout.lane_width)
                shapes.append(Shape("labels", agent_id, TEXT, Pose(above, NO_TURN), height, INK, (), str(agent_id)))
        return shapes

    def _colour(self, robot: Robot, state: AgentState, step: int) -> Colour:
        if state.agent_id in self._dead or state.step + SILENT_STEPS < step:
            return GREY
        if state.status == Status.SAFE_STOP:
            return SAFE_STOP
        return KINDS.get(Kind(robot.kind), GREY)

    def _torques(self) -> list[Shape]:
        """Return the arrows of the swarm's torque, actual and wanted: they point to the end that is pushed down."""
        layout = self.layout
        shapes = []
        for number, (state, colour) in enumerate(((self._abstract, ACTUAL), (self._desired, DESIRED))):
            if state is None or not isfinite(state.torque) or state.torque == 0.0:
                continue
            length = layout.length / 2.0 * min(abs(state.torque) / self._torque_max, 1.0)
            turn = NO_TURN if state.torque > 0.0 else Quaternion(0.0, 0.0, 1.0, 0.0)
            tail = Vector(0.0, 0.0, layout.length * (0.35 + 0.06 * number))
            thick = 0.03 * layout.length
            shapes.append(Shape("torque", number, ARROW, Pose(tail, turn), Vector(length, thick, thick), colour))
        return shapes


def _newer(known: _Known | None, message: _Known) -> _Known:
    return message if known is None or message.step >= known.step else known

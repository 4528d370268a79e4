"""What is drawn of a swarm: takes its messages, gives shapes in the frame `world`. It knows neither ROS nor a clock."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, isfinite
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from swarmabs_bag.membership_timeline import Attendance, is_silent
from swarmabs_config import configure
from swarmabs_core.messages import (
    AbstractState,
    AgentState,
    Basis,
    DesiredAbstractState,
    Kind,
    PlaneState,
    Source,
    Status,
    SwarmEvent,
)
from swarmabs_view.visualization.geometry import Layout, Pose, Quaternion, Robot, Vector, tilt, tilted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Message
    from swarmabs_core.steering import OffsetReference

HISTORY = 512
"""Steps that are kept, so that what is drawn together is of one step even if a queue is read later than another."""
CLOCK = 10**17
"""Stamps beyond, ns, are those of a clock and not of steps: three years."""
MOST_CHANGES = 16
"""How often a robot is in and out that is remembered, the latest times."""
LABELLED = 50
"""More robots than these have no labels."""

CUBE, CYLINDER, ARROW, LINES, TEXT = "cube", "cylinder", "arrow", "lines", "text"
_Kept = TypeVar("_Kept", PlaneState, AbstractState, DesiredAbstractState, AgentState)

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
    """Keeps the latest messages and draws the newest step of which all is there.

    Parameters
    ----------
    layout : Layout
        What is where.
    torque_max : float
        Torque, N m, at which an arrow is as long as half the plane.
    reference : OffsetReference, optional
        Angle, rad, that the plane should have at a time, s; it gets the offsets that are announced.
    period_ns : int
        The control period, ns.
    """

    def __init__(
        self,
        layout: Layout,
        torque_max: float,
        reference: OffsetReference | None = None,
        period_ns: int = 10_000_000,
    ) -> None:
        self.layout = layout
        self._torque_max = torque_max
        self._reference = reference
        self._period_ns = period_ns
        self._begun: Basis | None = None
        self._planes: dict[int, PlaneState] = {}
        self._abstract: dict[int, AbstractState] = {}
        self._desired: dict[int, DesiredAbstractState] = {}
        self._robots: dict[int, dict[int, AgentState]] = {agent_id: {} for agent_id in layout.robots}
        self._attendance = Attendance(layout.robots, most=MOST_CHANGES)
        self._drawn: set[tuple[str, int]] = set()

    @classmethod
    def of(cls, scenario: Scenario) -> Scene:
        """Return the scene of a scenario whose robots are listed."""
        robots = [(agent.id, int(Kind[agent.kind.upper()]), agent.mass) for agent in scenario.agents]
        layout = Layout.of(scenario.plane.length, robots)
        return cls(layout, scenario.manifold.torque_max, configure.reference(scenario), scenario.step_ns)

    def hear(self, message: Message) -> None:
        """Take a message; robots that do not belong here are left out."""
        if isinstance(message, PlaneState):
            _keep(self._planes, message)
        elif isinstance(message, AbstractState):
            _keep(self._abstract, message)
        elif isinstance(message, DesiredAbstractState):
            _keep(self._desired, message)
        elif isinstance(message, AgentState):
            if message.agent_id in self._robots:
                _keep(self._robots[message.agent_id], message)
        elif isinstance(message, Basis):
            known = self._begun
            if message.source == Source.CONTROLLER and (known is None or message.step > known.step):
                self._begun = message
        elif isinstance(message, SwarmEvent):
            if self._reference is not None:
                self._reference.hear(message)
            if message.agent_id in self._robots:
                self._attendance.take(message)

    def frame(self) -> Frame | None:
        """Return what to draw now, None before the first state of the plane."""
        step = self._step()
        if step is None or not isfinite(self._planes[step].angle):
            return None
        plane = self._planes[step]
        states = self._states(step)
        places = self._places(states)
        abstract, desired = _at(self._abstract, step), _at(self._desired, step)
        shapes = (
            *self._still(plane.angle),
            *self._wanted(plane),
            *self._bodies(plane, states, places),
            *self._torques(abstract, desired),
        )
        drawn = {(shape.group, shape.number) for shape in shapes}
        gone, self._drawn = tuple(sorted(self._drawn - drawn)), drawn
        effort = None if abstract is None else -cos(plane.angle) * abstract.torque
        return Frame(step, plane.stamp, plane.angle, plane.angular_velocity, effort, shapes, gone, places)

    def _step(self) -> int | None:
        """Return the newest step of which everything is there that those who are heard now say."""
        newest = max(self._planes, default=None)
        if newest is None:
            return None
        kept: list[Mapping[int, Any]] = [self._abstract, self._desired]
        kept += [states for agent_id, states in self._robots.items() if self._attendance.out(agent_id, newest) is None]
        speaking = [said for said in kept if said and not is_silent(max(said), newest)]
        # A robot that has left has said so with its last words.
        speaking = [said for said in speaking if getattr(said[max(said)], "status", None) != Status.LEFT]
        complete = (step for step in sorted(self._planes, reverse=True) if all(step in said for said in speaking))
        return next(complete, newest)

    def _states(self, step: int) -> dict[int, AgentState]:
        """Return the robots' states of a step, or the latest ones before; of those who are out, where they stand."""
        found = {}
        for agent_id, kept in self._robots.items():
            state, out = _at(kept, step), self._attendance.out(agent_id, step)
            if state is None or (out is not None and out.status == "left"):
                continue
            found[agent_id] = state._replace(position=out.place) if out is not None else state
        return found

    def _places(self, states: dict[int, AgentState]) -> dict[int, Vector]:
        """Return where the robots are that are on the plane."""
        return {
            agent_id: self.layout.on_plane(self.layout.robots[agent_id], state.position)
            for agent_id, state in states.items()
            if state.status != Status.LEFT and isfinite(state.position)
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
        begun = 0 if self._begun is None else self._begun.begun
        # By the clock the law's time begins when the controller says.
        if self._reference is None or (self._begun is None and plane.stamp > CLOCK) or begun > plane.step:
            return ()
        wanted = self._reference((plane.step - begun) * self._period_ns / 1e9)
        if not isfinite(wanted):
            return ()
        layout = self.layout
        sides = [end for side in (-0.52, 0.52) for end in layout.lane_ends(side * layout.width)]
        pose = Pose(Vector(0.0, 0.0, 0.0), tilt(wanted))
        return (Shape("reference", 0, LINES, pose, Vector(0.1 * layout.lane_width, 0.0, 0.0), REFERENCE, tuple(sides)),)

    def _bodies(self, plane: PlaneState, states: dict[int, AgentState], places: dict[int, Vector]) -> list[Shape]:
        shapes = []
        turn = tilt(plane.angle)
        labelled = len(self.layout.robots) <= LABELLED
        for agent_id, place in places.items():
            robot, state = self.layout.robots[agent_id], states[agent_id]
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
        if self._attendance.out(state.agent_id, step) is not None or is_silent(state.step, step):
            return GREY
        if state.status == Status.SAFE_STOP:
            return SAFE_STOP
        return KINDS.get(Kind(robot.kind), GREY)

    def _torques(self, abstract: AbstractState | None, desired: DesiredAbstractState | None) -> list[Shape]:
        """Return the arrows of the swarm's torque, actual and wanted: they point to the end that is pushed down."""
        layout = self.layout
        shapes = []
        for number, (state, colour) in enumerate(((abstract, ACTUAL), (desired, DESIRED))):
            if state is None or not isfinite(state.torque) or state.torque == 0.0:
                continue
            length = layout.length / 2.0 * min(abs(state.torque) / self._torque_max, 1.0)
            turn = NO_TURN if state.torque > 0.0 else Quaternion(0.0, 0.0, 1.0, 0.0)
            tail = Vector(0.0, 0.0, layout.length * (0.35 + 0.06 * number))
            thick = 0.03 * layout.length
            shapes.append(Shape("torque", number, ARROW, Pose(tail, turn), Vector(length, thick, thick), colour))
        return shapes


def _keep(kept: dict[int, _Kept], message: _Kept) -> None:
    """Keep the first message of a step, and only so many steps."""
    kept.setdefault(message.step, message)
    if len(kept) > HISTORY:
        del kept[next(iter(kept))]


def _at(kept: dict[int, _Kept], step: int) -> _Kept | None:
    """Return the message of a step, or the latest before, or the first if there is none."""
    if step in kept:
        return kept[step]
    before = max((known for known in kept if known < step), default=None)
    return kept.get(min(kept, default=0) if before is None else before)

"""What is measured of a simulated swarm, on the plane or on another parent system."""

from __future__ import annotations

from collections import Counter
from math import hypot, inf
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_bag.run.figures import tracking_of
from swarmabs_config import configure
from swarmabs_config.scenario import PlaneScenario
from swarmabs_core.messages import (
    NEVER,
    PARENT_STATES,
    AgentState,
    AuxiliaryState,
    Kind,
    RobotState,
    SwarmAuxiliary,
    SwarmEvent,
    coordinates_of,
    vector_of,
    word,
)
from swarmabs_core.ranges import Strays, lane
from swarmabs_core.systems.law import Gram

if TYPE_CHECKING:
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import AnyParentState, AnyRobotState, Message
    from swarmabs_core.robot_controller import Limits
    from swarmabs_core.systems.interface import NamedSystem, Vector

_AT_LIMIT = 1.0 - 1e-9
"""Share of the largest speed from which on a double integrator counts as limited by it."""


class Place(NamedTuple):
    """A value with the robot and the step in which it occurs."""

    value: float = 0.0
    robot: int = 0
    step: int = 0


class _OfPlane:
    """The measures of a swarm on the plane."""

    def __init__(self, scenario: PlaneScenario) -> None:
        self._length, self._limits = scenario.plane.length, scenario.limits
        self.coordinates = lane(self._length)
        self.ordinary_speed, self.rows = self._length, 2

    @property
    def limits(self) -> bool:
        """Whether anything limits the commands of the robots."""
        limits: Limits = self._limits
        return min(limits.velocity, limits.force) < inf

    def pivot(self, sums: Message) -> float:
        """Return S3 in units of S0^2 L^2."""
        assert isinstance(sums, AuxiliaryState)  # noqa: S101 - of the plane's family
        size = sums.s0 * sums.s0 * self._length * self._length
        return sums.s3 / size if size else 0.0

    def limited(self, state: AnyRobotState) -> bool:
        """Return whether a robot's command is at a limit of its drive."""
        assert isinstance(state, AgentState)  # noqa: S101 - of the plane's family
        command, limits = abs(state.command), self._limits
        if state.kind == Kind.SINGLE_INTEGRATOR:
            return command >= limits.velocity
        return command >= limits.force or abs(state.velocity) >= _AT_LIMIT * limits.velocity

    def contribution(self, state: AnyRobotState) -> Vector:
        """Return a robot's contribution to the abstract state, in units of what a mass of 1 kg changes by 1 m."""
        assert isinstance(state, AgentState)  # noqa: S101 - of the plane's family
        moment = state.mass * state.position
        return moment, moment * state.position / (2.0 * self._length)


class _OfSystem:
    """The measures of a swarm on any other parent system."""

    def __init__(self, named: NamedSystem) -> None:
        self._system = named.instance
        self.coordinates = self._system.robot
        self.ordinary_speed, self.rows = 1.0, len(self._system.abstract)

    @property
    def limits(self) -> bool:
        """Whether the system limits the commands of robots."""
        return hasattr(self._system, "limits")

    def pivot(self, sums: Message) -> float:
        """Return the least scaled pivot of the Gram matrix in units of its largest diagonal entry."""
        assert isinstance(sums, SwarmAuxiliary)  # noqa: S101 - of this family
        return Gram(sums.gram, self._system.abstract).least

    def limited(self, state: AnyRobotState) -> bool:
        """Return whether a command of a robot is at its limit."""
        if not self.limits:
            return False
        assert isinstance(state, RobotState)  # noqa: S101 - of this family
        low, high = self._system.limits(state.constants, word(Kind(state.kind)))  # type: ignore[attr-defined]
        return any(not a < u < b for u, a, b in zip(state.command, low, high, strict=True))

    def contribution(self, state: AnyRobotState) -> Vector:
        """Return a robot's contribution to the abstract state in units of the rows' scales."""
        assert isinstance(state, RobotState)  # noqa: S101 - of this family
        values = self._system.contribution(state.coordinates, state.constants)
        return tuple(value / row.scale for value, row in zip(values, self._system.abstract, strict=True))


class Measures:
    """What is measured of the swarm of a scenario.

    Attributes
    ----------
    of : _OfPlane or _OfSystem
        The measures that depend on the parent system.
    period : float
        Control period, s.
    tracks : bool
        Whether anything of the parent follows a reference.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.of = _OfPlane(scenario) if isinstance(scenario, PlaneScenario) else _OfSystem(scenario.named)
        self.period = scenario.period
        self._reference, self._tracking = configure.reference(scenario), tracking_of(scenario)
        self.tracks = bool(self._tracking.followed)

    def steps(self, time: float) -> int:
        """Return the number of steps in a time, s."""
        return round(time / self.period)

    def errors(self, parent: AnyParentState) -> tuple[float, float]:
        """Return the parent's distance from its reference, and its largest error in units of the tolerances."""
        errors = self._tracking.errors(self._reference(parent.stamp / 1e9), vector_of(parent, "state"))
        shares = [abs(e) / tolerance for e, tolerance in zip(errors, self._tracking.tolerances, strict=True)]
        return hypot(*errors), max(shares, default=0.0)


class Watch:
    """Follows the messages of a simulation from a step on.

    Attributes
    ----------
    newest : int
        Newest step of the parent.
    speed, farthest, outside : Place
        Largest speed (of a coordinate in units of its scale, 1/s; on the plane in m/s), largest coordinate, and largest
        distance beyond the range of a coordinate, in units of its scale and negative within the range.
    beyond : tuple of Quantity and float
        The coordinate of `outside` and its value.
    pivot : float
        Smallest scaled pivot of the Gram matrix.
    deviation : float
        Largest distance of the parent from its reference.
    errors : dict of int to float
        By step, the largest error of the parent in units of its tolerances.
    robots, limited, braking : Counter of int
        By step, the number of robots, of those with a command at a limit, and of those that cannot follow the law.
    strays : Strays
        The robots that have left the ranges of their coordinates, stated or assumed.
    failure : str
        Why the simulation has ended early.
    """

    def __init__(self, measures: Measures, first: int) -> None:
        self.measures, self._of = measures, measures.of
        self.first = self.newest = first
        self.speed, self.farthest, self.outside = Place(), Place(), Place(-inf)
        self.beyond = self._of.coordinates[0], 0.0
        self.pivot, self.deviation = inf, 0.0
        self.errors: dict[int, float] = {}
        self.robots, self.limited, self.braking = Counter[int](), Counter[int](), Counter[int]()
        self.strays, self.failure = Strays(), ""
        self._known: set[int] = set()

    def __call__(self, message: Message) -> None:
        """Take the next message."""
        if message.step < self.first:
            return
        if isinstance(message, AgentState | RobotState):
            self.take(message)
        elif isinstance(message, AuxiliaryState | SwarmAuxiliary):
            self.pivot = min(self.pivot, self._of.pivot(message))
        elif isinstance(message, PARENT_STATES):
            deviation, self.errors[message.step] = self.measures.errors(message)
            self.deviation, self.newest = max(self.deviation, deviation), message.step
        elif isinstance(message, SwarmEvent):
            self.strays.hear(message, message.stamp / 1e9)

    def take(self, state: AnyRobotState) -> None:
        """Take the state of a robot."""
        robot, step = state.agent_id, state.step
        for row, value in zip(self._of.coordinates, coordinates_of(state), strict=True):
            outside = max(value - row.high, row.low - value) / row.scale
            if outside > self.outside.value:
                self.outside, self.beyond = Place(outside, robot, step), (row, value)
            self.farthest = max(self.farthest, Place(abs(value), robot, step), key=_value)
        if state.kind != Kind.FIRST_ORDER_LAG:  # its velocities are rates of what its drive puts out
            for row, value in zip(self._of.coordinates, vector_of(state, "velocities"), strict=True):
                self.speed = max(self.speed, Place(abs(value) / row.scale, robot, step), key=_value)
        self.robots[step] += 1
        self.limited[step] += state.broadcast_step != NEVER and self._of.limited(state)
        self.braking[step] += state.broadcast_step == NEVER and robot in self._known
        self._known.add(robot)

    def last(self, time: float) -> range:
        """Return the steps at the end, for a time in s, at most all."""
        return range(max(self.first, self.newest + 1 - self.measures.steps(time)), self.newest + 1)

    @property
    def limited_share(self) -> float:
        """Share of the robots' commands that are at a limit."""
        return self.limited.total() / max(1, self.robots.total())

    def at(self, place: Place) -> str:
        """Return where a value occurs, in words."""
        return f"robot {place.robot} at {place.step * self.measures.period:g} s"

    def overloaded(self, step: int) -> bool:
        """Return whether a command is at a limit while the parent is not settled, or all commands are."""
        limited = self.limited[step]
        return limited > 0 and (self.errors.get(step, 0.0) >= 1.0 or limited == self.robots[step])


def _value(place: Place) -> float:
    return place.value

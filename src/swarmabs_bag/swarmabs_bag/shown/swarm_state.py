"""The state of a swarm for display: a projection of its messages, shared by all views.

It determines for terminal, page, RViz, Foxglove and reports which robots are active, silent, dead or gone, the
positions of dead robots, the step to show, the time of the law, and the reference. It has no clock and no network, and
accepts messages in any order and with gaps.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, NamedTuple, TypeAlias, TypeVar, get_args, overload

from swarmabs_config import configure
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import (
    PLANE_FAMILY,
    SYSTEM_FAMILY,
    AbstractState,
    AgentState,
    AnyRobotState,
    Basis,
    DesiredAbstractState,
    EventKind,
    Family,
    Kind,
    Message,
    ParentState,
    PlaneState,
    Removal,
    RobotState,
    Source,
    Status,
    SwarmEvent,
    SystemDescription,
)
from swarmabs_core.systems import SystemTables

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    import numpy as np
    from numpy.typing import NDArray
    from typing_extensions import Self

    from swarmabs_config.scenario import AnyScenario
    from swarmabs_core.steering import OffsetReference

    Integers = NDArray[np.int64]
    Flags = NDArray[np.bool_]

RobotStatus: TypeAlias = Literal["active", "safe_stop", "left", "dead", "silent", "limited"]
STATUSES: tuple[RobotStatus, ...] = get_args(RobotStatus)
STATUS_NAMES: dict[int, RobotStatus] = {
    Status.ACTIVE: "active",
    Status.SAFE_STOP: "safe_stop",
    Status.LEFT: "left",
    Status.LIMITED: "limited",
}
"""The status that a robot publishes, by `AgentState.status` or `RobotState.status`."""

ShownVector: TypeAlias = tuple[float | None, ...]
"""A vector for display: unknown and non-finite values are None."""

SILENT_STEPS = 50
"""Steps without a message after which a robot, the observer or the controller counts as silent."""
MOST_EVENTS = 1000
"""Most events that are kept, the latest."""
MOST_ROBOTS = 4096
"""Most robots that are shown, so that a foreign node cannot fill the memory."""
MOST_CHANGES = 16
"""Most changes of membership kept per robot, the latest."""
PENDING = 256
"""Most incomplete steps, and most states per robot, that are kept."""
CLOCK = 10**17
"""Stamps above this, three years in ns, come from a clock and not from steps."""


class RobotIdentity(NamedTuple):
    """Constant properties of a robot: id, kind, mass (kg), damping (N s/m), and whether it is absent until it joins."""

    id: int
    kind: Kind
    mass: float | None
    damping: float | None
    joins: bool = False


class SystemIdentity(NamedTuple):
    """Constant properties of a robot on any parent system: id, kind, constants, and whether it is absent at first."""

    id: int
    kind: Kind
    constants: ShownVector
    joins: bool = False


class Out(NamedTuple):
    """Why a robot does not take part; `place` (m) is the position, or first coordinate, of a dead robot."""

    status: Literal["absent", "dead", "left"]
    place: float = 0.0


class Members(NamedTuple):
    """Ids of the robots that are commanded, and ids and places (`Out.place`) of the dead robots."""

    moving: tuple[int, ...]
    standing: tuple[tuple[int, float], ...]


class ShownRobot(NamedTuple):
    """State of a robot for display: position (m), velocity (m/s), command (m/s, double integrators N), and status.

    Unknown and non-finite values are None; all are None for a robot without a state.
    """

    position: float | None = None
    velocity: float | None = None
    command: float | None = None
    status: RobotStatus | None = None


class ShownSystemRobot(NamedTuple):
    """State of a robot on any parent system for display; empty where nothing is known.

    A dead robot has the coordinates of its last state before its death, and no command.
    """

    coordinates: ShownVector = ()
    velocities: ShownVector = ()
    command: ShownVector = ()
    status: RobotStatus | None = None


class Abstract(NamedTuple):
    """An abstract state: torque (N m) and inertia (kg m^2); None if unknown or not finite."""

    torque: float | None = None
    inertia: float | None = None


class Instant(NamedTuple):
    """State of the whole swarm in a step, for display.

    The stamp is in ns, the time in s, angle and reference in rad, the angular velocity in rad/s. The reference includes
    offsets. Unknown and non-finite values are None.
    """

    step: int
    stamp: int
    time: float
    angle: float | None
    angular_velocity: float | None
    reference: float | None
    abstract: Abstract
    desired: Abstract


class SystemInstant(NamedTuple):
    """State of a whole swarm on any parent system in a step, for display.

    The stamp is in ns, the time in s. `reference` contains the references of what the parent tracks, with offsets.
    Vectors are empty if unknown.
    """

    step: int
    stamp: int
    time: float
    parent: ShownVector
    reference: ShownVector
    abstract: ShownVector
    desired: ShownVector


AnyInstant: TypeAlias = Instant | SystemInstant
AnyShownRobot: TypeAlias = ShownRobot | ShownSystemRobot
_Identity = TypeVar("_Identity", RobotIdentity, SystemIdentity)
InstantT = TypeVar("InstantT", Instant, SystemInstant)
ShownT = TypeVar("ShownT", ShownRobot, ShownSystemRobot)


class TimedEvent(NamedTuple):
    """An event and its time, s."""

    event: SwarmEvent
    time: float


def finite(value: float) -> float | None:
    """Return a finite number, otherwise None."""
    return value if isfinite(value) else None


def finites(values: Iterable[float]) -> ShownVector:
    """Return the numbers of a vector, None for those that are not finite."""
    return tuple(map(finite, values))


@overload
def is_silent(heard: int, step: int) -> bool: ...
@overload
def is_silent(heard: Integers, step: Integers) -> Flags: ...
def is_silent(heard: int | Integers, step: int | Integers) -> bool | Flags:
    """Return whether a node last heard in step `heard` is silent in a step."""
    return step - heard > SILENT_STEPS


def shown_status(out: Out | None, state: AnyRobotState | None, step: int) -> RobotStatus | None:
    """Return the status of a robot to show in a step, from its latest state up to then."""
    if out is not None and out.status != "absent":
        return out.status
    if state is None:
        return None
    return "silent" if is_silent(state.step, step) and state.status != Status.LEFT else STATUS_NAMES.get(state.status)


def shown_robot(out: Out | None, state: AgentState | None, step: int) -> ShownRobot:
    """Return the state of a robot to show in a step: its latest one up to then, unless it no longer takes part.

    A dead robot stays at its place, whatever its process still publishes.
    """
    status = shown_status(out, state, step)
    if out is not None and status == "dead":
        return ShownRobot(finite(out.place), 0.0, None, status)
    if state is None or status == "left":
        return ShownRobot(status=status)
    return ShownRobot(finite(state.position), finite(state.velocity), finite(state.command), status)


def shown_system_robot(out: Out | None, state: RobotState | None, step: int) -> ShownSystemRobot:
    """Return the state of a robot on any parent system, as `shown_robot`; for a dead one its last state is given."""
    status = shown_status(out, state, step)
    if state is None or status == "left":
        return ShownSystemRobot(status=status)
    if status == "dead":
        return ShownSystemRobot(finites(state.coordinates), (0.0,) * len(state.coordinates), (), status)
    return ShownSystemRobot(finites(state.coordinates), finites(state.velocities), finites(state.command), status)


def instant_of(
    plane: PlaneState,
    abstract: AbstractState | None,
    desired: DesiredAbstractState | None,
    *,
    time: float,
    reference: float | None,
) -> Instant:
    """Return the state of the whole swarm from the messages of a step, its time (s) and the reference (rad)."""
    return Instant(
        plane.step,
        plane.stamp,
        time,
        finite(plane.angle),
        finite(plane.angular_velocity),
        None if reference is None else finite(reference),
        _pair(abstract),
        _pair(desired),
    )


def system_instant(parent: ParentState, abstract: Any, desired: Any, *, time: float, reference: Any) -> SystemInstant:
    """Return the same on any parent system; the reference is a vector."""
    vectors = (parent.state, reference, abstract and abstract.value, desired and desired.value)
    return SystemInstant(parent.step, parent.stamp, time, *(finites(vector or ()) for vector in vectors))


class RobotHistory:
    """States and membership of robots by step.

    Events may arrive in any order and repeatedly. Only the observer knows which robots are dead, and announces their
    return. After its end, messages of a robot change nothing, except that it leaves or joins.

    Robots listed as `absent` take part only after they join. The latest `states` and `changes` of membership are kept
    per robot; if `changes` is None, all changes of any number of robots are kept.
    """

    def __init__(
        self,
        robots: Iterable[int] = (),
        absent: Iterable[int] = (),
        *,
        states: int = PENDING,
        changes: int | None = MOST_CHANGES,
    ) -> None:
        self._robots = tuple(robots)
        self._changes: dict[int, list[tuple[int, Out | None]]] = {robot: [(-1, Out("absent"))] for robot in absent}
        self._most_changes = changes
        self._states: dict[int, list[AnyRobotState]] = {}
        self._most_states = states
        self._steps: list[int] | None = None
        self._members: dict[int, Members] = {}

    def add(self, state: AnyRobotState) -> None:
        """Process the state of a robot."""
        known = self._states.setdefault(state.agent_id, [])
        if not known or known[-1].step < state.step:
            known.append(state)
        else:
            place = bisect_left(known, state.step, key=attrgetter("step"))
            if known[place].step != state.step:
                known.insert(place, state)
        del known[: -self._most_states]

    def take(self, event: SwarmEvent) -> None:
        """Process an event; ignore those that do not change the membership, and those of too many unknown robots."""
        if event.kind == EventKind.JOINED:
            out = None
        elif event.kind == EventKind.DEAD:
            out = Out("dead", event.value)
        elif event.kind == EventKind.LEFT:
            out = Out("left")
        else:
            return
        known = event.agent_id in self._changes or event.agent_id in self._states
        if self._most_changes is not None and not known and len(self._changes) >= MOST_ROBOTS:
            return
        changes = self._changes.setdefault(event.agent_id, [])
        insort(changes, (event.step, out), key=itemgetter(0))
        if self._most_changes is not None:
            del changes[: -self._most_changes]
        self._steps = None

    def out(self, robot: int, step: int) -> Out | None:
        """Return why a robot does not take part in a step, None if it does."""
        changes = self._changes.get(robot, [])
        place = bisect_right(changes, step, key=itemgetter(0))
        return changes[place - 1][1] if place else None

    def changes(self, robot: int) -> tuple[tuple[int, Out | None], ...]:
        """Return the steps at which the membership of a robot changes, ascending; None means that it takes part."""
        return tuple(self._changes.get(robot, ()))

    def members(self, step: int) -> Members:
        """Return the robots that take part in a step, of those known in advance."""
        if self._steps is None:
            self._steps = sorted({step for known in self._changes.values() for step, _ in known})
            self._members.clear()
        place = bisect_right(self._steps, step)
        found = self._members.get(place)
        if found is None:
            outs = [(robot, self.out(robot, step)) for robot in self._robots]
            found = self._members[place] = Members(
                tuple(robot for robot, out in outs if out is None),
                tuple((robot, out.place) for robot, out in outs if out is not None and out.status == "dead"),
            )
        return found

    def last_step(self, robot: int, step: int) -> int:
        """Return the last step, up to one, in which a robot was not dead."""
        changes = self._changes.get(robot, [])
        place = bisect_right(changes, step, key=itemgetter(0))
        begun, out = changes[place - 1] if place else (0, None)
        return begun - 1 if out is not None and out.status == "dead" else step

    def latest(self, robot: int, step: int) -> Any:
        """Return the latest state of a robot up to a step, for a dead one up to its death; None if there is none."""
        known = self._states.get(robot, [])
        place = bisect_right(known, self.last_step(robot, step), key=attrgetter("step"))
        return known[place - 1] if place else None


@dataclass(slots=True)
class _Step:
    """The received messages of a step."""

    parent: Any = None
    abstract: Any = None
    desired: Any = None


class _State(Generic[_Identity, InstantT, ShownT]):
    """The current state of a swarm.

    It shows the latest step with messages of parent, observer and controller, and each robot's latest state up to it.
    If observer or controller is silent, it shows the parent's latest step without it.

    Unknown robots are added when they are first heard. Announced offsets are added to the reference. With a control
    period, times are those of the steps, independent of the clocks that stamp the messages. `version` changes with
    every message; `events` are the latest, in the order of arrival.
    """

    family: ClassVar[Family]
    _identity: ClassVar[Callable[..., Any]]
    _instant_of: ClassVar[Callable[..., Any]]
    _robot: ClassVar[Callable[..., Any]]

    def __init__(
        self,
        robots: Sequence[_Identity] = (),
        *,
        reference: OffsetReference | None = None,
        period_ns: int | None = None,
    ) -> None:
        self.robots: list[_Identity] = list(robots)
        self.version = 0
        self.events: list[TimedEvent] = []
        self.event_count = 0
        self._ids = {robot.id for robot in robots}
        self._history = RobotHistory([robot.id for robot in robots], [robot.id for robot in robots if robot.joins])
        self._reference = reference
        self._period_ns = period_ns
        self._begun: Basis | None = None
        self._first_stamp: int | None = None
        self._known_events: dict[tuple[int, int, int, str], None] = {}
        self._parent: Any = None
        self._shown = _Step()
        self._steps: dict[int, _Step] = {}

    @classmethod
    def of(cls, scenario: AnyScenario) -> Self:
        """Return the initial state of a scenario's swarm; its robots must be listed."""
        there = {agent.id for agent in scenario.initial_agents}
        configs = configure.agent_configs(scenario)
        robots = [cls._identity(config, joins=config.agent_id not in there) for config in configs]
        return cls(robots, reference=configure.reference(scenario), period_ns=scenario.step_ns)

    @property
    def step(self) -> int | None:
        """The latest step of the parent, None before its first message."""
        return None if self._parent is None else int(self._parent.step)

    def add(self, message: Message) -> InstantT | None:
        """Process a message, and return the step that it completes, if any.

        Outdated messages change nothing.
        """
        self.version += 1
        if isinstance(message, self.family.robot.message):
            self._hear(message)
        elif isinstance(message, SwarmEvent) and not isinstance(message, Removal):  # its effect is announced
            self._record_event(message)
        elif isinstance(message, Basis):
            if message.source == Source.CONTROLLER and _newer(message, self._begun):
                self._begun = message
        elif isinstance(message, self.family.parent.message):
            if _newer(message, self._parent):
                self._parent = message
            self._pending(message.step).parent = message
            return self._complete(message.step)
        elif isinstance(message, self.family.abstract.message):
            self._pending(message.step).abstract = message
            return self._complete(message.step)
        elif isinstance(message, self.family.desired.message):
            self._pending(message.step).desired = message
            return self._complete(message.step)
        return None

    def instant(self) -> InstantT | None:
        """Return the step to show, None before the first message of the parent."""
        if self._parent is None:
            return None
        shown = self._shown
        if shown.parent is None or is_silent(shown.parent.step, self._parent.step):
            shown = self._steps.get(self._parent.step, _Step())
        return self._instant(shown.parent or self._parent, shown)

    def shown_robots(self, step: int) -> list[ShownT]:
        """Return the states of all robots to show in a step, in order."""
        history, ids = self._history, [robot.id for robot in self.robots]
        return [self._robot(history.out(robot, step), history.latest(robot, step), step) for robot in ids]

    def members(self) -> Members:
        """Return the robots that take part in the step shown, of those known in advance."""
        instant = self.instant()
        return self._history.members(0 if instant is None else instant.step)

    def _hear(self, state: Any) -> None:
        if state.agent_id not in self._ids:
            if len(self.robots) >= MOST_ROBOTS:
                return
            self._ids.add(state.agent_id)
            insort(self.robots, self._identity(state), key=lambda robot: robot.id)
        self._history.add(state)

    def _record_event(self, event: SwarmEvent) -> None:
        key = (event.step, event.agent_id, event.kind, event.detail)
        if key in self._known_events:  # events may arrive repeatedly
            return
        self._known_events[key] = None
        if len(self._known_events) > 4 * MOST_EVENTS:
            del self._known_events[next(iter(self._known_events))]
        self.events.append(TimedEvent(event, self._time(event)))
        del self.events[:-MOST_EVENTS]
        self.event_count += 1
        if self._reference is not None:
            self._reference.hear(event)
        self._history.take(event)

    def _pending(self, step: int) -> _Step:
        found = self._steps.get(step)
        if found is None:
            found = self._steps[step] = _Step()
            if len(self._steps) > PENDING:
                del self._steps[min(self._steps)]
        return found

    def _complete(self, step: int) -> InstantT | None:
        """Return a step if it is complete, and drop those before it."""
        found = self._steps.get(step, _Step())
        if found.parent is None or found.abstract is None or found.desired is None:
            return None
        if _newer(found.parent, self._shown.parent):
            self._shown = found
        for earlier in [one for one in self._steps if one <= step]:
            del self._steps[earlier]
        return self._instant(found.parent, found)

    def _instant(self, parent: Any, found: _Step) -> InstantT:
        time, reference = self._time(parent), self._reference_at(parent)
        made: InstantT = self._instant_of(parent, found.abstract, found.desired, time=time, reference=reference)
        return made

    def _time(self, message: Message) -> float:
        """Return the time of a message's step, s; without a period its stamp, relative to the first if from a clock."""
        if self._period_ns is not None:
            return message.step * self._period_ns / 1e9
        if self._first_stamp is None:
            self._first_stamp = message.stamp
        return (message.stamp - (self._first_stamp if self._first_stamp > CLOCK else 0)) / 1e9

    def _reference_at(self, parent: Any) -> Any:
        """Return the reference at a step, rad; in real time the controller announces when its law's time begins."""
        if self._reference is None or (self._begun is None and parent.stamp > CLOCK):
            return None
        begun = 0 if self._begun is None else self._begun.begun
        if begun > parent.step:
            return None
        return self._reference(self._time(parent._replace(step=parent.step - begun)))


def _identity(robot: Any, *, joins: bool = False) -> RobotIdentity:
    kind = Kind.DOUBLE_INTEGRATOR if robot.kind == Kind.DOUBLE_INTEGRATOR else Kind.SINGLE_INTEGRATOR
    return RobotIdentity(robot.agent_id, kind, finite(robot.mass), finite(robot.damping), joins)


def _system_identity(robot: Any, *, joins: bool = False) -> SystemIdentity:
    kind = robot.kind if robot.kind in set(Kind) else Kind.SINGLE_INTEGRATOR
    return SystemIdentity(robot.agent_id, Kind(kind), finites(robot.constants), joins)


class SwarmState(_State[RobotIdentity, Instant, ShownRobot]):
    """The current state of a swarm on the plane."""

    family = PLANE_FAMILY
    _identity = staticmethod(_identity)
    _instant_of = staticmethod(instant_of)
    _robot = staticmethod(shown_robot)


class SystemSwarmState(_State[SystemIdentity, SystemInstant, ShownSystemRobot]):
    """The current state of a swarm on any parent system.

    `tables` name its numbers, once they are known from the scenario or a message.
    """

    family = SYSTEM_FAMILY
    tables: SystemTables | None = None
    _identity = staticmethod(_system_identity)
    _instant_of = staticmethod(system_instant)
    _robot = staticmethod(shown_system_robot)

    @classmethod
    def of(cls, scenario: Any) -> Self:
        """Return the initial state of a scenario's swarm."""
        found = super().of(scenario)
        found.tables = SystemTables.read(scenario.named.description)
        return found

    def add(self, message: Message) -> SystemInstant | None:
        """Process a message, and return the step that it completes, if any."""
        if isinstance(message, SystemDescription):
            with suppress(MalformedMessageError):
                self.tables = SystemTables.read(message.description)
        return super().add(message)


def state_of(scenario: AnyScenario) -> SwarmState | SystemSwarmState:
    """Return the initial state of a scenario's swarm, of either family; its robots must be listed."""
    return SwarmState.of(scenario) if scenario.family is PLANE_FAMILY else SystemSwarmState.of(scenario)


def _newer(message: Message, known: Message | None) -> bool:
    return known is None or message.step > known.step


def _pair(state: AbstractState | DesiredAbstractState | None) -> Abstract:
    return Abstract() if state is None else Abstract(finite(state.torque), finite(state.inertia))

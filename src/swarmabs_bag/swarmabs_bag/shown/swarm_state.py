"""The state of a swarm for display: a projection of its messages, shared by all views.

It determines for terminal, page, RViz, Foxglove and reports which robots are active, silent, dead or gone, the
positions of dead robots, the step to show, the time of the law, and the reference. It has no clock and no network, and
accepts messages in any order and with gaps.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from dataclasses import dataclass, field
from math import isfinite, nan
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias, get_args, overload

from swarmabs_config import configure
from swarmabs_core.messages import (
    ABSTRACT_STATES,
    DESIRED_STATES,
    FAMILIES,
    PARENT_STATES,
    PLANE_FAMILY,
    ROBOT_STATES,
    SYSTEM_FAMILY,
    AnyRobotState,
    Basis,
    EventKind,
    Family,
    Field,
    Kind,
    Message,
    Removal,
    Source,
    Status,
    SwarmEvent,
    Topic,
    fields_of,
    vector_of,
)
from swarmabs_core.systems import PLANE_TABLES, Quantity

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy as np
    from numpy.typing import NDArray
    from typing_extensions import Self

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import (
        AbstractState,
        AnyParentState,
        DesiredAbstractState,
        SwarmAbstract,
        SwarmDesired,
    )
    from swarmabs_core.steering import OffsetReference
    from swarmabs_core.systems import SystemTables, Vector

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
    """Constant properties of a robot: id, kind, constants by the table, and whether it is absent until it joins."""

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
    """State of a robot for display, its vectors by the tables of the parent system; empty where nothing is known.

    A dead robot has no command. It stays at the first coordinate of its event, with the others of its last state.
    """

    coordinates: ShownVector = ()
    velocities: ShownVector = ()
    command: ShownVector = ()
    status: RobotStatus | None = None


class Instant(NamedTuple):
    """State of the whole swarm in a step, for display, its vectors by the tables of the parent system.

    The stamp is in ns, the time in s. `reference` contains the references of what the parent tracks, with offsets,
    `further` the `further_numbers`. Vectors are empty if unknown.
    """

    step: int
    stamp: int
    time: float
    parent: ShownVector
    reference: ShownVector
    abstract: ShownVector
    desired: ShownVector
    further: ShownVector = ()


class FurtherNumber(NamedTuple):
    """A number on a further topic of the swarm: the field of its messages, and how views name it."""

    topic: Topic
    field: str
    quantity: Quantity


def family_of(tables: SystemTables) -> Family:
    """Return the topics of a swarm on the parent system with these tables."""
    return PLANE_FAMILY if tables is PLANE_TABLES else SYSTEM_FAMILY


def further_numbers(family: Family) -> tuple[FurtherNumber, ...]:
    """Return the numbers on the further topics of a family, named after topic and field, such as ``effort_power``."""
    return tuple(
        FurtherNumber(topic, name, Quantity(f"{topic.name.rpartition('/')[2]}_{name}", declared.unit))
        for topic in family.further
        for name, declared in fields_of(topic.message).items()
        if isinstance(declared, Field) and declared.ros_type == "float64"
    )


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


def shown_robot(out: Out | None, state: AnyRobotState | None, step: int) -> ShownRobot:
    """Return the state of a robot to show in a step: its latest one up to then, unless it no longer takes part.

    A dead robot stays at its place, whatever its process still publishes.
    """
    status = shown_status(out, state, step)
    if out is not None and status == "dead":
        place = (out.place, *(() if state is None else vector_of(state, "coordinates")[1:]))
        return ShownRobot(finites(place), (0.0,) * len(place), (), status)
    if state is None or status == "left":
        return ShownRobot(status=status)
    coordinates, velocities, command = (
        finites(vector_of(state, name)) for name in ("coordinates", "velocities", "command")
    )
    return ShownRobot(coordinates, velocities, command, status)


def instant_of(
    parent: AnyParentState,
    abstract: Message | None,
    desired: Message | None,
    *,
    time: float,
    reference: Vector,
    further: Vector = (),
) -> Instant:
    """Return the state of the whole swarm from the messages of a step, its time (s), what is tracked, and `further`."""
    sums = (() if message is None else vector_of(message, "value") for message in (abstract, desired))
    vectors = (vector_of(parent, "state"), reference, *sums, further)
    return Instant(parent.step, parent.stamp, time, *map(finites, vectors))


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
        states = self._states.setdefault(state.agent_id, [])
        if not states or states[-1].step < state.step:
            states.append(state)
        else:
            place = bisect_left(states, state.step, key=attrgetter("step"))
            if states[place].step != state.step:
                states.insert(place, state)
        del states[: -self._most_states]

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
        heard = event.agent_id in self._changes or event.agent_id in self._states
        if self._most_changes is not None and not heard and len(self._changes) >= MOST_ROBOTS:
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
            self._steps = sorted({step for changes in self._changes.values() for step, _ in changes})
            self._members.clear()
        place = bisect_right(self._steps, step)
        members = self._members.get(place)
        if members is None:
            outs = [(robot, self.out(robot, step)) for robot in self._robots]
            members = self._members[place] = Members(
                tuple(robot for robot, out in outs if out is None),
                tuple((robot, out.place) for robot, out in outs if out is not None and out.status == "dead"),
            )
        return members

    def last_step(self, robot: int, step: int) -> int:
        """Return the last step, up to one, in which a robot was not dead."""
        changes = self._changes.get(robot, [])
        place = bisect_right(changes, step, key=itemgetter(0))
        begun, out = changes[place - 1] if place else (0, None)
        return begun - 1 if out is not None and out.status == "dead" else step

    def latest(self, robot: int, step: int) -> AnyRobotState | None:
        """Return the latest state of a robot up to a step, for a dead one up to its death; None if there is none."""
        states = self._states.get(robot, [])
        place = bisect_right(states, self.last_step(robot, step), key=attrgetter("step"))
        return states[place - 1] if place else None


@dataclass(slots=True)
class _Step:
    """The received messages of a step."""

    parent: AnyParentState | None = None
    abstract: AbstractState | SwarmAbstract | None = None
    desired: DesiredAbstractState | SwarmDesired | None = None
    further: dict[type[Message], Message] = field(default_factory=dict)


class SwarmState:
    """The current state of a swarm on the parent system with these tables.

    It shows the latest step with messages of parent, observer and controller, and each robot's latest state up to it.
    If observer or controller is silent, it shows the parent's latest step without it, until a step is complete that is
    not earlier: what is shown never goes back.

    Unknown robots are added when they are first heard. Announced offsets are added to the reference. With a control
    period, times are those of the steps, independent of the clocks that stamp the messages. `version` changes with
    every message; `events` are the latest, in the order of arrival.
    """

    def __init__(
        self,
        robots: Sequence[RobotIdentity] = (),
        *,
        tables: SystemTables = PLANE_TABLES,
        reference: OffsetReference | None = None,
        period_ns: int | None = None,
    ) -> None:
        self.tables = tables
        self.robots: list[RobotIdentity] = list(robots)
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
        family = family_of(tables)
        self._further = further_numbers(family)
        self._further_messages = tuple(topic.message for topic in family.further)
        self._foreign = tuple(topic.message for other in FAMILIES if other is not family for topic in other.main)
        self._parent: AnyParentState | None = None
        self._shown = _Step()
        self._least = 0  # the step that was last shown without observer or controller
        self._steps: dict[int, _Step] = {}

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Return the initial state of a scenario's swarm; its robots must be listed."""
        there = {agent.id for agent in scenario.initial_agents}
        reference = configure.reference(scenario)
        robots = [
            RobotIdentity(robot.agent_id, robot.kind, finites(robot.constants), robot.agent_id not in there)
            for robot in configure.agent_configs(scenario)
        ]
        return cls(robots, tables=scenario.tables, reference=reference, period_ns=scenario.step_ns)

    @property
    def step(self) -> int | None:
        """The latest step of the parent, None before its first message."""
        return None if self._parent is None else self._parent.step

    def add(self, message: Message) -> Instant | None:
        """Process a message, and return the step that it completes, if any.

        Outdated messages, and those of another family, change nothing.
        """
        self.version += 1
        if isinstance(message, self._foreign):
            return None
        if isinstance(message, ROBOT_STATES):
            self._hear(message)
        elif isinstance(message, SwarmEvent) and not isinstance(message, Removal):  # its effect is announced
            self._record_event(message)
        elif isinstance(message, Basis):
            if message.source == Source.CONTROLLER and _newer(message, self._begun):
                self._begun = message
        elif isinstance(message, PARENT_STATES):
            if _newer(message, self._parent):
                self._parent = message
            self._pending(message.step).parent = message
            return self._complete(message.step)
        elif isinstance(message, ABSTRACT_STATES):
            self._pending(message.step).abstract = message
            return self._complete(message.step)
        elif isinstance(message, DESIRED_STATES):
            self._pending(message.step).desired = message
            return self._complete(message.step)
        elif isinstance(message, self._further_messages):
            self._pending(message.step).further[type(message)] = message
        return None

    def instant(self) -> Instant | None:
        """Return the step to show, None before the first message of the parent."""
        if self._parent is None:
            return None
        shown, newest = self._shown, self._parent.step
        if shown.parent is None or shown.parent.step < self._least or is_silent(shown.parent.step, newest):
            shown, self._least = self._steps.get(newest, _Step()), newest
        return self._instant(shown.parent or self._parent, shown)

    def shown_robots(self, step: int) -> list[ShownRobot]:
        """Return the states of all robots to show in a step, in order."""
        history, ids = self._history, [robot.id for robot in self.robots]
        return [shown_robot(history.out(robot, step), history.latest(robot, step), step) for robot in ids]

    def members(self) -> Members:
        """Return the robots that take part in the step shown, of those known in advance."""
        instant = self.instant()
        return self._history.members(0 if instant is None else instant.step)

    def _hear(self, state: AnyRobotState) -> None:
        if state.agent_id not in self._ids:
            if len(self.robots) >= MOST_ROBOTS:
                return
            self._ids.add(state.agent_id)
            kind = Kind(state.kind) if state.kind in set(Kind) else Kind.SINGLE_INTEGRATOR
            robot = RobotIdentity(state.agent_id, kind, finites(vector_of(state, "constants")))
            insort(self.robots, robot, key=attrgetter("id"))
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
        pending = self._steps.get(step)
        if pending is None:
            pending = self._steps[step] = _Step()
            if len(self._steps) > PENDING:
                del self._steps[min(self._steps)]
        return pending

    def _complete(self, step: int) -> Instant | None:
        """Return a step if it is complete, and drop those before it."""
        messages = self._steps.get(step, _Step())
        if messages.parent is None or messages.abstract is None or messages.desired is None:
            return None
        if _newer(messages.parent, self._shown.parent):
            self._shown = messages
        for earlier in [one for one in self._steps if one <= step]:
            del self._steps[earlier]
        return self._instant(messages.parent, messages)

    def _instant(self, parent: AnyParentState, messages: _Step) -> Instant:
        time, reference = self._time(parent), self._reference_at(parent)
        said = [(messages.further.get(topic.message), name) for topic, name, _ in self._further]
        further = tuple(nan if message is None else getattr(message, name) for message, name in said)
        return instant_of(parent, messages.abstract, messages.desired, time=time, reference=reference, further=further)

    def _time(self, message: Message) -> float:
        """Return the time of a message's step, s; without a period its stamp, relative to the first if from a clock."""
        if self._period_ns is not None:
            return message.step * self._period_ns / 1e9
        if self._first_stamp is None:
            self._first_stamp = message.stamp
        return (message.stamp - (self._first_stamp if self._first_stamp > CLOCK else 0)) / 1e9

    def _reference_at(self, parent: AnyParentState) -> Vector:
        """Return the reference at a step; in real time the controller announces when its law's time begins."""
        if self._reference is None or (self._begun is None and parent.stamp > CLOCK):
            return ()
        begun = 0 if self._begun is None else self._begun.begun
        if begun > parent.step:
            return ()
        reference = self._reference(self._time(parent._replace(step=parent.step - begun)))
        return reference if isinstance(reference, tuple) else (reference,)


def _newer(message: Message, latest: Message | None) -> bool:
    return latest is None or message.step > latest.step

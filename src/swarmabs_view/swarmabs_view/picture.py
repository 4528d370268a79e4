"""The state of what is shown of a swarm that goes on: takes its messages, in any order and with gaps, gives frames.

It has no clock and no network. Whoever reads the messages may lose any number of them: the picture is then that of
the latest step of which plane, observer and controller were heard, with each robot as it was last heard up to then.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_bag.membership_timeline import Attendance, is_silent
from swarmabs_core.messages import (
    AbstractState,
    AgentState,
    Basis,
    DesiredAbstractState,
    EventKind,
    Kind,
    Message,
    PlaneState,
    Source,
    Status,
    SwarmEvent,
)
from swarmabs_view.curves import CurveBuffer, Point
from swarmabs_view.facts import finite
from swarmabs_view.protocol import Abstract, Event, Frame, Robot, RobotStates, RobotStatus

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_bag.membership_timeline import Members, Out
    from swarmabs_core.steering import OffsetReference

MOST_EVENTS = 1000
"""Events that are kept, the latest."""
MOST_ROBOTS = 4096
"""Robots that are shown; a stranger in the network cannot fill the memory."""
PENDING = 256
"""Steps that wait for the rest of their messages, and states of a robot that wait for the step that is shown."""

MOST_CHANGES = 16
"""How often a robot is in and out that is remembered, the latest times."""

STALE = 1000
"""Steps after which the plane is shown alone, if observer or controller are not heard any more."""
CLOCK = 10**17
"""Stamps beyond, ns, are those of a clock and not of steps: three years."""

_STATUS: dict[int, RobotStatus] = {Status.ACTIVE: "active", Status.SAFE_STOP: "safe_stop", Status.LEFT: "left"}


class Seen(NamedTuple):
    """What is shown of a robot: position (m), velocity (m/s), command (m/s, of double integrators N), and status."""

    position: float | None = None
    velocity: float | None = None
    command: float | None = None
    status: RobotStatus | None = None


def seen(out: Out | None, said: Seen, status: int | None, *, silent: bool) -> Seen:
    """Return what is shown of a robot: what it has said, unless it is out.

    Parameters
    ----------
    out : Out, optional
        How it is out: a dead one stands still at its place, whatever its process goes on saying.
    said : Seen
        What it has said last.
    status : int, optional
        Its status then, as in `AgentState`; None if it was never heard.
    silent : bool
        Whether that was too long ago.
    """
    if out is not None and out.status == "dead":
        return Seen(finite(out.place), 0.0, None, "dead")
    if (out is not None and out.status == "left") or status == Status.LEFT:
        return Seen(status="left")
    if status is None:
        return said
    return said._replace(status="silent" if silent else _STATUS.get(status))


def robot_states(robots: Sequence[Seen]) -> RobotStates:
    """Return what is shown of all robots, in their order."""
    return RobotStates(
        position=[robot.position for robot in robots],
        velocity=[robot.velocity for robot in robots],
        command=[robot.command for robot in robots],
        status=[robot.status for robot in robots],
    )


def event_of(event: SwarmEvent, time: float) -> Event:
    """Return an event as the page shows it, at a time (s)."""
    known = {kind.value: kind.name for kind in EventKind}
    return Event(
        step=event.step,
        time=time,
        agent=event.agent_id,
        kind=known.get(event.kind, str(event.kind)),
        value=finite(event.value),
        detail=event.detail,
    )


def event_key(event: SwarmEvent) -> tuple[int, int, int, str]:
    """Return what tells events apart; the same one may come more than once."""
    return event.step, event.agent_id, event.kind, event.detail


def robot_of(state: AgentState) -> Robot:
    """Return what does not change of a robot."""
    return Robot(
        id=state.agent_id,
        kind="double_integrator" if state.kind == Kind.DOUBLE_INTEGRATOR else "single_integrator",
        mass=finite(state.mass),
        damping=finite(state.damping),
    )


@dataclass(slots=True)
class _Step:
    """What has come of a step."""

    plane: PlaneState | None = None
    abstract: AbstractState | None = None
    desired: DesiredAbstractState | None = None


class Picture:
    """What is known of a swarm now.

    Parameters
    ----------
    robots : sequence of Robot
        Those that are known beforehand; others are added when they are heard.
    reference : OffsetReference, optional
        The angle wanted (rad) at a time (s) of the law; it gets the offsets that are announced.
    period_ns : int, optional
        The control period, ns. Times are then those of the steps, whatever the clocks say that stamp the messages.

    Attributes
    ----------
    robots : list of Robot
        In the order of the frames, by id where they were not known beforehand.
    curves : CurveBuffer
        The curves so far.
    events : list of Event
        The latest events, in the order of their arrival.
    event_count : int
        How many there were in all.
    version : int
        Changes with everything that comes.
    """

    def __init__(
        self,
        robots: Sequence[Robot] = (),
        *,
        reference: OffsetReference | None = None,
        period_ns: int | None = None,
    ) -> None:
        self.robots = list(robots)
        self.curves = CurveBuffer()
        self.events: list[Event] = []
        self.event_count = 0
        self.version = 0
        self._reference = reference
        self._period_ns = period_ns
        self._begun: Basis | None = None
        self._first_stamp: int | None = None
        self._states: dict[int, list[AgentState]] = {}
        known = [robot.id for robot in robots]
        absent = [robot.id for robot in robots if robot.joins]
        self._attendance = Attendance(known, absent, most=MOST_CHANGES)
        self._known_events: dict[tuple[int, int, int, str], None] = {}
        self._known = set(known)
        self._latest = _Step()
        self._shown = _Step()
        self._steps: dict[int, _Step] = {}

    @property
    def step(self) -> int | None:
        """The latest step of the plane that was heard, None before the first."""
        return None if self._latest.plane is None else self._latest.plane.step

    def add(self, message: Message) -> None:
        """Take a message; one that is older than what is known changes nothing."""
        self.version += 1
        if isinstance(message, AgentState):
            self._agent(message)
        elif isinstance(message, SwarmEvent):
            self._event(message)
        elif isinstance(message, Basis):
            if message.source == Source.CONTROLLER and _newer(message, self._begun):
                self._begun = message
        elif isinstance(message, PlaneState):
            if _newer(message, self._latest.plane):
                self._latest.plane = message
            self._pending(message.step).plane = message
            self._draw(message.step)
        elif isinstance(message, AbstractState):
            if _newer(message, self._latest.abstract):
                self._latest.abstract = message
            self._pending(message.step).abstract = message
            self._draw(message.step)
        elif isinstance(message, DesiredAbstractState):
            if _newer(message, self._latest.desired):
                self._latest.desired = message
            self._pending(message.step).desired = message
            self._draw(message.step)

    def frame(self, step_rate: float | None) -> Frame | None:
        """Return what is to be seen, None before the plane was heard."""
        plane, abstract, desired = self._current()
        if plane is None:
            return None
        time = self._time(plane)
        robots = [self._seen(robot.id, plane.step) for robot in self.robots]
        return Frame(
            step=plane.step,
            time=time,
            angle=finite(plane.angle),
            angular_velocity=finite(plane.angular_velocity),
            reference=self._wanted(plane),
            abstract=_pair(abstract),
            desired=_pair(desired),
            robots=robot_states(robots),
            step_rate=step_rate,
        )

    def members(self) -> Members:
        """Return who takes part in the step that is to be seen, of the robots that were known beforehand."""
        plane, _, _ = self._current()
        return self._attendance.members(0 if plane is None else plane.step)

    def _current(self) -> tuple[PlaneState | None, AbstractState | None, DesiredAbstractState | None]:
        """Return what is known of the step that is to be seen; no plane before it was heard."""
        latest, shown = self._latest, self._shown
        if latest.plane is None:
            return None, None, None
        if shown.plane is None or shown.plane.step + STALE < latest.plane.step:  # somebody says nothing any more
            shown = self._steps.get(latest.plane.step, _Step())
        return shown.plane or latest.plane, shown.abstract, shown.desired

    def _agent(self, state: AgentState) -> None:
        if state.agent_id not in self._known:
            if len(self.robots) >= MOST_ROBOTS:
                return
            self._known.add(state.agent_id)
            insort(self.robots, robot_of(state), key=lambda robot: robot.id)
        known = self._states.setdefault(state.agent_id, [])
        place = bisect_left(known, state.step, key=lambda one: one.step)
        if place == len(known) or known[place].step != state.step:
            known.insert(place, state)
            del known[:-PENDING]

    def _state(self, robot: int, step: int) -> AgentState | None:
        """Return the last state of a robot up to a step."""
        known = self._states.get(robot, [])
        place = bisect_right(known, step, key=lambda one: one.step)
        return known[place - 1] if place else None

    def _event(self, event: SwarmEvent) -> None:
        key = event_key(event)
        if key in self._known_events:
            return
        self._known_events[key] = None
        if len(self._known_events) > 4 * MOST_EVENTS:
            del self._known_events[next(iter(self._known_events))]
        self.events.append(event_of(event, self._time(event)))
        self.event_count += 1
        del self.events[:-MOST_EVENTS]
        if self._reference is not None:
            self._reference.hear(event)
        if event.agent_id in self._known or len(self._attendance) < MOST_ROBOTS:
            self._attendance.take(event)

    def _seen(self, robot: int, step: int) -> Seen:
        """Return what is shown of a robot: what it has said, unless it is out."""
        out, state = self._attendance.out(robot, step), self._state(robot, step)
        if state is None:
            return seen(out, Seen(), None, silent=False)
        said = Seen(finite(state.position), finite(state.velocity), finite(state.command))
        return seen(out, said, state.status, silent=is_silent(state.step, step))

    def _pending(self, step: int) -> _Step:
        found = self._steps.get(step)
        if found is None:
            found = self._steps[step] = _Step()
            if len(self._steps) > PENDING:
                del self._steps[min(self._steps)]
        return found

    def _draw(self, step: int) -> None:
        """Make a step that is complete a point of the curves; those before it will not come any more."""
        found = self._steps.get(step, _Step())
        plane, abstract, desired = found.plane, found.abstract, found.desired
        if plane is None or abstract is None or desired is None:
            return
        if _newer(plane, self._shown.plane):
            self._shown = found
        self.curves.add(
            Point(
                step,
                self._time(plane),
                finite(plane.angle),
                self._wanted(plane),
                finite(abstract.torque),
                finite(desired.torque),
                finite(abstract.inertia),
                finite(desired.inertia),
            )
        )
        for earlier in [one for one in self._steps if one <= step]:
            del self._steps[earlier]

    def _time(self, message: Message) -> float:
        """Return the time of a message's step, s; without a period by its stamp, of a clock since the first one."""
        if self._period_ns is not None:
            return message.step * self._period_ns / 1e9
        if self._first_stamp is None:
            self._first_stamp = message.stamp
        return (message.stamp - (self._first_stamp if self._first_stamp > CLOCK else 0)) / 1e9

    def _wanted(self, plane: PlaneState) -> float | None:
        """Return the angle wanted at a step, rad; by the clock the law's time begins when the controller says."""
        if self._reference is None or (self._begun is None and plane.stamp > CLOCK):
            return None
        begun = 0 if self._begun is None else self._begun.begun
        if begun > plane.step:
            return None
        return finite(self._reference(self._time(plane._replace(step=plane.step - begun))))


def _newer(message: Message, known: Message | None) -> bool:
    return known is None or message.step > known.step


def _pair(state: AbstractState | DesiredAbstractState | None) -> Abstract:
    if state is None:
        return Abstract(torque=None, inertia=None)
    return Abstract(torque=finite(state.torque), inertia=finite(state.inertia))

"""The abstraction observer: the robots' states in, abstract and auxiliary state of the swarm out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from swarmabs_core.abstraction import Weight, divided_load, observed
from swarmabs_core.behaviours.base import (
    Gathering,
    Run,
    UnexpectedMessageError,
    at_rest,
    is_new,
    place_of,
    refuse_other_system,
)
from swarmabs_core.declaration import same, setting
from swarmabs_core.errors import InStep, RunError
from swarmabs_core.membership import Change, Membership
from swarmabs_core.messages import (
    PLANE_FAMILY,
    PLANE_STATE,
    ROBOT_STATES,
    AbstractState,
    AgentState,
    AnyRobotState,
    EventKind,
    Family,
    Message,
    Messages,
    PlaneState,
    StandingState,
    Status,
    Steering,
    SwarmEvent,
    Topic,
)
from swarmabs_core.parent_response import ParentResponse, TorqueEstimator
from swarmabs_core.plant import Friction, Plane
from swarmabs_core.steering import change_of
from swarmabs_core.swarm_law import SwarmGains

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


@dataclass(frozen=True, slots=True)
class ObserverConfig:
    """Configuration of the observer, including the properties of the plane that its torque estimate requires."""

    members: tuple[int, ...] = same(Run, "members")
    period_ns: int = same(Run, "period_ns")
    gravity: float = same(Plane, "gravity")
    ksd: float = same(SwarmGains, "ksd")
    schedule: tuple[Change, ...] = same(Run, "schedule")
    last_step: int | None = same(Run, "last_step")
    division: int = same(Run, "division")
    type: str = setting(
        "sum",
        "source of the torque: the sum over the robots, or the plane's motion",
        choices=("sum", "parent_response"),
    )
    inertia: float = same(Plane, "inertia")
    friction: Friction = same(Plane, "friction")
    bandwidth: float = same(ParentResponse, "bandwidth")

    family: ClassVar[Family] = PLANE_FAMILY
    system_hash: ClassVar[None] = None

    @property
    def watches_plane(self) -> bool:
        """Whether the torque is estimated from the plane's motion."""
        return self.type == ParentResponse.type

    def estimator(self) -> TorqueEstimator | None:
        """Return the estimator of the torque, if it is estimated."""
        if not self.watches_plane:
            return None
        return TorqueEstimator(self.inertia, self.friction, self.bandwidth, self.period_ns / 1e9)

    def observed(
        self, stamp: int, step: int, moving: Sequence[AnyRobotState], standing: Iterable[AnyRobotState]
    ) -> Messages:
        """Return abstract and auxiliary state at a step, with a time stamp (ns)."""
        robots = [s for s in (*moving, *standing) if isinstance(s, AgentState)]
        followers = [s for s in moving if isinstance(s, AgentState) and s.status == Status.ACTIVE]
        weights = [Weight(s.mass, s.position, s.velocity) for s in robots]
        return observed(stamp, step, weights, followers, self.gravity, self.ksd)

    def divided(self, stamp: int, step: int, robots: Iterable[AnyRobotState]) -> StandingState:
        """Return how the abstract state divides at a step, with a time stamp (ns)."""
        return divided_load(stamp, step, robots, self.gravity)


class Observer:
    """Sums up the swarm once the states of all members of a step have arrived. It alone decides on membership.

    With the disturbance-observer estimate of the torque, inertia, sums and membership still come from the robots.

    Parameters
    ----------
    config : ObserverConfig or SystemObserverConfig
        Configuration, which determines the parent system.
    """

    _gatherer: ClassVar[type[Gathering]] = Gathering

    def __init__(self, config: Any) -> None:
        self._config = config
        self._system: int | None = config.system_hash
        self._estimator = config.estimator()
        self._plane: PlaneState | None = None
        self._announced = -1
        self._membership = Membership(config.members, config.schedule)
        self._gathering = self._gatherer(self._membership)
        self._previous: Iterable[AnyRobotState] = ()
        self._standing: dict[int, AnyRobotState] = {}

    def start(self) -> Messages:
        """Publish nothing: the robots start."""
        return ()

    @property
    def step(self) -> int:
        """The step that is summed up next."""
        return self._gathering.step

    @property
    def standing(self) -> tuple[AnyRobotState, ...]:
        """The robots that are assumed at rest."""
        return tuple(self._standing.values())

    def resume(self, states: Sequence[AnyRobotState]) -> None:
        """Continue after a step, given by its states, since whose predecessors the membership has not changed."""
        self._previous = states
        self._announced = states[0].step
        self._gathering.resume(self._announced + 1)

    def handle(self, message: Message) -> Messages:
        """Take a robot's state; return events, abstract and auxiliary state when a step is complete.

        If the torque is estimated from the plane's motion, the plane's state is awaited, too.
        """
        if self._system is not None:
            refuse_other_system(message, self._system)
        if isinstance(message, ROBOT_STATES):
            self._gathering.add(message)
        elif isinstance(message, PlaneState) and self._estimator is not None:
            if is_new(message, self._plane, self._gathering.step, PLANE_STATE.name):
                self._plane = message
        else:
            raise UnexpectedMessageError("observer", message)
        return self._proceed()

    def steer(self, order: Steering) -> None:
        """Apply an ordered change of the membership."""
        if (change := change_of(order)) is not None:
            self._membership.plan(change)

    def drop(self, agents: Iterable[int], reason: str) -> Messages:
        """Declare robots dead from the current step on: they are assumed at rest at their last positions."""
        for agent_id in agents:
            self._membership.end(agent_id, self._gathering.step - 1, stays=True, reason=reason)
        return self._proceed()

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the states of robots, and for that of the plane if its motion is used."""
        if self._finished():
            return ()
        robots = self._config.family.robot
        return (robots,) if self._estimator is None else (robots, PLANE_STATE)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step, and the missing robots, or else the plane."""
        robots = tuple(f"agent {i}" for i in self._gathering.missing())
        return self._gathering.step, robots or (() if self._estimator is None else (self._config.family.node,))

    def missing_agents(self) -> tuple[int, ...]:
        """Return the ids of the robots whose states of the current step are missing."""
        return self._gathering.missing()

    def silent_agents(self) -> tuple[int, ...]:
        """Return the ids of the robots whose states are missing in a step in which others have arrived.

        If no state has arrived, return no ids: then all robots wait for another node.
        """
        missing = self._gathering.missing()
        heard = len(missing) < len(self._membership.publishing(self._gathering.step))
        return missing if heard else ()

    def _finished(self) -> bool:
        last = self._config.last_step
        return last is not None and self._gathering.step > last

    def _proceed(self) -> Messages:
        """Announce membership changes at once, because the plane may wait for them; sum up once all has arrived."""
        if self._finished() or not self._gathering.complete():
            return ()
        events: Messages = ()
        if self._announced < self._gathering.step:
            self._announced = self._gathering.step
            events = self._announce()
        if self._estimator is not None and self._plane is None:
            return events
        return (*events, *self._sum_up())

    def _sum_up(self) -> Messages:
        config = self._config
        step = self._gathering.step
        stamp = step * config.period_ns
        states = self._gathering.take()
        if not self._finished() and not self._membership.publishing(self._gathering.step):
            raise RunError(f"step {self._gathering.step}: no robot is left in the run")
        self._previous = states
        with InStep(step):
            answer = self._observed(stamp, step, states)
            if self._membership.divides(step, config.division):
                answer = (*answer, config.divided(stamp, step, (*states, *self._standing.values())))
        plane, self._plane = self._plane, None
        abstract, *others = answer
        if self._estimator is not None and plane is not None and isinstance(abstract, AbstractState):
            torque, rate = self._estimator.update(plane.angle, plane.angular_velocity, abstract.inertia)
            answer = (abstract._replace(torque=torque, torque_rate=rate), *others)
        return answer

    def _observed(self, stamp: int, step: int, states: Sequence[AnyRobotState]) -> Messages:
        found: Messages = self._config.observed(stamp, step, states, self._standing.values())
        return found

    def _announce(self) -> Messages:
        """Return events for the membership changes that take effect at the current step."""
        step = self._gathering.step
        stamp = step * self._config.period_ns
        events = []
        changes = self._membership.changes(step)
        previous = {state.agent_id: state for state in self._previous} if changes else {}
        for agent_id, kind, reason in changes:
            if kind is EventKind.DEAD and agent_id in previous:
                self._standing[agent_id] = at_rest(previous[agent_id])
            position = place_of(previous[agent_id]) if agent_id in previous else 0.0
            events.append(SwarmEvent(stamp, step, agent_id, kind, position, reason))
        return tuple(events)

"""The abstraction observer: the robots' states in, abstract and auxiliary state of the swarm out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.behaviours.base import (
    Gathering,
    UnexpectedMessageError,
    at_rest,
    is_new,
    place_of,
    refuse_other_system,
)
from swarmabs_core.errors import InStep, RunError
from swarmabs_core.membership import Membership
from swarmabs_core.messages import (
    PARENT_STATES,
    ROBOT_STATES,
    AnyParentState,
    AnyRobotState,
    EventKind,
    Message,
    Messages,
    Steering,
    SwarmEvent,
    Topic,
)
from swarmabs_core.steering import change_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from swarmabs_core.model import Observation, Observed, ObserverConfig


class Observer:
    """Sums up the swarm once the states of all members of a step have arrived. It alone decides on membership.

    With the disturbance-observer estimate of the torque, inertia, sums and membership still come from the robots.

    Parameters
    ----------
    config : ObserverConfig
        Configuration, which determines the parent system.
    """

    def __init__(self, config: ObserverConfig) -> None:
        self._config = config
        self._system = config.system_hash
        self._observation: Observation = config.observation()
        self._parent: AnyParentState | None = None
        self._announced = -1
        self._membership = Membership(config.members, config.schedule)
        self._gathering = self._gather()
        self._previous: Iterable[AnyRobotState] = ()
        self._standing: dict[int, AnyRobotState] = {}

    def _gather(self) -> Gathering:
        return Gathering(self._membership)

    def start(self) -> Messages:
        """Publish nothing: the robots start."""
        return ()

    @property
    def step(self) -> int:
        """The step that is summed up next."""
        return self._gathering.step

    @property
    def membership(self) -> Membership:
        """Who takes part in which step, as far as it is known."""
        return self._membership

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
        watched = self._observation.watched
        refuse_other_system(message, self._system)
        if isinstance(message, ROBOT_STATES):
            self._gathering.add(message)
        elif isinstance(message, PARENT_STATES) and watched is not None:
            if is_new(message, self._parent, self._gathering.step, watched.name):
                self._parent = message
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
        robots, watched = self._config.family.robot, self._observation.watched
        return (robots,) if watched is None else (robots, watched)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step, and the missing robots, or else the plane."""
        robots = tuple(f"agent {i}" for i in self._gathering.missing())
        return self._gathering.step, robots or (
            () if self._observation.watched is None else (self._config.family.node,)
        )

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
        if self._observation.watched is not None and self._parent is None:
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
        watched, self._parent = self._parent, None
        with InStep(step):
            observed = self._observed(stamp, step, states, watched)
            if not self._membership.divides(step, config.division):
                return observed
            return (*observed, self._observation.divided(stamp, step, (*states, *self._standing.values())))

    def _observed(
        self, stamp: int, step: int, states: Sequence[AnyRobotState], watched: AnyParentState | None
    ) -> Observed:
        return self._observation.observed(stamp, step, states, self.standing, watched)

    def _announce(self) -> Messages:
        """Return events for the membership changes that take effect at the current step."""
        events = self.changes()
        if events:
            previous = {state.agent_id: state for state in self._previous}
            for event in events:
                if event.kind is EventKind.DEAD and event.agent_id in previous:
                    self._standing[event.agent_id] = at_rest(previous[event.agent_id])
        return events

    def changes(self) -> tuple[SwarmEvent, ...]:
        """Return events for the membership changes, as far as they are known, that take effect at the current step."""
        step = self._gathering.step
        changes = self._membership.changes(step)
        places = {state.agent_id: place_of(state) for state in self._previous} if changes else {}
        stamp = step * self._config.period_ns
        return tuple(
            SwarmEvent(stamp, step, agent_id, kind, places.get(agent_id, 0.0), reason)
            for agent_id, kind, reason in changes
        )

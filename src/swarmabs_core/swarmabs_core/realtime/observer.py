"""The abstraction observer in real time: it sums up recent states of the robots and decides their roles."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from swarmabs_core.abstraction import Weight, divided_load, observed
from swarmabs_core.behaviours.base import at_rest
from swarmabs_core.declaration import part, same
from swarmabs_core.events import EventCode
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    NEVER,
    AbstractState,
    AgentState,
    AuxiliaryState,
    Basis,
    EventKind,
    Message,
    Messages,
    Removal,
    Source,
    StandingState,
    Status,
    SwarmEvent,
)
from swarmabs_core.parameters import SettingError
from swarmabs_core.plant import Plane
from swarmabs_core.realtime.base import FEWEST, UNKNOWN, Health, Level, Realtime, Schedule, Sender, StepCounter
from swarmabs_core.realtime.leadership import Pair, Voice
from swarmabs_core.realtime.validation import NO_MEMBER, Bounds, HeardStates, Origin, Problem, Refusals
from swarmabs_core.settings import Run
from swarmabs_core.summation import exact_sum
from swarmabs_core.swarm_law import SwarmGains

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, MutableMapping


class Role(Enum):
    """The role of a robot in the sums."""

    UNHEARD = "not heard yet"
    ACTIVE = "active"
    STOPPED = "in a safe stop"
    SILENT = "silent"
    LEFT = "left"


@dataclass(frozen=True, slots=True)
class RealtimeObserverConfig:
    """Configuration of the observer in real time."""

    members: tuple[int, ...] = same(Run, "members")
    schedule: Schedule = part(Schedule, name="")
    gravity: float = same(Plane, "gravity")
    ksd: float = same(SwarmGains, "ksd")
    plane_length: float = same(Plane, "length")
    swarm_mass: float = same(Bounds, "swarm_mass")
    state_age_limit: float = same(Realtime, "state_age_limit")
    start: str = same(Realtime, "start")
    quorum: int | None = same(Realtime, "quorum")
    clock_tolerance: float = same(Realtime, "clock_tolerance")
    pair: Pair = part(Pair, name="")

    def __post_init__(self) -> None:
        """Reject a quorum that these robots cannot reach."""
        robots, quorum = len(self.members), self.quorum or 0
        if self.start == "quorum" and not FEWEST <= quorum <= robots:
            raise SettingError("quorum", f"{quorum} of {robots} robots", f"give a number from {FEWEST} to {robots}")

    @property
    def needed(self) -> int:
        """Number of robots that must be heard before anything is published."""
        if self.start == "quorum":
            return self.quorum or FEWEST
        return len(self.members) if self.start == "wait" else FEWEST

    @property
    def bounds(self) -> Bounds:
        """Known properties of the swarm and its plane, against which messages are validated."""
        return Bounds(self.gravity, self.plane_length, self.swarm_mass, self.schedule.period)


class RealtimeSums:
    """Roles and sums. It is stateless: verification recomputes the same bits from the same states."""

    def __init__(self, config: RealtimeObserverConfig) -> None:
        self._config = config
        self._age = config.schedule.steps(config.state_age_limit)

    def role(self, state: AgentState | None, step: int) -> Role:
        """Return the role in the sums of a step of a robot whose newest state is given."""
        if state is None:
            return Role.UNHEARD
        if state.status == Status.LEFT:
            return Role.LEFT
        if step - state.step > self._age:
            return Role.SILENT
        return Role.ACTIVE if state.status == Status.ACTIVE else Role.STOPPED

    def sum_up(
        self, states: Mapping[int, AgentState], standing: Collection[int], step: int, now: int
    ) -> tuple[AbstractState, AuxiliaryState]:
        """Return the abstract and auxiliary state of a step at a time (ns).

        `states` are the newest states by robot. Robots in `standing` are silent and assumed at rest in their positions.
        """
        weights, followers = [], []
        for _, state in sorted(states.items()):
            if state.status == Status.LEFT:
                continue
            stands = state.agent_id in standing
            weights.append(Weight(state.mass, state.position, 0.0 if stands else state.velocity))
            if state.status == Status.ACTIVE and not stands:
                followers.append(state)
        return observed(now, step, weights, followers, self._config.gravity, self._config.ksd)

    def divide(self, states: Mapping[int, AgentState], standing: Collection[int], step: int, now: int) -> StandingState:
        """Return how the abstract state of a step divides; parameters as for `sum_up`."""
        robots = [
            at_rest(state) if state.agent_id in standing else state
            for _, state in sorted(states.items())
            if state.status != Status.LEFT
        ]
        return divided_load(now, step, robots, self._config.gravity)


class RealtimeObserver:
    """Publishes abstract and auxiliary state once per period, even if robots are silent.

    An active robot counts in all sums. The weight of a stopped or silent robot remains in the abstract state, because
    it is still on the plane; a robot that has left does not count. A robot can return without a restart of other nodes.

    Parameters
    ----------
    memory : mutable mapping, optional
        Last states of silent robots, by id. If it is persistent, a restarted node knows of weights on the plane that
        are no longer reported.

    Attributes
    ----------
    roles : dict
        Role of every member.
    voice : Voice
        Whether it is this one of a pair that speaks.
    """

    def __init__(self, config: RealtimeObserverConfig, memory: MutableMapping[int, AgentState] | None = None) -> None:
        self._config, self._bounds, self._needed = config, config.bounds, config.needed
        self._memory: MutableMapping[int, AgentState] = {} if memory is None else memory
        self._sums = RealtimeSums(config)
        self._age = config.schedule.steps(config.state_age_limit)
        self._heard = HeardStates(self._age, config.schedule.ahead(config.clock_tolerance))
        self.roles = dict.fromkeys(sorted(config.members), Role.UNHEARD)
        self._states = {i: _long_ago(state) for i, state in self._memory.items() if i in self.roles}
        # The actual steps of the states, including those whose step was set to 0.
        self._steps = {i: state.step for i, state in self._memory.items()}
        self._remembered = frozenset(self._steps) & frozenset(self.roles)
        self._refusals = Refusals()
        self._counter = StepCounter(config.schedule)
        self._started = False
        self._under_way_since: int | None = None
        self.voice = Voice(EventCode.OBSERVER_LEADS, config.pair, config.schedule, config.clock_tolerance)

    def tuned(self, config: RealtimeObserverConfig) -> Callable[[], None]:
        """Return a callable that installs the gain of a configuration between two steps."""
        sums = RealtimeSums(config)

        def install() -> None:
            self._sums = sums

        return install

    def hear(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Messages:
        """Take an event, or a state of a member if it is valid and newer than the known one."""
        step = self._config.schedule.step(now)
        if isinstance(message, Removal):
            return self._remove(message, step, now)
        if isinstance(message, SwarmEvent):
            self._learn(message, step)
            return ()
        if isinstance(message, AbstractState) and not self._config.pair.single:
            return self._hear_peer(message, step, now, sender)
        if not isinstance(message, AgentState):
            return self._refusals.add(Problem("not a robot's state"), step, now)
        problem = self._problem(message, step, sender)
        if problem:
            return self._refusals.add(problem, step, now)
        if self._heard.replaces(message, self._states.get(message.agent_id), step):
            self._states[message.agent_id] = message
            self._steps[message.agent_id] = message.step
        return ()

    def tick(self, now: int) -> Messages:
        """Return events for changed roles, and the sums; one of a pair that stands by says nothing."""
        step = self._counter.next(now)
        if step is None:
            if self._counter.last is None and self._started:
                self.halt()
            return ()
        self._heard.writers.advance(step)
        events = self._update_roles(step, now)
        if not self._started and not self._may_start(step):
            return self.voice.say(events, now, able=False)
        self._started = True
        if not self._hears_robots and not self._config.pair.single:  # what it said would keep the other one silent
            return self.voice.say(events, now, able=False)
        standing = [i for i, role in self.roles.items() if role is Role.SILENT]
        swarm = self._states, standing, step, now
        answer = (self._provenance(standing, step, now), *self._sums.sum_up(*swarm), self._sums.divide(*swarm))
        return self.voice.say((*events, *answer), now)

    def halt(self) -> None:
        """Assume that all robots rest in their last known positions until they are heard again."""
        self._states = {i: _long_ago(s) if s.status != Status.LEFT else s for i, s in self._states.items()}
        self._heard.forget()

    def health(self, now: int) -> Health:
        """Return the number of robots in each role, and the robots for which a second sender speaks."""
        return self._heard.writers.warned(self._health(now))

    def _health(self, now: int) -> Health:
        count = {role: sum(r is role for r in self.roles.values()) for role in Role}
        ids = {role: [i for i, r in self.roles.items() if r is role][:20] for role in Role}
        values = tuple((role.value, " ".join(map(str, ids[role]))) for role in Role)
        values = (*values, *self._refusals.values(), *self.voice.values(now))
        if not self._started:
            heard = self._known()
            return Health(Level.WARN, f"waiting for robots: {heard} heard, {self._needed} needed", values)
        if not count[Role.ACTIVE]:
            # Robots in a safe stop report why: an operator may have told them to.
            return Health(Level.WARN if count[Role.STOPPED] else Level.ERROR, "no robot follows", values)
        missing = count[Role.STOPPED] + count[Role.SILENT]
        text = f"{count[Role.ACTIVE]} of {len(self.roles)} robots follow"
        return Health(Level.WARN if missing else Level.OK, text, values)

    @property
    def states(self) -> Mapping[int, AgentState]:
        """The newest state of each robot, by id; with step 0 if it is not known how old it is."""
        return self._states

    @property
    def _hears_robots(self) -> bool:
        """Whether it heard any robot recently: one of a pair that is cut off from all leaves them to the other one."""
        return any(role in (Role.ACTIVE, Role.STOPPED) for role in self.roles.values())

    def _hear_peer(self, message: AbstractState, step: int, now: int, sender: Sender) -> Messages:
        problem = self._bounds.problem(message)
        if not problem:
            origin = Origin(ABSTRACT_STATE.name, standby=sender.standby)
            problem = self._heard.writers.second(origin, sender.writer, step)
        if problem:
            return self._refusals.add(problem.of("the other observer"), step, now)
        self.voice.leadership.hear(message.step, step)
        return ()

    def _problem(self, message: AgentState, step: int, sender: Sender) -> Problem | None:
        if message.agent_id not in self.roles:
            return Problem(NO_MEMBER, f"robot {message.agent_id}")
        impossible = self._bounds.problem(message) or self._overweight(message)
        return self._heard.problem(message, step, impossible, sender.writer)

    def _overweight(self, state: AgentState) -> Problem | None:
        """Return a problem if the robot's mass and those of the others on the plane exceed the mass of the swarm."""
        before = self._states.get(state.agent_id)
        if before is not None and (before.mass, before.status) == (state.mass, state.status):
            return None
        others = [s.mass for i, s in self._states.items() if i != state.agent_id and s.status != Status.LEFT]
        if state.status != Status.LEFT and self._bounds.exceeds(exact_sum([*others, state.mass])):
            return Problem("a mass that is with the others more than the swarm's", f"{state.mass:.4g} kg")
        return None

    def _learn(self, event: SwarmEvent, step: int) -> None:
        """Note an event that shows that the swarm is already moving."""
        if event.agent_id in self.roles and event.kind == EventKind.RECOVERED and self._under_way_since is None:
            self._under_way_since = step

    def _remove(self, removal: Removal, step: int, now: int) -> Messages:
        """Take a silent robot off the plane, unless it has been heard since; return the removal for observers to come.

        Removals are kept for nodes that start later, so this one may be old.
        """
        state = self._states.get(removal.agent_id)
        if state is None or self._sums.role(state, step) is not Role.SILENT:
            return ()
        if self._heard.from_future(removal, step):
            problem = Problem("a removal from the future; the clocks differ")
            return self._refusals.add(problem.of(f"robot {removal.agent_id}"), step, now)
        if removal.step < self._steps[removal.agent_id]:
            return ()
        self._states[removal.agent_id] = state._replace(status=Status.LEFT)
        return (removal,)

    def _provenance(self, standing: Collection[int], step: int, now: int) -> Basis:
        """Return the provenance of the sums: the steps of the states, and the robots assumed at rest."""
        ids = tuple(i for i, state in sorted(self._states.items()) if state.status != Status.LEFT)
        steps = tuple(self._steps[agent_id] for agent_id in ids)
        marks = tuple(int(agent_id in standing) for agent_id in ids)
        return Basis(now, step, NEVER, NEVER, Source.OBSERVER, steps, ids, marks)

    def _may_start(self, step: int) -> bool:
        """Return whether enough robots are known, or only this node has restarted while the swarm is moving."""
        if self._known() >= self._needed:
            return True
        if self._under_way_since is None:
            if any(state.broadcast_step != NEVER for state in self._states.values()):
                self._under_way_since = step
            return False
        return step - self._under_way_since > self._age and len(self._states) >= FEWEST

    def _known(self) -> int:
        """Return how many robots have a known position: recently heard, or silent since before this node started.

        The count is that of the last tick. A state that was outdated on arrival does not count, because the robot may
        be elsewhere when the swarm starts.
        """
        absent = (Role.UNHEARD, Role.SILENT)
        return sum(role not in absent or i in self._remembered for i, role in self.roles.items())

    def _update_roles(self, step: int, now: int) -> Messages:
        events = []
        for agent_id, before in self.roles.items():
            role = self._sums.role(self._states.get(agent_id), step)
            if role is before:
                continue
            self.roles[agent_id] = role
            self._memorise(agent_id, role)
            there, was_there = (r in (Role.ACTIVE, Role.STOPPED) for r in (role, before))
            if there and was_there:
                continue  # the robot reports this change itself
            kind = {Role.SILENT: EventKind.DEAD, Role.LEFT: EventKind.LEFT}.get(role, EventKind.JOINED)
            position = self._states[agent_id].position
            events.append(SwarmEvent(now, step, agent_id, kind, position, "" if there else role.value))
        return tuple(events)

    def _memorise(self, agent_id: int, role: Role) -> None:
        if role is Role.SILENT:
            self._memory[agent_id] = self._states[agent_id]._replace(step=self._steps[agent_id])
        else:
            self._memory.pop(agent_id, None)


def _long_ago(state: AgentState) -> AgentState:
    """Return the state with step 0, so that any newer state replaces it."""
    return state._replace(step=0)

"""Validation of messages in real time: plausible numbers, no messages from the future, no contradictions.

In lockstep a node gathers all messages of a step (`swarmabs_core.behaviours.base.Gathering`). In real time it uses the
newest ones, so it must detect conflicting senders.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite
from typing import TYPE_CHECKING, Generic, TypeVar

from swarmabs_core.declaration import setting
from swarmabs_core.messages import (
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    EventKind,
    Kind,
    Message,
    Messages,
    Mode,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.realtime.base import Health, Level

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

Place = TypeVar("Place")
"""Hashable key of a message within its step; two different messages in one place contradict each other."""

QUIET_NS = 10_000_000_000
"""Time between two reports of the same reason, ns, so that an intruder cannot flood the events."""
MOST_REASONS = 100
"""Number of reasons that are reported separately; messages rejected for other reasons are only counted."""
SLACK = 1.05
"""Factor by which a bound may be exceeded, because measured positions are not exact."""
_MOST_SHOWN = 20
SHOWN_AGES = 100
"""For how many age limits a health status shows that a robot had a second sender."""
SECOND_SENDER = "a second sender, refused while the first is heard"
"""Reason for which the states of a second writer with the id of a robot are rejected."""
_ROUNDING = 1e-6
LEAST_DAMPING_TIME = 1e-3
"""Shortest time constant of a robot's own damping that is credible, in periods."""
FASTEST_TURN = 100.0
"""Largest credible angular velocity of the plane, rad/s: from one end stop to the other within three periods."""
_NUMERIC = (AbstractState, AuxiliaryState, DesiredAbstractState, AgentState, PlaneState)
"""Messages that consist of numbers."""
_KINDS, _STATUSES, _MODES = frozenset(Kind), frozenset(Status), frozenset(Mode)


@dataclass(frozen=True, slots=True)
class Bounds:
    """Known properties of a swarm and its plane: gravity (m/s^2), length of the plane (m) and mass of the swarm.

    The period (s) is the shortest time in which a robot may cross the plane.
    """

    gravity: float
    plane_length: float
    swarm_mass: float = setting(
        inf, "mass of all robots that ever take part, kg: the bound for plausible messages", above=0.0, unset=0.0
    )
    period: float = 0.001

    @property
    def reach(self) -> float:
        """Largest credible distance of a robot from the axis, m."""
        return 0.5 * self.plane_length * SLACK

    @property
    def fastest(self) -> float:
        """Largest credible speed of a robot, m/s."""
        return self.plane_length / self.period * SLACK

    def exceeds(self, mass: float) -> bool:
        """Return whether a mass (kg) exceeds that of the whole swarm."""
        return mass > self.swarm_mass * (1.0 + _ROUNDING)

    def problem(self, message: Message) -> str:
        """Return why a message cannot be true; empty if it can."""
        if isinstance(message, _NUMERIC) and not all(map(isfinite, message)):
            return "not all of its numbers are finite"
        if isinstance(message, AbstractState):
            return self._abstract(message)
        if isinstance(message, AuxiliaryState):
            return self._sums(message)
        if isinstance(message, DesiredAbstractState):
            return "" if message.mode in _MODES else f"there is no mode {message.mode}"
        if isinstance(message, AgentState):
            return self._robot(message)
        if isinstance(message, PlaneState):
            return self._plane(message)
        return ""

    def _plane(self, state: PlaneState) -> str:
        if abs(state.angle) > 3.2:
            return f"an angle of {state.angle:.4g} rad"
        if abs(state.angular_velocity) > FASTEST_TURN:
            return f"an angular velocity of {state.angular_velocity:.4g} rad/s, at most {FASTEST_TURN:g} is credible"
        return ""

    def _abstract(self, state: AbstractState) -> str:
        mass, arm = self.swarm_mass * (1.0 + 2.0 * _ROUNDING), self.reach
        weight = self.gravity * mass
        if abs(state.torque) > weight * arm:
            return f"a torque of {state.torque:.4g} N m, more than the swarm can exert"
        if not 0.0 <= state.inertia <= mass * arm * arm:
            return f"an inertia of {state.inertia:.4g} kg m^2, which the swarm cannot have"
        rate, inertia_rate = abs(state.torque_rate), abs(state.inertia_rate)
        if rate > weight * self.fastest or inertia_rate > 2.0 * mass * arm * self.fastest:
            return f"rates of {state.torque_rate:.4g} N m/s and {state.inertia_rate:.4g} kg m^2/s: robots too fast"
        return ""

    def _sums(self, sums: AuxiliaryState) -> str:
        arm = self.reach
        if sums.s0 < 0.0 or sums.s2 < 0.0 or sums.s3 < 0.0 or sums.d0 < 0.0 or sums.d2 < 0.0 or sums.q < 0.0:
            return "a sum of squares is negative"
        if sums.s0 > self.swarm_mass * self.swarm_mass * SLACK:
            return f"S0 = {sums.s0:.4g} kg^2, more than the swarm's mass allows"
        if abs(sums.s1) > sums.s0 * arm or sums.s2 > sums.s0 * arm * arm:
            return "S1 or S2 puts robots off the plane"
        product = sums.s0 * sums.s2
        if abs(sums.s3 - (product - sums.s1 * sums.s1)) > _ROUNDING * product:
            return "S3 is not S0 S2 - S1^2"
        return ""

    def _robot(self, state: AgentState) -> str:
        if state.kind not in _KINDS or state.status not in _STATUSES:
            return f"there is no kind {state.kind} or no status {state.status}"
        if not state.mass > 0.0 or state.damping < 0.0:
            return f"a mass of {state.mass:.4g} kg and a damping of {state.damping:.4g} N s/m"
        if abs(state.position) > self.reach:
            return f"a position of {state.position:.4g} m, which is off the plane"
        if self.exceeds(state.mass):
            return f"a mass of {state.mass:.4g} kg, more than the swarm's {self.swarm_mass:.4g} kg"
        if abs(state.velocity) > self.fastest:
            return f"a velocity of {state.velocity:.4g} m/s, at most {self.fastest:.4g} is credible"
        if state.damping * self.period * LEAST_DAMPING_TIME > state.mass:
            return f"a damping of {state.damping:.4g} N s/m, too much for a mass of {state.mass:.4g} kg"
        return ""


class Heard(Generic[Place]):
    """The first message of each step and place, and the places with contradictory messages.

    Nodes use the newest message. A comparison with the newest alone is not sufficient: a sender that is always ahead
    would never be compared with the senders that it has overtaken. Messages are therefore kept for the steps from `age`
    before to `ahead` after the current one.
    """

    def __init__(self, age: int, ahead: int) -> None:
        self._age = age
        self._ahead = ahead
        self._steps: dict[int, dict[Place, Message]] = {}
        self._contradicted: dict[Place, int] = {}

    def from_future(self, message: Message, step: int) -> bool:
        """Return whether a message is newer than the clock tolerance allows in a step."""
        return message.step > step + self._ahead

    def add(self, place: Place, message: Message, step: int) -> bool:
        """Keep a message if it is the first in its place; return whether it differs from the first.

        Messages of steps that are not kept are not compared; `step` is the current one.
        """
        if not step - self._age <= message.step <= step + self._ahead:
            return False
        if message.step not in self._steps:
            kept = range(step - self._age, step + self._ahead + 1)
            self._steps = {k: heard for k, heard in self._steps.items() if k in kept}
        differs = self._steps.setdefault(message.step, {}).setdefault(place, message) != message
        if differs:
            self.doubt(place, step)
        return differs

    def doubt(self, place: Place, step: int) -> None:
        """Distrust a place from a step on, until the messages of that step are outdated."""
        self._contradicted[place] = step

    def doubts(self, place: Place, step: int) -> bool:
        """Return whether a place is distrusted: two messages differed, and it is unknown which one is genuine."""
        since = self._contradicted.get(place)
        return since is not None and step - since <= self._age

    def doubted(self, step: int) -> Iterator[Place]:
        """Return the places that are distrusted."""
        return (place for place in self._contradicted if self.doubts(place, step))

    def of(self, step: int) -> Mapping[Place, Message]:
        """Return the messages of a step by place, in the order of arrival."""
        return self._steps.get(step, {})

    def steps(self) -> Collection[Mapping[Place, Message]]:
        """Return the messages of each step that is kept."""
        return self._steps.values()

    def _forget_place(self, place: Place) -> None:
        """Discard the messages of a place, and whether it is distrusted: from now on another one sends them."""
        for heard in self._steps.values():
            heard.pop(place, None)
        self._contradicted.pop(place, None)

    def forget(self) -> None:
        """Discard all messages."""
        self._steps.clear()
        self._contradicted.clear()


class Writers:
    """Binds the id of each robot to a writer: the first one, until it has been silent for the age limit, in steps.

    Silence is counted in the steps in which the receiver has run. After a pause of its own, whose messages still wait
    to be heard, or after a change of its clock, a second writer therefore cannot take the place of the first. Memory is
    bounded by the number of robots, however many writers there are.
    """

    def __init__(self, age: int) -> None:
        self._age = age
        self._bound: dict[int, tuple[bytes, int]] = {}
        self._refused: dict[int, tuple[int, bytes, int]] = {}
        self._ran = 0
        self._step: int | None = None

    def advance(self, step: int) -> None:
        """Count the steps since the last call; those of a pause count for half the age limit at most."""
        if step == self._step:
            return
        passed = 1 if self._step is None else step - self._step
        self._ran += min(max(1, passed), max(1, self._age // 2))
        self._step = step

    def refuses(self, agent_id: int, writer: bytes) -> bool:
        """Return whether a state is that of a second writer while the first one is alive; an unknown writer is none."""
        bound = self._bound.get(agent_id)
        if bound is None or not writer or writer == bound[0] or self._ran - bound[1] > self._age:
            return False
        count = self._refused[agent_id][0] if agent_id in self._refused else 0
        self._refused[agent_id] = count + 1, writer, self._ran
        return True

    def hear(self, agent_id: int, writer: bytes) -> bool:
        """Note that a writer that is not refused is alive; return whether it has taken the place of another one."""
        before = self._bound.get(agent_id)
        if writer:
            self._bound[agent_id] = writer, self._ran
        return bool(writer) and before is not None and before[0] != writer

    def contested(self, agent_id: int, ages: int = 1) -> bool:
        """Return whether a second writer of a robot was refused within so many age limits."""
        return agent_id in self._refused and self._ran - self._refused[agent_id][2] <= ages * self._age

    def warned(self, health: Health) -> Health:
        """Return a health status with the robots that have a second writer, or had one recently, and the writers.

        GIDs are written as by `ros2 topic info -v`, which names their nodes.
        """
        if not self._refused:
            return health
        found = tuple(
            (f"second sender of robot {i}", f"{gid.hex('.')}: {count} refused; the first: {self._bound[i][0].hex('.')}")
            for i, (count, gid, _) in sorted(self._refused.items())[:_MOST_SHOWN]
        )
        values = (*health.values, *found)
        contested = [i for i in sorted(self._refused) if self.contested(i, SHOWN_AGES)][:_MOST_SHOWN]
        if not contested:
            return health._replace(values=values)
        text = f"{health.text}; a second sender speaks for robots {' '.join(map(str, contested))}"
        return Health(max(health.level, Level.WARN), text, values)


class HeardStates(Heard[int]):
    """Received states of the robots.

    Attributes
    ----------
    writers : Writers
        Who speaks for which robot.
    """

    def __init__(self, age: int, ahead: int) -> None:
        super().__init__(age, ahead)
        self.writers = Writers(age)

    def problem(self, state: AgentState, step: int, impossible: str, writer: bytes = b"") -> str:
        """Return why a state is rejected, given why it is impossible, if it is; empty if it is valid."""
        self.writers.advance(step)
        problem = impossible
        if self.writers.refuses(state.agent_id, writer):
            problem = SECOND_SENDER
        elif self.from_future(state, step):
            problem = "a state from the future; the clocks differ, or it is of another swarm"
        elif not impossible:
            if step - self._age <= state.step and self.writers.hear(state.agent_id, writer):
                self._forget_place(state.agent_id)
            self.add(state.agent_id, state, step)
            problem = "two different states of a step" if self.doubts(state.agent_id, step) else ""
        return f"robot {state.agent_id}: {problem}" if problem else ""


class Refusals:
    """Counts the messages that a node, of a robot or of none (0), has rejected.

    Each reason is reported once, and again only after some time.

    Attributes
    ----------
    total : int
        Number of messages rejected so far.
    latest : str
        The latest reason.
    """

    def __init__(self, agent_id: int = 0) -> None:
        self._agent_id = agent_id
        self._reported: dict[str, int] = {}
        self._since: dict[str, int] = {}
        self.total = 0
        self.latest = ""

    def add(self, reason: str, step: int, now: int) -> Messages:
        """Count a rejection and return the event, if it is due for a report; `reason` has few variants."""
        self.total += 1
        self.latest = reason
        if reason not in self._reported and len(self._reported) >= MOST_REASONS:
            return ()
        count = self._since.get(reason, 0) + 1
        last = self._reported.get(reason)
        if last is not None and now - last < QUIET_NS:
            self._since[reason] = count
            return ()
        self._reported[reason], self._since[reason] = now, 0
        return (SwarmEvent(now, max(0, step), self._agent_id, EventKind.REFUSED, float(count), reason),)

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the values for a health status."""
        return ("refused", str(self.total)), ("last refusal", self.latest)

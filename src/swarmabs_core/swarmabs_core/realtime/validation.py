"""Validation of messages in real time: plausible numbers, no messages from the future, no contradictions.

In lockstep a node gathers all messages of a step (`swarmabs_core.behaviours.base.Gathering`). In real time it uses the
newest ones, so it must detect conflicting senders.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from swarmabs_core.declaration import setting
from swarmabs_core.events import EventCode
from swarmabs_core.messages import (
    AGENT_STATE,
    PLANE_KINDS,
    PLANE_STATUSES,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    Message,
    Messages,
    Mode,
    PlaneState,
    StandingState,
)
from swarmabs_core.realtime.base import Health, Level

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

Place = TypeVar("Place")
"""Hashable key of a message within its step; two different messages in one place contradict each other."""

QUIET_NS = 10_000_000_000
"""Time between two reports of the same reason, ns, so that an intruder cannot flood the events."""
SLACK = 1.05
"""Factor by which a bound may be exceeded, because measured positions are not exact."""
_PARTICIPANT = 12
_MOST_SHOWN = 20
SHOWN_AGES = 100
"""For how many age limits a health status shows that there was a second sender."""
SECOND_SENDER = "a second sender, refused while the first is heard"
"""Reason for which the messages of a second writer are rejected."""
FROM_FUTURE = "from the future; the clocks differ, or it is of another swarm"
"""Reason for which messages are rejected that are newer than the clock tolerance allows."""
NO_MEMBER = "a state of a robot that is not a member of this swarm"
"""Reason for which the states of unknown robots are rejected."""
_ROUNDING = 1e-6
LEAST_DAMPING_TIME = 1e-3
"""Shortest time constant of a robot's own damping that is credible, in periods."""
STEEPEST = 3.2
"""Largest credible angle of the plane, rad."""
FASTEST_TURN = 100.0
"""Largest credible angular velocity of the plane, rad/s: from one end stop to the other within three periods."""
_NUMERIC = (AbstractState, AuxiliaryState, DesiredAbstractState, AgentState, PlaneState)
"""Messages that consist of numbers."""
_KINDS, _STATUSES, _MODES = frozenset(PLANE_KINDS), frozenset(PLANE_STATUSES), frozenset(Mode)


class Origin(NamedTuple):
    """Who is said to have sent a message: there is one writer for each, as far as nodes believe.

    Attributes
    ----------
    topic : str
        The usual topic.
    number : int
        Robot of a state, or source of a provenance; 0 for others.
    standby : bool
        Whether a standby has sent it.
    """

    topic: str
    number: int = 0
    standby: bool = False

    def __str__(self) -> str:
        """Return the name in reasons and health statuses."""
        if self.topic == AGENT_STATE.name:
            return f"robot {self.number}"
        return f"{self.topic} of the standby" if self.standby else self.topic


class Problem(NamedTuple):
    """Why a message is rejected.

    Attributes
    ----------
    reason : str
        One of a fixed set, without anything that the message contains.
    shown : str
        What shows it, such as a value in the message.
    origin : str
        Who is said to have sent the message.
    """

    reason: str
    shown: str = ""
    origin: str = ""

    def __str__(self) -> str:
        """Return all of it in a line."""
        shown = f" ({self.shown})" if self.shown else ""
        return f"{self.kind}{shown}"

    @property
    def kind(self) -> str:
        """Origin and reason: what rejections are counted by."""
        return f"{self.origin}: {self.reason}" if self.origin else self.reason

    def of(self, origin: Origin | str) -> Problem:
        """Return the problem of a message with this origin."""
        return self._replace(origin=str(origin))


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

    def problem(self, message: Message) -> Problem | None:
        """Return why a message cannot be true; None if it can."""
        if isinstance(message, _NUMERIC) and not all(map(isfinite, message)):
            return Problem("not all of its numbers are finite")
        if isinstance(message, StandingState):
            return self._division(message)
        if isinstance(message, AbstractState):
            return self._abstract(message)
        if isinstance(message, AuxiliaryState):
            return self._sums(message)
        if isinstance(message, DesiredAbstractState):
            return None if message.mode in _MODES else Problem("an unknown mode", f"{message.mode}")
        if isinstance(message, AgentState):
            return self._robot(message)
        if isinstance(message, PlaneState):
            return self._plane(message)
        return None

    def _plane(self, state: PlaneState) -> Problem | None:
        if abs(state.angle) > STEEPEST:
            return Problem(f"an angle beyond {STEEPEST:g} rad", f"{state.angle:.4g} rad")
        if abs(state.angular_velocity) > FASTEST_TURN:
            return Problem(f"an angular velocity beyond {FASTEST_TURN:g} rad/s", f"{state.angular_velocity:.4g} rad/s")
        return None

    def _division(self, divided: StandingState) -> Problem | None:
        """Return why a division of torque and inertia (with one constant, the mass) cannot be true."""
        numbers = (
            (divided.standing, 2),
            (divided.standing_constants, 1),
            (divided.moving, 2),
            (divided.moving_rate, 2),
            (divided.moving_curvature, 2),
            (divided.moving_gram, 3),
            (divided.moving_constants, 1),
        )
        if any(len(values) != size for values, size in numbers):
            return Problem("a division that is not of torque and inertia")
        if not all(isfinite(value) for values, _ in numbers for value in values) or not isfinite(divided.moving_weight):
            return Problem("not all of its numbers are finite")
        masses = divided.standing_constants[0], divided.moving_constants[0]
        if min(masses) < 0.0 or self.exceeds(masses[0] + masses[1]) or (divided.moving_count and not masses[1] > 0.0):
            return Problem("masses that the swarm cannot have", f"{masses[0]:.4g} kg and {masses[1]:.4g} kg")
        return None

    def _abstract(self, state: AbstractState) -> Problem | None:
        mass, arm = self.swarm_mass * (1.0 + 2.0 * _ROUNDING), self.reach
        weight = self.gravity * mass
        if abs(state.torque) > weight * arm:
            return Problem("a torque beyond what the swarm can exert", f"{state.torque:.4g} N m")
        if not 0.0 <= state.inertia <= mass * arm * arm:
            return Problem("an inertia that the swarm cannot have", f"{state.inertia:.4g} kg m^2")
        rate, inertia_rate = abs(state.torque_rate), abs(state.inertia_rate)
        if rate > weight * self.fastest or inertia_rate > 2.0 * mass * arm * self.fastest:
            shown = f"{state.torque_rate:.4g} N m/s and {state.inertia_rate:.4g} kg m^2/s"
            return Problem("rates that the swarm cannot have: robots too fast", shown)
        return None

    def _sums(self, sums: AuxiliaryState) -> Problem | None:
        arm = self.reach
        if sums.s0 < 0.0 or sums.s2 < 0.0 or sums.s3 < 0.0 or sums.d0 < 0.0 or sums.d2 < 0.0 or sums.q < 0.0:
            return Problem("a sum of squares is negative")
        if sums.s0 > self.swarm_mass * self.swarm_mass * SLACK:
            return Problem("an S0 beyond what the swarm's mass allows", f"{sums.s0:.4g} kg^2")
        if abs(sums.s1) > sums.s0 * arm or sums.s2 > sums.s0 * arm * arm:
            return Problem("S1 or S2 puts robots off the plane")
        product = sums.s0 * sums.s2
        if abs(sums.s3 - (product - sums.s1 * sums.s1)) > _ROUNDING * product:
            return Problem("S3 is not S0 S2 - S1^2")
        return None

    def _robot(self, state: AgentState) -> Problem | None:
        if state.kind not in _KINDS or state.status not in _STATUSES:
            return Problem("an unknown kind or status", f"kind {state.kind}, status {state.status}")
        if not state.mass > 0.0 or state.damping < 0.0:
            shown = f"{state.mass:.4g} kg, {state.damping:.4g} N s/m"
            return Problem("a mass that is not positive, or a negative damping", shown)
        if abs(state.position) > self.reach:
            return Problem("a position off the plane", f"{state.position:.4g} m")
        if self.exceeds(state.mass):
            return Problem(f"a mass beyond the swarm's {self.swarm_mass:.4g} kg", f"{state.mass:.4g} kg")
        if abs(state.velocity) > self.fastest:
            return Problem(f"a velocity beyond {self.fastest:.4g} m/s", f"{state.velocity:.4g} m/s")
        if state.damping * self.period * LEAST_DAMPING_TIME > state.mass:
            return Problem("a damping too large for its mass", f"{state.damping:.4g} N s/m, {state.mass:.4g} kg")
        return None


class Heard(Generic[Place]):
    """The first message of each step and place, and the places with contradictory messages.

    Nodes use the newest message. A comparison with the newest alone is not sufficient: a sender that is always ahead
    would never be compared with the senders that it has overtaken. Messages are therefore kept for the steps from `age`
    before to `ahead` after the current one, those of a second writer apart from the others: they are only compared.
    """

    def __init__(self, age: int, ahead: int) -> None:
        self._age = age
        self._ahead = ahead
        self._steps: dict[int, dict[Place, Message]] = {}
        self._refused: dict[int, dict[Place, Message]] = {}
        self._contradicted: dict[Place, int] = {}

    def from_future(self, message: Message, step: int) -> bool:
        """Return whether a message is newer than the clock tolerance allows in a step."""
        return message.step > step + self._ahead

    def untimely(self, message: Message, step: int) -> Problem | None:
        """Return a problem if a message that arrives in a step is of too late or of too early a step."""
        if self.from_future(message, step):
            return Problem(FROM_FUTURE)
        return Problem("outdated") if message.step < step - self._age else None

    def add(self, place: Place, message: Message, step: int, *, refused: bool = False) -> bool:
        """Keep a message if it is the first in its place; return whether it differs from another one.

        Messages of steps that are not kept are not compared; `step` is the current one. `refused` tells whether it is
        that of a second writer.
        """
        if not step - self._age <= message.step <= step + self._ahead:
            return False
        own, other = (self._refused, self._steps) if refused else (self._steps, self._refused)
        if message.step not in own:
            kept = range(step - self._age, step + self._ahead + 1)
            for steps in (own, other):
                for old in [k for k in steps if k not in kept]:
                    del steps[old]
        first = own.setdefault(message.step, {}).setdefault(place, message)
        differs = first != message or other.get(message.step, {}).get(place, message) != message
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
        self._refused.clear()
        self._contradicted.clear()


def participant_of(writer: bytes) -> bytes:
    """Return the part of a writer's GID that all writers of its process have in common."""
    return writer[:_PARTICIPANT]


class Writers:
    """Binds each origin to a writer: the first one, until it has been silent for the age limit, in steps.

    Silence is counted in the steps in which the receiver has run. After a pause of its own, whose messages still wait
    to be heard, or after a change of its clock, a second writer therefore cannot take the place of the first. Memory is
    bounded by the number of origins, however many writers there are.

    `ages` has the age limits of topics with one of their own.
    """

    def __init__(self, age: int, ages: Mapping[str, int] | None = None) -> None:
        self._age = age
        self._ages = dict(ages or {})
        self._longest_pause = max(1, min(age, *self._ages.values()) // 2) if self._ages else max(1, age // 2)
        self._bound: dict[Origin, tuple[bytes, int]] = {}
        self._refused: dict[Origin, tuple[int, bytes, int]] = {}
        self._ran = 0
        self._step: int | None = None

    def age(self, origin: Origin) -> int:
        """Return the age limit of an origin, in steps."""
        return self._ages.get(origin.topic, self._age)

    def advance(self, step: int) -> None:
        """Count the steps since the last call; those of a pause count for half the age limit at most."""
        if step == self._step:
            return
        passed = 1 if self._step is None else step - self._step
        self._ran += min(max(1, passed), self._longest_pause)
        self._step = step

    def refuses(self, origin: Origin, writer: bytes) -> bool:
        """Return whether a message is that of a second writer while the first is alive; an unknown writer is none."""
        bound = self._bound.get(origin)
        if bound is None or not writer or writer == bound[0] or self._ran - bound[1] > self.age(origin):
            return False
        count = self._refused[origin][0] if origin in self._refused else 0
        self._refused[origin] = count + 1, writer, self._ran
        return True

    def hear(self, origin: Origin, writer: bytes) -> bool:
        """Note that a writer that is not refused is alive; return whether it has taken the place of another one."""
        before = self._bound.get(origin)
        if writer:
            self._bound[origin] = writer, self._ran
        return bool(writer) and before is not None and before[0] != writer

    def second(self, origin: Origin, writer: bytes, step: int) -> Problem | None:
        """Note a valid, fresh message that arrives in a step; return a problem if it is that of a second writer."""
        self.advance(step)
        if self.refuses(origin, writer):
            return Problem(SECOND_SENDER)
        self.hear(origin, writer)
        return None

    def is_bound(self, origin: Origin, writer: bytes) -> bool:
        """Return whether a writer is the first of an origin."""
        return origin in self._bound and self._bound[origin][0] == writer

    def is_heard(self, origin: Origin, within: int) -> bool:
        """Return whether the first writer of an origin is known, and has been heard within so many steps."""
        return origin in self._bound and self._ran - self._bound[origin][1] <= within

    def speaks(self, writer: bytes) -> bool:
        """Return whether the participant of a writer is that of the first writer of any origin."""
        participant = participant_of(writer)
        return any(participant_of(bound) == participant for bound, _ in self._bound.values())

    @property
    def longest_age(self) -> int:
        """The longest age limit of any origin, in steps."""
        return max(self._age, *self._ages.values()) if self._ages else self._age

    def warned(self, health: Health) -> Health:
        """Return a health status with the origins that have a second writer, or had one recently, and the writers.

        GIDs are written as by `ros2 topic info -v`, which names their nodes.
        """
        if not self._refused:
            return health
        writers = tuple(
            (f"second sender of {of}", f"{gid.hex('.')}: {count} refused; the first: {self._bound[of][0].hex('.')}")
            for of, (count, gid, _) in sorted(self._refused.items())[:_MOST_SHOWN]
        )
        values = (*health.values, *writers)
        contested = [
            of for of, (*_, ran) in sorted(self._refused.items()) if self._ran - ran <= SHOWN_AGES * self.age(of)
        ][:_MOST_SHOWN]
        if not contested:
            return health._replace(values=values)
        robots = [str(of.number) for of in contested if of.topic == AGENT_STATE.name]
        names = [f"robots {' '.join(robots)}"] if robots else []
        names += [str(of) for of in contested if of.topic != AGENT_STATE.name]
        text = f"{health.text}; a second sender speaks for {', '.join(names)}"
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

    def problem(self, state: AgentState, step: int, impossible: Problem | None, writer: bytes = b"") -> Problem | None:
        """Return why a state is rejected, given why it is impossible, if it is; None if it is valid."""
        self.writers.advance(step)
        origin = Origin(AGENT_STATE.name, state.agent_id)
        problem = impossible
        if self.writers.refuses(origin, writer):
            problem = Problem(SECOND_SENDER)
        elif self.from_future(state, step):
            problem = Problem(f"a state {FROM_FUTURE}")
        elif not impossible:
            if step - self._age <= state.step and self.writers.hear(origin, writer):
                self._forget_place(state.agent_id)
            self.add(state.agent_id, state, step)
            problem = Problem("two different states of a step") if self.doubts(state.agent_id, step) else None
        return problem and problem.of(origin)

    def replaces(self, state: AgentState, known: AgentState | None, step: int) -> bool:
        """Return whether a valid state that arrives in a step is newer than the known one, if there is one.

        A known one that has not come yet was heard before the clock was set back: it is older than any other.
        """
        return known is None or state.step > known.step or self.from_future(known, step)


class Refusals:
    """Counts the messages that a node, of a robot or of none (0), has rejected.

    Each origin and reason is reported once, and again only after some time. There are few: origins are those that a
    node knows, and reasons contain nothing of a message.

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

    def add(self, problem: Problem, step: int, now: int) -> Messages:
        """Count a rejection and return the event, if it is due for a report."""
        self.total += 1
        self.latest = str(problem)
        kind = problem.kind
        count = self._since.get(kind, 0) + 1
        last = self._reported.get(kind)
        if last is not None and 0 <= now - last < QUIET_NS:
            self._since[kind] = count
            return ()
        self._reported[kind], self._since[kind] = now, 0
        code = EventCode.REFUSED_BY_ROBOT if self._agent_id else EventCode.REFUSED
        return (code.event(now, max(0, step), float(count), robot=self._agent_id, detail=self.latest),)

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the values for a health status."""
        return ("refused", str(self.total)), ("last refusal", self.latest)

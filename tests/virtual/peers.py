"""What must hold among robots without coordinators, checked with what they are told, publish and hear.

Of each robot it is known from outside what has reached it: which states, orders and versions of the electorate, and
which of its neighbours has told what it holds. What certainly was taken is a lower bound of what the robot knows, and
all that was heard an upper one; they differ while a neighbour or an author has just started, or has a wrong clock. The
rules are those of docs/explanation/decentralised_realtime.md.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from tests.virtual.fleet import Parcel
from tests.virtual.properties import GUARD_MOST, BrokenError, Facts, Property
from tests.virtual.schedule import RESET_LASTS

from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_config.graph import PLANE
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    NEVER,
    PARENT,
    PLANE_STATE,
    RELAY,
    AbstractState,
    AgentState,
    PlaneState,
    Relay,
    Status,
    relay_topic,
)
from swarmabs_core.realtime.controller import LawView
from swarmabs_core.realtime.modes import Orders
from swarmabs_core.realtime.relayed import FOLLOWS, Answer, Motion, Told, read, read_plane

LARGEST = 1_300
"""Size of a relay, bytes, that is one datagram with all headers."""
RECORD, INTRODUCTION, SIGNED = 25, 19, 64
"""Sizes, bytes, of a state in a relay, of the constants of a robot, and of a signature."""
OLDEST = 238
"""Age, steps, from which on relays tell of what is held only that it is at least so old."""
SETTLED = 1.0
"""Time, s, for which a majority hears the same robots until these are those that count."""
APART, PASSED_APART = 0.2, 0.5
"""By how much the integrals of robots after the same step may differ soon after a start, relative to 1 + their size: if
all robots hear the plane, and if some miss what is lost on the way to them."""
PASSED_ON = "passes on what it hears"
SUMMED = "sums up what it knows"
ORDERED = "orders reach all"
COUNTED = "a majority moves"
ALIKE = "all know alike"
STATEMENTS = {
    PASSED_ON: (
        "What a robot passes on was published by its author, has reached the robot, and is the newest that has; a "
        "neighbour that has told that it lacks a state gets it, unless the datagram is full."
    ),
    SUMMED: (
        "A robot sums up the newest states that have reached it, for each state of the plane that reaches it; the one "
        "of lowest id of those that hear each other publishes that."
    ),
    ORDERED: (
        "A robot tells the newest STOP and RESET of all that have reached it and that operators have given to it; it "
        "does not move while the STOP holds."
    ),
    COUNTED: (
        "A robot follows only while it hears a majority of the robots that count: more than half of them, or half with "
        "the lowest id; and then it does. At first all count; only a majority decides, after it has heard the same "
        "robots for a second, that these count."
    ),
    ALIKE: (
        "When all is well, all robots know the same orders, count the same robots, and have laws of one time, which "
        "began after the newest RESET."
    ),
}
"""What each of these properties means, for people."""
_QUIET = 5
"""Periods for which whoever is to publish the sums may say none."""
_NO_ORDERS = Orders()


@dataclass(slots=True)
class _Sum:
    """What a robot knew as it summed up: the newest steps by rank, at least; and who had left."""

    known: tuple[int, ...]
    left: frozenset[int]


@dataclass(slots=True)
class _Robot:
    """What has reached a robot since its node started.

    By rank: `known` the newest step that it certainly knows, -1 if none; `may` all steps that it may know. Orders are
    at least `orders`, at most `most`; the electorates that it may have adopted are `electing`.
    """

    rank: int
    known: list[int]
    may: list[dict[int, None]]
    begun: int = 0
    introduced: set[int] = field(default_factory=set)
    orders: Orders = _NO_ORDERS
    most: Orders = _NO_ORDERS
    ordered: int = -(10**18)
    left: dict[int, int] = field(default_factory=dict)
    ordering: bool = False
    resumed: int = -(10**18)
    summed: int = -1
    plane: int = -1
    planes: dict[int, None] = field(default_factory=dict)
    told: dict[int, tuple[int, Told | None]] = field(default_factory=dict)
    sums: dict[int, _Sum] = field(default_factory=dict)
    last: tuple[int, int] = (-1, -1)
    held: tuple[int, ...] = ()
    own: list[tuple[int, frozenset[int]]] = field(default_factory=list)
    electing: list[tuple[int, frozenset[int]]] = field(default_factory=list)
    newest_since: int = -1
    settled: tuple[frozenset[int], int] = (frozenset(), 0)
    before: AgentState | None = None
    stopped: bool = False
    expected: int = 0
    started: bool = False
    due: list[int] = field(default_factory=list)
    laws: dict[tuple[int, int], tuple[float, ...]] = field(default_factory=dict)
    spoke: int = -1
    quiet: int = 0


class TellEachOther(Property):
    """All that robots without coordinators promise each other."""

    name = PASSED_ON
    statement = STATEMENTS[PASSED_ON]

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        case, scenario, clock = facts.case, facts.scenario, facts.clock
        self._names, self._ids = case.robot_names, tuple(range(1, case.robots + 1))
        self._rank = {name: rank for rank, name in enumerate(self._names)}
        self._robots = {name: self._new(name) for name in self._names}
        self._links = lockstep.links(scenario)
        self._constants = [(c.kind, c.mass, c.damping) for c in configure.agent_configs(scenario, clock)]
        self._published: dict[tuple[int, int], list[tuple[int, float, float]]] = {}
        self._planes: dict[int, list[PlaneState]] = {}
        self._read: dict[tuple[int, bytes], Told] = {}
        self._reset_in: dict[int, int] = {}
        self._guard = min(facts.age + facts.ahead, clock.steps(GUARD_MOST))
        self._late = any(fault.kind in {"slow", "late", "again"} for fault in case.faults)
        self._intruder = any(fault.kind == "impostor" for fault in case.faults)
        self._settled = clock.steps(SETTLED)
        self.published = {
            AGENT_STATE: self._state,
            PLANE_STATE: self._plane,
            RELAY: self._relay,
            ABSTRACT_STATE: self._speaks,
        }
        self.heard = {PLANE_STATE: self._hear_plane, relay_topic(PARENT): self._hear_plane}
        self.heard |= {relay_topic(robot): self._hear for robot in self._ids}

    def _new(self, name: str) -> _Robot:
        robots = len(self._names)
        return _Robot(
            self._rank[name], [-1] * robots, [{} for _ in range(robots)], self.facts.now, electing=[(-1, frozenset())]
        )

    def begins(self, node: str) -> None:
        if node in self._robots:
            self._robots[node] = self._new(node)

    def resumes(self, node: str) -> None:
        if (robot := self._robots.get(node)) is not None:  # how old what it knows is, it does not know any longer
            robot.known = [-1] * len(self._ids)
            robot.told.clear()
            robot.due.clear()
            robot.plane = robot.summed = -1
            robot.before, robot.expected, robot.resumed = None, 0, self.facts.now

    def told(self, node: str, command: str) -> None:
        robot = self._robots.get(node)
        if robot is None:
            return
        robot.expected = 0
        if command not in {"stop", "reset"}:
            return
        step = self.facts.step_of(node)
        for name in ("orders", "most"):
            known: Orders = getattr(robot, name)
            new = max(*known, step) if command == "stop" else max(step, *known, known.stop + self._guard + 1)
            if command == "reset" and known.stop < 0:
                new = max(known.reset, step)
            setattr(robot, name, known._replace(**{command: new}))
            if command == "reset" and node not in self.facts.wrong:
                self._reset_in[new] = step
        robot.ordered = self.facts.now
        robot.ordering = True

    def _break(self, name: str, node: str, text: str) -> BrokenError:
        return BrokenError(name, node, text)

    # Who can be relied on

    def _sure(self, name: str) -> bool:
        """Return whether what a node says is certainly taken: its clock was never wrong, and it has long been there."""
        facts = self.facts
        if name in facts.wrong:
            return False
        again = facts.fleet.nodes[name].started > 1
        return not again or (not self._late and facts.now - facts.started[name] > 4 * facts.state_age * facts.period)

    # What is published

    def _plane(self, node: str, state: PlaneState) -> None:
        self._planes.setdefault(state.step, []).append(state)

    def _state(self, node: str, state: AgentState) -> None:
        robot, rank = self._robots[node], self._rank[node]
        status = state.status | (FOLLOWS if state.broadcast_step != NEVER else 0)
        self._published.setdefault((rank, state.step), []).append((status, state.position, state.velocity))
        if node not in self.facts.wrong:
            self._follows(node, robot, state)
        robot.before = state
        robot.stopped = 0 <= robot.orders.stop >= robot.most.reset - self._guard
        self._learn(robot, rank, state.step, sure=True)
        robot.introduced.add(rank)

    def _follows(self, node: str, robot: _Robot, state: AgentState) -> None:
        """Check whether a robot may follow what it follows, or may stop if it does."""
        facts, before, used = self.facts, robot.before, state.broadcast_step
        if before is None:
            return
        if used == NEVER:
            if robot.expected >= 3 and state.status == Status.SAFE_STOP:
                text = f"stops in step {before.step}, although it hears a majority, the plane and no STOP"
                raise self._break(COUNTED, node, text)
            robot.expected = robot.expected + 1 if self._is_expected(node, robot, state) else 0
            return
        robot.expected = robot.expected + 1 if self._is_expected(node, robot, state) else 0
        if robot.stopped:
            text = f"moves in step {before.step}, but has heard of a STOP of step {robot.orders.stop}"
            raise self._break(ORDERED, node, text)
        if not -facts.ahead <= before.step - used <= facts.age:
            text = f"moves in step {before.step} on what it computed for step {used}"
            raise self._break(SUMMED, node, text)
        if used not in robot.planes:
            raise self._break(SUMMED, node, f"follows step {used}, of which it has no state of the plane")
        hears, counted = self._hears(robot, used, surely=False), self._electorates(robot, before.step - used)
        if not any(self._majority(hears, of) for of in counted):
            told = " or ".join(map(self._named, dict.fromkeys(counted)))
            text = f"follows step {used}, in which it hears no majority: {self._named(hears)} of {told}"
            raise self._break(COUNTED, node, text)
        lower = (steps for rank, steps in enumerate(robot.may) if rank < robot.rank)
        is_lowest = not any(of >= used - facts.state_age for steps in lower for of in reversed(steps))
        robot.quiet = robot.quiet + 1 if is_lowest and used > robot.spoke else 0
        if robot.quiet > _QUIET:
            text = (
                f"follows step {used}, and hears no robot of a lower id, but has published no sums since {robot.spoke}"
            )
            raise self._break(SUMMED, node, text)

    def _electorates(self, robot: _Robot, ago: int = 0) -> list[frozenset[int]]:
        """Return the ranks that may have counted since so many steps ago."""
        return [of for _, of in robot.own[-3 - max(0, ago) :]] or [frozenset(range(len(self._ids)))]

    def _majority(self, there: Collection[int], counted: Collection[int]) -> bool:
        inside = len({*there} & {*counted})
        return 2 * inside > len(counted) or (2 * inside == len(counted) and min(counted, default=-1) in there)

    def _hears(self, robot: _Robot, step: int, *, surely: bool) -> frozenset[int]:
        """Return the ranks that a robot hears as it sums up a step: within twice the age limit, and not left."""
        oldest = step - 2 * self.facts.state_age
        if surely:
            summed = robot.sums.get(step)
            known, left = (robot.known, self._left(robot)) if summed is None else (summed.known, summed.left)
            return frozenset(r for r, of in enumerate(known) if of >= max(1, oldest) and r not in left)
        return frozenset(
            r
            for r, steps in enumerate(robot.may)
            if any(of >= oldest and not self._only_left(r, of) for of in reversed(steps))
        )

    def _left(self, robot: _Robot) -> frozenset[int]:
        """Return the ranks of those that may have left as far as a robot knows."""
        return frozenset(r for r, of in robot.left.items() if of >= robot.known[r])

    def _may_have_left(self, rank: int, step: int) -> bool:
        return any(status == Status.LEFT for status, *_ in self._published.get((rank, step), ()))

    def _only_left(self, rank: int, step: int) -> bool:
        said = self._published.get((rank, step), ())
        return bool(said) and all(status == Status.LEFT for status, *_ in said)

    def _is_expected(self, node: str, robot: _Robot, state: AgentState) -> bool:
        """Return whether a robot must follow with its next decisions."""
        facts, step = self.facts, state.step
        if self._intruder or self._late or facts.moving_from > facts.now or not facts.is_sound(node):
            return False
        resets = RESET_LASTS * 1e9 + 4 * facts.period
        if 0 <= robot.most.stop >= robot.orders.reset - self._guard or facts.now - robot.ordered < resets:
            return False
        if robot.orders != robot.most or len(robot.own) < 2 or not robot.started or state.status == Status.LEFT:
            return False
        return robot.plane >= max(robot.summed, step - facts.age // 2) and all(
            self._majority(self._hears(robot, of, surely=True), counted)
            for of in robot.sums
            if step - facts.age <= of < step
            for counted in self._electorates(robot)
        )

    def _speaks(self, node: str, message: AbstractState) -> None:
        robot = self._robots[node]
        robot.spoke = message.step
        summed = robot.sums.get(message.step)
        if summed is None or node in self.facts.wrong:
            return
        oldest = message.step - self.facts.state_age
        lower = [r for r in range(robot.rank) if summed.known[r] >= max(1, oldest) and r not in summed.left]
        if lower:
            text = f"speaks for all in step {message.step}, although it hears robot {self._ids[lower[0]]}"
            raise self._break(SUMMED, node, text)
        counted = sum(of >= 0 and r not in summed.left for r, of in enumerate(summed.known))
        if message.agent_count < counted:
            text = f"counts {message.agent_count} robots in step {message.step}, and has heard of {counted}"
            raise self._break(SUMMED, node, text)

    # What is heard

    def _told(self, relay: Relay) -> Told:
        place = relay.step, relay.content
        told = self._read.get(place)
        if told is None:
            if len(self._read) > 400:
                self._read.clear()
            told = self._read[place] = read(relay, len(self._ids))
        return told

    def _learn(self, robot: _Robot, rank: int, step: int, *, sure: bool) -> None:
        may = robot.may[rank]
        may.pop(step, None)  # in the order in which they are learnt: after a clock was set back, lower ones are newer
        may[step] = None
        if self._may_have_left(rank, step):
            robot.left[rank] = max(robot.left.get(rank, -1), step)
        if len(may) > 200:
            for old in [*may][:-100]:
                del may[old]
        if sure:
            robot.known[rank] = max(robot.known[rank], step)

    def _hear_plane(self, node: str, parcel: Parcel) -> None:
        message, robot = parcel.message, self._robots.get(node)
        if robot is None or not parcel.sender or message is None:
            return
        plane = read_plane(message)[0] if isinstance(message, Relay) else message
        self._measure(node, robot, plane.step, sure=self._sure(PLANE))

    def _measure(self, node: str, robot: _Robot, step: int, *, sure: bool) -> None:
        """Note that a robot has a state of the plane, for which it sums up if it is newer than those before."""
        facts = self.facts
        now = facts.step_of(node)
        if not now - facts.age <= step <= now + facts.ahead:
            return
        robot.planes[step] = None
        if step > robot.summed:
            self._sum_up(robot, step)
            if sure:
                robot.due.append(step)
        if sure:
            robot.plane = max(robot.plane, step)

    def _sum_up(self, robot: _Robot, step: int) -> None:
        robot.summed = step
        robot.sums[step] = _Sum(tuple(robot.known), self._left(robot))
        for old in [old for old in robot.sums if old < step - 4 * self.facts.age]:
            del robot.sums[old]

    def _hear(self, node: str, parcel: Parcel) -> None:
        robot, relay = self._robots.get(node), parcel.message
        if robot is None or not parcel.sender or not isinstance(relay, Relay):
            return
        facts, receiver = self.facts, robot.rank + 1
        if self._links.loses(relay.step, relay.round, relay.agent_id, receiver):
            return
        now = facts.step_of(node)
        if relay.step > now + facts.ahead:
            return
        told, sender = self._told(relay), relay.agent_id
        long = facts.now - facts.stood_until(node) > 2 * facts.age * facts.period  # it may take senders for second ones
        sure = self._sure(parcel.sender) and node not in facts.wrong and long
        newest = robot.told.get(sender, (-1, None))[0]
        if newest < relay.step or not sure:
            robot.told[sender] = max(newest, relay.step), told if sure else None
        self._obey(robot, told, now, sure=sure)
        since, counted = told.electing
        if since <= now + facts.ahead:
            robot.electing.append((since, frozenset(_ranks(counted))))
            robot.newest_since = max(robot.newest_since, since) if sure else robot.newest_since
        lying = parcel.sender in facts.liars
        for motion in told.motions:
            step, rank = relay.step - motion.age, motion.rank
            if rank == robot.rank or (lying and not self._is_true(motion, step)):
                continue
            known = rank in robot.introduced or rank in told.constants
            certain = sure and known and not lying and self._sure(self._names[rank]) and step <= now + facts.ahead
            self._learn(robot, rank, step, sure=certain)
            if certain:
                robot.introduced.add(rank)
        if told.plane is not None and not (lying and told.plane not in self._planes.get(told.plane.step, ())):
            self._measure(node, robot, told.plane.step, sure=sure and not lying)

    def _obey(self, robot: _Robot, told: Told, now: int, *, sure: bool) -> None:
        if max(told.orders) > now + self.facts.ahead + self._guard + 1:
            sure = False
        if sure:
            joined = robot.orders.joined(told.orders)
            if joined != robot.orders:
                robot.ordered = self.facts.now
            robot.orders = joined
        robot.most = robot.most.joined(told.orders)

    # What is passed on

    def _relay(self, node: str, relay: Relay) -> None:
        if relay.agent_id == PARENT:
            return
        robot, told = self._robots[node], self._told(relay)
        turn = relay.step, relay.round
        if turn <= robot.last and node not in self.facts.wrong:
            raise self._break(PASSED_ON, node, f"sends relay {turn} after {robot.last}")
        robot.last = turn
        if len(relay.content) > LARGEST:
            text = f"sends {len(relay.content)} bytes in step {relay.step}, more than fit into a datagram"
            raise self._break(PASSED_ON, node, text)
        if node not in self.facts.liars:
            self._check_truth(node, robot, relay, told)
        if node in self.facts.wrong:
            return
        held = tuple(told.held.tolist())
        if not robot.ordering and relay.step - robot.summed > self.facts.state_age:
            self._sum_up(robot, relay.step)
        robot.ordering = False
        self._check_held(node, robot, relay, told, held)
        self._check_lacked(node, robot, relay, told, held)
        self._check_orders(node, robot, told)
        self._check_electing(node, robot, relay, told)
        self._check_sums(node, robot, told, held)
        oldest = relay.step - OLDEST
        robot.held = tuple(step if step > oldest else known for step, known in zip(held, robot.known, strict=True))
        robot.laws[told.law.begun, told.law.step] = told.law.memory
        if len(robot.laws) > 2 * self.facts.age:
            del robot.laws[next(iter(robot.laws))]

    def _is_true(self, motion: Motion, step: int) -> bool:
        """Return whether an author has published a state."""
        said = motion.status, motion.position, motion.velocity
        return said in self._published.get((motion.rank, step), ())

    def _check_truth(self, node: str, robot: _Robot, relay: Relay, told: Told) -> None:
        """Check that all that is passed on was published, and has been heard."""
        for motion in told.motions:
            step, author = relay.step - motion.age, self._ids[motion.rank]
            if not self._is_true(motion, step):
                text = f"tells of robot {author} in step {step} what that has never said"
                raise self._break(PASSED_ON, node, text)
            if step not in robot.may[motion.rank]:
                text = f"tells of robot {author} in step {step}, which it cannot have heard"
                raise self._break(PASSED_ON, node, text)
            if max(step, relay.step - OLDEST) != told.held[motion.rank]:
                text = f"tells of robot {author} in step {step}, but holds step {told.held[motion.rank]}"
                raise self._break(PASSED_ON, node, text)
        for rank, constants in told.constants.items():
            if tuple(constants) != self._constants[rank]:
                raise self._break(PASSED_ON, node, f"says that robot {self._ids[rank]} is {constants}")
        if told.plane is not None and told.plane not in self._planes.get(told.plane.step, ()):
            text = f"tells of the plane in step {told.plane.step} what that has never said"
            raise self._break(PASSED_ON, node, text)
        if told.sealed != self.facts.case.sealed:
            raise self._break(PASSED_ON, node, "sends a relay without signatures, or one with them")

    def _check_held(self, node: str, robot: _Robot, relay: Relay, told: Told, held: Sequence[int]) -> None:
        for rank, step in enumerate(held):
            known, author = robot.known[rank], self._ids[rank]
            if step < known and known > 0:
                text = f"holds step {step} of robot {author}, but has heard of step {known}"
                raise self._break(PASSED_ON, node, f"in step {relay.step} it {text}")
            if step > max(-1, relay.step - OLDEST) and step not in robot.may[rank]:
                text = f"holds step {step} of robot {author}, which it cannot have heard"
                raise self._break(PASSED_ON, node, f"in step {relay.step} it {text}")
        if told.plane_step < robot.plane and not self._intruder:
            text = f"holds step {told.plane_step} of the plane, but has heard of step {robot.plane}"
            raise self._break(PASSED_ON, node, f"in step {relay.step} it {text}")
        if told.plane_step >= 0 and told.plane_step not in robot.planes:
            text = f"holds step {told.plane_step} of the plane, which it cannot have heard"
            raise self._break(PASSED_ON, node, f"in step {relay.step} it {text}")

    def _check_lacked(self, node: str, robot: _Robot, relay: Relay, told: Told, held: Sequence[int]) -> None:
        """Check that neighbours get what they have told that they lack."""
        facts, passed = self.facts, {motion.rank for motion in told.motions}
        if held[robot.rank] >= 0 and robot.rank not in passed:
            raise self._break(PASSED_ON, node, f"does not tell its own state in step {relay.step}")
        record = RECORD + SIGNED * facts.case.sealed
        full = len(relay.content) > LARGEST - record - INTRODUCTION
        for neighbour, (heard, theirs) in robot.told.items():
            if theirs is None or relay.step - heard > facts.state_age:
                continue
            plane = told.plane_step
            if plane >= 0 and told.plane is None and theirs.plane_step < min(plane, heard - 1):
                text = f"has step {plane} of the plane and does not tell it, which robot {neighbour} lacks"
                raise self._break(PASSED_ON, node, f"in step {relay.step} it {text}")
            for rank, step in enumerate(held):
                lacks = step > max(-1, relay.step - OLDEST) and theirs.held[rank] < min(step, heard - 1)
                if lacks and rank not in passed and not full:
                    text = f"has step {step} of robot {self._ids[rank]} and does not tell it"
                    text = f"{text}, although robot {neighbour} holds step {theirs.held[rank]}"
                    raise self._break(PASSED_ON, node, f"in step {relay.step} it {text}")

    def _check_orders(self, node: str, robot: _Robot, told: Told) -> None:
        least, most = robot.orders, robot.most
        if told.orders.stop < least.stop or told.orders.reset < least.reset:
            text = f"tells {_said(told.orders)}, but has been told {_said(least)}"
            raise self._break(ORDERED, node, text)
        if told.orders.stop > most.stop or told.orders.reset > most.reset:
            text = f"tells {_said(told.orders)}, but has only been told {_said(most)}"
            raise self._break(ORDERED, node, text)

    def _check_electing(self, node: str, robot: _Robot, relay: Relay, told: Told) -> None:
        """Check who counts: what others have told, or whom a majority has heard for long."""
        facts = self.facts
        new = told.electing[0], frozenset(_ranks(told.electing[1]))
        hears = self._hears(robot, relay.step, surely=True)
        may = self._hears(robot, relay.step, surely=False)
        if (
            robot.settled[0] != hears
            or hears != may
            or any(not self._majority(hears, of) for of in self._electorates(robot))
        ):
            robot.settled = hears, relay.step
        lasting = relay.step - robot.settled[1]
        everybody = frozenset(range(len(self._ids)))
        before = robot.own[-1] if robot.own else (-1, everybody)
        if new[0] < before[0]:
            raise self._break(COUNTED, node, f"goes back to those that counted in step {new[0]} from {before[0]}")
        if new[0] == before[0] and new[1] != before[1] and (new[0] >= 0 or before[1] != everybody):
            text = f"counts robots {self._named(new[1])} as of step {new[0]}, and before {self._named(before[1])}"
            raise self._break(COUNTED, node, text)
        if new[0] < robot.newest_since:
            raise self._break(COUNTED, node, f"counts as of step {new[0]}, but was told of step {robot.newest_since}")
        if new != before and new not in robot.electing:
            self._check_elected(node, robot, relay, before, new, may)
        if lasting > self._settled + 2 * facts.age + 6 and new[1] != hears and robot.started and facts.is_sound(node):
            text = f"counts robots {self._named(new[1])}, but hears robots {self._named(hears)} for {lasting} steps"
            raise self._break(COUNTED, node, text)
        if new[0] > facts.counted[0]:
            facts.counted = new[0], frozenset(self._ids[rank] for rank in new[1])
        robot.electing = [new]
        robot.own = [*robot.own[-facts.age - 2 :], new]

    def _check_elected(
        self,
        node: str,
        robot: _Robot,
        relay: Relay,
        before: tuple[int, frozenset[int]],
        new: tuple[int, frozenset[int]],
        may: frozenset[int],
    ) -> None:
        """Check that a robot may have decided by itself who counts."""
        since, counted = new
        if since <= 0:  # at the start
            return
        text = f"decides that from step {since} on these robots count: {self._named(counted)}"
        may |= self._hears(robot, since, surely=False)
        if not counted <= may:
            raise self._break(COUNTED, node, f"{text}, but it hears {self._named(may)}")
        of = [known for _, known in (before, *robot.electing) if known]
        if of and not any(self._majority(counted, known) for known in of):
            raise self._break(COUNTED, node, f"{text}, but they are no majority of {self._named(before[1])}")
        changed = robot.settled[0] != counted or since - robot.settled[1] < self._settled - 4
        if self._settled > 8 and changed and counted != before[1] and self._was_otherwise(robot, counted, since):
            raise self._break(COUNTED, node, f"{text}, although it has not heard these for long")

    def _was_otherwise(self, robot: _Robot, counted: frozenset[int], since: int) -> bool:
        """Return whether a robot has certainly heard others, or not all of these, within the time before a step."""
        begin = since - self._settled + 4
        return any(self._hears(robot, of, surely=True) - counted for of in robot.sums if begin <= of < since - 1)

    def _check_sums(self, node: str, robot: _Robot, told: Told, held: Sequence[int]) -> None:
        """Check what a robot has computed since its relay before."""
        facts = self.facts
        computed = {answer.step: answer for answer in told.answers if answer.summed}
        for answer in computed.values():
            robot.started = True
            if answer.states is not None:
                self._check_sum(node, robot, answer, held)
        for answer in told.answers:
            if answer.since is not None and answer.step not in robot.planes:
                text = f"asks for step {answer.step}, of which it has no state of the plane"
                raise self._break(SUMMED, node, text)
        if robot.started and facts.is_sound(node) and not self._intruder:
            missing = [step for step in robot.due if step not in computed and step > min(computed, default=-1)]
            if missing and len(told.answers) < 12 and computed:
                text = f"has not summed up step {missing[0]}, of which it has a state of the plane"
                raise self._break(SUMMED, node, text)
        robot.due.clear()

    def _check_sum(self, node: str, robot: _Robot, answer: Answer, held: Sequence[int]) -> None:
        assert answer.states is not None
        summed = robot.sums.get(answer.step)
        least = summed.known if summed is not None else robot.held or (-1,) * len(held)
        left = self._left(robot) | (summed.left if summed is not None else frozenset())  # it may sum up a step late
        for rank, known in enumerate(least):
            used, author = answer.states.get(rank), self._ids[rank]
            if used is None:
                if known > 0 and rank not in left:
                    text = f"does not count robot {author}, of which it has heard step {known}"
                    raise self._break(SUMMED, node, f"in step {answer.step} it {text}")
                continue
            if used < known:
                text = f"uses step {used} of robot {author}, but has heard of step {known}"
                raise self._break(SUMMED, node, f"in step {answer.step} it {text}")
            if used > held[rank] and held[rank] > 0:
                text = f"uses step {used} of robot {author}, but holds step {held[rank]}"
                raise self._break(SUMMED, node, f"in step {answer.step} it {text}")
            if used == known and self._only_left(rank, used):
                text = f"counts robot {author}, which has left"
                raise self._break(SUMMED, node, f"in step {answer.step} it {text}")
        rests = self.facts.now - robot.resumed > 2 * self.facts.state_age * self.facts.period
        if answer.resting and rests and not self._intruder:
            resting = self._named(answer.resting)
            raise self._break(SUMMED, node, f"in step {answer.step} it takes robots {resting} for silent")

    def _named(self, ranks: Collection[int]) -> str:
        if len(ranks) == len(self._ids) > 2:
            return f"all {len(self._ids)}"
        return ", ".join(str(self._ids[rank]) for rank in sorted(ranks)) or "none"

    # When all is well

    @property
    def holders(self) -> list[str]:
        """The robots that live and certainly know of a STOP that holds."""
        facts = self.facts
        alive = [n for n in self._names if facts.fleet.nodes[n].activity is not None and n not in facts.wrong]
        known = {name: (self._robots[name].orders.stop, self._robots[name].most.reset) for name in alive}
        return [name for name, (stop, reset) in known.items() if 0 <= stop >= reset - self._guard]

    @property
    def stopped(self) -> bool:
        """Whether robots need a RESET: one says that a STOP holds, or has missed a RESET while its clock was wrong.

        Or the fleet started in STOP, and none knows of a RESET.
        """
        orders: list[Orders] = [one.orders for one in self._alive().values()]
        waits = self.facts.case.stopped and all(known.reset < 0 for known in orders)
        return waits or bool(self.facts.wrong) or any(known.stops(self._guard) for known in orders)

    def agree(self, before: float) -> None:
        """Raise an error unless all robots know the same orders and electorate, and their laws agree.

        `before` is the `spread` a while ago.
        """
        behaviours = self._alive()
        first = self._names[0]
        orders = {name: one.orders for name, one in behaviours.items()}
        for name, known in orders.items():
            if known != orders[first]:
                text = f"knows {_said(known)}, and {first} {_said(orders[first])}"
                raise self._break(ALIKE, name, text)
        everybody = " ".join(map(str, self._ids))
        for name, one in behaviours.items():
            values = dict(one.health(self.facts.fleet.now(name)).values)
            if values["counted robots"] != everybody:
                raise self._break(ALIKE, name, f"counts robots {values['counted robots']}")
            lacks = values["lacks robots"] and not self.facts.scenario.links.loss  # it may now and then, far away
            if values["hears a majority"] != "yes" or lacks:
                raise self._break(ALIKE, name, f"lacks robots {values['lacks robots']}")
        self._laws_agree(before, self._reset_in.get(orders[first].reset, -1))

    def _alive(self) -> dict[str, Any]:
        """Return the behaviours of the robots that live."""
        activities = ((name, self.facts.fleet.nodes[name].activity) for name in self._names)
        return {name: activity.engine.behaviour for name, activity in activities if activity is not None}

    def spread(self) -> float:
        """Return by how much what robots remember of their laws after a step differs, relative to 1 + its size."""
        told: dict[tuple[int, int], list[tuple[float, ...]]] = {}
        since = max(robot.last[0] for robot in self._robots.values()) - self.facts.age
        for robot in self._robots.values():
            for place, memory in robot.laws.items():
                if place[1] >= since and memory:
                    told.setdefault(place, []).append(memory)
        columns = (column for memories in told.values() for column in zip(*memories, strict=False))
        return max(((max(c) - min(c)) / (1.0 + max(map(abs, c))) for c in columns), default=0.0)

    def _laws_agree(self, before: float, reset_in: int) -> None:
        laws: dict[str, LawView] = {name: one.law for name, one in self._alive().items()}
        first = laws[self._names[0]]
        for name, law in laws.items():
            if law.begun != first.begun or abs(law.step - first.step) > self.facts.age:
                text = f"is at step {law.step} of a law begun at {law.begun}; the first at {first.step}, {first.begun}"
                raise self._break(ALIKE, name, text)
            if len(law.memory) != len(first.memory):
                raise self._break(ALIKE, name, "remembers nothing of its law")
            if law.begun <= reset_in:
                text = f"has a law that began in step {law.begun}, before the RESET that was ordered in step {reset_in}"
                raise self._break(ALIKE, name, text)
        all_hear = all(map(self.facts.links.senses, self._ids))
        most = max(APART if all_hear else PASSED_APART, before)
        if self.spread() > most:
            text = (
                f"has integrals that are {self.spread():.3g} apart from those of others; before they were {before:.3g}"
            )
            raise self._break(ALIKE, self._names[0], text)


def _ranks(bits: int) -> Iterator[int]:
    return (rank for rank in range(bits.bit_length()) if bits >> rank & 1)


def _said(orders: Orders) -> str:
    return f"STOP of step {orders.stop}, RESET of step {orders.reset}"

"""What must hold in a virtual fleet whatever happens to it, checked with everything that is published and heard.

The rules follow from docs/explanation/safety.md and standby.md, not from the code of the nodes: they know which
messages have reached a node and which faults are under way, and nothing of what is inside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from math import fsum, inf, isfinite
from typing import Any, NamedTuple

from tests.virtual.fleet import Parcel, VirtualFleet, Watcher
from tests.virtual.schedule import AGE, AHEAD, ALL, Case

from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_config.graph import CONTROLLER, PLANE, STANDBY_TOPICS, own_topic
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BASIS,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    NEVER,
    PLANE_STATE,
    REMOVALS,
    AbstractState,
    AgentState,
    AuxiliaryState,
    Basis,
    Broadcast,
    DesiredAbstractState,
    EventKind,
    Message,
    Mode,
    PlaneState,
    Source,
    Status,
    SwarmEvent,
    Topic,
)
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime.agent import RealtimeLaw
from swarmabs_core.realtime.base import Level
from swarmabs_core.robot_controller import RESET, STOPPED

CLEAN = {"crash", "idle", "leave", "pause", "cut", "skew"}
"""Faults of one of a pair of coordinators because of which no robot stops at all."""
GUARD_MOST = 0.5
"""Upper limit, s, of the time by which a RESET must be newer than a STOP."""
LATEST_RESET = 3.0
"""Age, s, up to which a RESET counts."""
LONGEST_STOP = 0.2
"""Time, s, for which robots may stop when one of a pair of coordinators has a fault."""
MAJORITY = 1.2
"""Time, s, for which robots without coordinators may stop when others have a fault."""
NODE_FAULTS = {"crash", "idle", "pause", "clock", "drift", "blind", "leave"}
"""Faults of a node itself."""
SPEAKERS = 20
"""Periods over which speakers are counted."""
EVERY = 16
"""Each command of so many is computed again; all are where two coordinators speak."""
FEWEST = 2
"""Number of robots without which the others cannot follow."""
LONG_AGO = -(2**62)
"""A time or step before all others."""
MOST_BACK = 2
"""Periods by which a clock may be set back without a robot forgetting what it has heard."""
MOST_ENTRIES = 3000
"""Entries of all containers of a node of a small fleet, whatever it has heard."""
SILENT = 5
"""Periods for which a robot or the plane may be silent: one whose clock is set back a little waits for it."""
MOST_LOST = 0.5
"""Share of the messages of a coordinator that may be lost so that robots get whole sets within the age limit."""
MOST_REFUSED = 40
"""Reports of refused messages of a node within ten seconds."""


class BrokenError(Exception):
    """A property does not hold: its name, the node concerned, and what is there instead."""

    def __init__(self, name: str, node: str, text: str) -> None:
        super().__init__(f"{name}: {node}: {text}")
        self.name = name
        self.node = node
        self.text = text


class Facts:
    """What is known of a run from outside: the fleet, its case, who is or was concerned by faults, and orders.

    Attributes
    ----------
    until : dict
        For each node the time, ns, until which a fault or its consequences concern it.
    odd : set
        Nodes whose clock was ever wrong, or which stood still; their steps and bodies may repeat or continue.
    coasting : set
        Force-driven robots without a measurement of their motion, now or before: these cannot brake.
    wrong : set
        Nodes whose clock was ever wrong.
    resumed : dict
        For nodes that stood still or were deactivated, the time, ns, at which they went on.
    counted : tuple
        The step since which robots without coordinators count for a majority, as they say, and the ids of these.
    liars : set
        Robots that pass on what others have not said.
    stood : dict
        For these, for how long, ns, they stood still the last time.
    removed : set
        Robots of which an operator has said that they were carried away.
    late_until : float
        Time, ns, until which there are other faults than those of `CLEAN`, or their consequences.
    started : dict
        For each node the time, ns, of its last start.
    moving_from : float
        Time, ns, from which all robots may be expected to follow; infinity while an order stops them.
    followed : set
        Robots that have followed since their last start.
    """

    def __init__(self, fleet: VirtualFleet, case: Case) -> None:
        self.fleet = fleet
        self.case = case
        self.scenario = configure.check_realtime(fleet.scenario)
        self.clock = fleet.clock
        self.links = lockstep.links(self.scenario)
        self.period = self.clock.period_ns
        self.age = self.state_age = AGE
        self.ahead = AHEAD
        configs = configure.agent_configs(self.scenario, self.clock)
        self.measurement_age = max(config.measurement_age_limit for config in configs) * 1e9
        self.until: dict[str, float] = dict.fromkeys(case.names, 0.0)
        self.odd: set[str] = set()
        self.wrong: set[str] = set()
        self._alike: set[str] = set()
        self.resumed: dict[str, int] = {}
        self.stood: dict[str, int] = {}
        self._still_since: dict[str, int] = {}
        self.moving_from = inf
        self.settles = (case.settles if case.paired else 1.0 + case.periods(10)) * 1e9
        self.started: dict[str, int] = {}
        self.followed: set[str] = set()
        self.coasting: set[str] = set()
        self.removed: set[int] = set()
        self.counted = -1, frozenset(range(1, case.robots + 1))
        self.liars: set[str] = set()
        self._sound: dict[str, float] = {}
        self._unsound: dict[str, int] = {}
        self.late_until = 0.0
        self._concerned: dict[str, int] = {}
        coordinators = {ALL, *case.coordinators}
        self._lossy = [
            fault
            for fault in case.faults
            if fault.kind == "loss" and fault.value >= MOST_LOST and coordinators.intersection(fault.ends[0].split(","))
        ]

    @property
    def now(self) -> int:
        return self.fleet.now_ns

    def step_of(self, node: str) -> int:
        """Return the step by a node's clock."""
        return self.clock.step(self.fleet.now(node))

    def begin(self, nodes: tuple[str, ...], kind: str) -> None:
        """Note that a fault of a kind begins to concern nodes."""
        if kind not in CLEAN:
            self.late_until = inf
        for node in nodes:
            self._concerned[node] = self._concerned.get(node, 0) + 1
            self.until[node] = inf
            if kind in NODE_FAULTS:
                self._unsound[node] = self._unsound.get(node, 0) + 1
                self._sound[node] = inf

    def end(self, nodes: tuple[str, ...], kind: str) -> None:
        """Note that it is over; they settle after a while."""
        if kind not in CLEAN:
            self.late_until = self.now + self.settles
        for node in nodes:
            self._concerned[node] -= 1
            if not self._concerned[node]:
                self.until[node] = self.now + self.settles
            if kind in NODE_FAULTS and node in self._unsound:
                self._unsound[node] -= 1
                if not self._unsound[node]:
                    self._sound[node] = self.now + self.settles

    def is_sound(self, node: str) -> bool:
        """Return whether a node itself has had no fault for long; its links may be bad."""
        return self._sound.get(node, 0.0) < self.now and (node not in self.wrong or node in self._alike)

    def goes_wrong(self, node: str, *, alike: bool = False) -> None:
        """Note that a clock is wrong, or that it was set back with all others, whose steps compare from now on."""
        self.odd.add(node)
        self.wrong.add(node)
        if alike:
            self._alike.add(node)
        else:
            self._alike.discard(node)

    def starts(self, node: str) -> None:
        """Note that a node starts."""
        self.started[node] = self.now
        self.followed.discard(node)
        self._still_since.pop(node, None)

    def resumes(self, node: str) -> None:
        """Note that a node goes on, if it stood still and nothing else holds it."""
        if node in self._still_since and self._runs(node):
            self.resumed[node], self.stood[node] = self.now, self.now - self._still_since.pop(node)

    def stands_still(self, node: str) -> None:
        """Note that a node stands still, or is deactivated."""
        self._still_since.setdefault(node, self.now)

    def stood_until(self, node: str) -> int:
        """Return until when, ns, a node stood still, also if it goes on only now; 0 if it never did."""
        return self.now if node in self._still_since else self.resumed.get(node, 0)

    def runs_since(self, node: str) -> float:
        """Return since when, ns, a node has run without standing still; infinity if it does not."""
        return max(self.started[node], self.resumed.get(node, 0)) if self._runs(node) else inf

    def _runs(self, node: str) -> bool:
        one = self.fleet.nodes[node]
        return one.activity is not None and one.activity.active and not one.paused

    def is_fine(self, node: str) -> bool:
        """Return whether no fault concerns a node, nor what is left of one."""
        return self.until[node] < self.now

    def follows(self, robot: str) -> str:
        """Return "always" if nothing excuses a robot that stops, "soon" if it may for a while, else an empty text."""
        if self.moving_from > self.now or not (self.is_fine(robot) and self.is_fine(PLANE)):
            return ""
        if self.case.each_robot:
            return "soon" if self._hears_most(robot) else ""
        pairs = [[self.is_fine(name) for name in pair] for pair in self.case.pairs]
        if any(fault.at <= self.now / 1e9 <= fault.end + self.settles / 1e9 for fault in self._lossy):
            return ""  # who is still heard leads on, and of each set a part may be lost
        fine = {*filter(self.is_fine, self.case.robot_names)}
        if not all(map(any, pairs)) or len(fine) < FEWEST:
            return ""
        if self.case.start == "wait" and len(fine) < self.case.robots and not fine & self.followed:
            return ""  # an observer that starts waits for all, unless the swarm is under way
        return "always" if all(map(all, pairs)) or self.late_until < self.now else "soon"

    def _hears_most(self, robot: str) -> bool:
        """Return whether a robot without coordinators hears most others, and the plane, past liars and faults."""
        names = self.case.robot_names
        fine = {number for number, name in enumerate(names, 1) if self.is_fine(name) and name not in self.liars}
        near = new = {names.index(robot) + 1}
        while new:
            new = {other for one in new for other in self.links.of(one)} & fine - near
            near = near | new
        starts_anew = self.case.start == "wait" and not any(names[number - 1] in self.followed for number in near)
        if starts_anew and len(near) < self.case.robots:  # whoever starts waits for all, unless the swarm is under way
            return False
        _, counted = self.counted
        most = 2 * len(near) > self.case.robots and 2 * len(near & counted) > len(counted)
        return most and any(map(self.links.senses, near))


class Property:
    """Something that always holds: `name` and `statement` tell people what; `published` and `heard` watch topics."""

    name = ""
    statement = ""

    def __init__(self, facts: Facts) -> None:
        self.facts = facts
        self.published: dict[Topic, Callable[[str, Any], None]] = {}
        self.heard: dict[Topic, Callable[[str, Parcel], None]] = {}

    def begins(self, node: str) -> None:
        """A node starts."""

    def resumes(self, node: str) -> None:
        """A node is activated that was deactivated."""

    def told(self, node: str, command: str) -> None:
        """An operator gives an order."""

    def period(self) -> None:
        """A period is nearly over; nodes with a right clock have done their work of it."""

    def broken(self, node: str, text: str) -> BrokenError:
        """Return the error with which this property is broken."""
        return BrokenError(self.name, node, text)


class _Robot:
    """What has reached a robot since its node started, as of its last published state."""

    def __init__(self) -> None:
        self.before: AgentState | None = None
        self.sets: dict[int, dict[tuple[Topic, bool], Message]] = {}
        self.stop: int | None = None
        self.reset = LONG_AGO
        self.writers: dict[bool, tuple[bytes, int]] = {}
        self.released = LONG_AGO
        self.held = 0
        self.new: list[tuple[bool, Topic, Message, bool, int]] = []
        self.clock = LONG_AGO
        self.forged: dict[tuple[int, Topic, bool], Message] = {}
        self.doubted: int | None = None
        self.age = 0
        self.count = 0
        self.unmeasured: list[float] = []


class ActsOnOneSet(Property):
    """The command of a robot comes from one set of broadcasts that has reached it, is fresh, and after no STOP."""

    name = "acts on one fresh set"
    statement = (
        "A robot moves only on broadcasts that it has received: all of one step, both sums from one observer, the "
        "desired state from one controller in mode RUN, not older than the age limit, and not after a STOP that no "
        "RESET followed, up to 3 s late."
    )

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._robots = {name: _Robot() for name in facts.case.robot_names}
        configs = configure.agent_configs(facts.scenario, facts.clock)
        self._laws = {agent_name(config.agent_id): RealtimeLaw(config) for config in configs}
        self._spoke: set[str] = set()
        self._guard = min(facts.age + facts.ahead, facts.clock.steps(GUARD_MOST))
        self._latest = max(facts.age, facts.clock.steps(LATEST_RESET))
        if facts.case.each_robot:  # they hear no broadcasts
            return
        self.published = {AGENT_STATE: self._state, EVENTS: self._event}
        for topic in (ABSTRACT_STATE, AUXILIARY_STATE, DESIRED_ABSTRACT_STATE):
            for variant in variants(topic):
                self.heard[variant] = partial(self._broadcast, topic, variant is not topic)

    def begins(self, node: str) -> None:
        if node in self._robots:
            self._robots[node] = _Robot()

    def _broadcast(self, topic: Topic, standby: bool, node: str, parcel: Parcel) -> None:  # noqa: FBT001
        robot, message = self._robots.get(node), parcel.message
        if robot is None or message is None:
            return
        stops = False
        if isinstance(message, DesiredAbstractState):
            stops = message.mode == Mode.STOP
            if standby not in robot.writers or robot.writers[standby][0] != parcel.writer:
                robot.writers[standby] = parcel.writer, self.facts.step_of(node)
            if message.mode == Mode.RESET and parcel.sender:
                step = self.facts.step_of(node)
                known = step - robot.writers[standby][1] > 3 * self.facts.age
                if known and step - self._latest <= message.step <= step + self.facts.ahead:
                    robot.released = max(robot.released, message.step)
        robot.new.append((standby, topic, message, not parcel.sender and not stops, self.facts.step_of(node)))

    def _state(self, node: str, state: AgentState) -> None:
        robot, facts = self._robots[node], self.facts
        before = robot.before
        if state.broadcast_step != NEVER:
            if before is None:
                raise self.broken(node, "moves in its first step, before it has decided anything")
            self._check(node, robot, before, state)
        if before is None or state.stamp != before.stamp:
            robot.unmeasured.clear()
        elif node not in facts.fleet.force_driven:  # a velocity moves it on while its sensor is silent
            robot.unmeasured.append(state.command * (state.step - before.step) * facts.clock.period)
        robot.before = state
        robot.age = facts.fleet.now(node) - state.stamp
        self._spoke.add(node)
        if robot.new:
            self._take(robot, facts.step_of(node))

    def period(self) -> None:
        """Check that a RESET has released the robots that have heard it, and no STOP after it."""
        for name, robot in self._robots.items():
            free = robot.stop is not None and robot.released - robot.stop > self._guard
            activity = self.facts.fleet.nodes[name].activity
            if not free or robot.forged or robot.new or activity is None or not self.facts.is_sound(name):
                robot.held = 0
                continue
            robot.held += 1
            if (
                robot.held == EVERY
                and f"safe stop: {STOPPED}" in activity.engine.behaviour.health(self.facts.fleet.now(name)).text
            ):
                text = f"is stopped by the STOP of step {robot.stop}, but has heard a RESET of step {robot.released}"
                raise self.broken(name, text)

    def _event(self, node: str, event: SwarmEvent) -> None:
        """Check that a robot does not take a RESET as effective too early."""
        robot = self._robots.get(node)
        if robot is None or event.kind != EventKind.SAFE_STOP or event.detail != RESET or node in self.facts.wrong:
            return
        if robot.stop is not None and robot.reset - robot.stop <= self._guard:
            text = f"takes the RESET of step {robot.reset} as effective, but has heard a STOP of step {robot.stop}"
            raise self.broken(node, f"{text} (needed: {self._guard + 1} steps later)")

    def _take(self, robot: _Robot, step: int) -> None:
        """Let what was heard since the last state count for the next decision."""
        for standby, topic, message, forged, heard in robot.new:
            of = message.step
            if heard < robot.clock - MOST_BACK:  # it forgets what it has heard by the clock of before
                robot.sets.clear()
                robot.forged.clear()
                stopped = robot.stop is not None and robot.reset - robot.stop <= self._guard
                robot.stop = heard if stopped else None
                robot.reset = robot.released = LONG_AGO
            robot.clock = heard
            if of > step + self.facts.ahead:
                continue
            if forged:
                robot.forged[of, topic, standby] = message
                if (known := robot.sets.get(of, {}).get((topic, standby))) is not None:
                    self._compare(robot, message, known, step)
                continue
            if topic is DESIRED_ABSTRACT_STATE and (mode := message.mode) != Mode.RUN:  # type: ignore[union-attr]
                if mode == Mode.STOP:
                    robot.stop = of if robot.stop is None else max(robot.stop, of)
                else:
                    robot.reset = max(robot.reset, of)
                continue
            robot.sets.setdefault(of, {}).setdefault((topic, standby), message)
            if robot.forged and (other := robot.forged.get((of, topic, standby))) is not None:
                self._compare(robot, other, message, step)
        robot.new.clear()
        if len(robot.sets) > 4 * (self.facts.age + self.facts.ahead):
            for old in [k for k in robot.sets if not step - 2 * self.facts.age <= k <= step + self.facts.ahead]:
                del robot.sets[old]

    def _compare(self, robot: _Robot, forged: Message, genuine: Message, step: int) -> None:
        """Let a robot doubt from a step on, if it can tell that somebody forges credible broadcasts."""
        credible = all(map(isfinite, forged)) and getattr(forged, "inertia", 0.0) >= 0.0
        if credible and forged != genuine and step - self.facts.age <= genuine.step:
            robot.doubted = step

    def _check(self, node: str, robot: _Robot, before: AgentState, state: AgentState) -> None:
        used, decided, facts = state.broadcast_step, before.step, self.facts
        if not -facts.ahead <= decided - used <= facts.age:
            text = f"moved in step {decided} on broadcasts of step {used}; {facts.age} steps is the age limit"
            raise self.broken(node, text)
        if facts.case.start == "wait" and len(self._spoke) < facts.case.robots:
            raise self.broken(
                node, f"moved in step {decided}, but {facts.case.robots - len(self._spoke)} robots never spoke"
            )
        if robot.age > facts.measurement_age:
            text = f"moved in step {decided} with a measurement of its motion that was {robot.age / 1e9:g} s old"
            raise self.broken(node, text)
        if robot.doubted is not None and not facts.case.paired and 0 <= decided - robot.doubted <= facts.age:
            text = (
                f"moved in step {decided}, but since step {robot.doubted} it knows two different broadcasts of a step"
            )
            raise self.broken(node, text)
        if robot.stop is not None and robot.reset - robot.stop <= self._guard:
            reset = "no RESET" if robot.reset < 0 else f"its newest RESET is of step {robot.reset}"
            text = f"moved in step {decided}, but has heard a STOP of step {robot.stop}, and {reset}"
            raise self.broken(node, f"{text} (needed: {self._guard + 1} steps later)")
        robot.count += 1
        if robot.sets.get(used, {}).keys() == _ONE_SET and robot.count % EVERY:
            return
        sets = self._sets(robot.sets.get(used, {}))
        if not sets:
            has = ", ".join(_said(key) for key in robot.sets.get(used, {})) or "nothing"
            text = f"moved in step {decided} on broadcasts of step {used}, of which it has received {has}"
            raise self.broken(node, text)
        if state.status == Status.ACTIVE:
            moved = fsum(robot.unmeasured)
            laws = [self._laws[node].decide(before.position, before.velocity, one, moved)[0].command for one in sets]
            if state.command not in laws:
                text = (
                    f"its command of step {decided} is {state.command:.9g}; the broadcasts of step {used} that it has "
                    f"received give {' or '.join(f'{law:.9g}' for law in laws)}"
                )
                raise self.broken(node, f"{text}{self._mixture(node, robot, before, state)}")

    def _mixture(self, node: str, robot: _Robot, before: AgentState, state: AgentState) -> str:
        """Return of which broadcasts that do not belong together a command comes, if it does, for people."""
        near = range(before.step - self.facts.age, before.step + self.facts.ahead + 1)
        heard = {topic: [] for topic in (ABSTRACT_STATE, AUXILIARY_STATE, DESIRED_ABSTRACT_STATE)}
        for step in near:
            for (topic, standby), message in robot.sets.get(step, {}).items():
                heard[topic].append((f"{_said((topic, standby))} of step {step}", message))
        for parts in product(*heard.values()):
            abstract, sums, desired = (message for _, message in parts)
            mixed = Broadcast(desired.stamp, desired.step, abstract, sums, desired)
            law = self._laws[node].decide(before.position, before.velocity, mixed, fsum(robot.unmeasured))
            if law[0].command == state.command:
                return f"; it follows from {', '.join(words for words, _ in parts)}"
        return ""

    @staticmethod
    def _sets(heard: dict[tuple[Topic, bool], Message]) -> list[Broadcast]:
        """Return the sets of one step that a robot may act on."""
        sets = []
        for observer, controller in product((False, True), repeat=2):
            keys = (ABSTRACT_STATE, observer), (AUXILIARY_STATE, observer), (DESIRED_ABSTRACT_STATE, controller)
            if all(key in heard for key in keys):
                abstract, sums, desired = (heard[key] for key in keys)
                sets.append(Broadcast(desired.stamp, desired.step, abstract, sums, desired))  # type: ignore[arg-type]
        return sets


_ONE_SET = {(topic, False) for topic in (ABSTRACT_STATE, AUXILIARY_STATE, DESIRED_ABSTRACT_STATE)}
"""What has been heard of a step in which only primaries have spoken."""


def _said(key: tuple[Topic, bool]) -> str:
    topic, standby = key
    return f"{topic.name}{' of the standby' if standby else ''}"


def variants(topic: Topic) -> Iterator[Topic]:
    """Yield a topic and that of the standby in its place, and those of single robots."""
    yield topic
    if topic in STANDBY_TOPICS:
        yield STANDBY_TOPICS[topic]
    if topic in {AGENT_STATE, EVENTS}:
        yield from (own_topic(topic, robot) for robot in range(1, 9))


class KeepsFollowing(Property):
    """A robot that no fault concerns, nor the coordinators, follows."""

    name = "keeps following"
    statement = (
        "A robot that no fault concerns follows, whatever happens to other robots, and also while one of a pair of "
        f"coordinators is lost; at most {LONGEST_STOP:g} s of safe stop if that one is late or its clock is wrong."
    )

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._stopped: dict[str, int] = {}
        longest = MAJORITY if facts.case.each_robot else LONGEST_STOP
        self._longest = max(longest, 10 * facts.clock.period) * 1e9
        self.published = {AGENT_STATE: self._state}

    def _state(self, node: str, state: AgentState) -> None:
        if state.status == Status.ACTIVE and state.broadcast_step != NEVER:
            self.facts.followed.add(node)
            self._stopped.pop(node, None)
            return
        expected = self.facts.follows(node)
        if not expected:
            self._stopped.pop(node, None)
            return
        since = self._stopped.setdefault(node, self.facts.now)
        lasting = self.facts.now - since
        if lasting > (self._longest if expected == "soon" else 3 * self.facts.period):
            what = f"is {Status(state.status).name} and does not move for {lasting / 1e9:.3f} s"
            others = "most robots are" if self.facts.case.each_robot else "one of each pair of coordinators is"
            why = f"it and {others} fine"
            raise self.broken(node, f"{what}, although {why}")


class OneLeads(Property):
    """Of a pair that no fault concerns one speaks."""

    name = "one leads"
    statement = "Of a pair of coordinators that no fault has concerned for a few seconds, one speaks, one is silent."

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._last: dict[str, int] = {}
        self._first: dict[tuple[str, ...], int] = {}
        if facts.case.paired:
            self.published = {ABSTRACT_STATE: self._spoke, DESIRED_ABSTRACT_STATE: self._spoke}

    def _spoke(self, node: str, message: Any) -> None:
        facts = self.facts
        if getattr(message, "mode", Mode.RUN) != Mode.RUN:
            return
        self._last[node] = facts.now
        (pair,) = (pair for pair in facts.case.pairs if node in pair)
        other = pair[1] if node == pair[0] else pair[0]
        inputs = (PLANE,) if pair[0] == CONTROLLER else facts.case.robot_names
        settled = facts.now - self._first.setdefault(pair, facts.now) > facts.settles  # it had nothing to say before
        both = settled and facts.is_fine(node) and facts.is_fine(other) and any(map(facts.is_fine, inputs))
        if both and facts.now - self._last.get(other, LONG_AGO) <= 2 * facts.period:
            raise self.broken(node, f"publishes step {message.step}, and so does {other}")


class SumsUpWhatItHears(Property):
    """The observer uses the newest state of each robot that has reached it, and forgets none."""

    name = "sums up what it hears"
    statement = (
        "An observer sums up the newest state of every robot that has reached it; one that is silent for the age limit "
        "counts as standing, one that has left does not count. Torque, inertia and their rates are sums over all that "
        "count, S0 to S3 over those that follow the law. It begins once all are there that it has to wait for, unless "
        "the swarm is under way. It passes on that a robot was carried away, for those that start later."
    )

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._newest: dict[str, dict[int, AgentState]] = {}
        self._arrived: dict[tuple[str, int], int] = {}
        self._twofold: dict[tuple[str, int], int] = {}
        self._counted: dict[str, tuple[int, int]] = {}
        if facts.case.each_robot:
            return
        self._newest = {name: {} for name in (PLANE, *facts.case.pairs[0])}
        self._standing: dict[str, dict[int, int]] = {name: {} for name in self._newest}
        self._silent: dict[str, set[int]] = {name: set() for name in self._newest}
        self._carried_away: dict[str, set[int]] = {name: set() for name in self._newest}
        self._used: dict[str, tuple[int, list[tuple[AgentState, bool]]]] = {}
        self.published = {BASIS: self._basis, ABSTRACT_STATE: self._sum, AUXILIARY_STATE: self._moments}
        for topic in variants(AGENT_STATE):
            self.heard[topic] = self._state
        self._untold: dict[str, set[int]] = {name: set() for name in self._newest}
        self.heard[REMOVALS] = self._removal
        self.published[REMOVALS] = lambda node, removal: self._untold[node].discard(removal.agent_id)
        self._begun: set[str] = set()
        self._under_way = False
        self.published[AGENT_STATE] = self._follows

    def _follows(self, node: str, state: AgentState) -> None:
        self._under_way |= state.broadcast_step != NEVER

    def begins(self, node: str) -> None:
        if node in self._newest:
            # One that has stood by may have seen them fall silent before it died, and its host remembers that.
            oldest = self.facts.step_of(node) - self.facts.state_age
            self._silent[node] |= {
                robot
                for robot, state in self._newest[node].items()
                if state.step < oldest and state.status != Status.LEFT
            }
            self._begun.discard(node)
            self._untold[node].clear()
            self._newest[node] = {}
            self._carried_away[node].clear()

    def resumes(self, node: str) -> None:
        """Let robots stand until they are heard again: a node does not know how old that is which it knows."""
        if node == PLANE or node not in self._newest:  # the plane takes robots for where they were
            return
        newest = self._newest[node]
        for robot, state in [*newest.items()]:
            if state.status != Status.LEFT:
                self._standing[node][robot] = state.step
                del newest[robot]

    def _state(self, node: str, parcel: Parcel) -> None:
        newest, state = self._newest.get(node), parcel.message
        if newest is None or not parcel.sender or not isinstance(state, AgentState):
            return
        before = newest.get(state.agent_id)
        if before is not None and state.step == before.step and state != before:  # its clock was set back
            self._twofold[node, state.agent_id] = state.step
        if (before is None or state.step > before.step) and state.step <= self.facts.step_of(node) + self.facts.ahead:
            newest[state.agent_id] = state
            self._arrived[node, state.agent_id] = self.facts.now
            fresh = state.step >= self.facts.step_of(node) - self.facts.state_age
            if fresh and self._standing[node].pop(state.agent_id, None) is not None:
                self._silent[node].add(state.agent_id)  # its host need not remember it

    def _removal(self, node: str, parcel: Parcel) -> None:
        """Let a robot have left that is silent, and was not heard after it was carried away."""
        newest, removal = self._newest[node], parcel.message
        assert removal is not None
        robot = removal.agent_id  # type: ignore[attr-defined]
        state, silent_before = newest.get(robot), self.facts.step_of(node) - self.facts.state_age
        if state is None and removal.step >= self._standing[node].get(robot, 0):
            if robot in self._standing[node].keys() | self._silent[node]:
                self._carried_away[node].add(robot)
            self._standing[node].pop(robot, None)
            self._silent[node].discard(robot)
        elif state is not None and state.step < silent_before and state.step <= removal.step:
            newest[robot] = state._replace(status=Status.LEFT)
            self._silent[node].discard(robot)
            self._arrived[node, robot] = self.facts.now
            if state.status != Status.LEFT and node != PLANE:
                self._untold[node].add(robot)

    def _basis(self, node: str, basis: Basis) -> None:
        if basis.source not in {Source.OBSERVER, Source.PLANE}:
            return
        facts, newest = self.facts, self._newest[node]
        if basis.source == Source.OBSERVER:
            self._counted[node] = basis.step, len(basis.agent_ids)
        self._used.pop(node, None)
        if node in facts.wrong:
            return
        used = dict(zip(basis.agent_ids, zip(basis.state_steps, basis.standing, strict=True), strict=True))
        lacks = facts.case.robots - len(used.keys() | newest.keys() | self._carried_away[node])
        begins = basis.source == Source.OBSERVER and node not in self._begun
        if begins and lacks and facts.case.start == "wait" and not self._under_way:
            raise self.broken(node, f"in step {basis.step} it begins without waiting for {lacks} robots")
        self._begun.add(node)
        for robot, (step, _) in used.items():
            if step > basis.step + facts.ahead:
                raise self.broken(node, f"in step {basis.step} it uses a state of robot {robot} of step {step}")
        known, silent = self._standing[node], self._silent[node]
        # The memory of the host knows those that stand on the plane.
        for robot in (known.keys() ^ used.keys()) - newest.keys() - (silent - known.keys()):
            what = "has forgotten" if robot in known else "counts"
            text = f"it {what} robot {robot}, which is{'' if robot in known else ' not'} known to stand on the plane"
            raise self.broken(node, f"in step {basis.step} {text}")
        silent.clear()
        known.clear()
        known.update((robot, step) for robot, (step, stands) in used.items() if stands)
        for robot, state in newest.items():
            name = agent_name(robot)
            # A node that has just started counts as a second sender until the one before it is forgotten; who stands
            # still forgets nobody. One that cannot brake may be off the plane, which nobody believes.
            since = max(facts.started[name], facts.stood_until(node))
            new = self._arrived[node, robot] - since <= 2 * facts.state_age * facts.period
            if name in facts.wrong or name in facts.coasting or new:
                continue
            if (state.status == Status.LEFT) == (robot in used):
                text = "has left, and still counts" if robot in used else "is on the plane, and does not count"
                raise self.broken(node, f"in step {basis.step} robot {robot} {text}")
            if robot not in used:
                if robot in self._untold[node]:
                    raise self.broken(node, f"has not passed on that robot {robot} was carried away")
                continue
            step, stands = used[robot]
            if step != state.step:
                text = f"it uses a state of step {step}, but has received one of step {state.step}"
                raise self.broken(node, f"in step {basis.step} of robot {robot}: {text}")
            if basis.source == Source.OBSERVER and bool(stands) != (basis.step - step > facts.state_age):
                text = f"it takes a state that is {basis.step - step} steps old as {'silent' if stands else 'fresh'}"
                raise self.broken(node, f"in step {basis.step} of robot {robot}: {text}")

        if basis.source == Source.OBSERVER:
            twofold = any(self._twofold.get((node, robot)) == step for robot, (step, _) in used.items())
            states = [] if twofold else [(newest.get(robot), *of) for robot, of in used.items()]
            known = [(state, bool(stands)) for state, step, stands in states if state and state.step == step]
            if len(known) == len(used):
                self._used[node] = basis.step, known

    def _sum(self, node: str, message: Any) -> None:
        step, count = self._counted.get(node, (-1, 0))
        if step != message.step or count != message.agent_count:
            text = f"it counts {message.agent_count} robots, and says that these sums are of {count}"
            raise self.broken(node, f"in step {message.step} {text}")
        if (used := self._used.get(node)) is None or used[0] != message.step:
            return
        gravity = self.facts.scenario.plane.gravity
        robots = [(state.mass, state.position, 0.0 if stands else state.velocity) for state, stands in used[1]]
        self._compare(
            node,
            message,
            torque=gravity * sum(m * p for m, p, _ in robots),
            inertia=sum(m * p * p for m, p, _ in robots),
            torque_rate=gravity * sum(m * v for m, _, v in robots),
            inertia_rate=2.0 * sum(m * p * v for m, p, v in robots),
        )

    def _moments(self, node: str, message: Any) -> None:
        if (used := self._used.get(node)) is None or used[0] != message.step:
            return
        robots = [
            (state.mass**2, state.position) for state, stands in used[1] if state.status == Status.ACTIVE and not stands
        ]
        s0, s1, s2 = (sum(mm * p**power for mm, p in robots) for power in range(3))
        self._compare(node, message, s0=s0, s1=s1, s2=s2, s3=s0 * s2 - s1 * s1)

    def _compare(self, node: str, message: Any, **sums: float) -> None:
        """Compare what a node has summed up with sums that are not computed by its code."""
        for name, expected in sums.items():
            if abs(getattr(message, name) - expected) > 1e-9:
                text = f"in step {message.step} its {name} is {getattr(message, name):g}; the states give {expected:g}"
                raise self.broken(node, text)


class AnswersThePlane(Property):
    """A controller asks for something only in answer to a state of the plane."""

    name = "answers the plane"
    statement = (
        "A controller in RUN publishes a desired state only for a step whose state of the plane has reached it, and is "
        "neither too old nor from the future."
    )

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._heard: dict[str, list[int]] = {}
        self._known: dict[str, dict[tuple[int, bool], Any]] = {}
        self._doubted: dict[str, int] = {}
        if facts.case.each_robot:  # they have states of the plane from each other
            return
        self._heard = {name: [] for name in facts.case.pairs[1]}
        self.published = {DESIRED_ABSTRACT_STATE: self._desired}
        self.heard = {PLANE_STATE: self._plane}

    def begins(self, node: str) -> None:
        if node in self._heard:
            self._heard[node] = []
            self._known.pop(node, None)
            self._doubted.pop(node, None)

    def _plane(self, node: str, parcel: Parcel) -> None:
        if node in self._heard and parcel.message is not None and parcel.sender:
            steps = self._heard[node]
            steps.append(parcel.message.step)
            del steps[:-50]
        if node in self._heard and parcel.message is not None:
            self._compare(node, parcel.message, forged=not parcel.sender)

    def _compare(self, node: str, state: Any, *, forged: bool) -> None:
        """Let a controller doubt from a step on, if it can tell that somebody forges credible states of the plane."""
        step, known = self.facts.step_of(node), self._known.setdefault(node, {})
        if abs(state.angle) > 3.2 or not step - self.facts.age <= state.step <= step + self.facts.ahead:
            return
        known[state.step, forged] = state
        other = known.get((state.step, not forged))
        if other is not None and other != state:
            self._doubted[node] = step
        if len(known) > 100:
            for old in [key for key in known if key[0] < step - self.facts.age]:
                del known[old]

    def _desired(self, node: str, message: Any) -> None:
        late = self.facts.step_of(node) - message.step
        if message.mode == Mode.RUN and not -self.facts.ahead <= late <= self.facts.age:
            raise self.broken(node, f"asks for step {message.step} in its step {message.step + late}")
        since = self._doubted.get(node, LONG_AGO)
        same = node not in self.facts.wrong  # otherwise its steps of then and now do not compare
        if same and message.mode == Mode.RUN and 0 <= message.step + late - since <= self.facts.age:
            raise self.broken(node, f"asks for step {message.step}, but knows since step {since} that states differ")
        if message.mode == Mode.RUN and message.step not in self._heard[node]:
            raise self.broken(node, f"asks for step {message.step}, of which it has no state of the plane")


class NoStepTwice(Property):
    """A node publishes each step once."""

    name = "no step twice"
    statement = "A node whose clock was never set publishes each step once, in order."

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._last: dict[tuple[str, str], int] = {}
        topics = (AGENT_STATE, PLANE_STATE, ABSTRACT_STATE, AUXILIARY_STATE)
        self.published = {topic: partial(self._said, topic.name) for topic in topics}

    def begins(self, node: str) -> None:
        for key in [key for key in self._last if key[0] == node]:
            del self._last[key]

    def _said(self, topic: str, node: str, message: Message) -> None:
        before = self._last.get((node, topic), -1)
        if message.step <= before and node not in self.facts.odd:
            raise self.broken(node, f"publishes step {message.step} of {topic} after step {before}")
        self._last[node, topic] = message.step


class KeepsSpeaking(Property):
    """A robot and the plane say in each period where they are, also if their clock is set."""

    name = "keeps speaking"
    statement = f"A robot that has not left, and the plane, are silent for {SILENT} periods at most while they run."

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._last: dict[str, int] = {}
        self.published = {AGENT_STATE: self._said, PLANE_STATE: self._said}

    def _said(self, node: str, message: AgentState | PlaneState) -> None:
        left = isinstance(message, AgentState) and message.status == Status.LEFT
        self._last[node] = 2**62 if left else self.facts.now

    def told(self, node: str, command: str) -> None:
        if command == "join":
            self._last[node] = self.facts.now

    def begins(self, node: str) -> None:
        self._last.pop(node, None)

    resumes = begins

    def period(self) -> None:
        """Look for those that are silent."""
        for node, last in self._last.items():
            lasting = self.facts.now - max(last, self.facts.runs_since(node))
            if self.facts.step_of(node) < SILENT:  # its clock shows a time before the first step, or did so
                self._last[node] = max(last, self.facts.now)
            elif lasting > SILENT * self.facts.period:
                raise self.broken(node, f"runs, and says nothing for {lasting / 1e9:.3f} s")


class StaysInItsLane(Property):
    """No robot leaves its lane or exceeds its limits."""

    name = "stays in its lane"
    statement = (
        "A robot that can brake, which one whose clock is set back cannot for a period, and whose base stops when "
        "commands cease, stays in its lane; no number is infinite."
    )

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        scenario = facts.scenario
        self._lane = max(0.0, 0.5 * scenario.plane.length - scenario.realtime.lane_margin) + 1e-9
        self.published = {AGENT_STATE: self._state}

    def _state(self, node: str, state: AgentState) -> None:
        if not isfinite(state.position) or not isfinite(state.command):
            raise self.broken(node, f"is at {state.position} m with command {state.command}")
        facts = self.facts
        if abs(state.position) > self._lane and node not in facts.coasting | (facts.wrong & facts.fleet.force_driven):
            raise self.broken(node, f"is at {state.position:.6f} m; its lane ends at {self._lane:.6f} m")


class ReportsSparingly(Property):
    """Refused messages do not flood the events."""

    name = "reports sparingly"
    statement = f"A node reports at most {MOST_REFUSED} times in ten seconds that it refuses messages."

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._times: dict[str, list[int]] = {}
        self.published = {EVENTS: self._event}

    def _event(self, node: str, event: SwarmEvent) -> None:
        if event.kind != EventKind.REFUSED or node in self.facts.odd:
            return
        times = self._times.setdefault(node, [])
        times.append(self.facts.now)
        while times[0] < self.facts.now - 10**10:
            del times[0]
        if len(times) > MOST_REFUSED:
            raise self.broken(node, f"has reported {len(times)} refusals in ten seconds, the last: {event.detail}")


class Speech(NamedTuple):
    """A message with its node and the time, ns, of its publication."""

    time: int
    node: str
    message: Message


class Ending(Watcher):
    """What was said lately, and whether all is well."""

    name = "recovers"
    statement = (
        "When all faults are over, all robots follow within a few seconds, one of each pair of coordinators speaks, "
        "all robots are counted, and every node reports that it is well; or, after a STOP, nobody moves until a RESET."
    )

    def __init__(self, facts: Facts) -> None:
        self._facts = facts
        self._recent: list[Speech] = []
        self._kinds = {ABSTRACT_STATE, AUXILIARY_STATE, DESIRED_ABSTRACT_STATE, AGENT_STATE, PLANE_STATE}

    def published(self, node: str, topic: Topic, message: Message, data: bytes) -> None:
        if topic in self._kinds:
            self._recent.append(Speech(self._facts.now, node, message))
            if len(self._recent) > 8000:
                self._prune()

    def _prune(self) -> None:
        oldest = self._facts.now - SPEAKERS * self._facts.period
        self._recent = [said for said in self._recent if said.time >= oldest]

    def _newest(self, kind: type[Message]) -> dict[str, Any]:
        oldest = self._facts.now - 3 * self._facts.period
        return {
            said.node: said.message for said in self._recent if isinstance(said.message, kind) and said.time > oldest
        }

    def _broken(self, node: str, text: str) -> BrokenError:
        return BrokenError(self.name, node, text)

    def all_is_well(self) -> None:
        """Raise an error unless the whole fleet runs."""
        self._prune()
        facts, case = self._facts, self._facts.case
        states = self._newest(AgentState)
        for name in case.robot_names:
            if name not in states:
                raise self._broken(name, "says nothing")
            state = states[name]
            if state.status != Status.ACTIVE or state.broadcast_step == NEVER:
                health = self._health(name)
                raise self._broken(name, f"does not follow: {health.text}")
        pairs = case.pairs or (case.robot_names, case.robot_names)
        for kind, pair in zip((AbstractState, DesiredAbstractState), pairs, strict=True):
            spoke = [said for said in self._recent if isinstance(said.message, kind)]
            speakers = sorted({said.node for said in spoke})
            if len(speakers) != 1:
                raise self._broken(" and ".join(pair), f"{' and '.join(speakers) or 'nobody'} of them speaks")
            lossy = case.each_robot and facts.scenario.links.loss  # who speaks may not hear each state of the plane
            if len(spoke) < (SPEAKERS // 4 if lossy else SPEAKERS - 2):
                raise self._broken(speakers[0], f"speaks in {len(spoke)} of {SPEAKERS} periods")
        told = next(said for said in reversed(self._recent) if isinstance(said.message, AbstractState))
        if told.message.agent_count != case.robots:
            raise self._broken(told.node, f"counts {told.message.agent_count} of {case.robots} robots")
        squares = sum(agent.mass * agent.mass for agent in facts.scenario.agents)
        for node, sums in self._newest(AuxiliaryState).items():
            if abs(sums.s0 - squares) > 1e-9:
                raise self._broken(node, f"sums up followers of {sums.s0:.6g} kg^2, all are {squares:.6g} kg^2")
        if not self._newest(PlaneState):
            raise self._broken(PLANE, "says nothing")
        for name in case.names if case.law == "pd" else case.robot_names:  # another law may leave the plane at its end
            health = self._health(name)
            # How long swarm and plane need to move is not a matter of who follows whom.
            excused = "a second sender" in health.text or "end stop" in health.text
            if health.level > Level.OK and not excused:
                raise self._broken(name, f"reports: {health.text}")

    def nobody_moves(self, since: float, why: str) -> None:
        """Raise an error if a robot moves, or a controller lets it, although the swarm was stopped at a time, ns.

        A controller that started later and leads in RUN may not have heard of it, nor a robot.
        """
        started = self._facts.started
        unaware = {name for name in self._facts.case.names if started[name] > since}
        for name, desired in self._newest(DesiredAbstractState).items():
            if desired.mode != Mode.STOP and name not in unaware:
                raise BrokenError("STOP wins", name, f"publishes {Mode(desired.mode).name}, although {why}")
        for name, state in self._newest(AgentState).items():
            if state.broadcast_step != NEVER and name not in unaware:
                raise BrokenError("STOP wins", name, f"moves, although {why}")

    def memory_is_bounded(self) -> None:
        """Raise an error if a node has kept too much."""
        for name, node in self._facts.fleet.nodes.items():
            if node.activity is not None:
                entries = entries_of(node.activity.engine.behaviour)
                if entries > MOST_ENTRIES:
                    raise BrokenError("memory is bounded", name, f"keeps {entries} entries")

    def _health(self, name: str) -> Any:
        activity = self._facts.fleet.nodes[name].activity
        assert activity is not None
        return activity.engine.behaviour.health(self._facts.fleet.now(name))


def entries_of(thing: object) -> int:
    """Return the number of entries of all containers that an object holds."""
    seen: set[int] = set()
    stack, total = [thing], 0
    while stack:
        one = stack.pop()
        if id(one) in seen or isinstance(one, (str, bytes, int, float, bool, type(None), type)) or callable(one):
            continue
        seen.add(id(one))
        if isinstance(one, dict):
            total += len(one)
            stack += one.values()
        elif isinstance(one, (list, set, frozenset, tuple)) or type(one).__name__ == "deque":
            total += 0 if isinstance(one, tuple) else len(one)
            stack += one  # type: ignore[misc]
        else:
            names = [n for kind in type(one).__mro__ for n in getattr(kind, "__slots__", ())]
            stack += [getattr(one, n) for n in names if hasattr(one, n)]
            stack += list(getattr(one, "__dict__", {}).values())
    return total

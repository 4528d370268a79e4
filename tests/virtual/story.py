"""A case and what comes of it: the fleet, the faults at their times, and whether all properties hold."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache, partial
from math import inf, nan
from pathlib import Path
from traceback import extract_tb
from typing import Any, NamedTuple, Protocol

from tests.swarmabs_core.helpers import builtin
from tests.virtual.checks import Checks
from tests.virtual.fleet import EPOCH, Parcel, VirtualFleet, Watcher
from tests.virtual.lies import VirtualSeals, falsified, forged_relays
from tests.virtual.properties import LONG_AGO, BrokenError, Ending, Facts
from tests.virtual.recorders import FleetBags
from tests.virtual.schedule import (
    AGE,
    AHEAD,
    ALL,
    COMMANDS,
    FORGED,
    LIAR,
    LINKS,
    RESET_LASTS,
    SET_BACK,
    TAKEOVER,
    Case,
    Fault,
    Tell,
    number_of,
    untold,
)
from tests.virtual.weather import Weather

from swarmabs_config.graph import OBSERVER, PLANE
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import encode
from swarmabs_core.events import EventCode
from swarmabs_core.messages import (
    NEVER,
    PARENT,
    REMOVALS,
    TOPIC_OF,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    Message,
    Mode,
    PlaneState,
    Relay,
    Removal,
    Status,
    SwarmEvent,
    Topic,
)
from swarmabs_core.nodes import ROBOT_PREFIX
from swarmabs_core.realtime.envelope import LATENCY

STARTS = 2.1
"""Time, s, at which an operator resets a fleet that starts in STOP."""
NEARLY = 0.95
"""Share of a period after which all have done their work of it."""
FOREIGN = b"a stranger's GID"
_MILD = {"loss": 0.05, "slow": 0.5, "late": 0.5}
"""By how much (of periods, for times) a whole network may be bad without any effect on who follows."""


@cache
def scenario_of(robots: int, hertz: int, start: str, coordination: str, links: str = "{}", law: str = "pd") -> Scenario:
    """Return the scenario of a fleet; its limits are as many periods as those of the default at 100 Hz.

    Below 20 Hz the fleet and the plane are slower by as much.
    """
    period, pace = 1.0 / hertz, min(1.0, hertz / 20)
    gains = {"k": 10.0 * pace, "kp": 10.0 * pace**2, "kd": 5.0 * pace}
    agents = []
    for number in range(1, robots + 1):
        side = 1.0 if number % 2 else -1.0
        body = "kind: double_integrator, damping: 0.6" if number % 3 else "kind: single_integrator"
        agents.append(
            f"{{id: {number}, {body}, mass: {0.3 + 0.05 * number:g}, position: {side * (0.1 + 0.03 * number):g}}}"
        )
    ages = ", ".join(f"{name}_age_limit: {AGE * period:g}" for name in ("broadcast", "state", "plane"))
    limits = f"{ages}, clock_tolerance: {AHEAD * period:g}, takeover_after: {TAKEOVER * period:g}, start: {start}"
    return builtin(
        "pd_het_4",
        f"swarm.agents=[{', '.join(agents)}]",
        *(f"swarm.gains.{name}=[{gain:g}, {gain:g}]" for name, gain in gains.items()),
        *([f"controller.gains=[{3.1623 * pace**2:g}, {3.2859 * pace:g}]"] if law == "pd" else []),
        f"step={period:g}",
        f"realtime={{{limits}}}",
        f"coordination={coordination}",
        f"links={links}",
        f"controller.type={law}",
        "plane.end_stop=0.5",
        "manifold.torque_max=2",
        "duration=10",
    ).resolved()


class Result(NamedTuple):
    """What has come of a case: what is broken, if anything, and at which time, s."""

    broken: BrokenError | None
    time: float


class Happening(Protocol):
    """A case that happens: how long it has, s, and what checks it."""

    @property
    def time(self) -> float: ...

    def check(self) -> None: ...


def outcome(story: Happening) -> Result:
    """Let everything happen; return what comes of it."""
    try:
        story.check()
    except BrokenError as broken:
        return Result(broken, story.time)
    except Exception as error:  # noqa: BLE001 - no node may fail, whatever happens
        last = extract_tb(error.__traceback__)[-1]
        where = f" in {Path(last.filename).name}, line {last.lineno}, {last.name}"
        return Result(BrokenError("no node fails", "a node", f"{type(error).__name__}: {error}{where}"), story.time)
    return Result(None, story.time)


class Story(Watcher):
    """Lets a case happen. `watchers` see everything, too; `tell` is told what is done to whom."""

    def __init__(self, case: Case, watchers: Iterable[Watcher] = (), tell: Tell = untold) -> None:
        self.case = case
        coordination = "each_robot" if case.each_robot else "central"
        scenario = scenario_of(case.robots, case.hertz, case.start, coordination, case.links, case.law)
        self.weather = Weather(case.seed, ("", *case.names))
        mode = Mode.STOP if case.stopped else Mode.RUN
        self.fleet = fleet = VirtualFleet(
            scenario,
            seed=case.seed,
            network=self.weather,
            start_mode=mode,
            own_topics=case.own_topics,
            paired=case.paired,
            identified=True,
            watchdog=LATENCY,
            kept=False,
            seals={author: VirtualSeals(author) for author in (PARENT, *range(1, case.robots + 1))}
            if case.sealed
            else None,
        )
        self.facts = Facts(fleet, case)
        self.ending = Ending(self.facts)
        self._checks = Checks(self.facts)
        self._tell = tell
        self._holders: set[str] = set()
        self._stopped_at: str | None = None
        self._stopped_since = 0
        self._told_at = LONG_AGO
        self._led: str | None = None  # who has published RUN last, unless it was to hand over
        self._follow_by = float("inf")
        self._left: set[str] = set()
        self._ordered = False
        self._calm = not case.each_robot
        self._back = 0.0
        self._following: set[str] = set()
        self._robots = case.robot_names
        self.bags = FleetBags(fleet, case) if case.recorded else None
        recorders = () if self.bags is None else self.bags.recorders
        fleet.watch(*watchers, *recorders, self._checks, self.ending, self)
        for node in fleet.nodes:
            for watcher in fleet.watchers:
                watcher.begins(node)
        for fault in case.faults:
            fleet.later(fault.at, partial(self._begin, fault))
        fleet.later(NEARLY * fleet.clock.period, self._period)

    @property
    def time(self) -> float:
        """The time since the beginning, s."""
        return self.fleet.time

    def check(self) -> None:
        """Let everything happen; raise an error if a property does not hold."""
        try:
            self._happen()
            if self.bags is not None:
                self.bags.check(
                    explained=not any(fault.kind in {"clock", "skew", "drift"} for fault in self.case.faults)
                )
        finally:
            if self.bags is not None:
                self.bags.remove()

    def _happen(self) -> None:
        case, fleet, facts = self.case, self.fleet, self.facts
        early = any(fault.at < case.begins for fault in case.faults)
        if case.stopped:
            fleet.run(STARTS)
            self._order("reset")
            self._ordered = early
        if not early:
            facts.moving_from = case.begins * 1e9
        heals, resets, holds = case.settles + 0.2, self._resets, case.periods(10)
        fleet.run(case.quiet - fleet.time)
        for name in sorted(self._left):
            self._command(name, "join")
        fleet.run(case.quiet + heals - fleet.time)
        self._say("all", f"no fault for {heals:g} s")
        unknown = facts.wrong >= {*case.stoppable}  # nothing tells which of their orders is newer
        if (self._holders or self._stops()) and not unknown:
            fleet.run(holds)
            why = f"an operator stopped the swarm at {self._stopped_at} and nobody has reset it"
            self.ending.nobody_moves(self._stopped_since, why)
        peers = self._checks.peers
        # Orders that were carried out need not be repeated, whatever has happened since.
        carried_out = peers is None and facts.moving_from < inf
        stopped = self._ordered and not carried_out and (peers is None or peers.stopped)
        if stopped:
            self._order("reset")
            fleet.run(resets)
        self.ending.all_is_well()
        facts.moving_from = facts.now
        spread = 0.0 if peers is None else peers.spread()
        fleet.run(holds)
        self.ending.all_is_well()
        if peers is not None:
            peers.agree(spread)
        self.ending.memory_is_bounded()

    def _period(self) -> None:
        self._checks.period()
        if self.facts.now > self._follow_by and self.facts.moving_from == inf and self._calm and not self._left:
            text = f"do not all follow, although {self._led} was told to reset, and nothing has happened since"
            raise BrokenError("recovers", "the robots", text)
        if (
            self.facts.moving_from == inf
            and self._calm
            and not self._holders
            and self.facts.now - self._told_at > RESET_LASTS * 1e9
            and len(self._following) == self.case.robots
        ):
            self.facts.moving_from = self.facts.now  # orders that nothing has disturbed have been carried out
        self.fleet.later(self.fleet.clock.period, self._period)

    @property
    def _resets(self) -> float:
        """Time, s, after which all robots follow when nothing else happens but a reset."""
        return RESET_LASTS + 0.4 + self.case.periods(20)

    def _stops(self) -> bool:
        """Return whether robots without coordinators know of a STOP that holds."""
        peers = self._checks.peers
        return peers is not None and bool(peers.holders)

    def _say(self, who: str, what: str, fault: Fault | None = None) -> None:
        number = "" if fault is None else f" {number_of(fault, self.case.faults, self.case.numbers)}"
        self._tell(self.fleet.time, who, f"{what}{number}")

    def _order(self, command: str) -> None:
        """Give an order to all parent controllers, or to one of the robots, which tell each other."""
        stoppable = self.case.stoppable
        for name in (stoppable[self.case.seed % len(stoppable)],) if self.case.each_robot else stoppable:
            self._command(name, command)

    def _command(self, name: str, command: str, fault: Fault | None = None) -> None:
        self._say(name, f"is told by an operator: {command}", fault)
        if not self.fleet.call(name, command):
            self._say(name, "is not there to hear it")

    # What is done

    def _begin(self, fault: Fault) -> None:
        if fault.kind not in COMMANDS and (self.facts.moving_from == inf or fault.kind in self._starting()):
            self._calm = False
        concerned = self._concerned(fault)
        if fault.kind not in COMMANDS:
            self.facts.begin(concerned, fault.kind)
        if fault.kind in LINKS:
            self.weather.begin(fault)
            self._say(*_of_link(fault), fault)
        elif fault.kind in COMMANDS:
            self._command(fault.who, fault.kind, fault)
        elif fault.kind == "removal":
            self._remove(fault)
        elif fault.kind == SET_BACK:
            self._set_back(fault)
        elif fault.kind == LIAR:
            self._say(fault.who, "passes on what others have not said", fault)
            self.facts.liars.add(fault.who)
            self.fleet.liars[fault.who] = partial(falsified, round(fault.value), self._robots)
        elif fault.kind in FORGED:
            self._say(fault.who, f"gets forged messages: {fault.kind}", fault)
            self._forge(fault)
        else:
            self._begin_of_node(fault, fault.who)
        if fault.kind not in COMMANDS:
            self.fleet.later(max(fault.lasting, 1e-3), partial(self._end, fault, concerned))

    def _begin_of_node(self, fault: Fault, name: str) -> None:
        fleet, facts = self.fleet, self.facts
        if fault.kind == "crash":
            self._say(name, "dies" if fleet.nodes[name].activity else "is dead, and will be for longer", fault)
            fleet.kill(name)
            if self.case.stopped and name in self.case.stoppable:
                self._ordered, facts.moving_from = True, float("inf")
        elif fault.kind == "idle":
            fleet.deactivate(name)
            facts.stands_still(name)
            self._say(name, "is deactivated", fault)
            if name in self._robots and not self._drive(name).rests:
                raise BrokenError("comes to rest", name, "goes on although its node is deactivated")
        elif fault.kind == "pause":
            facts.odd.add(name)
            fleet.pause(name)
            facts.stands_still(name)
            self._say(name, "stands still", fault)
        elif fault.kind in {"clock", "skew"}:
            facts.goes_wrong(name)
            fleet.set_clock(name, fault.value - self._back)
            self._say(
                name, f"has a clock that is {abs(fault.value):g} s {'ahead' if fault.value > 0 else 'behind'}", fault
            )
        elif fault.kind == "drift":
            facts.goes_wrong(name)
            fleet.set_drift(name, round(fault.value))
            self._say(name, f"has a clock that runs {fault.value:g} millionths too fast", fault)
        else:
            facts.odd.add(name)
            self._drive(name).blind = True
            facts.coasting |= {name} & self.fleet.force_driven
            self._say(name, "has no measurement of its motion", fault)

    def _end(self, fault: Fault, concerned: tuple[str, ...]) -> None:
        name, fleet = fault.who, self.fleet
        if fault.kind in LINKS:
            self.weather.end(fault)
            self._say(_of_link(fault)[0], f"no longer: {fault.kind}", fault)
        elif fault.kind == LIAR:
            fleet.liars.pop(name, None)
            self._say(name, "tells the truth again", fault)
        elif fault.kind == "crash":
            if fleet.nodes[name].activity is None:
                self._say(name, "starts again", fault)
            fleet.revive(name)
        elif fault.kind == "idle":
            self._say(name, "is activated", fault)
            fleet.activate(name)
            self.facts.resumes(name)
        elif fault.kind == "pause":
            self._say(name, "goes on", fault)
            fleet.resume(name)
            self.facts.resumes(name)
        elif fault.kind in {"clock", "skew", "drift"}:
            fleet.set_clock(name, -self._back)
            self._say(name, "has a clock that is right again", fault)
        elif fault.kind == "blind":
            self._drive(name).blind = False
            self._say(name, "measures its motion again", fault)
        self.facts.end(concerned, fault.kind)

    def _remove(self, fault: Fault) -> None:
        """Let an operator say that a robot was carried away; of one that lives nobody believes it."""
        name, fleet = fault.who, self.fleet
        self._say(name, "is said by an operator to be carried away", fault)
        robot = int(name.removeprefix(ROBOT_PREFIX))
        if fleet.nodes[name].activity is None:
            self.facts.removed.add(robot)
        step = fleet.clock.step(fleet.now(name))
        removal = Removal(*EventCode.CARRIED_AWAY.event(0, max(0, step), robot=robot))
        fleet.deliver(Parcel("operator", REMOVALS, encode(removal), b"", removal), self.case.coordinators)

    def _set_back(self, fault: Fault) -> None:
        """Set the clocks of all back; what was wrong with one of them is over."""
        self._say("all", f"have clocks that are set back by {fault.value:g} s", fault)
        self._back += fault.value
        for name in self.case.names:
            self.facts.goes_wrong(name, alike=True)
            self.fleet.set_clock(name, -self._back)

    def _drive(self, name: str) -> Any:
        return self.fleet.drives[int(name.removeprefix(ROBOT_PREFIX))]

    def _concerned(self, fault: Fault) -> tuple[str, ...]:
        """Return the nodes whose work a fault may disturb."""
        if fault.kind in LINKS:
            return tuple(sorted(self._of_links(fault)))
        if fault.kind == "removal":
            return ()
        if fault.kind == SET_BACK:
            return self.case.names
        if fault.kind in {"crash", "idle", "pause", "clock", "blind"}:
            return (fault.who,)
        # Who is first in the name of a robot is believed; robots and controllers stop if broadcasts, or states of the
        # plane, contradict each other.
        disturbed = fault.kind == "impostor" and fault.who not in {PLANE, OBSERVER}
        return (fault.who,) if disturbed else ()

    def _of_links(self, fault: Fault) -> set[str]:
        sender, receiver = fault.ends
        if fault.kind == "again":
            return set()
        limit = _MILD.get(fault.kind, 0.0) / (1 if fault.kind == "loss" else self.case.hertz)
        if fault.value and fault.value <= limit:
            return set()
        if ALL in {sender, receiver}:
            single = {sender, receiver} - {ALL}
            return single or set(self.case.names)
        concerned = set()
        for a in sender.split(","):
            for b in receiver.split(","):
                if self._talks(a, b):
                    concerned.add(a if a in self._robots else b)
        return concerned

    def _talks(self, sender: str, receiver: str) -> bool:
        return any(
            other.name == receiver
            for topic, readers in self.fleet.nodes[sender].readers.items()
            if topic.message is not SwarmEvent
            for other in readers
        )

    def _forge(self, fault: Fault, until: float | None = None) -> None:
        """Send forged messages to a node in every period."""
        fleet = self.fleet
        until = fleet.time + fault.lasting if until is None else until
        step = fleet.clock.step(fleet.now(fault.who)) + round(fault.value)
        for message in _forgeries(fault.kind, fault.who, max(0, step), self._robots):
            topic = TOPIC_OF[type(message)]
            data = encode(message) if fault.kind != "garbage" else encode(message)[:-9]
            known = None if fault.kind == "garbage" else message
            for read in fleet.nodes[fault.who].endpoints.subscriptions:
                if read.message is topic.message:
                    fleet.deliver(Parcel("", read, data, FOREIGN, known), [fault.who])
        for read in fleet.nodes[fault.who].endpoints.subscriptions:
            if read.message is Relay:
                for relay in forged_relays(fault.kind, read.agent_id, max(0, step), self.case):
                    fleet.deliver(Parcel("", read, encode(relay), FOREIGN, relay), [fault.who])
        if fleet.time + fleet.clock.period < until:
            fleet.later(fleet.clock.period, partial(self._forge, fault, until))

    # Who knows of a STOP

    def _starting(self) -> set[str]:
        """Return the faults after which a fleet that starts in STOP stands still."""
        return {"crash"} if self.case.stopped else set()

    def told(self, node: str, command: str) -> None:
        if command in {"stop", "reset"}:
            self._calm &= all(map(self.facts.is_fine, self.case.names)) and self.facts.late_until < self.facts.now
            since, self._told_at = self.facts.now - self._told_at, self.facts.now
            alone = since > 2 * self.facts.age * self.facts.period  # a reset does not undo what it cannot know of
            resets = command == "reset" and node == self._led and alone
            self._follow_by = self.facts.now + self._resets * 1e9 if resets else float("inf")
        if command == "stop":
            # Which of two orders in a period at different robots is newer, robots cannot tell.
            self._holders = set() if self.case.each_robot and since < self.facts.period else {node}
            self._stopped_at, self._stopped_since, self._ordered = node, self.facts.now, True
            self.facts.moving_from = float("inf")
        elif command == "reset":
            self._holders, self._stopped_at = set(), None
            self._ordered = True
            self.facts.moving_from = float("inf")
        elif command == "release":
            self._led = None
            pair = next(pair for pair in self.case.pairs if node in pair)
            if not all(self.facts.is_fine(other) for other in pair if other != node):  # there is nobody to take over
                self.facts.late_until = max(self.facts.late_until, self.facts.now + self.facts.settles)
        elif command == "leave" and node not in self._left:
            self._left.add(node)
            self.facts.begin((node,), "leave")
        elif command == "join" and node in self._left:
            self._left.remove(node)
            self.facts.end((node,), "leave")

    def ends(self, node: str) -> None:
        self._holders.discard(node)

    def published(self, node: str, topic: Topic, message: Message, data: bytes) -> None:
        if isinstance(message, DesiredAbstractState) and message.mode == Mode.RUN:
            self._led = node
        if isinstance(message, AgentState):
            follows = message.status == Status.ACTIVE and message.broadcast_step != NEVER
            (self._following.add if follows else self._following.discard)(node)
        if node in self._holders and isinstance(message, DesiredAbstractState) and message.mode == Mode.RUN:
            raise BrokenError("STOP wins", node, f"publishes RUN, but knows of the STOP given to {self._stopped_at}")

    def heard(self, node: str, parcel: Parcel) -> None:
        if parcel.topic.message is not DesiredAbstractState or node in self._robots or node in self.facts.wrong:
            return
        message = parcel.message
        if not parcel.sender or self._stopped_at is None or self.facts.wrong & {*self.case.stoppable}:
            return
        if not isinstance(message, DesiredAbstractState) or message.mode != Mode.STOP:
            return
        if message.stamp - EPOCH >= self._stopped_since:  # however late, and whether or not its sender still lives
            self._holders.add(node)


def _of_link(fault: Fault) -> tuple[str, str]:
    """Return who is concerned by a fault of links, and what happens, in words."""
    sender, receiver = ("all" if end == ALL else end for end in fault.ends)
    what = {
        "cut": "nothing arrives",
        "loss": f"{fault.value:.0%} of the messages are lost",
        "slow": f"messages are late by {fault.value:g} s",
        "late": f"messages are late by up to {fault.value:g} s, and overtake each other",
        "again": f"half of the messages arrive once more, {fault.value:g} s later",
    }[fault.kind]
    return f"{sender} to {receiver}", what


def _forgeries(kind: str, who: str, step: int, robots: tuple[str, ...]) -> list[Message]:
    """Return what somebody sends to a node who does not belong to the fleet."""
    stamp = 0
    state = AgentState(stamp, step, NEVER, 1, 1, 1, 0.3, 0.0, 0.05, 0.0, 0.0)
    abstract = AbstractState(stamp, step, len(robots), 0.1, 0.01, 0.0, 0.0)
    sums = AuxiliaryState(stamp, step, 0.32, 0.0, 0.0032, 0.001024, 0.1, 0.0, 0.001, 0.0)
    desired = DesiredAbstractState(stamp, step, Mode.RUN, 0.4, 0.02)
    plane = PlaneState(stamp, step, 0.1, 0.0)
    everything: list[Message] = [state, abstract, sums, desired, plane]
    if kind == "stranger":
        return [state._replace(agent_id=99 + step % 50)]
    if kind == "nonsense":
        return [
            state._replace(position=nan),
            state._replace(mass=-1.0),
            abstract._replace(inertia=-1.0),
            sums._replace(s0=nan),
            desired._replace(torque=nan),
            plane._replace(angle=9.0),
        ]
    if kind == "future":
        return [message._replace(step=step + 10**6) for message in everything]
    return everything

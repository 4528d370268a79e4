# ruff: noqa: SLF001 - the state of real objects is copied, compared and made older
# ruff: noqa: FBT001 - whether it is a standby identifies a coordinator
"""Exhaustive search of what can happen to pairs of coordinators.

`python -m tests.swarmabs_core.realtime.leadership_model [NAME]` does one search of `SEARCHES`, or all.

The world is one of steps. Two hosts have an observer and a parent controller each, primaries and standbys; three more
have a robot, the first of them the plane, too. The rules are those of the nodes: real `Leadership`, `PublishedMode` and
`BroadcastInbox` objects. Of the rest there is only what matters here: who hears whom, and who is able to speak.

An adversary begins and ends faults whenever it likes, as many as are granted. An operator says STOP to one controller,
and RESET to one that leads. From each state all that they may do is tried.

What makes this finite, and two faults affordable:

- Only the distance of a time from now matters, and none above `LONG`, which is longer than every limit. Objects are
  kept as if it were always the same step. A fault may thus last for any time.
- States of single coordinators and robots are numbered, and each step of one of them is computed once.
- The two pairs do not hear each other: an observer decides by robots and its peer, a controller by the plane and its
  peer. Only robots combine them. Two faults are therefore searched for one pair at a time, with the other kind single
  and without faults (`paired`), and for both kinds with one fault of each (`CROSSED`).
- A second fault begins while the first lasts or until `WINDOW` steps after its end, an order also before. After that
  one leads and the other one follows, or listens as after its start, and what comes then is as after no fault.
- Two faults, and orders, are searched with the faults of `FEWER`: other clocks and delays are on the same side of every
  limit, or between two that are there. Orders go to controllers, so observers are single then.
"""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator
from functools import cache, partial
from itertools import product
from time import process_time
from typing import Any, NamedTuple

from swarmabs_core.messages import AbstractState, AuxiliaryState, DesiredAbstractState, Message, Mode
from swarmabs_core.realtime.base import Schedule, Sender, StepCounter
from swarmabs_core.realtime.broadcasts import BroadcastInbox
from swarmabs_core.realtime.leadership import AGREED, PRIMARY, SINGLE, STANDBY, Leadership
from swarmabs_core.realtime.modes import ModeLatch, PublishedMode
from swarmabs_core.realtime.validation import Bounds

CLOCK = Schedule(10_000_000, 0)
AGE, TOLERANCE, TAKEOVER, LISTENING, RESET = 10, 2, 4, 16, 26
"""In steps; a starting standby listens for twice as long as its primary. RESET is longer than twice the guard."""
NOW = 1000
"""The step of every state."""
LONG = 24
"""Steps after which it makes no difference any more how long ago something was."""
SETTLED = 3 * LISTENING + AGREED
"""Steps after the end of all faults in which one observer and one parent controller are left."""
WINDOW = AGREED + 2 * TAKEOVER
"""Steps after the end of a fault in which a pair has settled, but for one that has just started."""
PRIMARIES, STANDBYS, ROBOTS, ELSEWHERE = 0, 1, (2, 3, 4), 5
"""Hosts. The plane is on that of the first robot; what has no standby is elsewhere, where no fault happens."""


class Fault(NamedTuple):
    """A fault of the coordinators `of` (kind, standby), of hosts, or of both, with a number of steps if it has one."""

    kind: str
    of: tuple[tuple[str, bool], ...] = ()
    hosts: tuple[int, ...] = ()
    steps: int = 0


ALL = tuple(product("oc", (False, True)))
HOSTS = tuple(tuple((kind, standby) for kind in "oc") for standby in (False, True))
TARGETS = (*((coordinator,) for coordinator in ALL), *HOSTS)
CRASHES = tuple(Fault("crash", of) for of in TARGETS)
PAUSES = tuple(Fault("pause", of) for of in TARGETS)
CUTS = tuple(Fault("cut", hosts=hosts) for hosts in ((0,), (1,), (2,), (3,), (0, 3), (1, 3), (0, 1), (0, 2), (1, 2)))
CLOCKS = tuple(Fault("clock", hosts=(host,), steps=by) for host in (0, 1) for by in (-12, -6, -3, -1, 1, 2, 3, 6, 12))
SLOW = tuple(Fault("slow", hosts=(host,), steps=by) for host in (0, 1) for by in (1, 3, 5, 8, 12))
UNHEARD = tuple(
    Fault("unheard", (coordinator,), hosts=(to,)) for coordinator in ALL for to in (int(not coordinator[1]), 3)
)
FAULTS = (*CRASHES, *PAUSES, *CUTS, *CLOCKS, *SLOW, *UNHEARD)
FEW = (PAUSES[4], CUTS[0], SLOW[3])
FEWER = tuple(
    fault
    for fault in (*CRASHES[4:], *PAUSES[4:], *CUTS, *CLOCKS, *SLOW, *UNHEARD)
    if fault.steps in {"clock": (-6, -1, 2, 6), "slow": (5, 12)}.get(fault.kind, (0,)) and fault.hosts != (3,)
)
FEWEST = (*CRASHES[4:], *PAUSES[4:], *CUTS[:2])
CROSSED = (*CRASHES[:4], *PAUSES[:4], *UNHEARD)


class Anything(Bounds):
    """Numbers play no part here."""

    def problem(self, message: Message) -> str:
        return ""


class BrokenError(AssertionError):
    """An invariant does not hold."""


class Said(NamedTuple):
    """What a coordinator says for a step, seen from the step in which it arrives; `late`: sent so much later."""

    kind: str
    standby: bool
    step: int
    late: int
    mode: Mode = Mode.RUN


@cache
def messages(said: Said) -> tuple[Message, ...]:
    """Return the broadcasts; the numbers tell who sent them and when."""
    by, late = float(said.standby), float(said.late)
    if said.kind == "c":
        return (DesiredAbstractState(0, said.step, said.mode, by, late, *(0.0,) * 6),)
    return AbstractState(0, said.step, int(by), late, *(0.0,) * 3), AuxiliaryState(0, said.step, by, late, *(0.0,) * 6)


def older(step: int) -> int:
    return max(step - 1, NOW - LONG)


class Numbered:
    """Numbers states, equal ones alike."""

    def __init__(self) -> None:
        self.objects: list[Any] = []
        self._numbers: dict[Hashable, int] = {}

    def clear(self) -> None:
        self.objects.clear()
        self._numbers.clear()

    def number(self, state: Any, key: Hashable) -> int:
        number = self._numbers.setdefault(key, len(self.objects))
        if number == len(self.objects):
            self.objects.append(state)
        return number


class Coordinator:
    """One of a pair, or one without a peer."""

    states = Numbered()

    def __init__(self, kind: str, rank: str) -> None:
        self.kind, self.standby = kind, rank == STANDBY
        self.leadership = Leadership(rank, TAKEOVER, TOLERANCE, LISTENING * (1 + self.standby))
        self.counter = StepCounter(CLOCK)
        latch = ModeLatch(CLOCK, AGE * CLOCK.period, TOLERANCE * CLOCK.period)
        self.mode = PublishedMode(Mode.RUN, latch, CLOCK)
        self.mode._lasting = RESET
        self.heard_source, self.fast = NOW - LONG, 0
        self.waiting: tuple[tuple[int, Mode], ...] = ()

    def aged(self) -> Coordinator:
        """Return a copy of a step ago."""
        copied = copy.copy(self)
        copied.leadership, copied.counter, copied.mode = map(copy.copy, (self.leadership, self.counter, self.mode))
        copied.mode._latch = copy.copy(self.mode._latch)
        copied.leadership.since, copied.leadership.why, copied.mode.why = 0, "", ""
        for of in (copied.leadership, copied.counter, copied.mode, copied.mode._latch):
            for name in _TIMES.intersection(vars(of)):
                if vars(of)[name] is not None:
                    setattr(of, name, older(vars(of)[name]))
        if copied.mode._commanded is not None:
            copied.mode._commanded = copied.mode._commanded[0], older(copied.mode._commanded[1])
        copied.mode._peer_resets = older(self.mode._peer_resets[0]), older(self.mode._peer_resets[1])
        copied.mode._reset_since = max(self.mode._reset_since - 1, NOW - LONG - RESET)
        copied.heard_source = older(self.heard_source)
        copied.waiting = tuple((older(step), mode) for step, mode in self.waiting)
        return copied

    def numbered(self) -> int:
        _simplify(self.mode._latch)
        latch = {name: value for name, value in vars(self.mode).items() if name != "_latch"}
        parts = (vars(self.leadership), {"last": self.counter.last}, latch, vars(self.mode._latch))
        values = (value for part in parts for name, value in part.items() if name != "_schedule")
        return self.states.number(self, (self.kind, self.standby, self.heard_source, self.fast, self.waiting, *values))


_TIMES = frozenset(
    {"_last", "_heard", "_able_since", "_able", "_spoke", "_until", "last", "_newest", "_stop_step", "reset_step"}
)


def _simplify(latch: ModeLatch) -> None:
    """Forget a STOP that a RESET has undone: when both are long ago, it cannot be seen which one was first."""
    if not latch.stopped:
        latch._stop_step = None


@cache
def started(kind: str, rank: str) -> int:
    return Coordinator(kind, rank).numbered()


@cache
def turned(
    number: int, heard: tuple[tuple[int, Mode], ...], clock: int, hears: bool, order: Mode | None
) -> tuple[int, tuple[Said, ...]]:
    """Let a coordinator hear its peer and perhaps its source (robots, plane), take an order, and speak, in a step."""
    c: Coordinator = Coordinator.states.objects[number].aged()
    own, said = NOW + clock, list[Said]()
    leads = c.leadership
    # The observer sums up what it has heard for a while; the controller answers each state of the plane.
    if hears and clock >= -TOLERANCE:
        c.heard_source, c.fast = NOW, max(0, clock - TOLERANCE) if c.kind == "c" else 0
    fresh = own - c.heard_source <= AGE
    able = fresh if c.kind == "o" else c.heard_source == NOW and fresh
    for step, mode in (*c.waiting, *heard):
        if step <= own + TOLERANCE and (step >= own - AGE or mode is Mode.STOP):
            leads.hear(step, own)
            if c.kind == "c":
                c.mode.hear(mode, step, leading=leads.leading)
    c.waiting = ()
    if c.kind == "o" and c.counter.next(CLOCK.begin(own)) is None:
        return c.numbered(), ()
    still = own - c.fast
    if order is Mode.STOP:
        c.mode.stop(own)
        said.append(Said("c", c.standby, still, 0, Mode.STOP))
    elif order is Mode.RESET:
        c.mode.reset(own)
    if c.mode.is_over(own) and (leads.leading or not leads.hears_peer(own)):
        c.mode.run()
    able = able or c.mode.now is not Mode.RUN
    if leads.tick(own, able=able) and able:
        if c.mode.now is not Mode.RUN:
            said.append(Said("c", c.standby, still, 0, c.mode.now))
        else:
            step = NOW if c.kind == "c" else own
            said.append(Said(c.kind, c.standby, step, NOW - step))
    elif c.mode.told_to_stop:
        said.append(Said("c", c.standby, still, 0, Mode.STOP))
    return c.numbered(), tuple(dict.fromkeys(said))


@cache
def frozen(number: int, heard: tuple[tuple[int, Mode], ...]) -> int:
    """Let a step pass in which a coordinator does nothing; messages wait for it."""
    c = Coordinator.states.objects[number].aged()
    c.waiting = (*c.waiting, *heard)[-10:]
    after: int = c.numbered()
    return after


class Robot(NamedTuple):
    """What a robot says of its broadcasts; `follows`, or has latched a STOP."""

    number: int
    follows: bool
    stopped: bool
    problem: str = ""


ROBOT_STATES = Numbered()


def _robot(inbox: BroadcastInbox) -> int:
    heard, latch = inbox._heard, inbox._latch
    _simplify(latch)
    heard._steps = {step: places for step, places in sorted(heard._steps.items()) if step >= NOW - AGE}
    heard._contradicted = {place: step for place, step in heard._contradicted.items() if step > NOW - LONG}
    key = (
        inbox.followed,
        frozenset(inbox._sets.items()),
        tuple((step, frozenset(places.items()), tuple(places)) for step, places in heard._steps.items()),
        frozenset(heard._contradicted.items()),
        latch._stop_step,
        latch.reset_step,
    )
    return ROBOT_STATES.number(inbox, key)


@cache
def first_robot() -> Robot:
    inbox = BroadcastInbox(CLOCK, AGE * CLOCK.period, TOLERANCE * CLOCK.period, Anything(1.0, 1.0))
    return Robot(_robot(inbox), follows=False, stopped=False)


def _aged(message: Any) -> Any:
    return message._replace(step=older(message.step))


@cache
def listened(number: int, heard: tuple[Said, ...]) -> Robot:
    """Let a robot hear, and look whether it may follow."""
    before: BroadcastInbox = ROBOT_STATES.objects[number]
    inbox, heard_before = copy.copy(before), before._heard
    inbox._heard, inbox._latch = copy.copy(heard_before), copy.copy(before._latch)
    inbox._heard._steps = {
        step - 1: {place: _aged(message) for place, message in places.items()}
        for step, places in heard_before._steps.items()
    }
    inbox._heard._contradicted = {place: older(step) for place, step in heard_before._contradicted.items()}
    inbox._sets = {
        of: broadcast._replace(
            step=older(broadcast.step),
            abstract=_aged(broadcast.abstract),
            auxiliary=_aged(broadcast.auxiliary),
            desired=_aged(broadcast.desired),
        )
        for of, broadcast in before._sets.items()
    }
    if inbox._latch._stop_step is not None:
        inbox._latch._stop_step = older(inbox._latch._stop_step)
    inbox._latch.reset_step = older(inbox._latch.reset_step)
    now = CLOCK.begin(NOW)
    for said in heard:
        for message in messages(said):
            inbox.add(message, now, Sender(said.standby))
    problem, newest = inbox.problem(now), inbox.newest
    if not problem and newest is not None:
        observers = {newest.abstract.agent_count, newest.auxiliary.s0, inbox.followed.observer}
        steps = {newest.step, newest.abstract.step, newest.auxiliary.step, newest.desired.step}
        if len(observers) > 1 or len(steps) > 1 or newest.desired.torque != inbox.followed.controller:
            raise BrokenError(f"a robot follows a mixed set: {newest}")
    return Robot(_robot(inbox), not problem, inbox.stopped, problem)


class Place(NamedTuple):
    """Which coordinator this is, and where."""

    kind: str
    standby: bool
    host: int

    @property
    def name(self) -> tuple[str, bool]:
        return self.kind, self.standby


class Setting(NamedTuple):
    """The coordinators of a world: two of the kinds that are paired."""

    places: tuple[Place, ...]

    @classmethod
    def of(cls, paired: str) -> Setting:
        pairs = (Place(kind, standby, int(standby)) for kind in paired for standby in (False, True))
        return cls((*pairs, *(Place(kind, False, ELSEWHERE) for kind in "oc" if kind not in paired)))


class Told(NamedTuple):
    """What the operator has said, RUN for nothing, and whether a fault may have kept it from being heard."""

    mode: Mode = Mode.RUN
    disturbed: bool = False


class World(NamedTuple):
    """A state; messages on their way with the steps after which they arrive, and at which hosts.

    Robots that are `obeying` have heard a STOP since the operator's.
    """

    coordinators: tuple[int, ...]
    robots: tuple[Robot, ...]
    transit: tuple[tuple[int, tuple[int, ...], Said], ...] = ()
    faults: tuple[Fault, ...] = ()
    left: int = 0
    calm: int = WINDOW
    told: Told = Told()
    speaking: tuple[int, ...] = ()
    obeying: tuple[bool, ...] = (False,) * len(ROBOTS)


Order = tuple[int, Mode] | None
"""To which coordinator the operator says what."""


class Conditions(NamedTuple):
    """What faults do to a coordinator: it has crashed or waits, whom its messages reach and how late, its clock, ..."""

    crashed: bool
    waits: bool
    reach: tuple[int, ...]
    late: int
    clock: int
    hears: bool
    """whether it hears any robot, or the plane"""


@cache
def conditions(place: Place, faults: tuple[Fault, ...]) -> Conditions:
    cuts = [fault.hosts for fault in faults if fault.kind == "cut"]
    near = [to for to in (1 - place.host, *ROBOTS) if all((place.host in cut) == (to in cut) for cut in cuts)]
    hit = {fault.kind for fault in faults if place.name in fault.of and place.host != ELSEWHERE}
    deaf = {to for f in faults if f.kind == "unheard" and place.name in f.of for to in f.hosts}

    def total(kind: str) -> int:
        return sum(fault.steps for fault in faults if fault.kind == kind and place.host in fault.hosts)

    reach = tuple(to for to in near if to >= 0 and to not in deaf)
    hears = ROBOTS[0] in near if place.kind == "c" else bool({*near}.intersection(ROBOTS))
    return Conditions("crash" in hit, "pause" in hit, reach, 1 + total("slow"), total("clock"), hears)


def advance(setting: Setting, world: World, faults: tuple[Fault, ...], left: int, order: Order = None) -> World:
    """Return the world a step later, with other faults and an order of the operator."""
    arrived: dict[int, list[Said]] = {}
    transit = []
    for due, reach, said in world.transit:
        if due > 1:
            transit.append((due - 1, reach, said))
            continue
        for to in reach:
            arrived.setdefault(to, []).append(said)
    robots = tuple(
        listened(robot.number, tuple(arrived.get(host, ()))) for host, robot in zip(ROBOTS, world.robots, strict=True)
    )
    numbers, speaking = [], []
    for index, (number, place) in enumerate(zip(world.coordinators, setting.places, strict=True)):
        condition = conditions(place, faults)
        if condition.crashed:
            numbers.append(started(place.kind, STANDBY if place.standby else PRIMARY))
            continue
        heard = tuple([(m.step, m.mode) for m in arrived.get(place.host, ()) if m.kind == place.kind])
        if condition.waits:
            numbers.append(frozen(number, heard))
            continue
        ordered = order[1] if order is not None and order[0] == index else None
        after, said_now = turned(number, heard, condition.clock, condition.hears, ordered)
        numbers.append(after)
        if said_now:
            speaking.append(index)
        transit += [
            (condition.late, condition.reach, said._replace(step=said.step - condition.late)) for said in said_now
        ]
    told = world.told if order is None else Told(order[1], disturbed=world.calm < WINDOW)
    if told.mode is Mode.RESET and faults:
        told = Told(Mode.RESET, disturbed=True)
    elif told == Told(Mode.RESET) and order is None and all(robot.follows for robot in robots):
        told = Told()  # all is as before the STOP
    elif told.mode is Mode.STOP:
        told = Told(Mode.STOP)
    calm = 0 if faults else min(world.calm + 1, WINDOW)
    obeying = tuple(
        told.mode is Mode.STOP and (before or any(said.mode is Mode.STOP for said in arrived.get(host, ())))
        for host, before in zip(ROBOTS, world.obeying, strict=True)
    )
    after = World(tuple(numbers), robots, tuple(transit), faults, left, calm, told, tuple(speaking), obeying)
    for was_told, robot in zip(world.obeying, robots, strict=True):
        if was_told and not robot.stopped:
            raise BrokenError("a robot may move again without a RESET")
    return after


def check_single_fault(before: World, world: World) -> None:
    """Check that robots follow during and after the only fault, unless it cut them off from all who could speak."""
    if world.told.mode is not Mode.RUN:
        return
    faults = (*before.faults, *world.faults)  # what is sent in a step arrives in the next one
    cut = [fault for fault in faults if fault.kind == "cut"]
    alone = any({0, 1} <= {*fault.hosts} or ROBOTS[0] in fault.hosts for fault in cut)
    missed = {host for fault in faults if fault.kind in {"cut", "unheard"} for host in fault.hosts}
    for host, was, robot in zip(ROBOTS, before.robots, world.robots, strict=True):
        if not alone and host not in missed and not robot.follows and (world.faults or was.follows):
            raise BrokenError(f"robot {host - 1} does not follow, though there was but one fault: {robot.problem}")


def check_settled(setting: Setting, world: World, *, single: bool) -> None:
    """Check a world in which nothing changes any more."""
    speaking = sorted(setting.places[index].kind for index in world.speaking)
    if speaking != ["c", "o"]:
        raise BrokenError(f"{speaking} speak long after the end of all faults")
    stopped, follow = [r.stopped for r in world.robots], [r.follows for r in world.robots]
    if world.told != Told(Mode.RESET, disturbed=True) and len({*zip(stopped, follow, strict=True)}) > 1:
        raise BrokenError("only some robots follow long after the end of all faults")
    if world.told.mode is Mode.RUN and not all(follow):
        raise BrokenError("robots do not follow long after the end of all faults")
    if world.told.mode is Mode.STOP and single and not all(stopped):
        raise BrokenError("robots are not stopped, though an operator has said so")
    if world.told == Told(Mode.RESET) and not all(follow):
        raise BrokenError("robots do not follow after a RESET without faults")


class Search:
    """Searches all that may happen in a setting; arguments as for `search`. Worlds are known by their hashes."""

    def __init__(self, setting: Setting, granted: int, orders: Iterable[Mode], crossed: bool) -> None:
        self._setting, self._granted = setting, granted
        self._orders, self._crossed = (*orders,), crossed
        self._settling: set[int] = set()
        self.seen: set[int] = set()

    def first(self, standby: bool, mode: Mode, lasting: int) -> World:
        """Return a world in which all is well and primaries lead, or standbys, and a mode was said some steps ago."""
        ranks = (SINGLE, PRIMARY, STANDBY)
        numbers = (started(p.kind, ranks[0 if p.host == ELSEWHERE else 1 + p.host]) for p in self._setting.places)
        world = World((*numbers,), (first_robot(),) * len(ROBOTS))
        for step in range(6 * LISTENING):
            absent = CRASHES[4:5] if standby and step < 3 * LISTENING else ()
            world = advance(self._setting, world, absent, 0)
        leader = next(i for i, p in enumerate(self._setting.places) if p.kind == "c" and i in world.speaking)
        for said in {Mode.RUN: (), Mode.STOP: (Mode.STOP,), Mode.RESET: (Mode.STOP, Mode.RESET)}[mode]:
            world = advance(self._setting, world, (), 0, (leader, said))
            for _ in range(lasting):
                world = advance(self._setting, world, (), 0)
        return world._replace(left=self._granted)

    def settle(self, world: World) -> None:
        """Check that a world without faults settles in time if nothing else happens."""
        world = world._replace(left=0, calm=WINDOW)
        for _ in range(SETTLED + RESET + LONG):
            if hash(world) in self._settling:
                return
            self._settling.add(hash(world))
            after = advance(self._setting, world, (), 0)
            if after == world:
                check_settled(self._setting, world, single=self._granted == 1)
                return
            world = after
        raise BrokenError("the world does not settle")

    def choices(self, world: World, faults: tuple[Fault, ...]) -> Iterator[tuple[tuple[Fault, ...], int, Order]]:
        """Yield faults, how many are left, and orders of the next step."""
        yield world.faults, world.left, None
        for fault in world.faults:
            yield tuple(other for other in world.faults if other != fault), world.left, None
        if world.left and (world.left == self._granted or world.faults or world.calm < WINDOW):
            for fault in faults:
                if fault not in world.faults and not (self._crossed and _same_kind(fault, world.faults)):
                    yield tuple(sorted((*world.faults, fault))), world.left - 1, None
        following = {Mode.RUN: Mode.STOP, Mode.STOP: Mode.RESET, Mode.RESET: Mode.STOP}[world.told.mode]
        if following in self._orders:
            for index, place in enumerate(self._setting.places):
                reached = not any(f.kind in {"crash", "pause"} and place.name in f.of for f in world.faults)
                leads = Coordinator.states.objects[world.coordinators[index]].leadership.leading
                if place.kind == "c" and reached and (following is Mode.STOP or leads):
                    yield world.faults, world.left, (index, following)

    def run(self, first: World, faults: tuple[Fault, ...]) -> None:
        """Search what may happen from a world on."""
        stack: list[tuple[World, tuple[object, ...]]] = [(first, ())]
        while stack:
            world, story = stack.pop()
            for after, left, order in self.choices(world, faults):
                told = story if (after, order) == (world.faults, None) else (*story, (order, after))
                try:
                    following = advance(self._setting, world, after, left, order)
                    key = hash(following)
                    if self._granted == 1:
                        check_single_fault(world, following)
                    if key in self.seen:
                        continue
                    if not following.faults:
                        self.settle(following)
                except BrokenError as error:
                    raise BrokenError(f"{error}: {told}") from None
                self.seen.add(key)
                # Without faults and orders to come, `settle` has seen the future.
                if (
                    following.faults
                    or following.left == self._granted
                    or (following.calm < WINDOW and (following.left or self._orders))
                ):
                    stack.append((following, told))


def _same_kind(fault: Fault, others: tuple[Fault, ...]) -> bool:
    return any(fault.of[0][0] == other.of[0][0] for other in others)


def search(
    faults: Iterable[Fault],
    *,
    granted: int = 1,
    paired: str = "oc",
    orders: Iterable[Mode] = (),
    said: Iterable[tuple[Mode, int]] = ((Mode.RUN, 0),),
    standbys: Iterable[bool] = (False,),
    crossed: bool = False,
) -> int:
    """Search all that may happen with a number of faults, and return how many worlds there are.

    The operator may give `orders`, and has given one some steps before (`said`); at first primaries lead, or standbys.
    Raises `BrokenError` with the story where an invariant fails.
    """
    for computed in (turned, frozen, started, listened, first_robot):
        computed.cache_clear()
    for states in (Coordinator.states, ROBOT_STATES):
        states.clear()
    searched = Search(Setting.of(paired), granted, orders, crossed)
    chosen = tuple(faults)
    if paired != "oc":  # coordinators without a peer are not hit
        chosen = tuple(f for f in chosen if not f.of or any(kind in paired for kind, _ in f.of))
    for standby, (mode, lasting) in product(standbys, said):
        searched.run(searched.first(standby, mode, lasting), chosen)
    return len(searched.seen)


SEARCHES: dict[str, Callable[[], int]] = {
    "one fault": partial(search, FAULTS, standbys=(False, True)),
    "two faults of controllers": partial(search, FEWER, granted=2, paired="c", said=((Mode.RESET, 80),)),
    "two faults of observers": partial(search, FEWER, granted=2, paired="o"),
    "two faults, one of each kind": partial(search, CROSSED, granted=2, crossed=True),
    "one fault and STOP": partial(search, FEWER, paired="c", orders=(Mode.STOP,)),
    "one fault and STOP during RESET": partial(
        search, FEWEST, paired="c", orders=(Mode.STOP,), said=((Mode.RESET, 3), (Mode.RESET, 16))
    ),
    "one fault and RESET": partial(search, FEWER, paired="c", orders=(Mode.RESET,), said=((Mode.STOP, 60),)),
}


def main(arguments: list[str]) -> None:
    """Do some searches, or all."""
    for name in arguments or SEARCHES:
        began = process_time()
        worlds = SEARCHES[name]()
        sys.stdout.write(f"{name}: {worlds} worlds, {process_time() - began:.0f} s\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])

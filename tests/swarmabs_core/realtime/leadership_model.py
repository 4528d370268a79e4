# ruff: noqa: SLF001 - the state of real objects is copied and compared
# ruff: noqa: FBT001 - whether it is a standby identifies a coordinator
"""Exhaustive search of what can happen to pairs of coordinators.

`python -m tests.swarmabs_core.realtime.leadership_model [FAULTS]` searches everything; it is not a test.

The world is one of steps. Two hosts have an observer and a parent controller each, primaries and standbys; three more
have a robot, the first of them the plane, too. The rules are those of the nodes: real `Leadership` and `BroadcastInbox`
objects. Of the rest there is only what matters here: who hears whom, who is able to speak, and STOP.

An adversary begins and ends faults whenever it likes, as many as are granted. From each state all that it may do is
tried; states that differ only in the time are the same.
"""

from __future__ import annotations

import copy
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import product
from typing import NamedTuple

from swarmabs_core.messages import AbstractState, AuxiliaryState, DesiredAbstractState, Message, Mode
from swarmabs_core.realtime.base import Schedule, StepCounter
from swarmabs_core.realtime.broadcasts import BroadcastInbox
from swarmabs_core.realtime.leadership import AGREED, PRIMARY, STANDBY, Leadership
from swarmabs_core.realtime.validation import Bounds

CLOCK = Schedule(10_000_000, 0)
AGE, TOLERANCE, TAKEOVER, LISTENING = 10, 2, 4, 20
"""In steps; a starting standby listens for twice as long as its primary."""
BEGIN = 1000
SETTLED = 3 * LISTENING + AGREED
"""Steps after the end of all faults in which one observer and one parent controller are left."""
_LONG = 60
"""Steps after which it makes no difference any more how long ago something was."""
ROBOTS = (2, 3, 4)
"""Hosts of the robots; 0 and 1 are those of primaries and standbys. The plane is on the first."""


class Fault(NamedTuple):
    """A fault of the coordinators `of` (kind, standby), of hosts, or of both, with a number of steps if it has one."""

    kind: str
    of: tuple[tuple[str, bool], ...] = ()
    hosts: tuple[int, ...] = ()
    steps: int = 0


ALL = tuple(product("oc", (False, True)))
TARGETS = (*((each,) for each in ALL), *(tuple((kind, standby) for kind in "oc") for standby in (False, True)))
CRASHES = tuple(Fault("crash", of) for of in TARGETS)
PAUSES = tuple(Fault("pause", of) for of in TARGETS)
CUTS = tuple(Fault("cut", hosts=hosts) for hosts in ((0,), (1,), (2,), (3,), (0, 3), (1, 3), (0, 1), (0, 2), (1, 2)))
CLOCKS = tuple(Fault("clock", hosts=(host,), steps=by) for host in (0, 1) for by in (-12, -6, -3, -1, 1, 2, 3, 6, 12))
SLOW = tuple(Fault("slow", hosts=(host,), steps=by) for host in (0, 1) for by in (1, 3, 5, 8, 12))
UNHEARD = tuple(Fault("unheard", (each,), hosts=(to,)) for each in ALL for to in (int(not each[1]), 3))
FAULTS = (*CRASHES, *PAUSES, *CUTS, *CLOCKS, *SLOW, *UNHEARD)
FEW = (PAUSES[4], CUTS[0], SLOW[3])


class Anything(Bounds):
    """Numbers play no part here."""

    def problem(self, message: Message) -> str:
        return ""


@cache
def said(kind: str, standby: bool, step: int, sent: int, mode: Mode) -> tuple[Message, ...]:
    """Return what a coordinator says for a step; the numbers tell who said it and when."""
    if kind == "c":
        return (DesiredAbstractState(0, step, mode, float(standby), sent, *(0.0,) * 6),)
    sums = AuxiliaryState(0, step, float(standby), *(0.0,) * 7)
    return AbstractState(0, step, int(standby), sent, *(0.0,) * 3), sums


@dataclass(slots=True)
class Coordinator:
    kind: str
    standby: bool
    leadership: Leadership
    counter: StepCounter
    heard_plane: int = BEGIN
    stopped: bool = False
    waiting: tuple[tuple[int, Mode], ...] = ()

    @property
    def host(self) -> int:
        return int(self.standby)

    @property
    def name(self) -> tuple[str, bool]:
        return self.kind, self.standby


def leadership(standby: bool) -> Leadership:
    return Leadership(STANDBY if standby else PRIMARY, TAKEOVER, TOLERANCE, LISTENING * (1 + standby))


@dataclass(slots=True)
class World:
    step: int
    coordinators: tuple[Coordinator, ...]
    robots: tuple[BroadcastInbox, ...]
    transit: tuple[tuple[int, int, str, bool, tuple[int, int, Mode]], ...] = ()
    faults: tuple[Fault, ...] = ()
    left: int = 0
    used: int = 0
    calm: int = 0
    spoke: dict[str, int] = field(default_factory=dict)
    deaf: tuple[int, ...] = (0, 0, 0)

    def copy(self) -> World:
        made = copy.copy(self)
        made.coordinators = tuple(
            Coordinator(
                c.kind, c.standby, copy.copy(c.leadership), copy.copy(c.counter), c.heard_plane, c.stopped, c.waiting
            )
            for c in self.coordinators
        )
        made.robots = tuple(map(_copied, self.robots))
        made.spoke = {}
        return made

    def key(self) -> object:
        """Return all that decides about the future, with the time as distance from now."""
        now = self.step

        def ago(value: int) -> int:
            return max(-_LONG, value - now)

        coordinators = tuple(
            (
                tuple(
                    ago(value) if name in _TIMES and value is not None else value
                    for name, value in vars(c.leadership).items()
                    if name not in {"since", "why"}
                ),
                None if c.counter.last is None else ago(c.counter.last),
                ago(c.heard_plane),
                c.stopped,
                tuple((ago(step), mode) for step, mode in c.waiting),
            )
            for c in self.coordinators
        )
        robots = tuple(
            (
                robot.followed,
                tuple((of, ago(found.step)) for of, found in robot._sets.items()),
                tuple((ago(step), tuple(places)) for step, places in robot._heard._steps.items() if step >= now - AGE),
                tuple((place, ago(step)) for place, step in robot._heard._contradicted.items()),
                robot.stopped,
            )
            for robot in self.robots
        )
        transit = tuple((due - now, to, kind, by, (ago(m[0]), m[2])) for due, to, kind, by, m in self.transit)
        return coordinators, robots, transit, self.faults, self.left, self.used, self.calm, self.deaf


_TIMES = frozenset({"_last", "_heard", "_able_since", "_able", "_spoke", "_until"})


def _copied(inbox: BroadcastInbox) -> BroadcastInbox:
    made, heard = copy.copy(inbox), copy.copy(inbox._heard)
    heard._steps = {step: dict(places) for step, places in heard._steps.items()}
    heard._contradicted = dict(heard._contradicted)
    made._heard, made._latch, made._sets = heard, copy.copy(inbox._latch), dict(inbox._sets)
    return made


class BrokenError(AssertionError):
    """An invariant does not hold."""


def connected(world: World, one: int, other: int) -> bool:
    return all((one in fault.hosts) == (other in fault.hosts) for fault in world.faults if fault.kind == "cut")


def _sum(world: World, kind: str, host: int) -> int:
    return sum(fault.steps for fault in world.faults if fault.kind == kind and host in fault.hosts)


def _hit(world: World, kind: str, name: tuple[str, bool]) -> bool:
    return any(fault.kind == kind and name in fault.of for fault in world.faults)


def advance(world: World, faults: tuple[Fault, ...], *, begins: bool, stop: Iterable[tuple[str, bool]] = ()) -> World:
    """Return the world a step later, with other faults; an operator's STOP reaches some controllers."""
    ended = [fault for fault in world.faults if fault not in faults]
    world = world.copy()
    world.faults, world.step = faults, world.step + 1
    world.left, world.used = world.left - begins, world.used + begins
    world.calm = 0 if faults else min(world.calm + 1, SETTLED + 1)
    for c in world.coordinators:
        if any(fault.kind == "crash" and c.name in fault.of for fault in ended):
            c.leadership, c.counter = leadership(c.standby), StepCounter(CLOCK)
            c.stopped, c.waiting = False, ()
        c.stopped = c.stopped or c.name in stop
    _deliver(world)
    _robots(world)
    sent: list[tuple[int, int, str, bool, tuple[int, int, Mode]]] = []
    for c in world.coordinators:
        if not _hit(world, "crash", c.name) and not _hit(world, "pause", c.name):
            sent += _turn(world, c)
    world.transit = (*world.transit, *sent)
    _check(world)
    return world


def _deliver(world: World) -> None:
    for due, to, kind, standby, (step, when, mode) in world.transit:
        if due > world.step:
            continue
        if to in ROBOTS:
            for message in said(kind, standby, step, when, mode):
                world.robots[to - 2].add(message, CLOCK.begin(world.step), standby=standby)
        else:
            peer = next(c for c in world.coordinators if c.kind == kind and c.host == to)
            if not _hit(world, "crash", peer.name):
                peer.waiting = (*peer.waiting, (step, mode))[-10:]
    world.transit = tuple(each for each in world.transit if each[0] > world.step)


def _robots(world: World) -> None:
    now, deaf = CLOCK.begin(world.step), []
    for number, robot in enumerate(world.robots):
        was_stopped = robot.stopped
        problem = robot.problem(now)
        deaf.append(world.deaf[number] + 1 if problem and not was_stopped else 0)
        found = robot.newest
        if not problem and found is not None:
            observers = {found.abstract.agent_count, found.auxiliary.s0, robot.followed.observer}
            steps = {found.step, found.abstract.step, found.auxiliary.step, found.desired.step}
            if len(observers) > 1 or len(steps) > 1 or found.desired.torque != robot.followed.controller:
                raise BrokenError(f"robot {number + 1} follows a mixed set: {found}")
    world.deaf = tuple(min(steps, _LONG) for steps in deaf)


def _turn(world: World, c: Coordinator) -> list[tuple[int, int, str, bool, tuple[int, int, Mode]]]:
    """Let a coordinator hear and speak; return what it sends."""
    step = world.step + _sum(world, "clock", c.host)
    for heard, mode in c.waiting:
        if heard <= step + TOLERANCE:
            c.leadership.hear(heard, step)
            c.stopped = c.stopped or mode is Mode.STOP
    c.waiting = ()
    if connected(world, c.host, ROBOTS[0]) if c.kind == "c" else any(connected(world, c.host, r) for r in ROBOTS):
        c.heard_plane = world.step
    # The observer remembers the robots' states for a while; the controller answers each state of the plane.
    able = world.step - c.heard_plane <= (0 if c.kind == "c" else AGE)
    if c.kind == "o" and c.counter.next(CLOCK.begin(step)) is None:
        return []
    speaks = c.leadership.tick(step, able=able) and able
    world.spoke[c.kind] = world.spoke.get(c.kind, 0) + speaks
    if not speaks:
        return []
    mode = Mode.STOP if c.stopped else Mode.RUN
    late = _sum(world, "slow", c.host)
    return [
        (world.step + 1 + late, host, c.kind, c.standby, (step if c.kind == "o" else world.step, world.step, mode))
        for host in (1 - c.host, *ROBOTS)
        if connected(world, c.host, host)
        and not any(f.kind == "unheard" and c.name in f.of and host in f.hosts for f in world.faults)
    ]


def _check(world: World) -> None:
    if world.calm > SETTLED:
        if world.spoke != {"o": 1, "c": 1}:
            raise BrokenError(f"{world.spoke} speak {world.calm} steps after the end of all faults")
        if any(world.deaf):
            raise BrokenError("a robot does not follow long after the end of all faults")
        stopped = [robot.stopped for robot in world.robots]
        if any(stopped) and not all(stopped):
            raise BrokenError("only some robots are stopped")
    if world.used <= 1:
        reached = [robot for robot in ROBOTS if all(robot not in f.hosts for f in world.faults if f.kind == "cut")]
        reached = [robot for robot in reached if all(robot not in f.hosts for f in world.faults if f.kind == "unheard")]
        without = any({0, 1} <= {*f.hosts} or ROBOTS[0] in f.hosts for f in world.faults if f.kind == "cut")
        for robot in reached:
            if world.deaf[robot - 2] and not without and world.calm == 0:
                raise BrokenError(f"robot {robot - 1} does not follow, though there was but one fault")


def settled(standby: bool) -> World:
    """Return a world in which all is well, and primaries lead, or standbys."""
    inbox = partial(BroadcastInbox, CLOCK, AGE * CLOCK.period, TOLERANCE * CLOCK.period, Anything(1.0, 1.0))
    coordinators = tuple(Coordinator(kind, by, leadership(by), StepCounter(CLOCK)) for kind, by in ALL)
    world = World(BEGIN, coordinators, (inbox(), inbox(), inbox()), used=2)
    absent = (Fault("crash", TARGETS[4]),)
    for step in range(6 * LISTENING):
        world = advance(world, absent if standby and step < 3 * LISTENING else (), begins=False)
    world.used = 0
    return world


def choices(world: World, faults: Iterable[Fault], spacing: int) -> Iterator[tuple[tuple[Fault, ...], bool]]:
    """Yield the faults of the next step, and whether one begins: all stay, one ends, or one begins."""
    yield world.faults, False
    for fault in world.faults:
        yield tuple(each for each in world.faults if each != fault), False
    if world.left and (not world.used or world.step % spacing == 0):
        for fault in faults:
            if fault not in world.faults:
                yield (*world.faults, fault), True


def search(
    faults: Iterable[Fault], *, granted: int = 1, longest: int = 40, spacing: int = 1, starts: Iterable[bool] = (False,)
) -> int:
    """Search all that may happen with a number of faults, each ended within `longest` steps; return the states found.

    Further faults begin at multiples of `spacing` steps. Raises `BrokenError` with the story where an invariant fails.
    """
    known: set[object] = set()
    chosen = tuple(faults)
    for start in starts:
        first = settled(start)
        first.left = granted
        stack: list[tuple[World, tuple[object, ...], int]] = [(first, (), 0)]
        while stack:
            world, story, lasting = stack.pop()
            for after, begins in choices(world, chosen, spacing):
                if after and lasting >= longest and after == world.faults:
                    continue  # it has lasted long enough
                # A fault begins at once or, where others have happened, whenever it likes.
                if not world.used and not begins:
                    continue
                told = (*story, (world.step - BEGIN, after)) if after != world.faults else story
                try:
                    made = advance(world, after, begins=begins)
                except BrokenError as error:
                    raise BrokenError(f"{error}: {told}") from None
                key = (made.key(), lasting if after else 0)
                if key in known or made.calm > SETTLED:
                    continue
                known.add(key)
                stack.append((made, told, lasting + 1 if after else 0))
    return len(known)


def main(arguments: list[str]) -> None:
    """Search everything with the number of faults given, by default one; with two it takes hours."""
    granted = int(arguments[0]) if arguments else 1
    found = search(FAULTS, granted=granted, spacing=1 if granted == 1 else 3, starts=(False, True))
    sys.stdout.write(f"{found} states\n")


if __name__ == "__main__":
    main(sys.argv[1:])

"""What happens to a virtual fleet: settings of the fleet, and faults with their times.

A case is drawn from a seed, and shortened to some of its faults, which are told as text:

    (0) from 2.130 s to 2.530 s: crash, parent_controller
    (3) at 2.500 s: stop, parent_controller_standby
    (4) from 2.700 s to 3.000 s: cut, agent_001 to abstraction_observer
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf
from random import Random
from typing import NamedTuple, Protocol

from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, standby_name
from swarmabs_core.nodes import agent_name

AGE, AHEAD, TAKEOVER = 10, 2, 4
"""Limits of all fleets, in periods: ages of messages, how far ahead they may be, and the silence before a takeover."""
RESET_LASTS = 1.0
"""Time, s, for which RESET is published, and robots stand still."""
ALL = "*"
LINKS = ("cut", "loss", "slow", "late", "again")
"""What can happen on a link: nothing passes; some messages are lost; all are late by a time; each by another time up to
one; some arrive a second time, so much later."""
NODES = ("crash", "idle", "pause", "clock", "skew", "drift", "blind")
"""What can happen to a node: it dies and starts; is deactivated and activated; stands still; its clock is wrong, within
what is tolerated, or too fast; its sensor is silent."""
COMMANDS = ("stop", "reset", "release", "leave", "join")
"""What an operator can say to a node."""
SET_BACK = "set back"
"""The clocks of all nodes are set back at once, for good."""
REMOVAL = "removal"
"""An operator says to all observers that a robot was carried off the plane."""
LIAR = "liar"
"""A robot passes on of others what they have not said, by its value: 1 moved, 2 later, 3 of the plane."""
FORGED = ("stranger", "nonsense", "future", "garbage", "impostor")
"""What somebody else can send to a node: states of an unknown robot, values that cannot be, steps that have not come,
bytes of another layout; or messages in the name of a node that are credible."""


def time_of(at: float, end: float) -> str:
    """Return the words for a time, s, or from one to another, which may be infinite."""
    if end <= at:
        return f"at {at:.3f} s"
    return f"from {at:.3f} s {'for ever' if end == inf else f'to {end:.3f} s'}"


class Fault(NamedTuple):
    """What happens to `who` (a node, or a link as ``sender>receiver``) at a time (s) and lasts for a while (s)."""

    at: float
    kind: str
    who: str
    lasting: float = 0.0
    value: float = 0.0

    def __str__(self) -> str:
        who = self.who.replace(ALL, "all").replace(">", " to ")
        return f"{time_of(self.at, self.end)}: {self.kind}, {who}{f', {self.value:g}' if self.value else ''}"

    @property
    def end(self) -> float:
        """The time, s, at which it is over."""
        return self.at + self.lasting

    @property
    def ends(self) -> tuple[str, str]:
        """The two ends of a link."""
        sender, _, receiver = self.who.partition(">")
        return sender, receiver


@dataclass(frozen=True)
class Case:
    """A fleet and what happens to it; `quiet` is the time, s, at which all faults are over.

    If only some of its faults happen, `numbers` says which.
    """

    seed: int
    robots: int = 4
    hertz: int = 20
    paired: bool = False
    own_topics: bool = False
    stopped: bool = False
    start: str = "wait"
    each_robot: bool = False
    links: str = "{}"
    law: str = "pd"
    sealed: bool = False
    recorded: bool = False
    quiet: float = 6.0
    faults: tuple[Fault, ...] = ()
    numbers: tuple[int, ...] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The nodes."""
        return (PLANE, *self.coordinators, *self.robot_names)

    @property
    def coordinators(self) -> tuple[str, ...]:
        """Observer and parent controller, and their standbys."""
        return tuple(name for pair in self.pairs for name in pair)

    @property
    def pairs(self) -> tuple[tuple[str, ...], ...]:
        """The instances of the observer, and those of the parent controller, if there are any."""
        if self.each_robot:
            return ()
        return tuple((n, standby_name(n)) if self.paired else (n,) for n in (OBSERVER, CONTROLLER))

    @property
    def robot_names(self) -> tuple[str, ...]:
        """The robots."""
        return tuple(map(agent_name, range(1, self.robots + 1)))

    @property
    def stoppable(self) -> tuple[str, ...]:
        """Those to whom an operator says STOP and RESET: the parent controllers, or the robots."""
        return self.pairs[1] if self.pairs else self.robot_names

    @property
    def begins(self) -> float:
        """Time, s, at which all may be expected to follow after a start without faults.

        That is after the two seconds for which a standby listens, and the second of a RESET if they start in STOP.
        """
        return 2.0 + self.periods(12) + self.stopped * (1.0 + self.periods(14))

    @property
    def settles(self) -> float:
        """Time, s, in which all settle after a fault: a standby that starts listens for two seconds."""
        return 2.2 + self.periods(20)

    def periods(self, number: float) -> float:
        """Return the time, s, of so many periods, or at a high rate of those at 20 Hz."""
        return number / min(self.hertz, 20)

    def only(self, numbers: Iterable[int]) -> Case:
        """Return the case with some of its faults only."""
        return replace(self, faults=tuple(self.faults[number] for number in numbers), numbers=tuple(numbers))

    def __str__(self) -> str:
        """Return the text of the case."""
        words = [
            f"{self.robots} robots at {self.hertz} Hz",
            f"each robot coordinates{', sealed' * self.sealed}, links {self.links}"
            if self.each_robot
            else f"observer, controller{', standbys' * self.paired}",
            f"law {self.law}",
            *(["two recorders"] if self.recorded else []),
            *(["a topic for each robot"] if self.own_topics else []),
            f"starts in {'STOP' if self.stopped else 'RUN'}, robots needed: {self.start}",
            f"step n is at n x {1 / self.hertz:g} s",
        ]
        head = f"seed {self.seed}: {'; '.join(words)}"
        return "\n".join([head, f"  limits: {'; '.join(self._limits)}", *numbered(self.faults, self.numbers)])

    @property
    def _limits(self) -> Iterator[str]:
        """Yield what the properties count with."""
        yield f"what is older than {AGE} steps is outdated, and its sender silent (DEAD)"
        if self.each_robot:
            yield f"a robot hears those of which it has a state of the last {2 * AGE} steps"
        if self.paired:
            yield f"takeover_after is {TAKEOVER} steps"


class Tell(Protocol):
    """Is told what happens to somebody at a time (s); `done` if it was done to them, and is not what they did."""

    def __call__(self, time: float, who: str, what: str, *, done: bool = True) -> None: ...


def untold(time: float, who: str, what: str, *, done: bool = True) -> None:
    """Ignore what happens."""


def numbered(faults: Sequence[object], numbers: Sequence[int] | None) -> Iterator[str]:
    """Yield a line for each fault with its number in the case of the seed."""
    for number, fault in zip(_numbers(faults, numbers), faults, strict=True):
        yield f"  ({number}) {fault}"


def number_of(fault: object, faults: Sequence[object], numbers: Sequence[int] | None) -> str:
    """Return in brackets the number of a fault in the case of the seed."""
    return f"({_numbers(faults, numbers)[faults.index(fault)]})"


def _numbers(faults: Sequence[object], numbers: Sequence[int] | None) -> Sequence[int]:
    return range(len(faults)) if numbers is None else numbers


def case_of(seed: int, robots: int | None = None) -> Case:
    """Draw a case; all cases of a seed are the same.

    What happens is a mix of a few kinds. In half of the cases there is one fault at a time, with time to recover: then
    robots must not notice much. In the other half there may be any number at once.
    """
    draw = Random(f"virtual case:{seed}")
    case = Case(
        seed,
        robots or draw.choice((2, 3, 3, 3, 4, 4, 5, 8)),
        draw.choices((10, 20, 50, 100), (10, 7, 2, 1))[0],
        draw.random() < 0.8,
        draw.random() < 0.3,
        draw.random() < 0.3,
        draw.choice(("wait", "wait", "proceed")),
    )
    if draw.random() < 0.4:
        case = _without_coordinators(case)
    mix = (*_MIX, *_AMONG_ROBOTS) if case.each_robot else _MIX
    kinds = draw.sample(mix, draw.choice((1, 2, 2, 3, 5, len(_MIX))))
    kinds += [_lies] * case.sealed
    one_at_a_time = draw.random() < 0.5
    faults: list[Fault] = []
    time = case.begins
    if draw.random() < 0.2:
        late = [name for name in case.names if draw.random() < 0.4]
        faults = [Fault(0.0, "crash", name, draw.choice((_length(draw), draw.uniform(0.0, 4.0)))) for name in late]
        time = max([case.begins, *(f.end + case.settles for f in faults)]) if one_at_a_time else 0.0
    if one_at_a_time:
        for _ in range(draw.randint(1, 3)):
            fault = draw.choice(kinds)(draw, case, time + draw.uniform(0.0, 0.3))
            faults += fault
            time = max([time, *(f.end for f in fault)]) + case.settles
        quiet = time - case.settles
    else:
        lasting = draw.choice((1.0, 2.5, 2.5, 5.0))
        for _ in range(draw.choice((2, 4, 6, 10))):
            faults += draw.choice(kinds)(draw, case, time + draw.uniform(0.0, lasting))
        quiet = time + lasting
        faults = [f for f in faults if f.kind != "impostor"]  # who takes the place of one that is lost is believed
    if not case.each_robot and draw.random() < 0.3:
        faults += _skew(draw, case, quiet)
    first = min((f.at for f in faults if f.kind == SET_BACK), default=inf)  # two might lead to before the start
    faults = [f for f in faults if f.kind != SET_BACK or f.at == first]
    faults = sorted(Fault(round(f.at, 3), f.kind, f.who, round(f.lasting, 3), round(f.value, 4)) for f in faults)
    if not case.each_robot:
        law = draw.choice(("pd", "pd", "pid", "arise")) if case.hertz >= 20 else "pd"
        simple = case.robots <= 4 and case.hertz <= 20 and all(fault.kind != SET_BACK for fault in faults)
        case = replace(case, law=law, recorded=simple and draw.random() < (0.2 if law == "pd" else 0.4))
    return replace(case, quiet=round(max([quiet, 0.5, *(f.end for f in faults)]), 3), faults=tuple(faults))


def _without_coordinators(case: Case) -> Case:
    """Return a case in which each robot coordinates: who hears whom and the plane, what links lose, law, and seals.

    Many robots do not all hear each other: that takes as long as all the rest.
    """
    draw = Random(f"virtual links:{case.seed}")
    robots = max(3, case.robots)
    kind = draw.choice(("ring", "random", "listed") if robots > 5 else ("all", "all", "ring", "random", "listed"))
    pairs = [f"{draw.randint(1, n)} {n + 1}" for n in range(1, robots)]  # a tree, and a few pairs more
    pairs += [f"{one} {other}" for one, other in (draw.sample(range(1, robots + 1), 2) for _ in range(robots // 2))]
    pairs = [*dict.fromkeys(" ".join(sorted(pair.split())) for pair in pairs)]
    degree = 2 if robots % 2 or draw.random() < 0.5 else 3
    more = {"random": f", degree: {degree}", "listed": f", pairs: [{', '.join(pairs)}]"}
    sensing = sorted(draw.sample(range(1, robots + 1), draw.randint(1, robots - 1))) if draw.random() < 0.3 else []
    loss = draw.choice((0.0, 0.0, 0.1, 0.3))
    links = (
        f"{{type: {kind}{more.get(kind, '')}, loss: {loss:g}, seed: {draw.randint(0, 99)}, "
        f"sensing: [{', '.join(map(str, sensing))}]}}"
    )
    return replace(
        case,
        each_robot=True,
        paired=False,
        own_topics=False,
        robots=robots,
        hertz=min(case.hertz, 20),
        links=links,
        law=draw.choice(("pd", "arise", "arise")) if case.hertz >= 20 else "pd",
        sealed=draw.random() < 0.3,
    )


def _length(draw: Random) -> float:
    """Draw how long a fault lasts, s: often about as long as the limits on ages, or long."""
    return draw.choice((draw.uniform(0.005, 0.12), draw.uniform(0.1, 0.6), draw.uniform(0.5, 2.0)))


def _some(draw: Random, case: Case) -> str:
    """Draw a node, a coordinator as often as a robot."""
    return draw.choice((draw.choice(case.coordinators or case.names), draw.choice(case.names)))


def _crash(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let a node be lost, and perhaps its last messages come again when it has started again."""
    name, lasting = _some(draw, case), _length(draw)
    again = [Fault(max(0.0, at - 0.5), "again", f"{name}>{ALL}", 0.6, lasting + draw.uniform(3.0, 30.0) / case.hertz)]
    kind = draw.choice(("crash", "crash", "idle"))
    return [*again[: draw.random() < 0.2], Fault(at, kind, name, lasting)]


def _pause(draw: Random, case: Case, at: float) -> list[Fault]:
    return [Fault(at, "pause", _some(draw, case), _length(draw))]


def _leader(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let one that leads, or a robot, be lost for longer than a takeover takes, or live in the future."""
    name, lasting = draw.choice(case.pairs or (case.robot_names,))[0], draw.uniform(8.0, 40.0) / case.hertz
    kind = draw.choice(("crash", "idle", "pause", "cut", "clock"))
    if kind == "clock":
        return [Fault(at, kind, name, 2.0 * lasting, draw.choice((2.5, 3.5, 6.0, 9.0)) / case.hertz)]
    return [Fault(at, kind, f"{name}>{ALL}" if kind == "cut" else name, lasting)]


def _host(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let the host of two coordinators fail, or of all primaries and a robot."""
    lasting, kind, standby = _length(draw), draw.choice(("crash", "pause")), case.paired and draw.random() < 0.5
    if case.each_robot:
        return [Fault(at, kind, name, lasting) for name in draw.sample(case.robot_names, 2)]
    return [Fault(at, kind, pair[standby], lasting) for pair in case.pairs]


def _parted(at: float, one: str, other: str, lasting: float) -> list[Fault]:
    """Let nothing pass between two groups of nodes, either way."""
    return [Fault(at, "cut", f"{one}>{other}", lasting), Fault(at, "cut", f"{other}>{one}", lasting)]


def _cut(draw: Random, case: Case, at: float) -> list[Fault]:
    """Cut a node off, or one link, or one way of it, or make a partition."""
    name, lasting = _some(draw, case), _length(draw)
    other = draw.choice([o for o in case.names if o != name])
    how = draw.randrange(5)
    if how == 0:
        return _parted(at, name, ALL, lasting)
    if how == 1:
        return [Fault(at, "cut", f"{name}>{ALL}", lasting)]
    if how == 2:
        return [Fault(at, "cut", f"{ALL}>{name}", lasting)]
    if how == 3:
        return [Fault(at, "cut", f"{name}>{other}", lasting)]
    side = [o for o in case.names if draw.random() < 0.5]
    rest = [o for o in case.names if o not in side]
    if not side or not rest:
        return []
    ways = [(side, rest), (rest, side)][: draw.choice((1, 2, 2))]
    return [Fault(at, "cut", f"{','.join(a)}>{','.join(b)}", lasting) for a, b in ways]


def _weather(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let the network be bad everywhere or for one node."""
    name = draw.choice((ALL, _some(draw, case)))
    link = draw.choice((f"{name}>{ALL}", f"{ALL}>{name}"))
    kind = draw.choice(("loss", "loss", "slow", "late", "again"))
    value = {
        "loss": draw.choice((0.03, 0.03, 0.2, 0.6)),
        "slow": draw.choice((0.3, 1.0, 4.0, 15.0, 40.0)) / case.hertz,
        "late": draw.choice((0.5, 2.0, 8.0, 20.0)) / case.hertz,
        "again": draw.choice((0.1, 3.0, 15.0, 60.0)) / case.hertz,
    }[kind]
    return [Fault(at, kind, link, draw.choice((_length(draw), draw.uniform(0.5, 2.0))), value)]


def _clock(draw: Random, case: Case, at: float) -> list[Fault]:
    if draw.random() < 0.3:
        return [Fault(at, "drift", _some(draw, case), draw.uniform(0.5, 2.0), draw.choice((-400, -50, 50, 400)))]
    periods = draw.choice((0.5, 1.0, 2.0, 3.0, 5.0, 12.0, 40.0, 120.0)) * draw.choice((-1, 1))
    return [Fault(at, "clock", _some(draw, case), _length(draw), periods / case.hertz)]


def _skew(draw: Random, case: Case, until: float) -> list[Fault]:
    """Let a clock be wrong all the time, within what is tolerated; perhaps a pair of which it is one is parted."""
    ahead = draw.choice((0.2, 0.9, 1.5, 1.5)) * draw.choice((1, 1, -1)) / case.hertz
    if not case.paired or draw.random() < 0.5:
        return [Fault(0.0, "skew", _some(draw, case), until, ahead)]
    one, other = draw.sample(draw.choice(case.pairs), 2)
    parted = _parted(draw.uniform(case.begins, max(case.begins, until - 1.0)), one, other, draw.uniform(0.5, 1.0))
    return [Fault(0.0, "skew", one, until, ahead), *parted]


def _operator(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let an operator stop or reset the swarm at either controller, hand over, or send a robot away."""
    controllers = case.stoppable
    what = draw.choice(("stop", "stop", "stop", "reset", "again", "leave", "release"))
    if what == "release" and case.paired:
        return [Fault(at, "release", draw.choice(case.coordinators))]
    if what == "leave":
        name = draw.choice(case.robot_names)
        return [Fault(at, "leave", name), Fault(at + _length(draw), "join", name)]
    if what == "again":
        return [
            Fault(at, "stop", draw.choice(controllers)),
            Fault(at + _length(draw), "reset", draw.choice(controllers)),
            Fault(at + draw.uniform(0.0, 1.5), "stop", draw.choice(controllers)),
        ]
    told = draw.choice(controllers)
    faults = [Fault(at, "reset" if what == "reset" else "stop", told)]
    if case.paired and draw.random() < 0.3:  # the other one of the pair does not hear of it
        (other,) = (name for name in controllers if name != told)
        faults.append(Fault(max(0.0, at - 0.1), "cut", f"{told}>{other}", draw.uniform(0.2, 2.0)))
    elif case.pairs and draw.random() < 0.5:  # all have known of that order for long
        at += case.periods(draw.uniform(21.0, 40.0))
        if draw.random() < 0.4:  # all of it is late
            faults.append(Fault(at - 0.01, "slow", f"{ALL}>{ALL}", 1.3, draw.uniform(11.0, 25.0) / case.hertz))
        faults.append(Fault(at, "reset", draw.choice(controllers)))
    return faults


def _takeover_of_a_stop(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let an operator stop the swarm around the moment in which a coordinator is lost or comes back."""
    lasting = _length(draw)
    lost = draw.choice((_crash, _pause, _cut, _host))(draw, case, at)
    when = draw.choice((at, at + lasting)) + draw.uniform(-0.05, 0.15)
    return [*lost, Fault(max(0.0, when), "stop", draw.choice(case.stoppable))]


def _stop_and_loss(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let an operator stop the swarm, and soon afterwards let the controller be lost, maybe with its messages late."""
    controller, when = draw.choice(case.stoppable), at + draw.uniform(0.01, 0.5)
    kind, lasting = draw.choice(("crash", "crash", "pause", "cut")), draw.uniform(6.0, 30.0) / case.hertz
    faults = [Fault(at, "stop", controller)]
    if draw.random() < 0.5:
        kind, lasting, when = "crash", 0.3 * lasting, at + draw.uniform(0.0, 3.0) / case.hertz
        late = draw.uniform(11.0, 25.0) / case.hertz
        faults.append(Fault(max(0.0, at - 0.01), "slow", f"{controller}>{ALL}", when - at + 0.02, late))
    elif draw.random() < 0.3:  # what has stopped a robot must not be forgotten with a clock, either
        periods = draw.choice((-3.0, -5.0, -9.0, -12.0))
        faults.append(Fault(when, "clock", draw.choice(case.robot_names), lasting + 1.0, periods / case.hertz))
    if kind == "cut":
        when = max(0.0, when - draw.uniform(0.0, 0.5))
    lost = draw.choice((controller, controller, controller, PLANE))  # a STOP is repeated without the plane, too
    ways = (f"{lost}>{ALL}", f"{ALL}>{lost}") if kind == "cut" else (lost,)
    return [*faults, *(Fault(when, kind, way, lasting) for way in ways)]


def _handover(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let coordinators hand over, those of a pair one after the other."""
    if not case.paired:
        return []
    pair = draw.choice(case.pairs)
    one, other = draw.sample(pair, 2)
    if draw.random() < 0.3:
        lost = at + draw.uniform(-10.0, 5.0) / case.hertz
        kind, lasting = draw.choice(("crash", "pause")), draw.uniform(8.0, 40.0) / case.hertz
        return [Fault(max(0.0, lost), kind, other, lasting), Fault(at, "release", one)]
    again = at + draw.choice((draw.uniform(1.0, 20.0) / case.hertz, draw.uniform(0.5, 2.0)))
    return [Fault(at, "release", one), Fault(again, "release", other)]


def _stay_away(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let a robot leave for long or be carried away, and maybe start observers in the meantime.

    Maybe it was silent before, so that hosts of observers have remembered it.
    """
    robot = draw.choice(case.robot_names)
    away = draw.uniform(12.0, 40.0) / case.hertz + draw.choice((0.5, 3.5))  # the longer time lets observers speak again
    faults, observers = [], (case.pairs or (case.robot_names,))[0]
    if draw.random() < 0.4:
        faults.append(Fault(at, "crash", robot, draw.uniform(11.0, 15.0) / case.hertz))
        at = faults[0].end + draw.uniform(22.0, 40.0) / case.hertz  # until it is no second sender any more
    if draw.random() < (0.5 if case.each_robot else 0.3):
        faults += [Fault(at, "leave", robot), Fault(at + away, "join", robot)]
    else:
        faults.append(Fault(at, "crash", robot, away))
        if not case.each_robot:
            carried = draw.choice((robot, robot, robot, draw.choice(case.robot_names)))
            faults.append(Fault(at + draw.uniform(draw.choice((0.0, 12.0, 12.0)) / case.hertz, away), REMOVAL, carried))
            if draw.random() < 0.4:  # it comes back and dies again; who starts then hears of the removal, too
                at += away + draw.uniform(22.0, 40.0) / case.hertz
                faults.append(Fault(at, "crash", robot, away))
    if draw.random() < 0.7:
        after = faults[-1].at if faults[-1].kind == REMOVAL and draw.random() < 0.7 else at
        begins, lasting = draw.uniform(after, at + away), _length(draw)
        kind, lost = draw.choice(("crash", "idle")), draw.choice((observers, (draw.choice(observers),)))
        if kind == "idle" and faults[-1].kind == REMOVAL:  # they hear of it only afterwards
            begins = max(0.0, faults[-1].at - draw.uniform(0.0, lasting))
        faults += [Fault(begins, kind, name, lasting) for name in lost]
    return faults


def _reset_at_a_stop(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let an operator stop and reset the swarm in turn, after about the guard time or the time of a RESET.

    Perhaps one controller is not heard by the other one, which it hears late.
    """
    faults, time = [], at
    if case.paired and draw.random() < 0.3:
        one, other = draw.sample(case.stoppable, 2)
        faults.append(Fault(at, "slow", f"{one}>{other}", 2.0, draw.uniform(0.5, 6.0) / case.hertz))
        faults.append(Fault(at, "cut", f"{other}>{one}", draw.uniform(0.2, 2.0)))
    for number in range(draw.randint(2, 4)):
        faults.append(Fault(time, ("stop", "reset")[number % 2], draw.choice(case.stoppable)))
        time += draw.choice((draw.uniform(0.0, 16.0) / case.hertz, draw.uniform(0.5, 1.5)))
    return faults


def _set_back(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let the clock of a node, or of all, be wrong by about as much as is tolerated, or set back by so many periods."""
    periods = draw.choice((1.0, 2.0, 2.5, 3.0, 3.5, 4.0, 6.0, 9.0, 10.0, 11.0, 12.0))
    value = draw.choice((-1.0, -1.0, 1.0)) * periods / case.hertz
    name = draw.choice((_some(draw, case), draw.choice(case.robot_names)))
    lasting = draw.uniform(8.0, 60.0) / case.hertz
    return [Fault(at, "clock", n, lasting, value) for n in (case.names if draw.random() < 0.2 else (name,))]


def _all_set_back(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let the clocks of all be set back, as by whoever gives them the time, to a time after the start.

    Perhaps one of a pair, or a robot, is lost afterwards, before the clocks are as late again.
    """
    at += draw.uniform(5.0, 10.0)
    back = Fault(at, SET_BACK, ALL, 0.0, draw.uniform(4.0, at - 0.5))
    lost = draw.choice((draw.uniform(0.0, 2.0), case.settles + draw.uniform(0.0, 1.0)))
    return [back, *_leader(draw, case, at + lost)][: draw.choice((1, 2, 2))]


def _deaf(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let a coordinator hear nothing of some or of all, for longer than the limits on ages."""
    pair = draw.choice(case.pairs or (case.robot_names[:2],))
    name, lasting = draw.choice(pair), draw.uniform(12.0, 50.0) / case.hertz
    others = case.robot_names, (PLANE,), tuple(o for o in pair if o != name), tuple(o for o in case.names if o != name)
    other = ",".join(draw.choice(others) or (PLANE,))
    ways = [f"{other}>{name}", f"{name}>{other}"][: draw.choice((1, 1, 2))]
    return [Fault(at, "cut", way, lasting) for way in ways if name not in other.split(",")]


def _absence(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let a robot be dead for long, and meanwhile a coordinator, or both of a pair, for a while, perhaps twice."""
    robot = agent_name(draw.randint(1, case.robots))
    pair, lasting = draw.choice((*case.pairs[:1], *case.pairs) or (case.robot_names,)), _length(draw)
    lost = draw.choice((pair, pair, pair[:1], pair[-1:]))
    soon = draw.uniform(-0.5 * lasting, 10.0 / case.hertz)  # one that starts again may not know of this robot
    begins = max(0.0, at + draw.choice((draw.uniform(0.3, 1.0), soon, soon)))
    faults = [Fault(begins, "crash", name, lasting) for name in lost]
    if not case.each_robot and draw.random() < 0.3:
        faults.append(Fault(at + draw.uniform(0.0, 0.5), REMOVAL, draw.choice((robot, draw.choice(case.robot_names)))))
    if case.start == "proceed" and draw.random() < 0.5:  # others wait for all if nobody follows any more
        begins += lasting + draw.uniform(0.05, 1.0)
        faults += [Fault(begins, "crash", name, lasting) for name in lost]
    long = begins - at + lasting + case.settles + 1.0
    away = draw.choice((long, long, draw.uniform(0.3, 1.0)))
    return [Fault(at, "crash", robot, away), *faults]


def _forged(draw: Random, case: Case, at: float) -> list[Fault]:
    kind = draw.choice(FORGED)
    return [Fault(at, kind, _some(draw, case), draw.uniform(0.1, 1.0), draw.choice((-1, 0, 1, 2)))]


def _impostor(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let somebody speak in the name of others, to somebody who hears robots or the plane."""
    hears = draw.choice(((PLANE,), *(case.pairs or (case.robot_names,))))
    return [Fault(at, "impostor", draw.choice(hears), draw.uniform(0.1, 1.0), draw.choice((-1, 0, 1, 2)))]


def _blind(draw: Random, case: Case, at: float) -> list[Fault]:
    return [Fault(at, "blind", agent_name(draw.randint(1, case.robots)), _length(draw))]


def _overload(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let all nodes stand still in bursts, and hear what is old."""
    lasting = draw.uniform(0.3, 2.0)
    bursts = [
        Fault(at + draw.uniform(0.0, lasting), "pause", name, draw.uniform(0.0, 0.5) * draw.choice((0.2, 1.0)))
        for name in case.names
        for _ in range(2)
    ]
    return [Fault(at, "late", f"{ALL}>{ALL}", lasting, draw.choice((0.05, 0.5, 2.0))), *bursts]


_MIX: tuple[Callable[[Random, Case, float], list[Fault]], ...] = (
    _crash,
    _pause,
    _leader,
    _leader,
    _host,
    _cut,
    _weather,
    _clock,
    _operator,
    _takeover_of_a_stop,
    _takeover_of_a_stop,
    _stop_and_loss,
    _reset_at_a_stop,
    _handover,
    _stay_away,
    _stay_away,
    _set_back,
    _all_set_back,
    _deaf,
    _absence,
    _forged,
    _impostor,
    _blind,
    _overload,
)


def _split(draw: Random, case: Case, at: float) -> list[Fault]:
    """Part the robots, often into halves, for so long that the others do not count any more; maybe with orders."""
    names = draw.sample(case.robot_names, case.robots)
    first = draw.choice((case.robots // 2, draw.randint(1, case.robots - 1)))
    sides = ",".join(names[:first]), ",".join(names[first:])
    lasting = draw.choice((case.periods(25) + 1.0, case.periods(draw.randint(10, 60))))
    cuts = _parted(at, *sides, lasting)
    how = draw.random()
    if how < 0.4:
        return cuts + _orders(draw, case, at + draw.uniform(0.0, lasting))
    if how < 0.7:  # the other side continues its law meanwhile
        return [*cuts, Fault(at + draw.uniform(0.0, 0.5), "reset", draw.choice(case.robot_names))]
    return cuts


def _orders(draw: Random, case: Case, at: float) -> list[Fault]:
    """Give robots orders within few periods, so that who gets one may not know of those before."""
    faults = []
    for _ in range(draw.randint(2, 4)):
        faults.append(Fault(at, draw.choice(("stop", "reset")), draw.choice(case.robot_names)))
        at += draw.choice((0.5, 1.0, 5.0, 15.0)) / case.hertz
    return faults


def _long(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let some robots be away for longer than it takes until they do not count any more, one after the other."""
    faults = []
    for name in draw.sample(case.robot_names, draw.randint(1, case.robots - 2)):
        lasting = case.periods(25) + draw.uniform(1.0, 3.0)
        crash = Fault(at, "crash", name, lasting)
        faults += [crash] if draw.random() < 0.6 else _parted(at, name, ALL, lasting)
        at += draw.choice((0.0, case.periods(25) + 1.2))
    return faults


def _return(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let robots die until they do not count any more, and part those that count as they come back."""
    names = draw.sample(case.robot_names, case.robots)
    dead = names[: draw.randint(1, max(1, (case.robots - 1) // 2))]
    stay = names[len(dead) :]
    away = case.periods(25) + draw.uniform(1.2, 2.0)
    split, number = at + away - draw.uniform(0.0, 0.3), draw.randint(1, len(stay) - 1)
    sides = ",".join(stay[:number]), ",".join([*stay[number:], *dead])
    lasting = case.periods(draw.randint(15, 60))
    return [*(Fault(at, "crash", name, away) for name in dead), *_parted(split, *sides, lasting)]


def _long_dead(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let a robot be dead for longer than relays tell ages, and another one start that has to hear of it."""
    robot, other = draw.sample(case.robot_names, 2)
    away = case.periods(draw.randint(256, 290))
    return [Fault(at, "crash", robot, away), Fault(at + away - case.periods(draw.randint(5, 30)), "crash", other, 0.1)]


def _lies(draw: Random, case: Case, at: float) -> list[Fault]:
    """Let a robot lie about others, where these sign what they say."""
    name, lasting = draw.choice(case.robot_names), draw.uniform(0.1, 2.0)
    return [Fault(at, LIAR, name, lasting, draw.choice((1, 2, 3)))] if case.sealed else _forged(draw, case, at)


_AMONG_ROBOTS = (*2 * (_split, _split, _orders, _long, _return, _lies), _long_dead)
"""What else happens among robots without coordinators."""

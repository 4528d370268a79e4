"""Cases in lockstep: a short run with everything in it, and what the transport and the machines do to it.

The digest must be that of the simulation in one process, whatever happens; where silent robots are dropped, that of a
run in which their death was planned.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from random import Random
from typing import Any, NamedTuple

from tests.transport.network import LARGEST, Act, script
from tests.transport.swarm import AGENTS, LONGEST_RUN, Node, Swarm
from tests.transport.test_lockstep import ASKED, CASES, DROPPING, STEERED, assert_planned, cast_of, expected, stored
from tests.virtual.properties import BrokenError
from tests.virtual.schedule import Tell, numbered, untold

from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, RECORDER
from swarmabs_core.behaviours import Request
from swarmabs_core.cdr import decode, step_of
from swarmabs_core.errors import InputError
from swarmabs_core.membership import SILENT
from swarmabs_core.messages import EVENTS, SwarmEvent, Topic
from swarmabs_core.nodes import ROBOT_PREFIX, agent_name
from swarmabs_core.steering import ENDS, STEERER

_LENGTH = 30
_LONG = 8.0
"""Time, s, for which a node stands still, longer than silent robots are waited for."""
_CALM = 0.7
"""Share of cases in which nothing else happens while it does; all that is drawn would be over before it goes on."""
_DROPS, _STANDS, _STEERED = 0.4, 0.5, 0.3
"""Shares of runs that drop silent robots, of those that are steered, and of others in which a node stands still."""


class Doing(NamedTuple):
    """A deviation from the usual turns of the scheduler: after how many it comes, what it is, to which of many."""

    after: int
    act: Act
    which: int

    kind = "schedule"

    def __str__(self) -> str:
        return f"after {self.after} usual turns: {self.act.value} ({self.which})"


class Asked(NamedTuple):
    """What an operator asks for in a steered run, and after how many turns; without a request it is a pause."""

    after: int
    request: Request | None

    def __str__(self) -> str:
        return f"after {self.after} turns: an operator asks for {self.what}"

    @property
    def what(self) -> str:
        """What is asked for, in words."""
        if self.request is None:
            return f"a pause of {_LONG:g} s"
        action, robot, value, steps = self.request
        of, as_much = f" of robot {robot}" * bool(robot), f" {value:g}" * bool(value)
        return f"{action.name}{of}{as_much}{f' for {steps} steps' * bool(steps)}"


@dataclass(frozen=True)
class LockstepCase:
    """A run, its deviations, and, if silent robots are dropped, who dies, and after how many turns.

    Or a node that is no robot only `stands` still for longer than robots may be silent; if it is `calm` meanwhile, the
    deviations that are left come after that. If the run is steered, `asked` is what an operator asks for.
    """

    seed: int
    name: str
    faults: tuple[Doing, ...]
    who: str = ""
    after: int = 0
    stands: bool = False
    calm: bool = False
    robots: int = 3
    asked: tuple[Asked, ...] = ()
    numbers: tuple[int, ...] | None = None

    def only(self, numbers: Iterable[int]) -> LockstepCase:
        """Return the case with some of its deviations only."""
        return replace(self, faults=tuple(self.faults[number] for number in numbers), numbers=tuple(numbers))

    def __str__(self) -> str:
        does = f"stands still for {_LONG:g} s{' of calm' * self.calm}" if self.stands else "dies"
        what = f"; {self.who} {does} after {self.after} turns" if self.who else ""
        asked = (f"  {one}" for one in self.asked)
        return "\n".join(
            [f"seed {self.seed}: lockstep, {self.name}{what}", *asked, *numbered(self.faults, self.numbers)]
        )


def lockstep_case(seed: int) -> LockstepCase:
    """Draw a case."""
    draw = Random(f"virtual lockstep:{seed}")
    doings = tuple(Doing(*deviation) for deviation in script(draw.randint(0, 2**40), _LENGTH))
    name = draw.choice([*DROPPING] if draw.random() < _DROPS else [*CASES])
    after = draw.randint(0, LARGEST) % 120
    if name not in DROPPING:
        return LockstepCase(seed, name, doings)
    if draw.random() < _STEERED:
        return _steered(seed, doings, draw)
    if cast_of(name).scenario.faults or draw.random() < _STANDS:
        others = (PLANE, RECORDER) if cast_of(name).scenario.decentralised else (PLANE, RECORDER, OBSERVER, CONTROLLER)
        return LockstepCase(seed, name, doings, draw.choice(others), after, stands=True, calm=draw.random() < _CALM)
    return LockstepCase(seed, name, doings, agent_name(draw.randint(1, len(AGENTS))), after)


def _steered(seed: int, doings: tuple[Doing, ...], draw: Random) -> LockstepCase:
    """Draw a case that is steered, in which perhaps a robot dies; then no other one is taken away, and one remains."""
    who = draw.choice((0, draw.randint(1, len(AGENTS))))
    possible = [one for one in ASKED if not who or one.action not in ENDS or one.agent_id == who]
    asked = draw.sample([None, *possible], draw.randint(1, 4))
    times = sorted(draw.randint(0, 200) for _ in asked)
    requests = tuple(map(Asked, times, asked))
    name = agent_name(who) if who else ""
    return LockstepCase(seed, draw.choice([*STEERED]), doings, name, draw.randint(0, 120), asked=requests)


class _Told(Swarm):
    """A swarm that tells what happens in it.

    Attributes
    ----------
    stood : set
        The nodes that have stood still.
    waiting : set
        Robots that an observer has dropped while they waited for a message of a node that stood still: nobody has
        repeated it, so they could not answer.
    """

    def __init__(self, case: LockstepCase, tell: Tell) -> None:
        self._tell = tell
        self.stood: set[str] = set()
        self.waiting: set[str] = set()
        self._asked, self._resumes = deque(case.asked), 0.0
        super().__init__(cast_of(case.name), list(case.faults))  # type: ignore[arg-type]

    def step(self) -> None:
        while self._asked and self.turn >= self._asked[0].after:
            self._ask(self._asked.popleft())
        if self.steerer.paused and self.now >= self._resumes:
            self._pause(paused=False)
        super().step()

    def _ask(self, asked: Asked) -> None:
        """Let the operator ask, or pause the run; what cannot be is refused."""
        if asked.request is None:
            self._resumes = self.now + _LONG
            self._pause(paused=True)
            return
        said = ""
        try:
            self.steerer.ask(asked.request)
        except InputError as error:
            said = f", which is refused: {error}"
        self._tell(self.now, STEERER, f"is asked for {asked.what}{said}")

    def _pause(self, *, paused: bool) -> None:
        with suppress(InputError):  # it is over
            self.steerer.pause(paused=paused)
            self._tell(self.now, STEERER, "pauses the run" if paused else "resumes the run")

    def freeze(self, name: str, seconds: float) -> None:
        self._tell(self.now, name, f"stands still for {seconds:g} s")
        self.stood.add(name)
        super().freeze(name, seconds)

    def kill(self, name: str) -> None:
        self._tell(self.now, name, "dies")
        super().kill(name)

    def _publish(self, sender: Node, topic: Topic, data: bytes) -> None:
        super()._publish(sender, topic, data)
        if topic is not EVENTS or (event := decode(SwarmEvent, data)).detail != SILENT:
            return
        robot = self.nodes[agent_name(event.agent_id)]
        standing = [node for node in self.nodes.values() if node.frozen_until > self.now]
        lacks = {topic.name for node in standing for topic in node.role.endpoints.publications}
        if robot.alive and lacks.intersection(robot.spec.behaviour.missing()[1]):
            self.waiting.add(robot.name)

    def _meet(self, act: Act, index: int) -> None:
        parcel = self._under_way[index]
        what = f"{parcel.topic.name} of step {step_of(parcel.data)} of {parcel.sender.name}"
        done = {Act.OTHER: "arrives out of order", Act.LOSE: "is lost", Act.TWICE: "arrives twice"}[act]
        self._tell(self.now, parcel.receiver.name, f"{what} {done}{' unless it is resent' * parcel.reliable}")
        super()._meet(act, index)

    def _go_on(self, node: Node) -> None:
        super()._go_on(node)
        if node.ended:
            self._tell(self.now, node.name, "has ended", done=False)
        if node.name in self.problems:
            self._tell(self.now, node.name, f"fails: {self.problems[node.name]}", done=False)


class LockstepStory:
    """Lets a case happen; as `tests.virtual.story.Story`."""

    def __init__(self, case: LockstepCase, tell: Tell = untold) -> None:
        self.case = case
        self.swarm = _Told(case, tell)

    @property
    def time(self) -> float:
        """The time since the beginning, s."""
        return self.swarm.now

    def said(self) -> str:
        """Return all that was published, and how often, line by line."""
        return "".join(
            f"{node} publishes {topic.name} {number} times {data.hex()}\n"
            for (node, topic, data), number in self.swarm.published.items()
        )

    def check(self) -> None:
        """Run; raise an error if a property does not hold."""
        swarm, case = self.swarm, self.case
        if case.who:
            self._begin()
        if case.who and not case.stands:
            self._drop()
            return
        if not swarm.run():
            waiting = {node.name: node.spec.behaviour.missing() for node in swarm.nodes.values() if node.alive}
            said = swarm.problems or f"does not end within {LONGEST_RUN:g} s; it waits for {waiting}"
            raise BrokenError("lockstep goes on", "the swarm", str(said))
        if swarm.waiting or case.name in STEERED:
            self._compare_with_planned()
            return
        wanted, _ = expected(case.name)
        if stored(swarm.recorded) != wanted:
            raise BrokenError("equal digests", "the recorder", _first_difference(stored(swarm.recorded), wanted))

    def _begin(self) -> None:
        """Run until something happens to a node."""
        swarm, case = self.swarm, self.case
        first = swarm.nodes[OBSERVER if OBSERVER in swarm.nodes else PLANE].spec.behaviour
        while first.missing()[0] == 0 and not swarm.problems:
            swarm.step()
        swarm.run_turns(case.after)
        if case.stands:
            swarm.freeze(case.who, _LONG)
            if case.calm:
                swarm.run_calmly(swarm.now + _LONG)
        else:
            swarm.kill(case.who)

    def _drop(self) -> None:
        swarm = self.swarm
        if swarm.run(30.0):
            self._compare_with_planned()
        elif not (self._lacks_last_words() or self._outnumbered()):
            raise BrokenError("lockstep goes on", "the swarm", f"does not end: {swarm.problems or swarm.stalls()}")

    def _compare_with_planned(self) -> None:
        """Compare a run that has dropped robots with one in which that was planned."""
        swarm, case = self.swarm, self.case
        try:
            assert_planned(swarm, cast_of(case.name))
        except AssertionError as error:
            raise BrokenError("equal digests", "the recorder", f"differs from a planned death: {error}") from None
        events = (event for step in swarm.recorded for event in step.events if event.detail == SILENT)
        dropped = {agent_name(event.agent_id) for event in events}
        if wrong := sorted(dropped - {case.who} - swarm.stood - swarm.waiting):
            raise BrokenError("lockstep goes on", OBSERVER, f"drops {wrong[0]}, which has never been silent")

    def _lacks_last_words(self) -> bool:
        """Return whether the run does not end because the last word of the dead has not reached all who must know it.

        If all but the observer know of the death from the observer, this cannot be; of robots without coordinators only
        the recorder may lack it, and nothing else.
        """
        swarm, dead = self.swarm, f"agent {int(self.case.who.removeprefix(ROBOT_PREFIX))}"
        if OBSERVER in swarm.nodes:
            return not cast_of(self.case.name).packed
        waiting = [node.name for node in swarm.nodes.values() if node.alive and node.spec.behaviour.awaits()]
        return waiting == [RECORDER] and swarm.nodes[RECORDER].spec.behaviour.missing()[1] == (dead,)

    def _outnumbered(self) -> bool:
        """Return whether robots without coordinators have stopped as no majority: in a steered run only two begin."""
        problems = self.swarm.problems.values()
        return self.case.name in STEERED and any("are no majority" in str(problem) for problem in problems)


def _first_difference(found: list[Any], wanted: list[Any]) -> str:
    """Return where two recordings differ."""
    for one, other in zip(found, wanted, strict=False):
        if one != other:
            return f"step {one[0]} is not that of the simulation"
    return f"has {len(found)} steps; the simulation has {len(wanted)}"

"""Robots in lockstep without coordinators: rounds of relays with losses, robots that come, go, end or stand still.

What is recorded must be, bit for bit, what observer and parent controller would have led to; where the robots agree on
dropping silent ones, with an observer that drops the same ones at the same steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from operator import itemgetter
from random import Random
from typing import Any, NamedTuple

from tests.swarmabs_core.behaviours.peers_in_time import LATE, LOOKS, PLANE, REPEAT, SECONDS, World
from tests.swarmabs_core.behaviours.test_dropping import LINKS, MORE, STEPS, judged, swarm
from tests.virtual.properties import BrokenError
from tests.virtual.schedule import Tell, numbered, untold

from swarmabs_config.graph import PLANE as PLANE_NODE
from swarmabs_core.agreement import NOTHING, Vote
from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.messages import EventKind, Message, Messages, SwarmEvent, said, topic_of
from swarmabs_core.nodes import agent_name
from swarmabs_core.rank_sets import ranks

_STANDS = SECONDS - REPEAT - 2 * LOOKS - LATE
"""Time, s, for which a robot that has just not repeated itself can stand still without being taken for silent."""
_UNTIL = 30.0
"""Time, s, after which a run that has not ended hangs."""


class Doing(NamedTuple):
    """What happens to a robot.

    It `ends` after so many messages; `stands` still from a time, s, for a while, s; or another one is `deaf` to it from
    a time on.
    """

    kind: str
    robot: int
    when: float
    lasting: float = 0.0
    other: int = 0

    def __str__(self) -> str:
        if self.kind == "deaf":
            return f"robot {self.other} does not hear robot {self.robot} any more from {self.when:.3f} s on"
        if self.kind == "ends":
            return f"robot {self.robot} ends after {self.when:g} messages"
        return f"robot {self.robot} stands still from {self.when:.3f} s on for {self.lasting:.3f} s"


@dataclass(frozen=True)
class RoundsCase:
    """A swarm, who hears whom, the share of messages that the network loses, what is planned, and what happens."""

    seed: int
    robots: int
    links: str
    loss: float
    planned: str
    faults: tuple[Doing, ...]
    numbers: tuple[int, ...] | None = None

    def only(self, numbers: Iterable[int]) -> RoundsCase:
        """Return the case with some of what happens only."""
        return replace(self, faults=tuple(self.faults[number] for number in numbers), numbers=tuple(numbers))

    def __str__(self) -> str:
        what = f"{self.robots} robots without coordinators, links {self.links}, loss {self.loss:g}"
        plan = f"; planned: {self.planned}" if self.planned != "[]" else ""
        return "\n".join([f"seed {self.seed}: lockstep, {what}{plan}", *numbered(self.faults, self.numbers)])


def rounds_case(seed: int) -> RoundsCase:
    """Draw a case: with changes of the swarm that are planned, or with robots that end or stand still.

    Robots end while they or others have yet to join, but not after others have left: who is gone may lack a last
    message for ever.
    """
    draw = Random(f"virtual rounds:{seed}")
    robots = draw.randint(4, 10)
    links, loss = draw.choice(LINKS if robots < 6 else LINKS + MORE), draw.choice((0.0, 0.0, 0.05))
    if draw.random() < 0.3:
        first, *others = draw.sample(range(3, robots + 1), 2)
        joining = draw.random() < 0.5
        kinds = ["join", "join"] if joining else draw.sample(("kill", "leave", "join", "freeze"), 2)
        planned = [
            f"{{kind: {kind}, agent: {robot}, at: {0.01 * draw.randint(2, STEPS - 3):g}}}"
            for kind, robot in zip(kinds, (first, *others), strict=True)
        ]
        links = draw.choice([one for one in LINKS if "ring" not in one])
        ending = draw.sample(range(1, robots + 1), draw.randint(1, robots - 1)) if joining else []
        doings = [Doing("ends", robot, draw.randint(1, 100)) for robot in ending]
        return RoundsCase(seed, robots, links, loss, f"[{', '.join(planned)}]", tuple(doings))
    doings = []
    for robot in draw.sample(range(1, robots + 1), draw.randint(1, robots // 2)):
        if draw.random() < 0.7:
            doings.append(Doing("ends", robot, draw.randint(1, 100)))
        else:
            lasting = draw.uniform(0.0, _STANDS)
            doings.append(Doing("stands", robot, round(draw.uniform(0.0, 1.0), 3), round(lasting, 3)))
    if draw.random() < 0.4:
        robot, other = draw.sample(range(1, robots + 1), 2)
        doings.append(Doing("deaf", robot, round(draw.uniform(0.0, 1.0), 3), other=other))
    if draw.random() < 0.1:  # long enough to be dropped: it finds that out when it goes on
        doings = [Doing("stands", draw.randint(1, robots), round(draw.uniform(0.1, 0.3), 3), 4 * SECONDS)]
    return RoundsCase(seed, robots, links, loss, "[]", tuple(doings))


class _Told(World):
    """A swarm that tells what happens in it."""

    def __init__(self, case: RoundsCase, tell: Tell) -> None:
        super().__init__(swarm(case.robots, case.links, faults=case.planned), Random(case.seed), loss=case.loss)
        self._tell = tell
        self._votes: dict[int, Vote] = {}

    def _do(self, node: int, message: Message | None) -> None:
        try:
            super()._do(node, message)
        except RunError as error:
            self._now(node, f"stops: {error}")
            raise

    def _say(self, node: int, messages: Messages) -> None:
        before, lived = len(self.log), node not in self.dead
        super()._say(node, messages)
        for _, message in self.log[before:]:
            if isinstance(message, SwarmEvent):
                why = f", {message.detail}" if message.detail else ""
                what = f"robot {message.agent_id} {said(EventKind(message.kind))}{why}"
                self._now(node, f"tells all, of step {message.step}: {what}")
            elif node == PLANE:
                self._now(node, f"moves with the states of step {message.step}")
        if node != PLANE:
            self._vote(node)
        if lived and node in self.dead:
            self._tell(self.time, agent_name(node), "ends")

    def _vote(self, robot: int) -> None:
        """Tell what a robot votes now, if that is news."""
        agreement = self.peers[robot]._agreement  # noqa: SLF001 - before others hear of it
        own, before = agreement.own, self._votes.get(robot, NOTHING)
        self._votes[robot] = own
        names = ("takes for silent", "leaves out", "", "waits in vain for the plane without")
        for what, bits, known in zip(names, own, before, strict=True):
            if what and bits and bits != known:
                self._now(robot, f"{what} {', '.join(f'robot {rank + 1}' for rank in ranks(bits))}")

    def _now(self, node: int, what: str) -> None:
        self._tell(self.time, PLANE_NODE if node == PLANE else agent_name(node), what, done=False)


class RoundsStory:
    """Lets a case happen; as `tests.virtual.lockstep.LockstepStory`."""

    def __init__(self, case: RoundsCase, tell: Tell = untold) -> None:
        self.case = case
        self._tell = tell
        self.world = _Told(case, tell)

    @property
    def time(self) -> float:
        """The time since the beginning, s."""
        return self.world.time

    def said(self) -> str:
        """Return what was said, as text."""
        return "".join(f"{node} says {topic_of(m).name} {encode(m).hex()}\n" for node, m in self.world.log)

    def check(self) -> None:
        """Run; raise an error if a property does not hold."""
        world, case = self.world, self.case
        turns: list[tuple[float, str, str, Callable[[Any], None], Any]] = []
        for doing in case.faults:
            if doing.kind == "ends":
                world.end_at(doing.robot, int(doing.when))
            elif doing.kind == "deaf":
                link = f"{agent_name(doing.robot)} to {agent_name(doing.other)}"
                turns.append((doing.when, link, "nothing arrives", world.cut.add, (doing.robot, doing.other)))
            else:
                name, frozen = agent_name(doing.robot), world.frozen
                turns.append((doing.when, name, "stands still", frozen.add, doing.robot))
                turns.append((doing.when + doing.lasting, name, "goes on", frozen.discard, doing.robot))
        for when, who, what, do, of in sorted(turns, key=itemgetter(0)):
            world.run(max(0.0, when - world.time))
            self._tell(when, who, what)
            do(of)
        world.run(_UNTIL)
        try:
            judged(world, swarm(case.robots, case.links, "central", case.planned))
        except AssertionError as error:
            raise BrokenError("equal digests", "the swarm", f"is not as one with an observer: {error}") from None

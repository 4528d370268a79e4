"""Cases of recorders: what a fleet or a run in lockstep says, heard by several recorders, whose disks and hosts fail.

The runs are simulated once in each process, so a case costs no more than its bags.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import groupby
from math import inf
from operator import attrgetter, itemgetter
from pathlib import Path
from random import Random
from typing import Any, NamedTuple, cast

from tests.swarmabs_core.helpers import builtin, singly
from tests.transport.network import Reports
from tests.transport.swarm import AGENTS, Cast, Swarm
from tests.virtual.disk import RESERVED, Disk
from tests.virtual.fleet import EPOCH, VirtualFleet, Watcher
from tests.virtual.properties import BrokenError
from tests.virtual.recorders import (
    CLOSED,
    FULL,
    KILLED,
    MERGED,
    POLLS,
    POWER,
    STOPPED,
    TOPICS_BY_NAME,
    Bags,
    Place,
    RealtimeRecorder,
    Recorder,
    Stored,
    content,
    is_explained,
    lacking,
    place_of,
)
from tests.virtual.schedule import Fault, Tell, numbered, untold
from tests.virtual.story import scenario_of

from swarmabs_analysis.verification.lockstep import LockstepVerification
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.errors import BagWriteError
from swarmabs_bag.merge import merge_bags
from swarmabs_bag.recorder.node import Recorder as LockstepBehaviour, Reporter
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.repair.completeness import complete_steps
from swarmabs_bag.run.digest import Digest
from swarmabs_bag.run.step import Step
from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_config import configure
from swarmabs_config.graph import CONTROLLER, OBSERVER, STANDBY_SUFFIX, standby_topic, usual_topic
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import decode, step_of
from swarmabs_core.membership import SILENT
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BASIS,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    STANDING,
    Message,
    Relay,
    Topic,
    relay_topic,
    topic_of,
)
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.relays import Content
from swarmabs_run.simulation import Simulation

_TOPICS = (ABSTRACT_STATE, AUXILIARY_STATE, DESIRED_ABSTRACT_STATE, PLANE_STATE, BASIS)
_DEPTH = 10
"""Messages of a topic that wait for a recorder that stands still."""


class Harm(NamedTuple):
    """What happens to a recorder at a time (s) and lasts for a while (s).

    It loses messages with a probability; stands still; hears messages late by up to a time, or twice, or also some that
    are cut off; has a wrong clock; is killed, or its power is cut, and it starts again with another bag; its disk has
    so many bytes; it is stopped; or it begins late.
    """

    at: float
    kind: str
    recorder: int
    lasting: float = 0.0
    value: float = 0.0

    def __str__(self) -> str:
        return str(Fault(self.at, self.kind, f"recorder {self.recorder}", self.lasting, self.value))


@dataclass(frozen=True)
class BagCase:
    """A run by its name, its recorders and what happens to them.

    A file of a bag ends after so many bytes (`split`, 0: never) or s (`lasts`); chunks have `chunk_bytes`; writes are
    short with a probability. A run in lockstep takes `pace` s for a step; its recorder gathers messages for so long, s.
    No recorder hears the topic `deaf_to`.
    """

    seed: int
    name: str
    faults: tuple[Harm, ...]
    recorders: int = 2
    split: int = 0
    lasts: float = 0.0
    chunk_bytes: int = 2**20
    short: float = 0.0
    pace: float = 0.02
    gathers: float = 0.0
    deaf_to: str = ""
    robots: int = 3
    numbers: tuple[int, ...] | None = None

    def only(self, numbers: Iterable[int]) -> BagCase:
        """Return the case with some of its faults only."""
        return replace(self, faults=tuple(self.faults[number] for number in numbers), numbers=tuple(numbers))

    def __str__(self) -> str:
        words = [
            f"{self.recorders} recorder{'s' * (self.recorders > 1)} of a run: {self.name}",
            f"chunks of {self.chunk_bytes} bytes",
            *([f"files of {self.split} bytes"] if self.split else []),
            *([f"files of {self.lasts:g} s"] if self.lasts else []),
            *(["short writes"] if self.short else []),
            *([f"nobody hears {self.deaf_to}"] if self.deaf_to else []),
        ]
        return "\n".join([f"seed {self.seed}: {'; '.join(words)}", *numbered(self.faults, self.numbers)])


def bag_case(seed: int) -> BagCase:
    """Draw a case."""
    draw = Random(f"virtual bags:{seed}")
    name = draw.choice((*FLEETS, *RUNS, *RUNS))
    recorders = draw.choice((1, 2, 2, 3)) if name in FLEETS else draw.choice((1, 1, 2))
    pace, harms = draw.choice((0.005, 0.02, 0.06)), []
    length = _LENGTH if name in FLEETS else pace * run_of(name).scenario.steps
    all_end = name in RUNS and recorders > 1 and draw.random() < 0.5
    for number in range(1, recorders + 1):
        lossy = (
            ("loss", "loss", "pause", "late", "again", "garbage", "clock", "begins")
            if name in FLEETS
            else ("late", "again")
        )
        kinds = [draw.choice(lossy) for _ in range(draw.choice((0, 1, 1, 3)))]
        ends = draw.choice((KILLED, POWER))
        kinds += [ends] if all_end else draw.choice(((), (), (KILLED,), (POWER,), (POWER,), (FULL,), (STOPPED,)))
        harms += [_harm(draw, kind, number, length) for kind in kinds]
        if all_end:  # for good
            harms[-1] = harms[-1]._replace(lasting=0.0)
    split, lasts = draw.choice(((0, 0.0), (0, 0.0), (24_000, 0.0), (50_000, 0.0), (0, 1.0), (40_000, 0.7)))
    return BagCase(
        seed,
        name,
        tuple(sorted(harms)),
        recorders,
        split,
        lasts * draw.choice((1.0, 1.6)) if name in FLEETS else lasts * draw.choice((0.1, 0.3)),
        draw.choice((2**20, 2**20, 2500, 8000)),
        draw.choice((0.0, 0.3)),
        pace,
        draw.choice((0.0, 0.2, 0.2)),
        draw.choice(_TOPICS).name if name in FLEETS and draw.random() < 0.15 else "",
    )


def _harm(draw: Random, kind: str, number: int, length: float) -> Harm:
    at, lasting = draw.uniform(0.0, 0.9 * length), draw.choice((draw.uniform(0.01, 0.3), draw.uniform(0.3, 2.5)))
    value = {
        "loss": draw.choice((0.02, 0.3, 1.0)),
        "late": draw.choice((0.02, 0.3)),
        "again": draw.choice((0.02, 0.3)),
        "garbage": draw.choice((0.02, 0.3)),
        "clock": draw.choice((-0.3, -0.02, 0.05, 0.4)),
        FULL: float(draw.choice((draw.randint(4_000, 60_000), draw.randint(60_000, 150_000)))),
    }.get(kind, 0.0)
    if kind in {KILLED, POWER}:
        lasting = draw.choice((0.0, lasting))
    return Harm(round(at, 3), kind, number, round(lasting, 3), value)


# What is said in the runs


class Said(NamedTuple):
    """A message that a node publishes at a time, s."""

    time: float
    node: str
    topic: Topic
    data: bytes
    writer: bytes


class Fleet(NamedTuple):
    """A run in real time."""

    scenario: Scenario
    schedule: Schedule
    paired: bool
    said: tuple[Said, ...]


class _Listener(Watcher):
    def __init__(self, fleet: VirtualFleet) -> None:
        self._fleet = fleet
        self.said: list[Said] = []

    def published(self, node: str, topic: Topic, message: Message, data: bytes) -> None:
        told = standby_topic(topic) if node.endswith(STANDBY_SUFFIX) else topic
        told = topic_of(message) if isinstance(message, Relay) else told
        self.said.append(Said(self._fleet.time, node, told, data, self._fleet.nodes[node].writers.get(told, b"")))


_LENGTH = 4.0
"""Length, s, of a run in real time."""
_OBSERVER_DIES = ((1.9, OBSERVER, 0.9), (1.0, agent_name(2), 1.5))
_LEADER_DIES = ((2.2, CONTROLLER, 0.8), (3.5, OBSERVER, 1.0))
_ROBOT_DIES = (0.9, agent_name(3), 1.5)
_STOPPED = ((1.7, CONTROLLER, "stop"), (2.4, CONTROLLER, "reset"), (3.6, CONTROLLER, "stop"))
_STOPPED_WITHOUT = ((1.7, agent_name(2), "stop"), (2.4, agent_name(1), "reset"), (3.6, agent_name(2), "stop"))
FLEETS: dict[str, tuple[tuple[float, str, float | str], ...]] = {
    "a fleet": (),
    "a fleet whose observer and a robot die": _OBSERVER_DIES,
    "a fleet that is stopped while a robot is dead": (_ROBOT_DIES, *_STOPPED),
    "a fleet with standbys": _LEADER_DIES,
    "a fleet without coordinators": ((2.0, agent_name(3), 0.7),),
    "a fleet without coordinators whose speaker dies": ((1.3, agent_name(1), 1.4),),
    "a fleet without coordinators that is stopped while a robot is dead": (_ROBOT_DIES, *_STOPPED_WITHOUT),
}
"""Runs in real time: when, s, which node dies and for how long, s, or what it is told."""
_DROPPING = "a run without coordinators in which a robot is dropped"
_DROPS = 1400
"""Turns of the scheduler after which that robot dies."""
RUNS: dict[str, tuple[str, ...]] = {
    "a run in lockstep": (),
    "a run in which robots join and die": (
        "faults=[{kind: join, agent: 3, at: 0.13}, {kind: kill, agent: 2, at: 0.3}]",
    ),
    "a run without coordinators": ("coordination=each_robot",),
    _DROPPING: ("coordination=each_robot", "lockstep.on_stall=drop"),
}
"""Runs in lockstep: what their scenarios say beyond three robots and 61 steps."""


@cache
def fleet_of(name: str) -> Fleet:
    """Return what is said in a run in real time."""
    paired = "standbys" in name
    scenario = scenario_of(3, 20, "wait", "each_robot" if "without coordinators" in name else "central")
    fleet = VirtualFleet(scenario, seed=7, paired=paired, identified=True, kept=False)
    listener = _Listener(fleet)
    fleet.watch(listener)
    for at, node, what in FLEETS[name]:
        if isinstance(what, str):
            fleet.later(at, partial(fleet.call, node, what))
            continue
        fleet.later(at, partial(fleet.kill, node))
        fleet.later(at + what, partial(fleet.revive, node))
    fleet.run(_LENGTH)
    return Fleet(scenario, fleet.clock, paired, tuple(listener.said))


class Run(NamedTuple):
    """A run in lockstep: its steps, all that a bag of it holds, and its digest.

    Relays of a robot that is dropped, and those in a step in which their sender votes, are `optional` in a bag.
    """

    scenario: Scenario
    steps: tuple[Step, ...]
    stored: tuple[Stored, ...]
    digest: str
    optional: frozenset[Stored]


@cache
def run_of(name: str) -> Run:
    """Return what is said in a run in lockstep."""
    agents = f"swarm.agents=[{', '.join(AGENTS)}]"
    scenario = builtin("pd_het_4", agents, "duration=0.6", *RUNS[name]).resolved()
    steps = _dropping(scenario) if name == _DROPPING else tuple(singly(Simulation(scenario).steps()))
    digest = Digest()
    for step in steps:
        digest.update(step)
    stored = tuple(Stored(topic.name, time, data) for step in steps for topic, time, data in step.stored())
    return Run(scenario, steps, stored, digest.hexdigest(), frozenset(_depends_on_time(scenario, steps)))


def _depends_on_time(scenario: Scenario, steps: Iterable[Step]) -> Iterator[Stored]:
    """Yield the relays of a run that may be missing in a bag, although nothing is lost."""
    content = Content(sorted(configure.members(scenario)), scenario.family)
    dropped = {event.agent_id for step in steps for event in step.events if event.detail == SILENT}
    for step in steps if dropped else ():
        relays = {
            Stored(topic.name, time, data): cast("Relay", decode(Relay, data))
            for topic, time, data in step.stored()
            if topic.message is Relay
        }
        voted = {relay.agent_id for relay in relays.values() if content.votes(relay)}
        yield from (stored for stored, relay in relays.items() if relay.agent_id in dropped | voted)


def _dropping(scenario: Scenario) -> tuple[Step, ...]:
    """Return the steps of a run in which the robot that speaks for all dies."""
    swarm = Swarm(Cast(scenario))
    swarm.run_turns(_DROPS)
    swarm.kill(agent_name(1))
    assert swarm.run()
    return tuple(swarm.recorded)


class LockstepRecorder(Recorder):
    """A recorder of a run in lockstep."""

    recording: Recording

    def __init__(
        self, name: str, folder: Path, disk: Disk, scenario: Scenario, split: Split, *, gathers: float
    ) -> None:
        super().__init__(name, folder, disk)
        self._gathers, self._drained = gathers, disk.clock()
        self._arrived: dict[Topic, list[bytes]] = {}
        self.recording = Recording(scenario, folder, driver="lockstep", split=split)
        self.behaviour = LockstepBehaviour(scenario, self.recording, lambda _: None)
        self.reports = Reports()
        self._watch("write_step")

    def hear(self, topic: Topic, data: bytes) -> None:
        """Take a message that arrives; messages are gathered for a while."""
        self._arrived.setdefault(topic, []).append(data)
        if self.disk.clock() - self._drained >= self._gathers:
            self._drain()

    def _drain(self) -> None:
        arrived, self._arrived, self._drained = self._arrived, {}, self.disk.clock()
        try:
            for topic, payloads in arrived.items():
                self.behaviour.hear_all(topic, payloads)
        except BagWriteError as error:
            self.fail(error)

    def end(self, ending: str = CLOSED) -> None:
        """End after what has arrived is recorded."""
        if not self.ending:
            self._drain()
        super().end(ending)

    def complete(self, ending: str) -> None:
        """End as the node does: the bag of a run that is not over is not closed."""
        reporter = Reporter(self.recording, cast("Any", self.reports), "")
        reporter.done(None if ending == CLOSED else STOPPED, complete=self.behaviour.finished)
        if ending == CLOSED and not self.behaviour.finished:
            self.ending = STOPPED


# What happens to those who hear it


class _Host:
    """The host of a recorder: it has a clock, a disk, and a list of what arrives when."""

    def __init__(self, case: BagCase, number: int, bags: Bags, tell: Tell) -> None:
        self._case, self._bags, self._tell = case, bags, tell
        self.name = f"recorder {number}"
        self._harms = [harm for harm in case.faults if harm.recorder == number]
        self._draw = Random(f"virtual bags:{case.seed}:{number}")
        self._now = 0.0
        self._polled = 0.0
        full = next((round(harm.value) for harm in self._harms if harm.kind == FULL), None)
        self._disk = partial(
            Disk,
            self._draw,
            lambda: self._now,
            short=case.short,
            free=None if full is None else RESERVED + full,
            chunk_bytes=case.chunk_bytes,
        )
        self._split = Split(case.split, round(case.lasts * 1e9)) if case.split or case.lasts else ONE_FILE
        self._recorder: Any = None

    def run(self) -> None:
        """Let all happen, and end."""
        ends = sorted((h for h in self._harms if h.kind in {KILLED, POWER, STOPPED}), key=attrgetter("at"))
        begins = max((harm.at for harm in self._harms if harm.kind == "begins"), default=0.0)
        self._now = begins
        self._begin()
        for time, said in self._arrivals():
            while ends and ends[0].at < time:
                harm = ends.pop(0)
                self._pass(harm.at)
                self._end(harm)
                begins = harm.at + harm.lasting if harm.lasting else inf
            if time < begins:
                continue
            self._pass(time)
            if self._recorder is None:
                self._begin()
            if not self._recorder.ending:
                self._hear(said)
                if self._recorder.ending:
                    self._tell(self._now, self.name, "has no room on its disk, and completes its bag", done=False)
        if self._recorder is not None and not self._recorder.ending:
            self._recorder.end()
            self._tell(self._now, self.name, "closes its bag", done=False)

    def _begin(self) -> None:
        case, disk = self._case, self._disk()
        folder = self._bags.place(disk)
        name = f"{self.name} in {folder.name}"
        self._tell(self._now, self.name, f"begins {folder.name}", done=False)
        if case.name in FLEETS:
            fleet = fleet_of(case.name)
            self._recorder = RealtimeRecorder(
                name, folder, disk, fleet.scenario, fleet.schedule, paired=fleet.paired, split=self._split
            )
        else:
            self._recorder = LockstepRecorder(
                name, folder, disk, run_of(case.name).scenario, self._split, gathers=case.gathers
            )
        self._bags.recorders.append(self._recorder)

    def _end(self, harm: Harm) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is None or recorder.ending:
            return
        what = {KILLED: "is killed", POWER: "loses its power", STOPPED: "is stopped"}[harm.kind]
        self._tell(self._now, self.name, what)
        if harm.kind == STOPPED:
            recorder.end(STOPPED)
        else:
            recorder.die(harm.kind)

    def _pass(self, time: float) -> None:
        """Let time pass; a recorder looks at its clock meanwhile."""
        while self._polled + POLLS < time:
            self._polled += POLLS
            self._now = max(self._now, self._polled)
            if self._recorder is not None:
                self._recorder.poll()
        self._now = max(self._now, time)

    def _hear(self, said: Said) -> None:
        if isinstance(self._recorder, RealtimeRecorder):
            wrong = sum(harm.value for harm in self._harms if harm.kind == "clock" and _during(harm, self._now))
            self._recorder.hear(said.topic, said.data, EPOCH + round((self._now + wrong) * 1e9), said.writer)
        else:
            self._recorder.hear(said.topic, said.data)

    def _arrivals(self) -> list[tuple[float, Said]]:
        """Return what arrives when, in this order."""
        draw, arrivals = self._draw, []
        waiting: dict[tuple[Harm, Topic], list[Said]] = {}
        for said in _said_in(self._case):
            if usual_topic(said.topic).name == self._case.deaf_to:
                continue
            harms = [harm for harm in self._harms if _during(harm, said.time)]
            if any(harm.kind == "loss" and draw.random() < harm.value for harm in harms):
                continue
            pause = next((harm for harm in harms if harm.kind == "pause"), None)
            if pause is not None:
                queue = waiting.setdefault((pause, said.topic), [])
                queue.append(said)
                del queue[:-_DEPTH]
                continue
            after = draw.uniform(1e-4, 2e-3) + sum(draw.random() * h.value for h in harms if h.kind == "late")
            arrivals.append((said.time + after, said))
            if any(harm.kind == "again" and draw.random() < harm.value for harm in harms):
                arrivals.append((said.time + after + draw.uniform(0.0, 0.3), said))
            if any(harm.kind == "garbage" and draw.random() < harm.value for harm in harms):
                arrivals.append((said.time + after, said._replace(data=said.data[:-9])))
        arrivals += [(harm.at + harm.lasting, said) for (harm, _), queue in waiting.items() for said in queue]
        return sorted(arrivals, key=itemgetter(0))


def _during(harm: Harm, time: float) -> bool:
    return harm.at <= time < harm.at + harm.lasting


def _said_in(case: BagCase) -> Iterable[Said]:
    if case.name in FLEETS:
        return fleet_of(case.name).said
    return (
        Said(step.step * case.pace, "", topic, data, b"")
        for step in run_of(case.name).steps
        for topic, _, data in step.stored()
    )


class BagStory:
    """Lets a case happen; as `tests.virtual.story.Story`."""

    def __init__(self, case: BagCase, tell: Tell = untold) -> None:
        self.case = case
        self._tell = tell
        self._said: list[str] = []

    @property
    def time(self) -> float:
        """The time that is simulated, s."""
        return _LENGTH * self.case.recorders

    def said(self) -> str:
        """Return what is in the bags, line by line."""
        return "".join(self._said)

    def check(self) -> None:
        """Let everything happen; raise an error if a property does not hold."""
        case, bags = self.case, Bags()
        try:
            for number in range(1, case.recorders + 1):
                _Host(case, number, bags, self._tell).run()
            found = bags.check(explained=True)
            for recorder, bag in found.items():
                stored = content(bag)
                self._said += [f"{bag.name} {topic} {time} {data.hex()}\n" for topic, time, data in stored]
                if case.name in RUNS:
                    is_run(cast("LockstepRecorder", recorder), bag, stored, run_of(case.name))
            if case.name in RUNS and case.seed % 3 == 0:
                misses_one(run_of(case.name), Random(case.seed))
            merged = bags.merged(found.values(), explained=case.name in FLEETS)
            if merged is not None:
                stored = content(merged[0])
                missing = {*lacking(merged[1])}
                if case.name in FLEETS:
                    names_losses(missing, stored, fleet_of(case.name))
                else:
                    names_steps(missing, stored, run_of(case.name), cut=bags.cut)
                    if not missing:
                        is_explained(merged[0], MERGED)
                if case.seed % 3 == 0:
                    is_the_same(merged[0], found.values())
        finally:
            bags.remove()


def is_run(recorder: LockstepRecorder, bag: Path, found: list[Stored], run: Run) -> None:
    """Raise an error unless a bag has a run, up to where it was ended, and says so."""
    name = f"{recorder.name} ({recorder.ending})"
    lacks, more = Counter(run.stored), Counter(found)
    lacks, more = lacks - more - Counter(run.optional), more - lacks
    if more:
        raise BrokenError("bags survive", name, f"has {more.total()} messages that are not those of the run")
    result = BagToVerify(bag).verify()
    if recorder.ending == CLOSED:
        if lacks:
            steps = sorted({step_of(stored.payload) for stored in lacks})
            raise BrokenError("bags survive", name, f"lacks messages of steps {steps[:5]} of a complete run")
        digests = {run.digest, result.digest, recorder.recording.figures()["digest"]}
        if len(digests) > 1 or not result.complete:
            raise BrokenError("losses are counted", name, f"is complete, but verified {result.steps} steps, {digests}")
        return
    missing = [step_of(stored.payload) for stored in lacks if stored.topic != EVENTS.name]
    last = min(missing, default=run.steps[-1].step + 1) - 1
    steps = complete_steps(bag)
    # Relays of a robot that is dropped may be missing. Before a bag tells of it, it is not known that the robot has not
    # said more in its last step than what is there.
    there = {*found}
    told = any(map(tells_of_drop, found))
    ends = {step_of(stored.payload) for stored in run.optional if not told} & {last}
    lacking = {step_of(stored.payload) for stored in run.optional - there}
    least = min([last, *(step - 1 for step in lacking | ends)])
    if steps is None or (steps.first == 0 and last >= 0 and not least <= steps.last_complete <= last):
        raise BrokenError("losses are counted", name, f"has the steps up to {last}, but a repair finds {steps}")


def misses_one(run: Run, draw: Random) -> None:
    """Raise an error unless it is found that one message is missing of a bag that is whole, often an event."""
    messages = [message for step in run.steps for message in step.stored()]
    events = [message for message in messages if message[0] is EVENTS]
    topic, time, data = draw.choice(draw.choice((events or messages, messages)))
    if Stored(topic.name, time, data) in run.optional:
        return
    verification = LockstepVerification(run.scenario, relayed=run.scenario.decentralised)
    for message in messages:
        if message != (topic, time, data):
            verification.add(*message)
    verification.finish()
    if verification.result.difference is None:
        text = f"nothing is missed of a bag without the message on {topic.name} of step {step_of(data)}"
        raise BrokenError("bags are explained", "verify", text)


def tells_of_drop(stored: Stored) -> bool:
    """Return whether a message tells that a robot is dropped because it is silent."""
    return stored.topic == EVENTS.name and SILENT.encode() in stored.payload


Missing = tuple["str | None", int, int]
"""A message that is missing: topic (None: all), robot (0: none), step."""


def names_steps(named: set[Missing], merged: list[Stored], run: Run, *, cut: bool) -> None:
    """Raise an error unless what merged bags of a run in lockstep lack up to their last step is named.

    So is what comes after it, if the bags are `cut` off. Of events, and of how the abstract state divides, no number of
    a step is known. Where the event is lost that tells of a dropped robot, more of that robot may seem to be missing.
    """
    optional = {EVENTS.name, STANDING.name}
    there = {place_of(stored.topic, stored.payload) for stored in merged}
    last = max(place.step for place in there)
    places = {place_of(stored.topic, stored.payload) for stored in run.stored}
    wanted = {_missing(place) for place in places - there if place.topic not in optional and place.step <= last}
    perhaps = {_missing(place_of(stored.topic, stored.payload)) for stored in run.optional}
    found = {name for name in named if name[2] <= last and name[0] not in optional}
    if not any(tells_of_drop(stored) for stored in merged):
        dropped = {event.agent_id for step in run.steps for event in step.events if event.detail == SILENT}
        theirs = {
            *((AGENT_STATE.name, robot) for robot in dropped),
            *((relay_topic(robot).name, 0) for robot in dropped),
        }
        perhaps |= {name for name in found - {_missing(place) for place in places} if name[:2] in theirs}
    is_named(found - perhaps, wanted - perhaps)
    if cut:
        never: set[Missing] = {(None, 0, step) for step in range(last + 1, run.scenario.steps + 1)}
        is_named({(None, 0, step) for _, _, step in named if step > last}, never)


def names_losses(named: set[Missing], merged: list[Stored], fleet: Fleet) -> None:
    """Raise an error unless what merged bags in real time lack is named where it is known.

    What a node says at once is known as soon as a bag has a part of it, and a step without any message between others.
    """
    there = {_usual(stored.topic, stored.payload) for stored in merged if stored.topic != EVENTS.name}
    begins: dict[tuple[str, int], int] = {}
    for topic, of, step in there:
        begins[topic, of] = min(step, begins.get((topic, of), step))
    steps = {step for _, _, step in there}
    first = min(steps)
    silent: set[Missing] = {(None, 0, step) for step in range(first, max(steps)) if step not in steps}
    said, known = _said_at_once(fleet), set()
    for together in () if fleet.scenario.decentralised else said:
        if together & there:
            known |= {one for one in together - there if one[2] > begins.get(one[:2], first)}
    possible = {_folded(one) for one in _all_said(fleet) - there}
    if wrong := sorted(name for name in named if name[0] is not None and name not in possible):
        topic, of, step = wrong[0]
        raise BrokenError("losses are counted", MERGED, f"wrongly names as missing: {topic} of {of}, step {step}")
    wanted = silent | {_folded(one) for one in known}
    is_named({name for name in named if name in wanted or name[0] is None}, wanted)


@cache
def _said_at_once(fleet: Fleet) -> list[set[tuple[str, int, int]]]:
    """Return what nodes have said at once."""
    spoken = (said for said in fleet.said if usual_topic(said.topic) not in {EVENTS, STANDING})
    return [
        {_usual(said.topic.name, said.data) for said in together}
        for _, together in groupby(spoken, key=attrgetter("time", "node"))
    ]


@cache
def _all_said(fleet: Fleet) -> set[tuple[str, int, int]]:
    return {_usual(said.topic.name, said.data) for said in fleet.said}


def _usual(topic: str, data: bytes) -> tuple[str, int, int]:
    """Return usual topic, robot or source, and step of a message."""
    place = place_of(topic, data)
    usual = topic if topic.endswith("/relay") else usual_topic(TOPICS_BY_NAME[topic]).name
    return usual, place.of, place.step


def _folded(one: tuple[str, int, int]) -> Missing:
    """Return how a report names a message."""
    topic, of, step = one
    return topic, of if topic == AGENT_STATE.name else 0, step


def _missing(place: Place) -> Missing:
    return _folded((place.topic, place.of, place.step))


def is_named(named: set[Missing], wanted: set[Missing]) -> None:
    """Raise an error unless all that is lacking is named, and nothing else."""
    for others, what in ((wanted - named, "does not name"), (named - wanted, "wrongly names")):
        for topic, of, step in sorted(others, key=str)[:1]:
            where = f"{topic or 'all topics'}{f' of {of}' if of else ''}, step {step}"
            raise BrokenError("losses are counted", MERGED, f"{what} as missing: {where}")


def is_the_same(merged: Path, bags: Iterable[Path]) -> None:
    """Raise an error if a merge depends on the order of the bags."""
    again = merged.with_name("merged again")
    merge_bags([*bags][::-1], again)
    for file in sorted(merged.iterdir()):
        if file.read_bytes() != (again / file.name).read_bytes():
            raise BrokenError("bags are merged", MERGED, f"{file.name} depends on the order of the bags")

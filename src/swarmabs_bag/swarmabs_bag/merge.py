"""Merging bags that several recorders wrote of one run: what each of them lacks, another one may have."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import dataclass, replace
from hashlib import sha256
from heapq import merge
from itertools import count
from operator import itemgetter
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_bag.attached import (
    MERGED,
    PROVENANCE_FILE,
    SCENARIO_FILE,
    attached_provenance,
    attached_scenario,
    contradiction,
    is_realtime,
)
from swarmabs_bag.errors import BagWriteError, DamagedBagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import realtime_world
from swarmabs_bag.repair.bag import CUT_OFF, refuse_taken, repair_bag, work_folder
from swarmabs_bag.repair.completeness import LockstepCompleteness, RealtimeCompleteness
from swarmabs_bag.repair.spans import Spans
from swarmabs_bag.run.gatherer import MEMORY as LOCKSTEP_MEMORY
from swarmabs_bag.run.metadata import REPAIRED_KEY, load_yaml
from swarmabs_bag.run.realtime_gatherer import RealtimeCollector
from swarmabs_bag.run.step import ORDER
from swarmabs_bag.run.writer import BagWriter
from swarmabs_bag.run_folder import ONE_FILE, Split, find_bag
from swarmabs_config import configure
from swarmabs_config.graph import LOCKSTEP, OFFERED, REALTIME, usual_topic
from swarmabs_config.model.errors import show
from swarmabs_core.errors import InputError, MalformedMessageError, RunError
from swarmabs_core.messages import EVENTS, Relay, SwarmEvent
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from swarmabs_bag.reader import BagReader
    from swarmabs_bag.realtime_world import RealtimeWorld
    from swarmabs_bag.repair.bag import RepairReport
    from swarmabs_bag.repair.completeness import Gap
    from swarmabs_core.messages import Message, Topic

_OF_RECORDER = ("machine", "byte_order", "libm_fingerprint", "standby")
"""What the provenance says of the recorder and its host, which may differ."""
_BLOCK = 2**20


class ContradictionError(RunError):
    """Two different messages where a run in lockstep has one."""


class Contradiction(NamedTuple):
    """Two different messages in one place of bags in real time: topic without namespace, robot (0: none) and step."""

    topic: str
    robot: int
    step: int


@dataclass(frozen=True, slots=True)
class MergedBag:
    """One of the bags: its messages, the spans of steps of which it has any, and its repair if that was necessary.

    The repaired copy is temporary, so the report of the repair has no output.
    """

    bag: str
    messages: int
    steps: tuple[tuple[int, int], ...]
    repaired: RepairReport | None


@dataclass(frozen=True, slots=True)
class MergeReport:
    """The result of a merge.

    Attributes
    ----------
    output : str
        The merged bag.
    topics : dict
        Its numbers of messages by topic, without namespace.
    gaps : tuple of Gap
        Messages that are known to be in none of the bags.
    contradictions : tuple of Contradiction
        Places where bags in real time have different messages; the one that was received first is kept.
    ended_early : str or None
        Why the recording ended early, if it did.
    """

    output: str
    bags: tuple[MergedBag, ...]
    messages: int
    topics: dict[str, int]
    gaps: tuple[Gap, ...]
    contradictions: tuple[Contradiction, ...]
    ended_early: str | None

    @property
    def complete(self) -> bool:
        """Whether nothing is known to be missing, or in doubt."""
        return not self.gaps and not self.contradictions


def merge_bags(paths: Sequence[Path | str], output: Path) -> MergeReport:
    """Merge bags that several recorders wrote of one run into a new one, which does not depend on their order.

    A damaged bag is repaired first, in a temporary copy. Messages are read in bounded memory, twice: the first time
    nothing is written, so that a merge that is refused leaves nothing behind. The bags are not changed.

    Parameters
    ----------
    paths : sequence of Path
        At least two bags: run folders, their ``bag/``, or MCAP files.
    output : Path
        Folder of the new bag, new or empty.

    Raises
    ------
    InputError
        If a path is not a bag, the bags are not of one run, or the output exists.
    ContradictionError
        If bags of a run in lockstep contain different messages in one place.
    DamagedBagError
        If no message of a bag can be recovered.
    BagWriteError
        If the disk is full or fails; nothing is left behind.
    """
    refuse_taken(output)
    _refuse_repeated(paths)
    with work_folder(output) as work:
        try:
            sources = [_Source(Path(path), work / str(number)) for number, path in enumerate(paths)]
            run = _Run(sources)
            examined = run.examined()
            _write(run, examined, work / "merged")
        except BagWriteError as error:
            raise BagWriteError(output, error.cause) from error
        (work / "merged").rename(output)
    return MergeReport(
        output=str(output),
        bags=tuple(
            MergedBag(str(source.named), source.bag.message_count, tuple(source.steps), source.repaired)
            for source in sources
        ),
        messages=examined.topics.total(),
        topics=dict(examined.topics),
        gaps=tuple(examined.gaps),
        contradictions=tuple(examined.contradictions),
        ended_early=examined.ended_early,
    )


def _refuse_repeated(paths: Sequence[Path | str]) -> None:
    """Raise `InputError` if a bag is named twice."""
    named: dict[Path, Path | str] = {}
    for path in paths:
        bag = find_bag(Path(path)).resolve()
        if bag in named:
            raise InputError(f"{named[bag]} and {path} are the same bag: name every bag once")
        named[bag] = path


class _Received(NamedTuple):
    """A message in one of the bags, with its log and publish time, ns."""

    source: _Source
    time: int
    published: int
    record: Record

    @property
    def order(self) -> tuple[object, ...]:
        """A key that differs for different messages: in lockstep in the order of a bag, in real time of receipt."""
        topic, agent_id, message, payload, *_ = self.record
        return self.time, _rank(topic), _round(message), agent_id, message.step, payload, self.published


class _Source:
    """One of the bags, repaired at a place if necessary.

    Attributes
    ----------
    steps : Spans
        The steps of which it has messages, once they have been read.
    """

    def __init__(self, named: Path, place: Path) -> None:
        self.named = named
        repair = repair_bag(named, place, if_needed=True)
        self.repaired = None if repair.output is None else replace(repair, output=None)
        self.digests = [_digest(Path(file.file)) for file in repair.files]
        self.bag: BagReader = open_bag(named if repair.output is None else place, several=True)
        self.provenance = attached_provenance(self.bag)
        self.scenario = self.bag.attachment(SCENARIO_FILE) or b""
        self.steps = Spans()
        if (problem := self._problem()) is not None:
            raise InputError(f"{named} cannot be merged: {problem}")

    def _problem(self) -> str | None:
        """Return why this is not the bag of a recorder of the swarm, or None."""
        if len(self.bag.swarms) > 1:
            return "it contains several swarms; name the bags that recorders wrote"
        if "driver" not in self.provenance or not self.scenario:
            return "it lacks a recorder's scenario or provenance; name the bag itself, not a conversion"
        recorded = OFFERED[REALTIME if is_realtime(self.bag) else LOCKSTEP]
        for channel in self.bag.channels:
            if channel.message_count and (channel.topic is None or usual_topic(channel.topic) not in recorded):
                return f"{show(channel.name)} is not a topic that a recorder of the swarm writes"
        return contradiction(self.bag)

    def received(self) -> Iterator[_Received]:
        """Yield its messages in file order."""
        for topic, time, published, payload in self.bag.published():
            try:
                yield _Received(self, time, published, Record.read(topic, time, payload, published))
            except MalformedMessageError as error:
                raise DamagedBagError(f"{self.named}: /{topic.name} at {time / 1e9:.9g} s: {error}") from error

    def ordered(self) -> Iterator[tuple[tuple[object, ...], _Received]]:
        """Yield its messages in file order with keys that ascend, also where a message is older than one before it."""
        newest: tuple[object, ...] = ()
        late = 0
        for received in self.received():
            order = received.order
            newest, late = (order, 0) if order > newest else (newest, late + 1)
            yield (newest, late, order), received

    def entry(self, differing: Iterable[str]) -> dict[str, Any]:
        """Return its entry in the provenance of the merged bag."""
        said = {
            "sha256": self.digests,
            "messages": self.bag.message_count,
            "steps": [list(span) for span in self.steps],
            "aborted": self.bag.aborted(),
            "repaired": self.bag.custom_data().get(REPAIRED_KEY),
            **{name: self.provenance.get(name) for name in (*differing, MERGED)},
        }
        return {name: value for name, value in said.items() if value is not None}


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    digest = sha256()
    with path.open("rb") as stream:
        while piece := stream.read(_BLOCK):
            digest.update(piece)
    return digest.hexdigest()


class _Run:
    """The run of all the bags; raises `InputError` if they are not of one."""

    def __init__(self, sources: Sequence[_Source]) -> None:
        self.sources = sources
        first = sources[0]
        for other in sources[1:]:
            if (difference := _difference_between(first, other)) is not None:
                raise InputError(f"{first.named} and {other.named} are not bags of one run: {difference}")
        bag = first.bag
        self.namespace = bag.namespace or "/"
        self.scenario = attached_scenario(bag, steered=False)
        self.world: RealtimeWorld | None = realtime_world(bag) if is_realtime(bag) else None
        self.topics = sorted({EVENTS, *(topic for source in sources for topic in source.bag.topics())}, key=_rank)

    def union(self) -> _Collected | _Agreed:
        """Return what selects the messages of the merged bag."""
        if self.world is None:
            return _Agreed(" and ".join(str(source.named) for source in self.sources))
        members, each_robot = configure.members(self.scenario), self.scenario.decentralised
        return _Collected(RealtimeCollector(members, self.world.schedule, each_robot=each_robot))

    def joined(self) -> Iterator[_Received]:
        """Yield the messages of all bags, in an order that does not depend on that of the bags."""
        ordered = merge(*(source.ordered() for source in self.sources), key=itemgetter(0))
        return (received for _, received in ordered)

    def examined(self) -> _Examined:
        """Read all bags once, without writing anything."""
        union, topics = self.union(), Counter[str]()
        lockstep = LockstepCompleteness(self.scenario, self.scenario.family)
        realtime = None if self.world is None else RealtimeCompleteness(self.world, configure.relaying(self.scenario))
        for received in self.joined():
            message = received.record.message
            if not isinstance(message, SwarmEvent):
                received.source.steps.add(message.step)
            for kept in union.add(received):
                topics[kept.topic.name] += 1
                if realtime is not None:
                    realtime.add(kept, received.time)
                else:
                    lockstep.add(kept.topic, kept.message)
        topics.update(told.topic.name for told in union.finish())
        ended_early = self._ended_early()
        if realtime is not None:
            return _Examined(topics, realtime.gaps(), union.contradictions, ended_early)
        continued = ended_early in {None, CUT_OFF}
        gaps = lockstep.gaps(self.scenario.steps if continued else lockstep.last)
        whole = not gaps and lockstep.last >= self.scenario.steps
        return _Examined(topics, gaps, union.contradictions, None if whole else ended_early)

    def _ended_early(self) -> str | None:
        """Return why the recording ended early: what the bag says that ends last."""
        end = max(source.bag.end for source in self.sources)
        reasons = {source.bag.aborted() for source in self.sources if source.bag.end == end}
        return None if None in reasons else min(filter(None, reasons))


@dataclass(frozen=True, slots=True)
class _Examined:
    """What is known of the merged bag before it is written."""

    topics: Counter[str]
    gaps: list[Gap]
    contradictions: list[Contradiction]
    ended_early: str | None


def _rank(topic: Topic) -> tuple[int, str]:
    """Return the place of a topic among those of the same time."""
    if topic.message is Relay:  # those of a round follow one another
        return min(ORDER.values()) - 1, ""
    return ORDER.get(topic, len(ORDER)), topic.name


def _round(message: Message) -> int:
    """Return the round of a relay, of which a robot sends several in a step; 0 for other messages."""
    return message.round if isinstance(message, Relay) else 0


class _Agreed:
    """Selects each message of a run in lockstep once; raises `ContradictionError` if there are different ones."""

    def __init__(self, names: str) -> None:
        self._names = names
        self._known: dict[int, dict[tuple[Topic, object], bytes]] = {}
        self.contradictions: list[Contradiction] = []

    def add(self, received: _Received) -> tuple[Record, ...]:
        """Return the record if it is to be written."""
        topic, agent_id, message, payload, *_ = received.record
        of_step = self._known.setdefault(message.step, {})
        place = topic, payload if topic is EVENTS else (agent_id, _round(message))
        if place not in of_step:
            of_step[place] = payload
            self._forget()
            return (received.record,)
        if of_step[place] != payload:
            robot = f" of robot {agent_id}" if agent_id else ""
            raise ContradictionError(
                f"{self._names} contradict each other: /{topic.name}{robot} at step {message.step}; "
                "they are not of one run, or one is falsified: verify each of them"
            )
        return ()

    def finish(self) -> tuple[Record, ...]:
        """Return the records to write at the end: none."""
        return ()

    def _forget(self) -> None:
        """Forget what is so old that no recorder takes it any more."""
        if len(self._known) > 2 * LOCKSTEP_MEMORY:
            begin = max(self._known) - LOCKSTEP_MEMORY
            self._known = {step: of_step for step, of_step in self._known.items() if step >= begin}


class _Collected:
    """Selects the messages that a recorder would have recorded that had received what all recorders did."""

    def __init__(self, collector: RealtimeCollector) -> None:
        self._collector = collector
        self.contradictions: list[Contradiction] = []
        self.finish = collector.finish

    def add(self, received: _Received) -> tuple[Record, ...]:
        """Return the record if it is to be written, or an event about it."""
        collector, record = self._collector, received.record
        different = collector.different
        kept = collector.add(record, received.time)
        if collector.refused:
            reason = "".join(told.message.detail for told in kept if isinstance(told.message, SwarmEvent))
            raise InputError(
                f"{received.source.named} cannot be merged: "
                f"at {received.time / 1e9:.9g} s, step {record.message.step}: {reason}"
            )
        if collector.different > different:
            self.contradictions.append(Contradiction(record.topic.name, record.agent_id, record.message.step))
        return kept


def _difference_between(one: _Source, other: _Source) -> str | None:
    """Return in what two bags differ that are not of one run, or None."""
    if one.bag.namespace != other.bag.namespace:
        return f"their namespaces are {show(one.bag.namespace)} and {show(other.bag.namespace)}"
    if one.scenario != other.scenario:
        tree, its = (load_yaml(source.scenario.decode("utf-8", "replace")) for source in (one, other))
        return _difference(tree, its, "scenario") or "the texts of their scenarios differ"
    of_recorder = {*_OF_RECORDER, MERGED}
    stated, its = (
        {name: value for name, value in source.provenance.items() if name not in of_recorder} for source in (one, other)
    )
    if (difference := _difference(stated, its)) is not None:
        return difference
    types, others = ({channel.name: channel.type_hash for channel in source.bag.channels} for source in (one, other))
    both = sorted(types.keys() & others.keys())
    return _difference({name: types[name] for name in both}, {name: others[name] for name in both}, "type of")


def _difference(one: object, other: object, place: str = "") -> str | None:
    """Return the first difference between two documents, or None."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in dict.fromkeys((*one, *other)):
            if one.get(key) != other.get(key):
                return _difference(one.get(key), other.get(key), f"{place}.{key}" if place else str(key))
        return None
    return None if one == other else f"{place} is {show(one)} and {show(other)}"


def _write(run: _Run, examined: _Examined, folder: Path) -> None:
    """Write the merged bag. No time of this machine enters it."""
    first = run.sources[0]
    differing = [
        name
        for name in _OF_RECORDER
        if any(source.provenance.get(name) != first.provenance.get(name) for source in run.sources)
    ]
    entries = [(source.entry(differing), source) for source in run.sources]
    entries.sort(key=lambda listed: json.dumps([listed[0]["steps"], listed[0]["sha256"]]))
    provenance = {name: value for name, value in first.provenance.items() if name not in differing}
    provenance[MERGED] = [entry for entry, _ in entries]
    text = json.dumps(provenance, indent=2, sort_keys=True)
    bags = [source.bag for _, source in entries]
    several = any(len(bag.files) > 1 for bag in bags)
    writer = BagWriter(
        folder,
        topics=run.topics,
        attachments={SCENARIO_FILE: first.scenario, PROVENANCE_FILE: text.encode() + b"\n"},
        namespace=run.namespace,
        qos=OFFERED[LOCKSTEP if run.world is None else REALTIME],
        chunk_seconds=math.inf,
        split=Split(bytes=max(file.size for bag in bags for file in bag.files)) if several else ONE_FILE,
    )
    union = run.union()
    with writer:
        for received in run.joined():
            for kept in union.add(received):
                published = received.published if kept is received.record else max(0, kept.message.stamp)
                writer.write(kept.topic, received.time, kept.payload, published)
        for told in union.finish():
            writer.write(told.topic, told.message.stamp, told.payload, told.message.stamp)
        writer.close(_other_attachments(bags), aborted=examined.ended_early)


def _other_attachments(bags: Sequence[BagReader]) -> dict[str, bytes]:
    """Return the attachments besides scenario and provenance; different ones of a name get numbers."""
    attachments: dict[str, bytes] = {}
    names = {entry.name for bag in bags for entry in bag.index.attachments} - {SCENARIO_FILE, PROVENANCE_FILE}
    for name in sorted(names):
        contents = list(dict.fromkeys(data for bag in bags if (data := bag.attachment(name)) is not None))
        path = PurePath(name)
        numbered = (f"{path.stem}-{number}{path.suffix}" for number in count(1))
        free = (unused for unused in numbered if unused not in names)
        attachments |= zip([name] if len(contents) == 1 else free, contents, strict=False)
    return attachments

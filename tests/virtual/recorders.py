# ruff: noqa: SLF001 - what has been passed to the disk, and when, only the parts of a writer know
"""Recorders with bags on simulated disks, and what must hold of their bags.

A bag has what its recorder has written, in this order, and nothing else. Once it is closed it needs no repair. After
the death of the process, a full disk or a power cut, a repair finds all that must have survived.
"""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from functools import partial
from itertools import groupby, pairwise
from math import inf
from operator import attrgetter
from pathlib import Path
from random import Random
from typing import Any, NamedTuple, cast

from mcap.records import Chunk
from tests.virtual.disk import RESERVED, Disk, Disks
from tests.virtual.fleet import EPOCH, VirtualFleet, Watcher, decode
from tests.virtual.properties import BrokenError
from tests.virtual.schedule import Case

from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.errors import BagWriteError, DamagedBagError
from swarmabs_bag.mcap.records import parse, read_record
from swarmabs_bag.merge import MergeReport, merge_bags
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import RealtimeWorld
from swarmabs_bag.recorder.recording import RealtimeRecording, Recording
from swarmabs_bag.repair.bag import CUT_OFF, RepairReport, repair_bag
from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_config.graph import STANDBY_SUFFIX, STANDBY_TOPICS, standby_topic
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import agent_id_of, step_of
from swarmabs_core.errors import InputError, MalformedMessageError
from swarmabs_core.messages import (
    MAIN_TOPICS,
    TOPICS,
    Basis,
    DesiredAbstractState,
    EventKind,
    Message,
    Relay,
    SwarmEvent,
    Topic,
    topic_of,
)
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.record import Record

IN_MEMORY = 1.0
"""Age, s, up to which messages may be lost when the process of a recorder dies."""
POLLS = 0.1
"""Time, s, between two looks of a recorder at its clock."""
OWN = "swarm/events"
"""The topic on which a recorder notes what it has left out."""
MERGED = "the merged bag"
CLOSED, KILLED, POWER, FULL, STOPPED = "closed", "killed", "power cut", "full disk", "stopped"
"""How a recording ends."""


class Stored(NamedTuple):
    """A message in a bag."""

    topic: str
    time: int
    payload: bytes


class Piece(NamedTuple):
    """The bytes of a file that the operating system has got at once, and the numbers of the messages in them."""

    path: Path
    begin: int
    end: int
    first: int
    last: int


class Recorder:
    """A recorder, whose bag is on a disk; `written` is what it has written, `since` when each of it, s.

    `ending` is how it has ended, empty before; `ended` when, s. `survives` are the numbers of the written messages that
    a power cut has not touched, and `described` says whether the scenario of the bag has survived.
    """

    recording: Recording | RealtimeRecording

    def __init__(self, name: str, folder: Path, disk: Disk) -> None:
        self.name, self.folder, self.disk = name, folder, disk
        self.written: list[Stored] = []
        self.since: list[float] = []
        self.ending = ""
        self.ended = inf
        self.described = True
        self.survives: set[int] | None = None
        self.pieces: list[Piece] = []
        self._first = self._complete = 0

    @property
    def writer(self) -> Any:
        """The product's writer of the bag."""
        return self.recording._writer

    def _watch(self, method: str) -> None:
        """Note what is written by a method of the writer."""
        setattr(self.writer, method, partial(self._noting, getattr(self.writer, method)))

    def _noting(self, write: Any, *arguments: Any) -> None:
        path = self.writer.path
        stored = _stored(*arguments)
        self.written += stored
        self.since += [self.disk.clock()] * len(stored)
        try:
            write(*arguments)
        finally:
            self._note_pieces(path)

    def _note_pieces(self, path: Path) -> None:
        """Note what has been passed to the operating system since the last time, maybe as the end of a former file."""
        writer = self.writer
        if writer.path != path:
            for file in writer._complete[self._complete :]:
                self._complete += 1
                done = self.folder / file.record.name
                self._note_piece(done, done.stat().st_size, self._first + file.record.message_count)
                self._first += file.record.message_count
        self._note_piece(writer.path, writer._file.committed, self._first + writer._mcap.statistics.message_count)

    def _note_piece(self, path: Path, end: int, last: int) -> None:
        of_file = [piece for piece in self.pieces if piece.path == path]
        begin, first = (of_file[-1].end, of_file[-1].last) if of_file else (0, self._first)
        if last > first:
            self.pieces.append(Piece(path, begin, end, first, last))

    def poll(self) -> None:
        """Do what a recorder does from time to time."""
        if not self.ending:
            try:
                self.recording.poll()
            except BagWriteError as error:
                self.fail(error)
            self._note_pieces(self.writer.path)

    def fail(self, error: BagWriteError) -> None:
        """Complete the bag as far as possible, as the node does after an error."""
        self._over(FULL)
        self.recording.abort(str(error))

    def die(self, ending: str) -> None:
        """End without a word: what was not passed to the operating system is lost, and more if the power is cut."""
        self._over(ending)
        self.disk.close()
        if ending == POWER:
            self.cut_power()

    def cut_power(self) -> None:
        """Cut the power of the disk."""
        before = {piece: piece.path.read_bytes()[piece.begin : piece.end] for piece in self.pieces}
        self.disk.cut_power()
        files = {path: path.read_bytes() if path.exists() else b"" for path in {piece.path for piece in self.pieces}}
        whole = [piece for piece, data in before.items() if files[piece.path][piece.begin : piece.end] == data]
        described = {piece.path for piece in whole if not piece.begin}  # the first one describes topics and run
        self.described = bool(described)
        self.survives = {n for p in whole if p.path in described for n in range(p.first, p.last)}

    def end(self, ending: str = CLOSED) -> None:
        """Close the bag, or abort it, if it is still written."""
        if self.ending:
            return
        self._over(ending)
        try:
            self.complete(ending)
        except BagWriteError:  # it has been completed as far as possible
            self.ending = FULL
        self._note_pieces(self.writer.path)

    def complete(self, ending: str) -> None:
        """Close the bag, or abort it."""
        if ending == CLOSED:
            self.recording.close()
        else:
            self.recording.abort(STOPPED)

    def _over(self, ending: str) -> None:
        self.ending, self.ended = ending, self.disk.clock()

    def must_survive(self) -> set[int]:
        """Return the numbers of the written messages that must be found again."""
        if self.ending in {CLOSED, STOPPED}:
            return set(range(len(self.written)))
        if self.survives is not None:
            return self.survives
        return {number for number, since in enumerate(self.since) if since < self.ended - IN_MEMORY}


class RealtimeRecorder(Recorder):
    """A recorder in real time; it counts what it has `heard`, and what of it nobody can read (`garbage`)."""

    recording: RealtimeRecording

    def __init__(
        self,
        name: str,
        folder: Path,
        disk: Disk,
        scenario: Scenario,
        schedule: Schedule,
        *,
        paired: bool,
        split: Split = ONE_FILE,
    ) -> None:
        super().__init__(name, folder, disk)
        world = RealtimeWorld(schedule, (), plane=True)
        self.recording = RealtimeRecording(cast("Any", scenario), folder, world, paired=paired, split=split)
        self.heard: Counter[tuple[str, bytes]] = Counter()
        self.garbage = 0
        self.central = not scenario.decentralised
        self._watch("write")

    def hear(self, topic: Topic, data: bytes, now: int, writer: bytes) -> None:
        """Record a message that arrives at a time, ns since 1970."""
        try:
            record = Record.heard(topic, data)
        except MalformedMessageError:
            self.garbage += 1
        else:
            self.heard[recorded_topic(record), record.payload] += 1
        try:
            self.recording.hear(topic, data, now, writer)
        except BagWriteError as error:
            self.fail(error)


def recorded_topic(record: Record) -> str:
    """Return the name of the topic on which a message is recorded: those of robots' own topics on the usual ones."""
    return (topic_of(record.message) if record.topic.agent_id else record.topic).name


def _stored(first: Any, time: int = 0, payload: bytes = b"", published: int | None = None) -> list[Stored]:
    """Return what `BagWriter.write` or `BagWriter.write_step` is given."""
    if isinstance(first, Topic):
        return [Stored(first.name, time, payload)]
    return [Stored(topic.name, stamp, data) for topic, stamp, data in first.stored()]


class Place(NamedTuple):
    """Where a run has one message: usual topic, robot or source (0: none), step, and which of several it is."""

    topic: str
    of: int
    step: int
    part: int | bytes


TOPICS_BY_NAME = {topic.name: topic for topic in (*TOPICS, *STANDBY_TOPICS.values())}


def _class_of(topic: str) -> type[Message]:
    return Relay if topic.endswith("/relay") else TOPICS_BY_NAME[topic].message


def place_of(topic: str, payload: bytes) -> Place:
    """Return the place of a stored message."""
    message = decode(_class_of(topic), payload)
    of, part = agent_id_of(message), 0
    if isinstance(message, SwarmEvent):
        return Place(topic, of, message.step, payload)
    if isinstance(message, Basis):
        of = message.source
    elif isinstance(message, DesiredAbstractState):
        part = message.mode
    elif isinstance(message, Relay):
        part = message.round
    return Place(topic, of, message.step, part)


class Bags:
    """The bags of some recorders in a temporary folder, and what must hold of them."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="bags-"))
        self.disks = Disks()
        self.recorders: list[Recorder] = []
        self._stack = ExitStack()
        self._stack.enter_context(self.disks.used())

    def place(self, disk: Disk) -> Path:
        """Return the folder of the next bag, on a disk."""
        folder = self.folder / f"bag{len(self.recorders) + 1}"
        self.disks.mount(folder, disk)
        return folder

    def remove(self) -> None:
        """Take away all files."""
        for recorder in self.recorders:
            recorder.disk.close()
        self._stack.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def check(self, *, explained: bool) -> dict[Recorder, Path]:
        """Raise an error if a bag lies, lacks what must have survived, or is not explained; return those left."""
        bags = {}
        for number, recorder in enumerate(self.recorders, 1):
            bag = self._checked(recorder, self.folder / f"repaired{number}", explained=explained)
            if bag is not None:
                bags[recorder] = bag
        return bags

    @property
    def cut(self) -> bool:
        """Whether all recorders were killed or have lost their power."""
        return {recorder.ending for recorder in self.recorders} <= {KILLED, POWER}

    def merged(self, bags: Iterable[Path], *, explained: bool) -> tuple[Path, MergeReport] | None:
        """Merge bags, check the result and return it, with the report; None if there are not several bags."""
        bags, merged = tuple(bags), self.folder / "merged"
        if len(bags) < 2:
            return None
        report = merge_bags(bags, merged)
        contents = [content(bag) for bag in bags]
        check_merged(content(merged), contents, report)
        if explained:
            is_explained(merged, MERGED)
        return merged, report

    def _checked(self, recorder: Recorder, place: Path, *, explained: bool) -> Path | None:
        recorder.end()
        name = f"{recorder.name} ({recorder.ending})"
        survives = recorder.must_survive()
        if whole := recorder.ending in {CLOSED, STOPPED, FULL}:
            recorder.cut_power()  # what is complete is on the disk
        try:
            report = repair_bag(recorder.folder, place, if_needed=True)
        except (DamagedBagError, InputError) as error:
            if not whole and not survives:
                return None
            raise BrokenError("bags survive", name, str(error).replace(f"{self.folder}/", "")) from error
        bag = recorder.folder if report.output is None else place
        if whole and report.output is not None:
            problems = (*report.problems, *(problem for file in report.files for problem in file.problems))
            raise BrokenError("bags survive", name, f"is not whole: {'; '.join(problems)}")
        found = content(bag)
        lost = is_part(found, recorder.written, name)
        if missing := sorted(survives & lost):
            first = recorder.written[missing[0]]
            text = f"lacks {len(missing)} messages, the first on {first.topic} of step {step_of(first.payload)}"
            raise BrokenError("bags survive", name, text)
        is_counted(report, found, name)
        # Without its beginning nothing says that numbers of messages in a file have no gaps.
        headless = any(damage.offset == 0 for file in report.files for damage in file.lost)
        if not headless:
            losses_are_counted(report, recorder, lost, name)
        reason, cut = open_bag(bag).aborted(), recorder.ending in {KILLED, POWER}
        unknown = cut and reason is None and not recorder.writer.path.exists()  # the file that was not complete is lost
        if ((reason is None) != (recorder.ending == CLOSED) or (reason == CUT_OFF) != cut) and not unknown:
            raise BrokenError("bags survive", name, f"says that it ended early because: {reason}")
        if isinstance(recorder, RealtimeRecorder):
            are_counted(recorder, name)
        if whole:
            has_checksums(bag, name)
        if not recorder.described or not found:
            return None
        # A bag in lockstep is verified up to its end, if it has no gap and says why it ended; one of robots without
        # coordinators if it has no gap, which hides what the one that spoke for all had heard.
        follows = found == recorder.written[: len(found)]
        realtime = isinstance(recorder, RealtimeRecorder)
        if explained and ((follows or recorder.central) if realtime else (follows and not unknown)):
            is_explained(bag, name)
        return bag


def content(bag: Path) -> list[Stored]:
    """Return all messages of a bag."""
    return [Stored(topic.name, time, payload) for topic, time, payload in open_bag(bag).messages()]


def is_part(found: list[Stored], written: list[Stored], name: str) -> set[int]:
    """Raise an error unless a bag has a part of what was written, in this order; return the numbers of the rest."""
    lost, number = set(), 0
    for stored in found:
        begin = number
        while number < len(written) and written[number] != stored:
            number += 1
        if number == len(written):
            what = f"on {stored.topic} of step {step_of(stored.payload)} at {stored.time} ns"
            raise BrokenError("bags survive", name, f"has a message that was not written in this place: {what}")
        lost.update(range(begin, number))
        number += 1
    return lost | set(range(number, len(written)))


def is_counted(report: RepairReport, found: list[Stored], name: str) -> None:
    """Raise an error if the report of a repair counts other messages than the bag has."""
    counted = {topic.name.lstrip("/"): topic.messages for topic in report.topics if topic.messages}
    has = dict(Counter(stored.topic for stored in found))
    if counted != has or report.messages != len(found):
        raise BrokenError("losses are counted", name, f"has {has}, but the repair counts {counted}")


def has_checksums(bag: Path, name: str) -> None:
    """Raise an error if a chunk of a bag has no CRC, without which damage cannot be seen."""
    for file in open_bag(bag).files:
        with file.path.open("rb") as stream:
            for entry in file.index.chunks:
                if not parse(Chunk, read_record(stream, entry.chunk_start_offset, file.size)).uncompressed_crc:
                    raise BrokenError("bags survive", name, f"has a chunk without a CRC in {file.path.name}")


def losses_are_counted(report: RepairReport, recorder: Recorder, lost: set[int], name: str) -> None:
    """Raise an error if the report of a repair does not count what is lost before others of its topic in a file."""
    truth: Counter[str] = Counter()
    gap: Counter[str] = Counter()
    begins = {min(piece.first for piece in of) for _, of in groupby(recorder.pieces, key=attrgetter("path"))}
    for number, stored in enumerate(recorder.written):
        if number in begins:
            gap.clear()
        if number in lost:
            gap[stored.topic] += 1
        else:
            truth[stored.topic] += gap.pop(stored.topic, 0)
    counted = {topic.name.lstrip("/"): topic.lost for topic in report.topics if topic.lost}
    if counted != {topic: number for topic, number in truth.items() if number}:
        raise BrokenError("losses are counted", name, f"has lost {+truth}, but the repair counts {counted}")


def are_counted(recorder: RealtimeRecorder, name: str) -> None:
    """Raise an error if the figures of a recorder differ from what it has heard and written."""
    figures = recorder.recording.figures()
    realtime, own = figures["realtime"], 0
    heard = sum(recorder.heard.values())
    steps: dict[tuple[str, int], list[int]] = {}
    for stored in recorder.written:
        known = recorder.heard[stored.topic, stored.payload]
        if not known and stored.topic != OWN:
            raise BrokenError("bags survive", name, f"has recorded a message on {stored.topic} that it has not heard")
        own += not known
        place = place_of(stored.topic, stored.payload)
        steps.setdefault((place.topic, place.of), []).append(place.step)
    doubles = [key for key, times in Counter((s.topic, s.payload) for s in recorder.written).items() if times > 1]
    if doubles:
        raise BrokenError(
            "bags survive", name, f"has recorded {len(doubles)} messages twice, the first on {doubles[0][0]}"
        )
    if recorder.recording.malformed != recorder.garbage:
        text = f"counts {recorder.recording.malformed} messages that nobody can read; there were {recorder.garbage}"
        raise BrokenError("losses are counted", name, text)
    dropped = sum(realtime["dropped"].values())
    if recorder.ending in {CLOSED, STOPPED} and heard != len(recorder.written) - own + dropped:
        text = f"has heard {heard} messages, recorded {len(recorder.written) - own} and dropped {dropped}"
        raise BrokenError("losses are counted", name, text)
    for topic in MAIN_TOPICS:
        of_topic = [numbers for (name_of, _), numbers in steps.items() if name_of == topic.name]
        received = sum(map(len, of_topic))
        doubles_of_step = sum(len(numbers) - len({*numbers}) for numbers in of_topic)
        missing = sum(max(numbers) - min(numbers) + 1 - len({*numbers}) for numbers in of_topic)
        said = realtime["losses"][topic.name]
        if said["received"] != received or not missing - doubles_of_step <= said["missing"] <= missing:
            text = f"says of {topic.name} {said}, but has received {received} and lacks {missing}"
            raise BrokenError("losses are counted", name, text)
    stops = sum(
        cast("SwarmEvent", decode(SwarmEvent, stored.payload)).kind == EventKind.SAFE_STOP
        for stored in recorder.written
        if stored.topic == OWN
    )
    if figures["messages"] != len(recorder.written) or realtime["safe_stops"] != stops:
        raise BrokenError(
            "losses are counted", name, f"counts {figures['messages']} messages and {realtime['safe_stops']} stops"
        )


def is_explained(bag: Path, name: str) -> None:
    """Raise an error if a bag is not verified."""
    result = BagToVerify(bag).verify()
    if result.difference is not None or result.problem is not None:
        raise BrokenError("bags are explained", name, str(result.difference or result.problem))


def check_merged(merged: list[Stored], contents: list[list[Stored]], report: MergeReport) -> None:
    """Raise an error unless merged bags have each message once, in order, and at the first time of its receipt."""
    name = MERGED
    times: dict[tuple[str, bytes], int] = {}
    for of_bag in contents:
        for stored in of_bag:
            key = stored.topic, stored.payload
            times[key] = min(stored.time, times.get(key, stored.time))
    for before, after in pairwise(stored for stored in merged if stored.topic != OWN):  # in lockstep events may be late
        if after.time < before.time:
            raise BrokenError("bags are merged", name, f"has {after.topic} at {after.time} ns after {before.time} ns")
    for stored in merged:
        time = times.get((stored.topic, stored.payload))
        if time != stored.time and (stored.topic != OWN or time is not None):
            raise BrokenError("bags are merged", name, f"has {stored.topic} at {stored.time} ns, heard first at {time}")
    places = Counter(place_of(stored.topic, stored.payload) for stored in merged)
    if doubles := [place for place, number in places.items() if number > 1]:
        raise BrokenError("bags are merged", name, f"has {len(doubles)} messages twice, the first {doubles[0][:3]}")
    wanted = {place_of(*key) for key in times}
    if lost := sorted(wanted - places.keys(), key=str):
        raise BrokenError("bags are merged", name, f"lacks {len(lost)} messages, the first {lost[0][:3]}")
    counted = dict(Counter(stored.topic for stored in merged))
    if report.messages != len(merged) or {topic: n for topic, n in report.topics.items() if n} != counted:
        raise BrokenError("losses are counted", name, f"has {counted}, but the report counts {report.topics}")


def lacking(report: MergeReport) -> Iterator[tuple[str | None, int, int]]:
    """Yield topic (None: all), robot (0: none) and step of each message that a report of a merge names as missing."""
    for gap in report.gaps:
        for step in range(gap.first, gap.last + 1):
            yield from ((gap.topic, robot, step) for robot in gap.robots or (0,))


class FleetRecorder(Watcher):
    """A recorder of a fleet, which hears what is published, late or not at all, and ends in one of several ways."""

    def __init__(self, fleet: VirtualFleet, case: Case, bags: Bags, number: int) -> None:
        draw = Random(f"recorder:{case.seed}:{number}")
        ending = draw.choice((CLOSED, KILLED, POWER, FULL))
        self._fleet, self._draw = fleet, draw
        self._ending = ending if ending in {KILLED, POWER} else CLOSED
        self._ends = draw.uniform(1.0, max(1.5, case.quiet)) if ending in {KILLED, POWER} else inf
        self._loss = draw.choice((0.0, 0.05))
        free = RESERVED + draw.randint(20_000, 150_000) if ending == FULL else None
        disk = Disk(draw, lambda: fleet.time, short=draw.choice((0.0, 0.3)), free=free)
        self.recorder = RealtimeRecorder(
            f"recorder {number}", bags.place(disk), disk, fleet.scenario, fleet.clock, paired=case.paired
        )
        bags.recorders.append(self.recorder)

    def published(self, node: str, topic: Topic, message: Message, data: bytes) -> None:
        if self.recorder.ending or self._draw.random() < self._loss:
            return
        told = standby_topic(topic) if node.endswith(STANDBY_SUFFIX) else topic
        if isinstance(message, Relay):
            told = topic_of(message)
        after = self._draw.uniform(1e-4, 2e-3)
        self._fleet.later(after, partial(self._hear, told, data, self._fleet.nodes[node].writers.get(told, b"")))

    def _hear(self, topic: Topic, data: bytes, writer: bytes) -> None:
        if self.recorder.ending:
            return
        if self._fleet.time > self._ends:
            self.recorder.die(self._ending)
            return
        self.recorder.hear(topic, data, EPOCH + self._fleet.now_ns, writer)


class FleetBags:
    """Two recorders of a fleet, and what must hold of their bags."""

    def __init__(self, fleet: VirtualFleet, case: Case) -> None:
        self._bags = Bags()
        self.recorders = [FleetRecorder(fleet, case, self._bags, number) for number in (1, 2)]
        self.remove = self._bags.remove

    def check(self, *, explained: bool) -> None:
        """Raise an error if something does not hold of a bag, or of both merged."""
        self._bags.merged(self._bags.check(explained=explained).values(), explained=explained)

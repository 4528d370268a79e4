# ruff: noqa: SLF001 - a recording has no parameter for the clock of its writer
"""Recorders of a virtual fleet, each with a disk of its own: writes may be short, the disk full, the power cut.

What was written and not synced may be lost page by page at a power cut; what was passed to the operating system
survives the death of the process. Nothing else than what was heard may ever be in a bag, and after a repair all that
must have survived is there.
"""

from __future__ import annotations

import errno
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from math import inf
from pathlib import Path
from random import Random
from typing import Any, cast

import pytest
from tests.virtual.fleet import EPOCH, VirtualFleet, Watcher
from tests.virtual.properties import BrokenError
from tests.virtual.schedule import Case

from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.errors import BagWriteError, DamagedBagError
from swarmabs_bag.mcap.output import RecordFile
from swarmabs_bag.merge import merge_bags
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import RealtimeWorld
from swarmabs_bag.recorder.recording import RealtimeRecording
from swarmabs_bag.repair.bag import repair_bag
from swarmabs_bag.run import writer as bag_writer
from swarmabs_config.graph import STANDBY_SUFFIX, standby_topic
from swarmabs_core.cdr import step_of
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Message, Topic
from swarmabs_core.record import Record

PAGE = 4096
IN_MEMORY = 1.0
"""Age, s, up to which messages may be lost when the process of a recorder dies."""
RESERVED = 2**18
"""Bytes that a writer reserves at first for the end of its file."""
OWN = "events"
"""The topic on which a recorder notes what it has left out."""
ENDINGS = ("closed", "killed", "power cut", "full disk")
"""How a recording ends."""
Key = tuple[str, bytes]


class SimulatedFile(RecordFile):
    """A file on a disk; `unsynced` are the writes (offset, size) since the last `sync`."""

    def __init__(self, path: Path, disk: Disk) -> None:
        super().__init__(path)
        self.path = path
        self.unsynced: list[tuple[int, int]] = []
        self.raw = cast("Any", _Raw(self.raw, disk, self.unsynced))
        disk.files.append(self)

    def sync(self) -> None:
        self.unsynced.clear()


class _Raw:
    """The operating system's side of a file, which writes less than it is asked to, or nothing."""

    def __init__(self, actual: Any, disk: Disk, unsynced: list[tuple[int, int]]) -> None:
        self._actual, self._disk, self._unsynced = actual, disk, unsynced
        self.seek, self.truncate, self.close = actual.seek, actual.truncate, actual.close

    def write(self, data: Any) -> int:
        written = int(self._actual.write(data[: self._disk.room(len(data))]))
        self._unsynced.append((self._actual.tell() - written, written))
        return written


class Disk:
    """What happens to writes."""

    def __init__(self, draw: Random, size: int | None) -> None:
        self._draw = draw
        self._short = draw.choice((0.0, 0.3))
        self._free = size
        self.files: list[SimulatedFile] = []

    def room(self, wanted: int) -> int:
        """Return how many bytes are written of so many; raises `OSError` if the disk is full."""
        if self._free is not None:
            if self._free <= 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            wanted = min(wanted, self._free)
            self._free -= wanted
        return self._draw.randint(1, wanted) if wanted > 1 and self._draw.random() < self._short else wanted

    def take(self, size: int) -> None:
        """Reserve so many bytes, or release them if it is negative; raises `OSError` if there is no room for them."""
        if self._free is not None:
            if size > self._free:
                raise OSError(errno.ENOSPC, "No space left on device")
            self._free -= size

    def cut_power(self) -> None:
        """Lose some pages of what was not synced, and maybe the end of each file."""
        draw = self._draw
        for file in self.files:
            data = bytearray(file.path.read_bytes())
            for offset, size in file.unsynced:
                for page in range(offset // PAGE, (offset + size - 1) // PAGE + 1):
                    if draw.random() < 0.2:
                        begin, end = max(offset, page * PAGE), min(offset + size, (page + 1) * PAGE)
                        data[begin:end] = bytes(max(0, min(end, len(data)) - begin))
            if file.unsynced and draw.random() < 0.7:
                first = file.unsynced[0][0]
                del data[draw.randint(min(first, len(data)), len(data)) :]
            file.path.write_bytes(data)


class SimulatedReserve:
    """Space that a writer keeps for the end of its file; as `Reserve`."""

    def __init__(self, folder: Path, disk: Disk) -> None:
        self._disk = disk
        self._size = 0

    def hold(self, size: int) -> None:
        if size > self._size:
            self._disk.take(size - self._size)
            self._size = size

    def release(self) -> None:
        self._disk.take(-self._size)
        self._size = 0


class Recorder(Watcher):
    """A recorder of a fleet; it hears all, late or not at all, and ends in one of several ways."""

    def __init__(self, fleet: VirtualFleet, case: Case, folder: Path, number: int) -> None:
        draw = Random(f"recorder:{case.seed}:{number}")
        self.ending = draw.choice(ENDINGS)
        self._ends = draw.uniform(1.0, max(1.5, case.quiet)) if self.ending in {"killed", "power cut"} else inf
        self.disk = Disk(draw, RESERVED + draw.randint(20_000, 150_000) if self.ending == "full disk" else None)
        self.folder = folder / f"bag{number}"
        self._loss = draw.choice((0.0, 0.05))
        self._draw = draw
        self._fleet = fleet
        self.messages: dict[Key, float] = {}
        self.over = False
        world = RealtimeWorld(fleet.clock, (), plane=True)
        with self._disk():
            self._recording = RealtimeRecording(cast("Any", fleet.scenario), self.folder, world, paired=case.paired)
        writer = self._writer
        writer._monotonic = lambda: fleet.time
        writer._chunk_opened = None

    @property
    def _writer(self) -> Any:
        return self._recording._writer

    @contextmanager
    def _disk(self) -> Iterator[None]:
        """Let files that are opened be on this disk."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(bag_writer, "RecordFile", partial(SimulatedFile, disk=self.disk))
            patch.setattr(bag_writer, "Reserve", partial(SimulatedReserve, disk=self.disk))
            yield

    def published(self, node: str, topic: Topic, message: Message, data: bytes) -> None:
        if not self.over and self._draw.random() >= self._loss:
            told = standby_topic(topic) if node.endswith(STANDBY_SUFFIX) else topic
            after = self._draw.uniform(1e-4, 2e-3)
            self._fleet.later(after, partial(self._record, told, data, self._fleet.nodes[node].writers.get(told, b"")))

    def _record(self, topic: Topic, data: bytes, writer: bytes) -> None:
        if self.over:
            return
        if self._fleet.time > self._ends and self.ending in {"killed", "power cut"}:
            self._die()
            return
        record = Record.heard(topic, data)
        self.messages.setdefault((record.topic.name, record.payload), self._fleet.time)
        try:
            with self._disk():
                self._recording.add(record, EPOCH + self._fleet.now_ns, writer)
        except BagWriteError as error:
            self.over, self._ends = True, self._fleet.time
            with self._disk():
                self._recording.abort(str(error))

    @property
    def kept(self) -> set[Key]:
        """What must be in the bag, whatever has happened: at a power cut maybe nothing.

        A recorder leaves out what second senders say, such as a node that has just started again, and says how much.
        """
        dropped = self._recording.figures()["realtime"]["dropped"]
        if self.ending == "power cut" or dropped["refused"] or dropped["different"]:
            return set()
        until = inf if self.ending == "closed" else self._ends - IN_MEMORY
        return {key for key, time in self.messages.items() if time < until}

    def _die(self) -> None:
        """End without a word: what was not passed to the operating system is lost, and more if the power is cut."""
        self.over = True
        for file in self.disk.files:
            file.close()
        if self.ending == "power cut":
            self.disk.cut_power()

    def end(self) -> None:
        """Close the bag, if it is still written."""
        if self.over:
            return
        if self.ending in {"killed", "power cut"}:
            self._die()
            return
        self.over = True
        try:
            with self._disk():
                self._recording.close()
        except BagWriteError:  # it has been completed as far as possible
            self._ends = self._fleet.time


class Bags:
    """The recorders of a fleet in a temporary folder, and what must hold of their bags."""

    def __init__(self, fleet: VirtualFleet, case: Case) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="virtual-bags-"))
        self.recorders = [Recorder(fleet, case, self._folder, number) for number in (1, 2)]

    def remove(self) -> None:
        """Take away all files."""
        for recorder in self.recorders:
            for file in recorder.disk.files:
                file.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def check(self, *, explained: bool) -> None:
        """Raise an error if a bag lies, lacks what must have survived, or is not explained; then of both merged."""
        bags = []
        for number, recorder in enumerate(self.recorders, 1):
            recorder.end()
            bag = self._repaired(recorder, number)
            if bag is None:
                continue
            self._is_true(bag, f"recorder {number} ({recorder.ending})", {*recorder.messages}, recorder.kept)
            if explained:
                self._is_explained(bag, number)
            bags.append(bag)
        if len(bags) == 2:
            merged = self._folder / "merged"
            merge_bags(bags, merged)
            heard, kept = ({key for r in self.recorders for key in what(r)} for what in (_heard, _kept))
            self._is_true(merged, "the merged bag", heard, kept)
            if explained:
                self._is_explained(merged, 0)

    def _repaired(self, recorder: Recorder, number: int) -> Path | None:
        output = self._folder / f"repaired{number}"
        try:
            report = repair_bag(recorder.folder, output)
        except (DamagedBagError, InputError) as error:
            if recorder.ending == "power cut" or not recorder.kept:
                return None
            raise BrokenError("bags survive", f"recorder {number}", f"{recorder.ending}: {error}") from error
        return recorder.folder if report.output is None else output

    def _is_true(self, bag: Path, name: str, heard: set[Key], kept: set[Key]) -> None:
        found = {(topic.name, payload) for topic, _, payload in open_bag(bag).messages()}
        if more := [key for key in found - heard if OWN not in key[0]]:
            raise BrokenError("bags survive", name, f"has {len(more)} messages that were never heard, on {more[0][0]}")
        if lost := [key for key in kept - found if OWN not in key[0]]:
            steps = sorted({step_of(payload) for _, payload in lost})
            raise BrokenError("bags survive", name, f"lacks {len(lost)} messages, the first of step {steps[0]}")

    def _is_explained(self, bag: Path, number: int) -> None:
        result = BagToVerify(bag).verify()
        if result.difference is not None:
            raise BrokenError("bags are explained", f"recorder {number}", str(result.difference))


def _heard(recorder: Recorder) -> Iterable[Key]:
    return recorder.messages


def _kept(recorder: Recorder) -> Iterable[Key]:
    return recorder.kept

"""How a bag comes to be: chunks, closing, aborting, refusals, and what each leaves on the disk."""

import errno
import io
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from unittest.mock import Mock

import pytest
import yaml
from mcap.exceptions import EndOfFile
from mcap.records import Message as StoredMessage
from mcap.stream_reader import StreamReader
from tests.swarmabs_bag.answers import read_everywhere
from tests.swarmabs_bag.conftest import STEPS_PER_FILE, WriteBag
from tests.swarmabs_bag.sample_run import PERIOD, bag_writer, payloads, write_all

from swarmabs_bag.errors import BagFolderError, BagWriteError, DamagedBagError, UnknownTypeError
from swarmabs_bag.mcap.output import RecordFile, Reserve
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run.writer import CHUNK_BYTES, CHUNK_SECONDS, BagWriter
from swarmabs_bag.run_folder import Split
from swarmabs_config.graph import Qos
from swarmabs_core.cdr import encode
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, PLANE_STATE, Message, PlaneState, Topic


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def plane(step: int) -> tuple[Topic, int, bytes]:
    return PLANE_STATE, step * 10_000_000, encode(PlaneState(step * 10_000_000, step, 0.1, 0.2))


def on_disk(file: Path) -> list[int]:
    """Return the steps of all messages that a process finds that reads the file from its start now."""
    found: list[int] = []
    with file.open("rb") as stream, suppress(EndOfFile):
        records = StreamReader(stream, validate_crcs=True).records
        found.extend(record.log_time // 10_000_000 for record in records if isinstance(record, StoredMessage))
    return found


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def writer(tmp_path: Path, clock: Clock) -> Iterator[BagWriter]:
    writer = bag_writer(tmp_path / "bag", {"scenario.yaml": b"name: x\n"}, monotonic=clock)
    yield writer
    writer.abort()


def test_chunk_reaches_the_disk_when_it_is_old_or_large_enough(writer: BagWriter, clock: Clock, tmp_path: Path) -> None:
    assert open_bag(writer.folder, damaged=True).attachment("scenario.yaml") == b"name: x\n", "at once"
    clock.now += 50.0
    writer.poll()
    writer.write(*plane(0))
    clock.now += CHUNK_SECONDS - 0.001
    writer.write(*plane(1))
    writer.poll()
    assert on_disk(writer.path) == []
    clock.now += 0.002
    writer.poll()
    assert on_disk(writer.path) == [0, 1]
    writer.write(*plane(2))
    clock.now += 1.0
    assert on_disk(writer.path) == [0, 1]
    writer.write(*plane(3))
    assert on_disk(writer.path) == [0, 1, 2, 3]
    assert CHUNK_SECONDS < 1.0 and CHUNK_BYTES == 2**20, "the contract"
    with bag_writer(tmp_path / "large", chunk_bytes=20_000, monotonic=clock) as large:
        step = 0
        while not on_disk(large.path):
            large.write(*plane(step))
            step += 1
    assert on_disk(large.path) == list(range(step))


def test_how_chunks_are_cut_changes_no_message_and_the_same_run_gives_the_same_file(
    tmp_path: Path, write_bag: WriteBag, run: list[Message], bag: Path
) -> None:
    for chunk_bytes in (1, 4000, 10**6):
        found = write_bag(tmp_path / str(chunk_bytes), chunk_bytes=chunk_bytes)
        assert read_everywhere(found) == payloads(run)
    assert (tmp_path / "4000" / "bag_0.mcap").read_bytes() == (bag / "bag_0.mcap").read_bytes()


def test_an_empty_bag_is_a_bag_and_messages_keep_their_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its library need not have been built."""
    monkeypatch.setattr("swarmabs_config.installation.version", Mock(side_effect=PackageNotFoundError))
    (tmp_path / "bag").mkdir()
    with bag_writer(tmp_path / "bag", {"scenario.yaml": b""}):
        pass
    assert read_everywhere(tmp_path / "bag") == []
    reader = open_bag(tmp_path / "bag")
    assert reader.index.header.library == "swarmabs"
    assert [channel.topic for channel in reader.channels] == [*MAIN_TOPICS, EVENTS]
    assert reader.attachment("scenario.yaml") == b""
    with bag_writer(tmp_path / "unordered", chunk_bytes=1) as writer:
        for step in (5, 9, 2):
            writer.write(*plane(step))
        writer.close({"run.log": b""})
    reader = open_bag(tmp_path / "unordered")
    reader.check()
    assert reader.index.attachments[-1].log_time == 90_000_000
    assert [time for _, time, _ in reader.messages()] == [50_000_000, 90_000_000, 20_000_000]
    assert (reader.start, reader.end) == (20_000_000, 90_000_000)


def test_qos_and_types_can_be_others_than_those_of_lockstep(tmp_path: Path) -> None:
    joints = Topic("plane/joint_states", PlaneState, "sensor_msgs/msg/JointState")
    payload = b"\x00\x01\x00\x00" + bytes(range(256))
    with BagWriter(tmp_path / "bag", topics=[joints], attachments={}, qos={joints: Qos("best_effort", 3)}) as writer:
        writer.write(joints, 7, payload, 5)
    ((channel, message),) = open_bag(tmp_path).stored_messages()
    assert (channel.name, channel.ros_type, channel.topic) == ("/plane/joint_states", joints.ros_type, None)
    assert (message.log_time, message.publish_time, message.payload) == (7, 5, payload)
    (profile,) = yaml.safe_load(channel.qos_profiles)
    assert (profile["reliability"], profile["depth"]) == ("best_effort", 3)


def test_close_attaches_and_ends_everything_and_refusals_harm_nothing(writer: BagWriter) -> None:
    with pytest.raises(ValueError, match="plane/state: log time -1 ns is negative"):
        writer.write(PLANE_STATE, -1, b"")
    with pytest.raises(KeyError):
        writer.write(Topic("other", PlaneState, "std_msgs/msg/Header"), 0, b"")
    writer.write(*plane(0))
    with pytest.raises(DamagedBagError, match="is incomplete"):
        open_bag(writer.folder)
    writer.close({"run.log": b"done"})
    reader = open_bag(writer.folder)
    assert [(entry.name, entry.log_time) for entry in reader.index.attachments] == [
        ("scenario.yaml", 0),
        ("run.log", 0),
    ]
    assert (reader.aborted(), reader.message_count) == (None, 1)
    for again in (writer.close, writer.poll, lambda: writer.write(*plane(1))):
        with pytest.raises(ValueError, match=r"bag_0\.mcap is closed"):
            again()
    writer.abort()
    reader.check()


@pytest.mark.parametrize(
    ("error", "said"),
    [(RuntimeError("agent 7 is silent"), "agent 7 is silent"), (KeyboardInterrupt(), "KeyboardInterrupt")],
)
def test_exception_in_the_block_aborts(error: BaseException, said: str, tmp_path: Path, writer: BagWriter) -> None:
    with pytest.raises(type(error)), bag_writer(tmp_path / "raised") as raised:  # noqa: PT012 - the block is what fails
        raised.write(*plane(0))
        raise error
    reader = open_bag(raised.folder)
    reader.check()
    assert (reader.aborted(), reader.message_count) == (said, 1)
    writer.write(*plane(3))
    writer.abort(reason="stalled", attachments={"run.log": b"agent 3: silence"})
    found = open_bag(writer.folder)
    assert (found.attachment("run.log"), found.aborted()) == (b"agent 3: silence", "stalled")
    assert found.index.attachments[-1].log_time == 30_000_000


def test_folder_that_cannot_be_used_is_refused_untouched(tmp_path: Path) -> None:
    (tmp_path / "old.txt").write_text("keep me", encoding="utf-8")
    with pytest.raises(BagFolderError, match="is not empty"):
        bag_writer(tmp_path)
    with pytest.raises(BagFolderError, match="Not a directory; name another folder"):
        bag_writer(tmp_path / "old.txt" / "bag")
    unknown = Topic("plane/wind", PlaneState, "weather_msgs/msg/Wind")
    with pytest.raises(UnknownTypeError, match="package weather_msgs"):
        BagWriter(tmp_path / "deep/bag", topics=[unknown], attachments={}, qos={unknown: Qos("reliable", 1)})
    assert [path.name for path in tmp_path.iterdir()] == ["old.txt"]


# A disk that fills up or fails: one clear error, and a bag that opens everywhere with all that was there before


RESERVE = 2**18
SCENARIO = b"name: x\n"


class Disk:
    """A disk on which there is so much space left; what does not fit is written in part, as real disks do.

    When the writer gives up its reserve, there are `kept_back` bytes more; `cuts` and `syncs` tell whether files can be
    cut off and synchronised.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.free, self.kept_back, self.code = 2**40, RESERVE, errno.ENOSPC
        self.cuts = self.syncs = True
        monkeypatch.setattr("swarmabs_bag.run.writer.RecordFile", self._file)
        monkeypatch.setattr("swarmabs_bag.run.writer.Reserve", self._reserve)

    def _file(self, path: Path) -> RecordFile:
        made = RecordFile(path)
        made.raw = RawFile(made.raw, self)
        return made

    def _reserve(self, folder: Path) -> Reserve:
        made = Reserve(folder)
        release = made.release

        def give_back() -> None:
            release()
            self.free += self.kept_back

        made.release = give_back
        return made


class RawFile:
    """A file on a disk."""

    def __init__(self, raw: io.FileIO, disk: Disk) -> None:
        self.raw, self.disk = raw, disk
        self.seek, self.close = raw.seek, raw.close

    def write(self, data: memoryview) -> int:
        if self.disk.free <= 0:
            raise OSError(self.disk.code, os.strerror(self.disk.code))
        done = self.raw.write(data[: self.disk.free])
        self.disk.free -= done
        return done

    def truncate(self, size: int) -> int:
        if self.disk.cuts:
            self.disk.free += max(0, self.raw.seek(0, os.SEEK_END) - size)
        return self.raw.truncate(size)

    def fileno(self) -> int:
        if not self.disk.syncs:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return self.raw.fileno()


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


def writer_on(disk: Disk, folder: Path, free: int = 10**6) -> BagWriter:
    """Return a writer with so much space left after opening."""
    writer = bag_writer(folder, {"scenario.yaml": SCENARIO}, chunk_bytes=12_000)
    disk.free = free
    return writer


def write_to_the_end(writer: BagWriter, run: list[Message]) -> None:
    with writer:
        write_all(writer, run)


def refuse(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def beginning_kept(folder: Path, run: list[Message]) -> int:
    """Check that every reader opens the bag and finds the beginning of the run in it; return how much."""
    found = read_everywhere(folder)
    assert found == payloads(run[: len(found)])
    assert open_bag(folder).attachment("scenario.yaml") == SCENARIO
    assert sorted(path.name for path in folder.iterdir()) == ["bag_0.mcap", "metadata.yaml"]
    return len(found)


@pytest.mark.parametrize(
    ("free", "code", "problem"),
    [
        *((free, errno.ENOSPC, "No space left on device; free space") for free in (0, 1, 2000, 4000, 12000)),
        (5000, errno.EDQUOT, "Disk quota exceeded; free some of your quota"),
        (5000, errno.EIO, "Input/output error; the disk reports a defect"),
        (5000, errno.EROFS, "Read-only file system; check that disk"),
    ],
)
def test_full_disk_leaves_a_bag_that_opens_everywhere(
    free: int, code: int, problem: str, tmp_path: Path, run: list[Message], disk: Disk
) -> None:
    disk.code = code
    with pytest.raises(BagWriteError, match=rf"^cannot write .*bag_0\.mcap: {problem}[^\n]*$"):
        write_to_the_end(writer_on(disk, tmp_path / "bag", free), run)
    assert (beginning_kept(tmp_path / "bag", run) > 0) == (free >= 4000)
    assert os.strerror(code) in (open_bag(tmp_path / "bag").aborted() or "")


def test_error_is_remembered_until_abort(tmp_path: Path, run: list[Message], disk: Disk) -> None:
    writer = writer_on(disk, tmp_path / "bag", 50)
    with pytest.raises(BagWriteError) as first:
        write_all(writer, run)
    # Killed now, the writer leaves nothing behind its last whole record.
    assert writer.path.stat().st_size == open_bag(writer.path, damaged=True).index.data_end
    for again in (writer.poll, writer.close, lambda: write_all(writer, run)):
        with pytest.raises(BagWriteError) as later:
            again()
        assert later.value is first.value
    for reason in ("first", "second"):
        writer.abort(reason)
    assert (open_bag(tmp_path / "bag").message_count, open_bag(tmp_path / "bag").aborted()) == (0, "first")


def test_a_file_that_cannot_be_begun_is_not_there(tmp_path: Path, run: list[Message], disk: Disk) -> None:
    split = Split(nanoseconds=STEPS_PER_FILE * PERIOD)
    writer = bag_writer(tmp_path / "bag", {"scenario.yaml": SCENARIO}, chunk_bytes=2000, split=split)
    write_all(writer, [message for message in run if message.step < STEPS_PER_FILE])
    disk.free = 0
    with pytest.raises(BagWriteError, match=r"bag_1\.mcap: No space left"):
        writer.write(*plane(STEPS_PER_FILE))
    assert [path.name for path in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
    writer.abort("full")
    assert beginning_kept(tmp_path / "bag", run) > 60


def test_a_lost_end_of_the_file_costs_its_last_chunks(tmp_path: Path, run: list[Message], disk: Disk) -> None:
    kept = []
    for reserve in (RESERVE, 0):
        disk.kept_back = reserve
        with pytest.raises(BagWriteError):
            write_to_the_end(writer_on(disk, tmp_path / str(reserve), 9000), run * 3)
        kept.append(beginning_kept(tmp_path / str(reserve), run * 3))
    with_reserve, without = kept
    assert with_reserve > without
    disk.cuts = False
    with pytest.raises(BagWriteError):
        write_to_the_end(writer_on(disk, tmp_path / "bag", 9000), run * 3)
    assert [path.name for path in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
    reader = open_bag(tmp_path / "bag", damaged=True)
    assert reader.size == reader.index.data_end
    found = [payload for _, _, payload in reader.messages()]
    assert found == payloads(run[: len(found)])


@pytest.mark.parametrize("free", [0, 3000, 5000, 9000])
def test_disk_full_at_closing_keeps_what_fits(free: int, tmp_path: Path, run: list[Message], disk: Disk) -> None:
    writer = writer_on(disk, tmp_path / "bag")
    write_all(writer, run)
    disk.free = free
    with pytest.raises(BagWriteError, match="No space left"):
        writer.close({"run.log": os.urandom(10_000)})
    assert beginning_kept(tmp_path / "bag", run) == len(run) or free < 5000


def test_failed_sync_at_closing_and_missing_metadata_are_errors_and_the_bag_still_opens(
    tmp_path: Path, run: list[Message], disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk.syncs = False
    with pytest.raises(BagWriteError, match="Input/output error"):
        write_to_the_end(writer_on(disk, tmp_path / "sync"), run)
    with pytest.raises(BagWriteError, match="No space left"):
        write_to_the_end(writer_on(disk, tmp_path / "full", 5000), run)
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["bag_0.mcap"], "only what is on the disk is listed"
    disk.syncs = True
    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(BagWriteError, match="No space left"):
        write_to_the_end(writer_on(disk, tmp_path / "bag"), run)
    assert [path.name for path in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
    for name in ("sync", "bag"):
        open_bag(tmp_path / name).check()
        assert open_bag(tmp_path / name).message_count == len(run)


def test_space_is_reserved_and_may_not_fit(tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def count(_: int, __: int, size: int) -> None:
        asked.append(size)
        refuse()

    with monkeypatch.context() as full:
        full.setattr(os, "posix_fallocate", count)
        with pytest.raises(BagWriteError, match="No space left"):
            bag_writer(tmp_path / "new/bag")
    assert (list(tmp_path.iterdir()), asked) == ([], [RESERVE])
    writer = bag_writer(tmp_path / "new/bag", {"scenario.yaml": SCENARIO}, chunk_bytes=1)
    monkeypatch.setattr(os, "posix_fallocate", count)
    with pytest.raises(BagWriteError, match="No space left"):
        write_to_the_end(writer, run * 2)
    assert asked == [RESERVE, RESERVE + 2**16]
    assert beginning_kept(tmp_path / "new/bag", run * 2) == 1


@contextmanager
def limited(what: int, most: int) -> Iterator[None]:
    """Let this process have no more of a resource."""
    soft, hard = resource.getrlimit(what)
    resource.setrlimit(what, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(what, (soft, hard))


def test_limit_on_the_size_of_files_is_met_like_a_full_disk(tmp_path: Path, run: list[Message]) -> None:
    most = RESERVE + 2**16
    writer = bag_writer(tmp_path / "bag", {"scenario.yaml": SCENARIO}, chunk_bytes=12_000)
    with (
        limited(resource.RLIMIT_FSIZE, most),
        pytest.raises(BagWriteError, match="File too large; raise the limit on file sizes"),
    ):
        write_to_the_end(writer, run * 40)
    assert (tmp_path / "bag" / "bag_0.mcap").stat().st_size <= most
    assert beginning_kept(tmp_path / "bag", run * 40) > 1000


def test_without_a_free_descriptor_no_file_is_begun(tmp_path: Path, run: list[Message]) -> None:
    split = Split(nanoseconds=STEPS_PER_FILE * PERIOD)
    writer = bag_writer(tmp_path / "bag", {"scenario.yaml": SCENARIO}, chunk_bytes=2000, split=split)
    taken: list[int] = []
    with limited(resource.RLIMIT_NOFILE, max(int(entry.name) for entry in Path("/proc/self/fd").iterdir()) + 2):
        with suppress(OSError):
            while True:
                taken.append(os.open("/dev/null", os.O_RDONLY))
        with pytest.raises(BagWriteError, match=r"bag_0\.mcap: Too many open files; raise the limit"):
            bag_writer(tmp_path / "new")
        with pytest.raises(BagWriteError, match=r"bag_1\.mcap: Too many open files; raise the limit"):
            write_to_the_end(writer, run)
    for descriptor in taken:
        os.close(descriptor)
    assert not (tmp_path / "new").exists()
    assert beginning_kept(tmp_path / "bag", run) > 60
    assert "Too many open files" in (open_bag(tmp_path / "bag").aborted() or "")

"""A disk that fills up or fails: one clear error, and a bag that opens everywhere with all that was there before."""

from __future__ import annotations

import errno
import io
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from swarmabs_bag.errors import BagWriteError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.writer import BagWriter
from swarmabs_core.cdr import encode
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, TOPIC_OF, Message

TOPICS = (*MAIN_TOPICS, EVENTS)
CHUNK_BYTES = 12_000
RESERVE = 2**18
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


class FullDisk:
    """A file on a disk with so much space left; what does not fit is written in part, as real disks do."""

    def __init__(self, raw: io.FileIO, space: int, code: int = errno.ENOSPC) -> None:
        self.raw = raw
        self.free = space
        self.code = code
        self.fails_sync = False

    def write(self, data: memoryview) -> int:
        if self.free <= 0:
            raise OSError(self.code, os.strerror(self.code))
        done = self.raw.write(data[: self.free])
        self.free -= done
        return done

    def truncate(self, size: int) -> int:
        self.free += max(0, self.raw.seek(0, os.SEEK_END) - size)
        return self.raw.truncate(size)

    def seek(self, offset: int) -> int:
        return self.raw.seek(offset)

    def fileno(self) -> int:
        if self.fails_sync:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return self.raw.fileno()

    def close(self) -> None:
        self.raw.close()


def full_writer(
    folder: Path, monkeypatch: pytest.MonkeyPatch, space: int, code: int = errno.ENOSPC, reserve: int = RESERVE
) -> tuple[BagWriter, FullDisk]:
    """Return a writer with so much space left after opening, and as much again when it gives up its reserve."""
    writer = BagWriter(folder, topics=TOPICS, attachments={"scenario.yaml": b"name: x\n"}, chunk_bytes=CHUNK_BYTES)
    disk = FullDisk(writer._file.raw, space, code)
    monkeypatch.setattr(writer._file, "raw", disk)
    release = writer._reserve.release

    def give_back() -> None:
        release()
        disk.free += reserve

    monkeypatch.setattr(writer._reserve, "release", give_back)
    return writer, disk


def write_all(writer: BagWriter, run: list[Message]) -> None:
    with writer:
        for message in run:
            writer.write(TOPIC_OF[type(message)], message.stamp, encode(message))


def assert_readable_prefix(folder: Path, run: list[Message]) -> int:
    """Check that every reader opens the bag and finds the beginning of the run in it; return how much."""
    reader = open_bag(folder)
    reader.check()
    found = [payload for _, _, payload in reader.messages()]
    assert found == [encode(message) for message in run[: len(found)]]
    with (folder / "bag_0.mcap").open("rb") as stream:
        assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages()) == len(found)
    with Reader(folder) as other:
        assert other.message_count == len(found)
        assert sum(1 for _ in other.messages()) == len(found)
    assert reader.attachment("scenario.yaml") == b"name: x\n"
    assert sorted(path.name for path in folder.iterdir()) == ["bag_0.mcap", "metadata.yaml"]
    return len(found)


@pytest.mark.parametrize("space", [0, 1, 9, 100, 2000, 4000, 6000, 8000, 12000])
def test_full_disk_leaves_a_bag_that_opens_everywhere(
    space: int, tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, _ = full_writer(tmp_path / "bag", monkeypatch, space)
    with pytest.raises(BagWriteError, match=r"cannot write .*bag_0\.mcap: No space left on device; free space"):
        write_all(writer, run)
    kept = assert_readable_prefix(tmp_path / "bag", run)
    assert (kept > 0) == (space >= 4000)
    aborted = open_bag(tmp_path / "bag").aborted()
    assert aborted is not None
    assert "No space left on device" in aborted


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (errno.EDQUOT, "Disk quota exceeded; free some of your quota"),
        (errno.EIO, "Input/output error; the disk reports a defect"),
        (errno.EFBIG, "File too large; raise the limit on file sizes"),
        (errno.EROFS, "Read-only file system; check that disk"),
    ],
)
def test_other_errors_of_the_disk_are_named(
    code: int, text: str, tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, _ = full_writer(tmp_path / "bag", monkeypatch, 5000, code)
    with pytest.raises(BagWriteError, match=text) as caught:
        write_all(writer, run)
    assert "\n" not in str(caught.value)
    assert assert_readable_prefix(tmp_path / "bag", run) > 0


def test_last_chunks_are_given_up_for_the_end_of_the_file(
    tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = []
    for reserve in (RESERVE, 0):
        folder = tmp_path / str(reserve)
        writer, _ = full_writer(folder, monkeypatch, 9000, reserve=reserve)
        with pytest.raises(BagWriteError):
            write_all(writer, run * 3)
        kept.append(assert_readable_prefix(folder, run * 3))
    with_reserve, without = kept
    assert with_reserve > without


def test_disk_that_takes_nothing_any_more_leaves_whole_records(
    tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, disk = full_writer(tmp_path / "bag", monkeypatch, 9000, reserve=0)
    monkeypatch.setattr(disk, "truncate", disk.raw.truncate)
    with pytest.raises(BagWriteError):
        write_all(writer, run * 3)
    assert [path.name for path in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
    reader = open_bag(tmp_path / "bag", damaged=True)
    assert reader.size == reader.index.data_end
    found = [payload for _, _, payload in reader.messages()]
    assert found == [encode(message) for message in run[: len(found)]]


def test_error_is_remembered_until_abort(tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch) -> None:
    writer, _ = full_writer(tmp_path / "bag", monkeypatch, 50)
    topic, payload = TOPIC_OF[type(run[0])], encode(run[0])
    with pytest.raises(BagWriteError) as first:  # noqa: PT012 - whichever write it is
        while True:
            writer.write(topic, 0, payload)
    # Killed now, the writer leaves nothing behind its last whole record.
    assert writer.path.stat().st_size == writer._file.committed == open_bag(writer.path, damaged=True).index.data_end
    for again in (writer.poll, writer.close, lambda: writer.write(topic, 0, payload)):
        with pytest.raises(BagWriteError) as later:
            again()
        assert later.value is first.value
    writer.abort()
    assert open_bag(tmp_path / "bag").message_count == 0


@pytest.mark.parametrize("space", [0, 3000, 5000, 8000, 9000])
def test_disk_full_at_closing_keeps_what_fits(
    space: int, tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, disk = full_writer(tmp_path / "bag", monkeypatch, 10**6)
    for message in run:
        writer.write(TOPIC_OF[type(message)], message.stamp, encode(message))
    disk.free = space
    with pytest.raises(BagWriteError, match="No space left"):
        writer.close({"run.log": os.urandom(10_000)})
    kept = assert_readable_prefix(tmp_path / "bag", run)
    assert kept == len(run) or space < 5000


def test_failed_sync_at_closing_is_an_error_and_the_bag_still_opens(
    tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, disk = full_writer(tmp_path / "bag", monkeypatch, 10**6)
    for message in run:
        writer.write(TOPIC_OF[type(message)], message.stamp, encode(message))
    disk.fails_sync = True
    with pytest.raises(BagWriteError, match="Input/output error"):
        writer.close()
    reader = open_bag(tmp_path / "bag")
    reader.check()
    assert reader.message_count == len(run)


def test_metadata_that_cannot_be_written_leaves_no_piece_of_it(
    tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    writer = BagWriter(tmp_path / "bag", topics=TOPICS, attachments={})
    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(BagWriteError, match="No space left"):
        write_all(writer, run)
    assert [path.name for path in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
    open_bag(tmp_path / "bag").check()


def test_disk_that_is_full_from_the_start_is_left_as_it_was(
    tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch, write_bag: Callable[..., Path]
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as full:
        full.setattr(os, "posix_fallocate", refuse)
        with pytest.raises(BagWriteError, match="No space left"):
            BagWriter(tmp_path / "new/bag", topics=TOPICS, attachments={})
    assert list(tmp_path.iterdir()) == []
    assert open_bag(write_bag(tmp_path / "new/bag")).message_count == len(run)


def test_reserve_grows_and_its_growth_may_be_what_does_not_fit(
    tmp_path: Path, run: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = BagWriter(tmp_path / "bag", topics=TOPICS, attachments={"scenario.yaml": b"name: x\n"}, chunk_bytes=1)
    asked: list[int] = []

    def count(_: int, __: int, size: int) -> None:
        asked.append(size)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", count)
    with pytest.raises(BagWriteError, match="No space left"):
        write_all(writer, run * 2)
    assert asked == [RESERVE + 2**16]
    assert assert_readable_prefix(tmp_path / "bag", run * 2) == 1


def in_child(folder: Path, *prefix: str, limit: int | None = None) -> subprocess.CompletedProcess[str]:
    script = Path(__file__).with_name("endless_writer.py")

    def set_limit() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.run(
        [*prefix, sys.executable, str(script), str(folder), "0.1"],
        capture_output=True,
        text=True,
        check=False,
        timeout=18,
        env=ENVIRONMENT,
        preexec_fn=set_limit,
    )


def test_limit_on_the_size_of_files_is_met_like_a_full_disk(tmp_path: Path) -> None:
    done = in_child(tmp_path / "bag", limit=2**19)
    assert done.returncode == 1, done.stderr
    assert "File too large; raise the limit on file sizes" in done.stdout.splitlines()[-1]
    reader = open_bag(tmp_path / "bag")
    reader.check()
    assert reader.size <= 2**19
    assert reader.message_count > 1000
    with Reader(tmp_path / "bag") as other:
        assert other.message_count == reader.message_count


def test_real_disk_that_fills_up(tmp_path: Path) -> None:
    mount, copy = tmp_path / "disk", tmp_path / "copy"
    mount.mkdir()
    script = (
        f'mount -t tmpfs -o size=4m tmpfs "{mount}" || exit 77\n"$@"\ncode=$?\n'
        f'df "{mount}" >&2\ncp -r "{mount}/bag" "{copy}"\nexit $code\n'
    )
    done = in_child(mount / "bag", "unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, "sh")
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip(f"cannot mount a small disk here: {done.stderr.strip()}")
    assert done.returncode == 1, done.stderr
    said = done.stdout.splitlines()
    assert "No space left on device" in said[-1]
    reader = open_bag(copy)
    reader.check()
    steps = [time // 1_000_000 for _, time, _ in reader.messages()]
    assert steps[-1] == (len(steps) - 1) // 4
    # What is missing is the last chunk at most: the space for the end was kept back.
    assert reader.size > 2**21
    with Reader(copy) as other:
        assert other.message_count == reader.message_count

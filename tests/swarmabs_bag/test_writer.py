"""How a bag comes to be: chunks, closing, aborting, refusals, and what each leaves on the disk."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path

import pytest
import yaml
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Attachment, Message as StoredMessage
from mcap.stream_reader import StreamReader

from swarmabs_bag.errors import BagFolderError, DamagedBagError, UnknownTypeError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.writer import BagWriter
from swarmabs_config.graph import Qos
from swarmabs_core.cdr import encode
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, PLANE_STATE, Message, PlaneState, Topic

TOPICS = (*MAIN_TOPICS, EVENTS)


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def plane(step: int) -> tuple[Topic, int, bytes]:
    return PLANE_STATE, step * 10_000_000, encode(PlaneState(step * 10_000_000, step, 0.1, 0.2))


def on_disk(file: Path) -> list[int]:
    """Return the log times of all messages that a process finds that reads the file from its start now."""
    found: list[int] = []
    with file.open("rb") as stream, suppress(EndOfFile):
        records = StreamReader(stream, validate_crcs=True).records
        found.extend(record.log_time for record in records if isinstance(record, StoredMessage))
    return found


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def writer(tmp_path: Path, clock: Clock) -> Iterator[BagWriter]:
    attachments = {"scenario.yaml": b"name: x\n"}
    writer = BagWriter(tmp_path / "bag", topics=TOPICS, attachments=attachments, monotonic=clock)
    yield writer
    writer.abort()


def test_attachments_of_the_start_are_on_disk_at_once(writer: BagWriter) -> None:
    with writer.path.open("rb") as stream:
        _, attached = islice(StreamReader(stream).records, 2)
    assert isinstance(attached, Attachment)
    assert (attached.name, attached.data) == ("scenario.yaml", b"name: x\n")
    assert not (writer.folder / "metadata.yaml").exists()


def test_chunk_reaches_the_disk_when_it_is_old_enough(writer: BagWriter, clock: Clock) -> None:
    writer.write(*plane(0))
    clock.now += 0.799
    writer.write(*plane(1))
    writer.poll()
    assert on_disk(writer.path) == []
    clock.now += 0.002
    writer.poll()
    assert on_disk(writer.path) == [0, 10_000_000]


def test_write_closes_an_old_chunk_without_poll(writer: BagWriter, clock: Clock) -> None:
    writer.write(*plane(0))
    clock.now += 1.0
    writer.write(*plane(1))
    assert on_disk(writer.path) == [0, 10_000_000]


def test_age_of_a_chunk_counts_from_its_first_message(writer: BagWriter, clock: Clock) -> None:
    clock.now += 50.0
    writer.poll()
    writer.write(*plane(0))
    writer.poll()
    assert on_disk(writer.path) == []


def test_chunk_reaches_the_disk_when_it_is_large_enough(tmp_path: Path, clock: Clock) -> None:
    with BagWriter(tmp_path / "bag", topics=TOPICS, attachments={}, chunk_bytes=20_000, monotonic=clock) as writer:
        step = 0
        while not on_disk(writer.path):
            writer.write(*plane(step))
            step += 1
    assert on_disk(writer.path) == [number * 10_000_000 for number in range(step)]


def test_how_chunks_are_cut_changes_no_message(
    tmp_path: Path, write_bag: Callable[..., Path], run: list[Message]
) -> None:
    contents = []
    for chunk_bytes in (1, 3000, 10**6):
        reader = open_bag(write_bag(tmp_path / str(chunk_bytes), chunk_bytes=chunk_bytes))
        contents.append(list(reader.messages()))
        reader.check()
    assert contents[0] == contents[1] == contents[2]
    assert len(contents[0]) == len(run)


def test_same_run_gives_the_same_file(tmp_path: Path, write_bag: Callable[..., Path]) -> None:
    first, second = (write_bag(tmp_path / name) / "bag_0.mcap" for name in "ab")
    assert first.read_bytes() == second.read_bytes()


def test_topic_keeps_its_order_and_not_that_of_time(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", topics=TOPICS, attachments={}) as writer:
        for step in (5, 2, 9):
            writer.write(*plane(step))
    reader = open_bag(tmp_path)
    assert [time for _, time, _ in reader.messages()] == [50_000_000, 20_000_000, 90_000_000]
    assert (reader.start, reader.end) == (20_000_000, 90_000_000)


def test_bag_without_messages_is_a_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", topics=TOPICS, attachments={"scenario.yaml": b""}):
        pass
    reader = open_bag(tmp_path / "bag")
    reader.check()
    assert list(reader.messages()) == []
    assert [channel.topic for channel in reader.channels] == list(TOPICS)
    assert reader.attachment("scenario.yaml") == b""
    with (tmp_path / "bag/bag_0.mcap").open("rb") as stream:
        assert list(make_reader(stream).iter_messages()) == []


def test_qos_can_be_another_than_that_of_lockstep(tmp_path: Path) -> None:
    qos = {PLANE_STATE: Qos("best_effort", 3)}
    with BagWriter(tmp_path / "bag", topics=[PLANE_STATE], attachments={}, qos=qos):
        pass
    (channel,) = open_bag(tmp_path).channels
    (profile,) = yaml.safe_load(channel.qos_profiles)
    assert (profile["reliability"], profile["depth"]) == ("best_effort", 3)


def test_close_attaches_and_ends_everything(writer: BagWriter) -> None:
    writer.write(*plane(0))
    writer.close({"run.log": b"done"})
    reader = open_bag(writer.folder)
    assert tuple(entry.name for entry in reader.index.attachments) == ("scenario.yaml", "run.log")
    assert reader.aborted() is None
    for again in (writer.close, writer.poll, lambda: writer.write(*plane(1))):
        with pytest.raises(ValueError, match=r"bag_0\.mcap is closed"):
            again()
    writer.abort()
    reader.check()


def test_exception_in_the_block_aborts_and_the_bag_says_why(tmp_path: Path) -> None:
    def record() -> None:
        with BagWriter(tmp_path / "bag", topics=TOPICS, attachments={}) as writer:
            writer.write(*plane(0))
            raise RuntimeError("agent 7 has not answered")

    with pytest.raises(RuntimeError, match="agent 7"):
        record()
    reader = open_bag(tmp_path)
    reader.check()
    assert reader.aborted() == "agent 7 has not answered"
    assert reader.message_count == 1


def test_interrupt_without_a_text_is_named_by_its_kind(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "bag", topics=TOPICS, attachments={}):
        raise KeyboardInterrupt
    assert open_bag(tmp_path).aborted() == "KeyboardInterrupt"


def test_abort_attaches_the_log(writer: BagWriter) -> None:
    writer.write(*plane(0))
    writer.abort(reason="stalled", attachments={"run.log": b"agent 3: silence"})
    assert open_bag(writer.folder).attachment("run.log") == b"agent 3: silence"


def test_negative_time_is_refused_and_harms_nothing(writer: BagWriter) -> None:
    with pytest.raises(ValueError, match="plane/state: log time -1 ns is negative"):
        writer.write(PLANE_STATE, -1, b"")
    writer.write(*plane(0))
    writer.close()
    reader = open_bag(writer.folder)
    reader.check()
    assert reader.message_count == 1


def test_topic_that_was_not_named_is_a_bug(writer: BagWriter) -> None:
    with pytest.raises(KeyError):
        writer.write(Topic("other", PlaneState, "std_msgs/msg/Header"), 0, b"")
    writer.close()


def test_folder_that_is_not_empty_is_refused_untouched(tmp_path: Path) -> None:
    (tmp_path / "old.txt").write_text("keep me", encoding="utf-8")
    with pytest.raises(BagFolderError, match="is not empty"):
        BagWriter(tmp_path, topics=TOPICS, attachments={})
    assert [path.name for path in tmp_path.iterdir()] == ["old.txt"]


def test_folder_that_is_empty_is_used(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with BagWriter(tmp_path / "bag", topics=TOPICS, attachments={}):
        pass
    assert open_bag(tmp_path / "bag").problem is None


def test_folder_under_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BagFolderError, match="Not a directory; name another folder"):
        BagWriter(tmp_path / "file/bag", topics=TOPICS, attachments={})
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_folder_without_permission_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(BagFolderError, match="Permission denied"):
            BagWriter(tmp_path / "bag", topics=TOPICS, attachments={})
    finally:
        tmp_path.chmod(0o700)


def test_type_that_is_not_installed_leaves_nothing_behind(tmp_path: Path) -> None:
    unknown = Topic("plane/wind", PlaneState, "weather_msgs/msg/Wind")
    with pytest.raises(UnknownTypeError, match="package weather_msgs"):
        BagWriter(tmp_path / "deep/bag", topics=[unknown], attachments={}, qos={unknown: Qos("reliable", 1)})
    assert list(tmp_path.iterdir()) == []


def test_bag_of_standard_messages(tmp_path: Path) -> None:
    joints = Topic("plane/joint_states", PlaneState, "sensor_msgs/msg/JointState")
    with BagWriter(tmp_path / "bag", topics=[joints], attachments={}, qos={joints: Qos("reliable", 1)}) as writer:
        writer.write(joints, 0, b"\x00\x01\x00\x00" + bytes(24))
    ((channel, message),) = open_bag(tmp_path).stored_messages()
    assert (channel.name, channel.ros_type, channel.topic) == ("/plane/joint_states", joints.ros_type, None)
    assert message.payload == b"\x00\x01\x00\x00" + bytes(24)


def test_file_that_is_still_written_is_told_from_a_complete_one(writer: BagWriter, clock: Clock) -> None:
    writer.write(*plane(0))
    clock.now += 2
    writer.poll()
    with pytest.raises(DamagedBagError, match=r"is incomplete: .*1 message"):
        open_bag(writer.folder)
    assert [time for _, time, _ in open_bag(writer.folder, damaged=True).messages()] == [0]
    writer.close()
    open_bag(writer.folder).check()


def test_payload_reaches_the_file_byte_by_byte(tmp_path: Path) -> None:
    payload = bytes(range(256)) * 4
    with BagWriter(tmp_path / "bag", topics=[PLANE_STATE], attachments={"blob": payload}) as writer:
        writer.write(PLANE_STATE, 7, payload)
    reader = open_bag(tmp_path)
    assert [(time, data) for _, time, data in reader.messages()] == [(7, payload)]
    assert reader.attachment("blob") == payload

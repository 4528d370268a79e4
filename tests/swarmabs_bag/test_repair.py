"""A damaged bag is made whole: what was saved is what was written, bit for bit, and what was lost is named."""

from __future__ import annotations

import errno
import os
import random
import shutil
import struct
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path

import pytest
import yaml
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Header, Message as McapMessage, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import Reader
from tests.swarmabs_bag.conftest import WriteBag
from tests.swarmabs_bag.damage import MAGIC, chunk as packed, sealed

from swarmabs_bag.errors import BagFolderError, BagWriteError, DamagedBagError, NotABagError
from swarmabs_bag.info import bag_info
from swarmabs_bag.output import RecordFile
from swarmabs_bag.reader import open_bag
from swarmabs_bag.records import encoded
from swarmabs_bag.repair import RepairReport, repair_bag
from swarmabs_bag.run_folder import Split
from swarmabs_bag.writer import BagWriter
from swarmabs_cli import main
from swarmabs_core.cdr import encode
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, TOPIC_OF, Message

PERIOD = 10_000_000


def payloads(run: Iterable[Message]) -> list[bytes]:
    return [encode(message) for message in run]


def read_everywhere(folder: Path) -> list[bytes]:
    """Check that every reader opens a bag and finds the same in it; return its payloads in file order."""
    reader = open_bag(folder)
    reader.check()
    found = [payload for _, _, payload in reader.messages()]
    files = sorted(folder.glob("*.mcap"))
    seeking = []
    for file in files:
        with file.open("rb") as stream:  # in the order of log times, which needs every index
            seeking += [message.data for _, _, message in make_reader(stream, validate_crcs=True).iter_messages()]
    assert sorted(seeking) == sorted(found)
    with Reader(folder) as other:
        assert other.message_count == len(found)
        assert sorted(bytes(data) for _, _, data in other.messages()) == sorted(found)
    assert repair_bag(folder).output is None
    return found


def repaired(path: Path, to: Path) -> tuple[RepairReport, list[bytes]]:
    report = repair_bag(path, to)
    found = read_everywhere(to)
    assert report.messages == len(found)
    return report, found


def records(file: Path) -> list[tuple[int, int, int]]:
    """Return opcode, begin and end of every record of a whole file."""
    data, position, found = file.read_bytes(), 8, []
    while position < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, position)
        found.append((opcode, position, position + 9 + length))
        position += 9 + length
    return found


@pytest.fixture
def copy(bag: Path, tmp_path: Path) -> Path:
    """Return a bag's folder that may be damaged."""
    return Path(shutil.copytree(bag, tmp_path / "bag"))


def overwrite(file: Path, position: int, data: bytes) -> None:
    with file.open("r+b") as stream:
        stream.seek(position)
        stream.write(data)


def test_a_whole_bag_is_left_alone_or_copied(copy: Path, tmp_path: Path) -> None:
    before = {path.name: path.read_bytes() for path in copy.iterdir()}
    for in_place in (False, True):
        assert repair_bag(copy, in_place=in_place).output is None
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    repair_bag(copy, tmp_path / "new")
    for folder in (copy, tmp_path / "new"):
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.timeout(60)
def test_wherever_a_file_is_cut_off_all_before_is_saved(bag: Path, tmp_path: Path, run: list[Message]) -> None:
    whole = bag / "bag_0.mcap"
    chunks = [(begin, end) for opcode, begin, end in records(whole) if opcode == Opcode.CHUNK]
    counts = []
    draw = random.Random(1)
    cuts = sorted(draw.sample(range(chunks[0][1], whole.stat().st_size), 15))
    for cut in cuts:
        folder = tmp_path / str(cut)
        folder.mkdir()
        (folder / "bag_0.mcap").write_bytes(whole.read_bytes()[:cut])
        reader = open_bag(folder, damaged=True)
        in_whole_chunks = reader.message_count
        report, found = repaired(folder, tmp_path / f"{cut}_new")
        assert found == payloads(run[: len(found)])
        assert len(found) >= in_whole_chunks
        assert (
            report.last_complete_step == len([1 for m in run[: len(found)] if type(m).__name__.startswith("Des")]) - 1
        )
        assert report.attachments[:2] == ("scenario.yaml", "provenance.json")
        assert "cut off" in (open_bag(tmp_path / f"{cut}_new").aborted() or "") or cut > chunks[-1][1]
        counts.append(len(found))
    assert counts == sorted(counts)
    assert len(set(counts)) > 5


@pytest.mark.parametrize("compression", list(CompressionType))
def test_of_a_cut_chunk_the_whole_messages_are_saved(compression: CompressionType, tmp_path: Path) -> None:
    """One chunk of 2 MB that compresses badly, in a file of another writer, cut in the middle."""
    draw = random.Random(2)
    sent = [draw.randbytes(1000) for _ in range(2000)]
    stream = BytesIO()
    writer = Writer(stream, chunk_size=2**30, compression=compression)
    writer.start(profile="ros2", library="somebody else")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channel = writer.register_channel("/chatter", "cdr", schema, {"offered_qos_profiles": ""})
    for number, data in enumerate(sent):
        writer.add_message(channel, number * 10 + 5, data, number * 10 + 5, number)
    writer.finish()
    (tmp_path / "x.mcap").write_bytes(stream.getvalue()[:1_000_000])
    report = repair_bag(tmp_path / "x.mcap")
    assert report.output == str(tmp_path / "x_repaired")
    reader = open_bag(tmp_path / "x_repaired")
    reader.check()
    found = [message.payload for _, message in reader.stored_messages()]
    assert found == sent[: len(found)]
    assert len(found) > 700
    (lost,) = report.files[0].lost
    assert (lost.start, lost.end) == (5e-9, 19995e-9)
    assert lost.offset + lost.bytes == 1_000_000
    assert report.last_complete_step is None
    with Reader(tmp_path / "x_repaired") as other:
        assert other.message_count == len(found)


@pytest.mark.timeout(60)
def test_whatever_byte_is_wrong_nothing_wrong_is_kept(bag: Path, tmp_path: Path, run: list[Message]) -> None:
    whole = (bag / "bag_0.mcap").read_bytes()
    sent = payloads(run)
    draw = random.Random(3)
    for number in range(25):
        folder = tmp_path / str(number)
        shutil.copytree(bag, folder)
        data = bytearray(whole)
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        (folder / "bag_0.mcap").write_bytes(data)
        report, found = repaired(folder, tmp_path / f"{number}_new")
        assert report.output is not None
        rest = iter(sent)
        assert all(payload in rest for payload in found), "not a part of what was written, in its order"
        assert report.messages + sum(topic.lost for topic in report.topics) == len(sent)
        if len(found) < len(sent):
            assert report.lost_bytes > 0
            assert bag_info(tmp_path / f"{number}_new").repaired is not None


def test_a_chunk_that_is_damaged_is_named_with_its_times(copy: Path, tmp_path: Path, run: list[Message]) -> None:
    file = copy / "bag_0.mcap"
    index = open_bag(copy).index.chunks[2]
    overwrite(file, index.chunk_start_offset + index.chunk_length - 5, b"\xff\xff\xff")
    report, found = repaired(copy, tmp_path / "new")
    (lost,) = report.files[0].lost
    assert (lost.offset, lost.bytes) == (index.chunk_start_offset, index.chunk_length)
    assert (lost.start, lost.end) == (index.message_start_time / 1e9, index.message_end_time / 1e9)
    with file.open("rb") as stream:
        kept = [m.data for _, _, m in make_reader(stream).iter_messages(ending_before=index.message_start_time)]
    assert found[: len(kept)] == kept[: len(found)]
    (plane,) = (topic for topic in report.topics if topic.name == "/plane/state")
    assert plane.messages + plane.lost == 41
    assert report.last_complete_step == index.message_start_time // PERIOD - 1 or plane.lost == 0
    assert "1 place could not be saved" in (bag_info(tmp_path / "new").repaired or "")


def test_a_message_index_with_the_head_of_a_message_is_none(copy: Path, tmp_path: Path, run: list[Message]) -> None:
    file = copy / "bag_0.mcap"
    for _, begin, _ in [found for found in records(file) if found[0] == Opcode.MESSAGE_INDEX][:12]:
        overwrite(file, begin, bytes([Opcode.MESSAGE]))
    report, found = repaired(copy, tmp_path / "new")
    assert found == payloads(run)
    assert "outside of the chunks, where no CRC says that it is one" in report.files[0].problems[0]


def test_a_header_with_the_head_of_a_message_is_none(split: Path, tmp_path: Path, run: list[Message]) -> None:
    """It would be one on channel 4, the length of the profile's name, which another file of the bag describes."""
    file = split / "bag_4.mcap"
    overwrite(file, len(MAGIC), bytes([Opcode.MESSAGE]))
    overwrite(file, file.stat().st_size - 60, b"\xff\xff")
    _, found = repaired(split, tmp_path / "new")
    assert found == payloads(run)


def test_topics_that_stood_in_a_lost_chunk_come_from_the_summary(copy: Path, tmp_path: Path) -> None:
    first = open_bag(copy).index.chunks[0]
    overwrite(copy / "bag_0.mcap", first.chunk_start_offset + 60, b"\0\0\0\0\0\0")
    before = open_bag(copy)
    report, found = repaired(copy, tmp_path / "new")
    assert len(found) > 100
    after = open_bag(tmp_path / "new")
    assert [(c.name, c.ros_type, c.qos_profiles) for c in after.channels] == [
        (c.name, c.ros_type, c.qos_profiles) for c in before.channels
    ]
    assert report.first_step is not None
    assert report.first_step > 0


def test_what_is_lost_with_the_index_alone_comes_back_in_full(copy: Path, tmp_path: Path, run: list[Message]) -> None:
    """Without its message indexes, summary and metadata.yaml, a bag has lost nothing."""
    file = copy / "bag_0.mcap"
    data = file.read_bytes()
    kept = [(opcode, begin, end) for opcode, begin, end in records(file) if opcode != Opcode.MESSAGE_INDEX]
    kept = kept[: [opcode for opcode, _, _ in kept].index(Opcode.DATA_END) + 1]
    footer = struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0)
    file.write_bytes(data[:8] + b"".join(data[begin:end] for _, begin, end in kept) + footer + data[:8])
    (copy / "metadata.yaml").unlink()
    report, found = repaired(copy, tmp_path / "new")
    assert found == payloads(run)
    assert (report.lost_bytes, report.last_complete_step) == (0, 40)
    assert open_bag(tmp_path / "new").aborted() is None
    assert bag_info(tmp_path / "new").repaired is None


def test_metadata_alone_is_made_anew(copy: Path, tmp_path: Path) -> None:
    right = (copy / "metadata.yaml").read_text()
    lies = (right.replace("message_count: 41", "message_count: 42"), "a: [", "- 1\n", "")
    for number, wrong in enumerate(lies):
        (copy / "metadata.yaml").write_text(wrong)
        to = tmp_path / f"new{number}"
        report = repair_bag(copy, to)
        assert report.problems[0].startswith("metadata.yaml ")
        assert (to / "metadata.yaml").read_text() == right
        assert (to / "bag_0.mcap").read_bytes() == (copy / "bag_0.mcap").read_bytes()


def foreign_metadata(file: str, counts: dict[str, int]) -> str:
    """Return a ``metadata.yaml`` as rosbag2 writes it for one file of texts."""
    entries = [
        {
            "topic_metadata": {
                "name": topic,
                "type": "std_msgs/msg/String",
                "serialization_format": "cdr",
                "offered_qos_profiles": [],
                "type_description_hash": "RIHS01_ab",
            },
            "message_count": count,
        }
        for topic, count in counts.items()
    ]
    described = {"relative_file_paths": [file], "message_count": sum(counts.values()), "files": []}
    return yaml.safe_dump({"rosbag2_bagfile_information": {**described, "topics_with_message_count": entries}})


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """Return the folder of a bag as rosbag2 writes it: a topic without messages is in the summary section only."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    with (folder / "foreign_0.mcap").open("wb") as stream:
        writer = Writer(stream, chunk_size=1000)
        writer.start(profile="ros2", library="libmcap 1.4.0")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        chatter = writer.register_channel("/chatter", "cdr", schema, {"topic_type_hash": "RIHS01_ab"})
        for number in range(100):
            writer.add_message(chatter, 10 * number, b"\0\1\0\0%04d" % number, 10 * number, number)
        writer.flush()  # what is defined from here on is in no chunk
        other = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
        writer.register_channel("/silent", "cdr", other, {"topic_type_hash": "RIHS01_cd"})
        writer.finish()
    (folder / "metadata.yaml").write_text(foreign_metadata("foreign_0.mcap", {"/chatter": 100, "/silent": 0}))
    return folder


def topics_in(folder: Path) -> dict[str, int]:
    """Return the topics that ``metadata.yaml`` lists, with their numbers of messages."""
    text = (folder / "metadata.yaml").read_text()
    listed = yaml.safe_load(text)["rosbag2_bagfile_information"]["topics_with_message_count"]
    return {entry["topic_metadata"]["name"]: entry["message_count"] for entry in listed}


def test_a_whole_bag_of_rosbag2_with_a_topic_without_messages_is_left_alone(foreign: Path, tmp_path: Path) -> None:
    before = {path.name: path.read_bytes() for path in foreign.iterdir()}
    for in_place in (False, True):
        report = repair_bag(foreign, in_place=in_place)
        assert (report.output, report.problems, report.files[0].problems) == (None, (), ())
    assert [path.name for path in tmp_path.iterdir()] == ["foreign"]
    assert {path.name: path.read_bytes() for path in foreign.iterdir()} == before
    assert [(topic.name, topic.messages) for topic in report.topics] == [("/chatter", 100), ("/silent", 0)]
    repair_bag(foreign, tmp_path / "copy")
    assert topics_in(tmp_path / "copy") == {"/chatter": 100, "/silent": 0}


@pytest.mark.parametrize("listed", [{"/chatter": 100}, {"/chatter": 100, "/silent": 0, "/nowhere": 0}])
def test_which_topics_without_messages_the_metadata_lists_is_no_damage(listed: dict[str, int], foreign: Path) -> None:
    """A writer may leave such topics out of the file, or of the list: nothing of the recording differs."""
    (foreign / "metadata.yaml").write_text(foreign_metadata("foreign_0.mcap", listed))
    assert repair_bag(foreign).output is None


def test_a_repaired_bag_keeps_its_topics_without_messages(foreign: Path, tmp_path: Path) -> None:
    file = foreign / "foreign_0.mcap"
    chunk = open_bag(foreign).index.chunks[0]
    overwrite(file, chunk.chunk_start_offset + chunk.chunk_length - 5, b"\xff\xff\xff")
    report = repair_bag(foreign, tmp_path / "new")
    assert 0 < report.messages < 100
    assert topics_in(tmp_path / "new") == {"/chatter": report.messages, "/silent": 0}
    reader = open_bag(tmp_path / "new")
    reader.check()
    (silent,) = (channel for channel in reader.channels if channel.name == "/silent")
    assert (silent.ros_type, silent.type_hash) == ("std_msgs/msg/Empty", "RIHS01_cd")
    lost = {topic.name: topic.lost for topic in report.topics}
    assert lost == {"/chatter": 100 - report.messages, "/silent": 0}
    assert repair_bag(tmp_path / "new").output is None


def test_topics_without_messages_outlive_the_summary_section_in_the_metadata(foreign: Path, tmp_path: Path) -> None:
    """Of a file that has lost its end, ``metadata.yaml`` alone names them, here with QoS in the form of version 5."""
    listed = foreign_metadata("foreign_0.mcap", {"/chatter": 100, "/silent": 0, "/lost": 3})
    document = yaml.safe_load(listed)
    entries = document["rosbag2_bagfile_information"]["topics_with_message_count"]
    entries[1]["topic_metadata"]["offered_qos_profiles"] = "- {history: 1, depth: 7, reliability: 2, durability: 1}"
    (foreign / "metadata.yaml").write_text(yaml.safe_dump(document))
    os.truncate(foreign / "foreign_0.mcap", records(foreign / "foreign_0.mcap")[-12][1])
    report = repair_bag(foreign, tmp_path / "new")
    assert report.output is not None
    assert topics_in(tmp_path / "new") == {"/chatter": report.messages, "/silent": 0}
    new = yaml.safe_load((tmp_path / "new" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    silent = new["topics_with_message_count"][1]["topic_metadata"]
    assert (silent["type"], silent["type_description_hash"]) == ("std_msgs/msg/String", "RIHS01_ab")
    assert silent["offered_qos_profiles"][0]["depth"] == 7
    assert repair_bag(tmp_path / "new").output is None


def test_messages_outside_of_chunks_of_another_writer_get_indexes(tmp_path: Path) -> None:
    stream = BytesIO()
    writer = Writer(stream, use_chunking=False)
    writer.start(profile="ros2", library="somebody else")
    qos = yaml.safe_dump(
        [{"history": 1, "depth": 5, "reliability": 2, "durability": 1, "deadline": {"sec": 1, "nsec": 2}}]
    )
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channel = writer.register_channel("/chatter", "cdr", schema, {"offered_qos_profiles": qos})
    for number in range(50):
        writer.add_message(channel, 1000 - number, b"\0\1\0\0%04d" % number, 7)
    writer.add_attachment(1, 2, "note.txt", "text/plain", b"keep me")
    writer.finish()
    (tmp_path / "x.mcap").write_bytes(stream.getvalue())
    report = repair_bag(tmp_path / "x.mcap")
    assert report.lost_bytes == 0
    assert report.attachments == ("note.txt",)
    with (tmp_path / "x_repaired" / "x.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [message.data[-4:] for _, _, message in reader.iter_messages()] == [
            b"%04d" % n for n in range(49, -1, -1)
        ]
    description = yaml.safe_load((tmp_path / "x_repaired" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    (profile,) = description["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"]
    assert (profile["reliability"], profile["durability"], profile["depth"]) == ("best_effort", "transient_local", 5)
    assert profile["deadline"] == {"sec": 1, "nsec": 2}
    assert profile["lifespan"] == {"sec": 9223372036, "nsec": 854775807}
    assert repair_bag(tmp_path / "x_repaired").output is None


def test_in_place_the_damaged_file_is_kept(copy: Path, tmp_path: Path, run: list[Message]) -> None:
    file = copy / "bag_0.mcap"
    os.truncate(file, 20_000)
    before = file.read_bytes()
    report = repair_bag(copy, in_place=True)
    assert report.output == str(copy)
    assert {path.name for path in copy.iterdir()} == {
        *("bag_0.mcap", "bag_0.mcap.damaged", "metadata.yaml", "metadata.yaml.damaged")
    }
    assert (copy / "bag_0.mcap.damaged").read_bytes() == before
    assert read_everywhere(copy) == payloads(run[: report.messages])
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    os.truncate(file, 15_000)
    again = file.read_bytes()
    with pytest.raises(BagFolderError, match=r"bag_0\.mcap\.damaged is there from an earlier repair"):
        repair_bag(copy, in_place=True)
    assert file.read_bytes() == again


def test_what_is_no_bag_and_what_is_in_the_way_is_refused(copy: Path, tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"something else, long enough for a header")
    with pytest.raises(NotABagError, match="does not begin as an MCAP file"):
        repair_bag(tmp_path / "x.mcap")
    os.truncate(copy / "bag_0.mcap", 20_000)
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "file").touch()
    with pytest.raises(BagFolderError, match="there exists: name a new folder with -o"):
        repair_bag(copy, tmp_path / "there")
    with pytest.raises(BagFolderError, match="leave out --in-place or -o"):
        repair_bag(copy, tmp_path / "new", in_place=True)
    repair_bag(copy)
    with pytest.raises(BagFolderError, match="bag_repaired exists"):
        repair_bag(copy)


@pytest.mark.parametrize("size", [0, 7, 8])
def test_a_file_in_which_there_is_nothing_cannot_be_repaired(size: int, copy: Path, tmp_path: Path) -> None:
    os.truncate(copy / "bag_0.mcap", size)
    with pytest.raises(DamagedBagError, match=f"nothing can be saved: .* has only {size} bytes"):
        repair_bag(copy)
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


def test_a_file_of_which_nothing_is_right_cannot_be_repaired(copy: Path) -> None:
    file = copy / "bag_0.mcap"
    for opcode, begin, _ in records(file):
        if opcode == Opcode.CHUNK:
            overwrite(file, begin + 60, b"\0\0\0\0\0\0\0\0")
    with pytest.raises(DamagedBagError, match=r"no message can be saved: at byte .* chunk: "):
        repair_bag(copy)


def test_a_recording_that_was_killed_before_its_first_chunk_cannot_be_repaired(copy: Path, tmp_path: Path) -> None:
    """There is a scenario, but no message: no bag of a run can be made of that."""
    file = copy / "bag_0.mcap"
    os.truncate(file, next(begin for opcode, begin, _ in records(file) if opcode == Opcode.CHUNK))
    with pytest.raises(DamagedBagError, match=r"no message can be saved: it ends before it says what it holds"):
        repair_bag(copy)
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


def test_of_less_than_a_step_no_step_is_said_to_be_complete(
    tmp_path: Path, run: list[Message], write_bag: WriteBag, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag", run[:2])
    (bag / "metadata.yaml").unlink()
    assert main(["repair", str(bag)]) == 0
    shown = capfd.readouterr().out
    assert "no step is complete, of 0 to 40" in shown
    assert "-1" not in shown.replace(str(tmp_path), "")


def test_a_disk_that_is_full_leaves_nothing_behind(copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.truncate(copy / "bag_0.mcap", 20_000)
    before = (copy / "bag_0.mcap").read_bytes()

    def full(self: RecordFile) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for output, in_place in ((tmp_path / "a" / "b", False), (None, True)):
        with monkeypatch.context() as patch:
            patch.setattr(RecordFile, "commit", full)
            with pytest.raises(BagWriteError, match="No space left on device; free space"):
                repair_bag(copy, output, in_place=in_place)
        assert [path.name for path in tmp_path.iterdir()] == ["bag"]
        assert (copy / "bag_0.mcap").read_bytes() == before
    assert repair_bag(copy).messages > 0


@pytest.fixture
def split(tmp_path: Path, run: list[Message]) -> Path:
    """Return the folder of a split bag of five files that may be damaged."""
    with BagWriter(
        tmp_path / "split",
        topics=(*MAIN_TOPICS, EVENTS),
        attachments={},
        chunk_bytes=2000,
        split=Split(nanoseconds=10 * PERIOD),
    ) as writer:
        for message in run:
            writer.write(TOPIC_OF[type(message)], message.stamp, encode(message))
    return tmp_path / "split"


@pytest.mark.parametrize("left", [0, 100, 4000])
def test_a_split_bag_whose_writer_was_killed(left: int, split: Path, tmp_path: Path, run: list[Message]) -> None:
    """Killed while it was writing the fourth file: those before are whole and stay as they are."""
    (split / "metadata.yaml").unlink()
    (split / "bag_4.mcap").unlink()
    os.truncate(split / "bag_3.mcap", left)
    report, found = repaired(split, tmp_path / "new")
    assert found == payloads(run[: len(found)])
    assert len(found) >= 211
    for name in ("bag_0.mcap", "bag_1.mcap"):
        assert (tmp_path / "new" / name).read_bytes() == (split / name).read_bytes()
    assert "cut off" in (open_bag(tmp_path / "new").aborted() or "")
    assert (tmp_path / "new" / "bag_3.mcap").exists() == (left > 0)
    assert bool(report.files[3].problems)
    description = yaml.safe_load((tmp_path / "new" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert description["relative_file_paths"] == sorted(path.name for path in (tmp_path / "new").glob("*.mcap"))


def test_a_file_of_a_split_bag_that_is_missing_closes_the_row(split: Path, tmp_path: Path, run: list[Message]) -> None:
    (split / "bag_1.mcap").unlink()
    with pytest.raises(BagFolderError, match=r"cannot be repaired in place: bag_1\.mcap is missing"):
        repair_bag(split, in_place=True)
    report, found = repaired(split, tmp_path / "new")
    assert report.problems == ("bag_1.mcap is missing",)
    assert found == [encode(message) for message in run if not 10 <= message.step < 20]
    assert len(list((tmp_path / "new").glob("*.mcap"))) == 4


def test_an_empty_file_within_a_split_bag_cannot_be_left_out_in_place(split: Path, tmp_path: Path) -> None:
    os.truncate(split / "bag_1.mcap", 0)
    with pytest.raises(BagFolderError, match=r"cannot be repaired in place: bag_1\.mcap has only 0 bytes"):
        repair_bag(split, in_place=True)
    repaired(split, tmp_path / "new")


def test_what_is_no_file_is_not_waited_for(split: Path, tmp_path: Path, run: list[Message]) -> None:
    (split / "metadata.yaml").unlink()
    os.mkfifo(split / "metadata.yaml")
    report, found = repaired(split, tmp_path / "new")
    assert (report.problems, found) == (("metadata.yaml cannot be read",), payloads(run))
    (split / "bag_2.mcap").unlink()
    os.mkfifo(split / "bag_2.mcap")
    with pytest.raises(NotABagError, match=r"bag_2\.mcap is no file: move it away"):
        repair_bag(split)


def test_a_link_that_leads_nowhere_is_kept_too(copy: Path) -> None:
    (copy / "metadata.yaml").unlink()
    (copy / "metadata.yaml").symlink_to("metadata.yaml")
    assert repair_bag(copy, in_place=True).output == str(copy)
    assert (copy / "metadata.yaml.damaged").readlink() == Path("metadata.yaml")
    assert (copy / "metadata.yaml").is_file() and not (copy / "metadata.yaml").is_symlink()


def test_a_folder_in_the_place_of_the_metadata_is_not_half_replaced(copy: Path) -> None:
    os.truncate(copy / "bag_0.mcap", 20_000)
    (copy / "metadata.yaml").unlink()
    (copy / "metadata.yaml").mkdir()
    with pytest.raises(BagFolderError, match=r"metadata\.yaml is a folder: move it away"):
        repair_bag(copy, in_place=True)
    assert {path.name for path in copy.iterdir()} == {"bag_0.mcap", "metadata.yaml"}
    assert (copy / "bag_0.mcap").stat().st_size == 20_000


@pytest.mark.parametrize("in_summary", [True, False])
def test_a_schema_that_was_lost_before_its_channel(tmp_path: Path, in_summary: bool) -> None:  # noqa: FBT001
    """It comes from the summary, else its topic has none: the mcap library reads no channel whose schema is nowhere."""
    definition = Schema(id=3, name="std_msgs/msg/String", encoding="ros2msg", data=b"string data")
    channel = Channel(id=4, schema_id=3, topic="/chatter", message_encoding="cdr", metadata={})
    messages = [McapMessage(4, 10 * number, b"\0\1\0\0%04d" % number, 7, number) for number in range(5)]
    lost, kept = (packed(b"".join(map(encoded, found))) for found in ([definition], [channel, *messages]))
    data = sealed(MAGIC + encoded(Header("ros2", "somebody else")) + lost + kept)
    place = data.index(lost) + len(lost) - 5
    data = data[:place] + b"\xff\xff" + data[place + 2 :]
    (tmp_path / "x.mcap").write_bytes(data if in_summary else data[: data.index(kept) + len(kept)])
    report = repair_bag(tmp_path / "x.mcap")
    with (tmp_path / "x_repaired" / "x.mcap").open("rb") as stream:
        found = [(schema, message.data) for schema, _, message in make_reader(stream).iter_messages()]
    assert found == [(definition if in_summary else None, message.data) for message in messages]
    lacks = "1 topics whose definition is nowhere in the file"
    assert (lacks in report.files[0].problems) == (not in_summary)
    assert repair_bag(tmp_path / "x_repaired").output is None


def test_a_schema_that_is_in_the_summary_neither(tmp_path: Path) -> None:
    channel = Channel(id=4, schema_id=3, topic="/chatter", message_encoding="cdr", metadata={})
    messages = [McapMessage(4, 10 * number, b"\0\1\0\0", 7, number) for number in range(5)]
    data = b"".join(map(encoded, [channel, *messages]))
    (tmp_path / "x.mcap").write_bytes(sealed(MAGIC + encoded(Header("ros2", "somebody else")) + packed(data)))
    assert "1 topics whose definition is nowhere in the file" in repair_bag(tmp_path / "x.mcap").files[0].problems
    with (tmp_path / "x_repaired" / "x.mcap").open("rb") as stream:
        assert len(list(make_reader(stream).iter_messages())) == 5
    assert repair_bag(tmp_path / "x_repaired").output is None


def test_records_that_were_kept_are_the_same_bytes(copy: Path, tmp_path: Path) -> None:
    os.truncate(copy / "bag_0.mcap", 20_000)
    index = open_bag(copy, damaged=True).index
    repair_bag(copy, tmp_path / "new")
    new = (tmp_path / "new" / "bag_0.mcap").read_bytes()
    old = (copy / "bag_0.mcap").read_bytes()
    for chunk in index.chunks:
        assert old[chunk.chunk_start_offset : chunk.chunk_start_offset + chunk.chunk_length] in new
    with (tmp_path / "new" / "bag_0.mcap").open("rb") as stream:
        assert len(list(StreamReader(stream, validate_crcs=True).records)) > len(index.chunks)

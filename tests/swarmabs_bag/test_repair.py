"""A damaged bag is made whole: what was saved is what was written, bit for bit, and what was lost is named."""

import errno
import os
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Schema
from mcap.writer import CompressionType
from rosbags.rosbag2 import Reader
from tests.swarmabs_bag.answers import read_everywhere
from tests.swarmabs_bag.conftest import WriteBag
from tests.swarmabs_bag.mcap_files import (
    HEADER,
    MAGIC,
    Recorded,
    channel,
    chunk,
    joined,
    message,
    record,
    schema,
    sealed,
    split as in_records,
)
from tests.swarmabs_bag.sample_run import PERIOD, payloads

from swarmabs_bag.errors import BagFolderError, BagWriteError, DamagedBagError, NotABagError
from swarmabs_bag.info import bag_info
from swarmabs_bag.mcap.output import RecordFile
from swarmabs_bag.mcap.records import HEAD_SIZE, Record
from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair import RepairReport, repair_bag
from swarmabs_cli import main
from swarmabs_core.cdr import encode
from swarmabs_core.messages import Message


def repaired(path: Path, to: Path) -> tuple[RepairReport, list[bytes]]:
    report = repair_bag(path, to)
    found = read_everywhere(to)
    assert report.messages == len(found)
    assert repair_bag(to).output is None
    return report, found


def files_in(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def records(file: Path, *opcodes: Opcode) -> list[Record]:
    """Return the records of some kinds."""
    return [found for found in in_records(file.read_bytes()) if found.opcode in opcodes]


def overwrite(file: Path, position: int, data: bytes) -> None:
    with file.open("r+b") as stream:
        stream.seek(position)
        stream.write(data)


def metadata_of(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((folder / "metadata.yaml").read_text())
    return found["rosbag2_bagfile_information"]


def topics_in(folder: Path) -> dict[str, int]:
    """Return the topics that ``metadata.yaml`` lists, with their numbers of messages."""
    listed = metadata_of(folder)["topics_with_message_count"]
    return {entry["topic_metadata"]["name"]: entry["message_count"] for entry in listed}


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """Return the folder of a bag as rosbag2 writes it.

    A topic without messages is in the summary section only, and one has two publishers with channels of their own.
    """
    folder = tmp_path / "foreign"
    folder.mkdir()
    with Recorded(folder / "foreign_0.mcap", chunk_size=1000) as bag:
        offered = ("[]", "[{depth: 3}]")
        chatter = [bag.channel("/chatter", topic_type_hash="RIHS01_ab", offered_qos_profiles=qos) for qos in offered]
        for number in range(100):
            bag.message(chatter[number % 3 // 2], b"\0\1\0\0%04d" % number, 10 * number)
        bag.writer.flush()  # what is defined from here on is in no chunk
        bag.channel("/silent", "std_msgs/msg/Empty", topic_type_hash="RIHS01_cd")
    describe(folder, {"/chatter": 100, "/silent": 0})
    return folder


def describe(folder: Path, counts: dict[str, int]) -> None:
    """Write ``metadata.yaml`` as rosbag2 does, with QoS in the form of version 5, for one file of texts."""
    described = {"type": "std_msgs/msg/String", "serialization_format": "cdr", "type_description_hash": "RIHS01_ab"}
    described["offered_qos_profiles"] = "- {history: 1, depth: 7, reliability: 2, durability: 1}"
    entries = [{"topic_metadata": {"name": name, **described}, "message_count": n} for name, n in counts.items()]
    document = {"relative_file_paths": ["foreign_0.mcap"], "message_count": sum(counts.values())}
    document["topics_with_message_count"] = entries
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": document}))


# What is whole


def test_a_whole_bag_is_left_alone_or_copied(copy: Path, foreign: Path, tmp_path: Path) -> None:
    for number, folder in enumerate((copy, foreign)):
        before = files_in(folder)
        for in_place in (False, True):
            report = repair_bag(folder, in_place=in_place)
            assert (report.output, report.problems, report.files[0].problems) == (None, (), ())
        assert {path.name for path in tmp_path.iterdir()} == {"bag", "foreign", *("new",)[:number]}
        repair_bag(folder, tmp_path / "new" / str(number))
        assert files_in(folder) == before
        if folder == copy:
            assert files_in(tmp_path / "new" / "0") == before
    assert [(topic.name, topic.messages) for topic in report.topics] == [("/chatter", 100), ("/silent", 0)]
    assert topics_in(tmp_path / "new" / "1") == {"/chatter": 100, "/silent": 0}
    # A writer may leave topics without messages out of the file, or of the list: nothing of the recording differs.
    for listed in ({"/chatter": 100}, {"/chatter": 100, "/silent": 0, "/nowhere": 0}):
        describe(foreign, listed)
        assert repair_bag(foreign).output is None


def test_metadata_alone_is_made_anew(copy: Path, tmp_path: Path, run: list[Message]) -> None:
    right = (copy / "metadata.yaml").read_text()
    lies = (
        right.replace("message_count: 41", "message_count: 42"),
        right.replace(f"  message_count: {len(run)}", "  message_count: 1"),
        right.replace("  - bag_0.mcap", "  - bag_1.mcap"),
        right.replace("topics_with_message_count:", "topics_with_message_count: 1\n  other:"),
        *("a: [", "- 1\n", ""),
    )
    for number, wrong in enumerate(lies):
        assert wrong != right
        (copy / "metadata.yaml").write_text(wrong)
        to = tmp_path / f"new{number}"
        assert repair_bag(copy, to).problems[0].startswith("metadata.yaml ")
        assert (to / "metadata.yaml").read_text() == right
        assert (to / "bag_0.mcap").read_bytes() == (copy / "bag_0.mcap").read_bytes()


# Damaged chunks, indexes and definitions


@pytest.mark.parametrize("compression", list(CompressionType))
def test_of_a_cut_chunk_the_whole_messages_are_saved(compression: CompressionType, tmp_path: Path) -> None:
    """One chunk of 2 MB that compresses badly, in a file of another writer, cut in the middle."""
    draw = random.Random(2)
    sent = [draw.randbytes(1000) for _ in range(2000)]
    with Recorded(tmp_path / "x.mcap", chunk_size=2**30, compression=compression) as bag:
        bag.writer.add_attachment(0, 0, "map", "", bytes(1_500_000))
        number = bag.channel("/chatter")
        for place, data in enumerate(sent):
            bag.message(number, data, place * 10 + 5)
    os.truncate(tmp_path / "x.mcap", 2_500_000)
    report = repair_bag(tmp_path / "x.mcap")
    assert (report.output, report.last_complete_step) == (str(tmp_path / "x_repaired"), None)
    reader = open_bag(tmp_path / "x_repaired")
    reader.check()
    found = [one.payload for _, one in reader.stored_messages()]
    assert found == sent[: len(found)]
    assert len(found) > 700
    (lost,) = report.files[0].lost
    assert (lost.start, lost.end, lost.offset + lost.bytes) == (5e-9, 19995e-9, 2_500_000)
    with Reader(tmp_path / "x_repaired") as other:
        assert other.message_count == len(found)


def test_what_a_cut_chunk_holds_is_saved_up_to_what_it_cannot_hold(tmp_path: Path) -> None:
    known = schema(1, b"std_msgs/msg/String") + channel(1, 1, b"/chatter")
    for times, saved in (((5, 100, 70, 80), 4), ((7, 8, 101, 9), 2), ((7, 8, 9, 4), 3)):
        messages = b"".join(message(time=time) for time in times)
        data = MAGIC + HEADER + chunk(known + messages + message(), "", times=(5, 100))
        (tmp_path / "x.mcap").write_bytes(data[:-1])
        assert repair_bag(tmp_path / "x.mcap", tmp_path / str(saved)).messages == saved
    for wrong in (schema(2, b"x", reaching=1), record(0x7F, b"")):
        data = MAGIC + HEADER + chunk(known + message() + wrong + message() * 2, "", times=(0, 100))
        (tmp_path / "x.mcap").write_bytes(data[:-1])
        assert repair_bag(tmp_path / "x.mcap", tmp_path / wrong.hex()[:4]).messages == 1, "those before it"


@pytest.mark.parametrize("cut", [False, True])
def test_a_chunk_that_is_damaged_is_named_with_its_times(copy: Path, tmp_path: Path, *, cut: bool) -> None:
    """If the summary is missing too, the losses follow from the sequence numbers."""
    file = copy / "bag_0.mcap"
    index = open_bag(copy).index.chunks[2]
    with file.open("rb") as stream:
        kept = [m.data for _, _, m in make_reader(stream).iter_messages(ending_before=index.message_start_time)]
    overwrite(file, index.chunk_start_offset + index.chunk_length - 5, b"\xff\xff\xff")
    os.truncate(file, file.stat().st_size - (20 if cut else 0))
    report, found = repaired(copy, tmp_path / "new")
    (lost,) = report.files[0].lost
    assert (lost.offset, lost.bytes) == (index.chunk_start_offset, index.chunk_length)
    assert (lost.start, lost.end) == (index.message_start_time / 1e9, index.message_end_time / 1e9)
    assert found[: len(kept)] == kept != []
    (plane,) = (topic for topic in report.topics if topic.name == "/plane/state")
    assert plane.messages + plane.lost == 41
    assert plane.lost > 0
    assert report.last_complete_step == index.message_start_time // PERIOD - 1 or plane.lost == 0
    assert "1 place could not be recovered" in (bag_info(tmp_path / "new").repaired or "")


def without_indexes(file: Path) -> None:
    """Leave of a bag what it lacks nothing without: no message indexes, summary or metadata.yaml."""
    kept = [found for found in in_records(file.read_bytes()) if found.opcode != Opcode.MESSAGE_INDEX]
    file.write_bytes(joined(kept) + record(Opcode.DATA_END, bytes(4)) + record(Opcode.FOOTER, bytes(20)) + MAGIC)
    (file.parent / "metadata.yaml").unlink()


def heads_of_messages(file: Path) -> None:
    for index in records(file, Opcode.MESSAGE_INDEX)[:12]:
        overwrite(file, index.offset, bytes([Opcode.MESSAGE]))


def wrong_length(place: int) -> Callable[[Path], None]:
    return lambda file: overwrite(file, records(file, Opcode.ATTACHMENT)[place].offset + 1, b"\xff" * 8)


def end_of_scenario(file: Path) -> None:
    """Leave zeros where a power cut has lost the last page of the scenario, and with it its CRC."""
    scenario = records(file, Opcode.ATTACHMENT)[0]
    overwrite(file, scenario.end - 200, bytes(200))


@pytest.mark.parametrize(
    ("damage", "problem", "lost"),
    [
        (without_indexes, "^{chunks} chunks with wrong or missing message indexes or times$", ()),
        (heads_of_messages, "outside of the chunks, where no CRC confirms it", ()),
        (lambda file: overwrite(file, 0, b"\0\0"), "^at byte 0: the file does not begin as an MCAP file$", ()),
        (lambda file: overwrite(file, 0, bytes(8)), "^at byte 0: the file does not begin as an MCAP file$", ()),
        (end_of_scenario, "attachment: zeros instead of its CRC", ("scenario.yaml",)),
        (wrong_length(0), "", ("scenario.yaml",)),
        (wrong_length(-1), "", ("run.log",)),
    ],
)
def test_what_is_damaged_besides_messages_costs_none(
    damage: Callable[[Path], None], problem: str, lost: tuple[str, ...], copy: Path, tmp_path: Path, run: list[Message]
) -> None:
    chunks = len(records(copy / "bag_0.mcap", Opcode.CHUNK))
    damage(copy / "bag_0.mcap")
    report, found = repaired(copy, tmp_path / "new")
    assert found == payloads(run)
    assert report.lost_attachments == lost
    assert re.search(problem.format(chunks=chunks), report.files[0].problems[0])
    assert open_bag(tmp_path / "new").aborted() is None
    if damage is without_indexes:
        assert (report.lost_bytes, report.last_complete_step, len(report.files[0].problems)) == (0, 40, 1)
        assert bag_info(tmp_path / "new").repaired is None
    if lost:
        assert len(report.files[0].lost) == 1


def test_topics_that_stood_in_a_lost_chunk_come_from_the_summary(copy: Path, tmp_path: Path) -> None:
    first = open_bag(copy).index.chunks[0]
    overwrite(copy / "bag_0.mcap", first.chunk_start_offset + 60, b"\0\0\0\0\0\0")
    before = open_bag(copy)
    report, found = repaired(copy, tmp_path / "new")
    assert len(found) > 100
    assert [(c.name, c.ros_type, c.qos_profiles) for c in open_bag(tmp_path / "new").channels] == [
        (c.name, c.ros_type, c.qos_profiles) for c in before.channels
    ]
    assert (report.first_step or 0) > 0


def test_topics_that_nothing_describes_are_lost_and_named_once_for_a_chunk(tmp_path: Path) -> None:
    known = schema(1, b"std_msgs/msg/String") + channel(1, 1, b"/chatter") + message(1)
    data = MAGIC + HEADER + chunk(known) + chunk(message(7) * 3 + message(1) + message(8)) + chunk(message(7))
    (tmp_path / "x.mcap").write_bytes(data)
    report = repair_bag(tmp_path / "x.mcap")
    assert report.messages == 2
    offset, later = (found.offset for found in in_records(data + record(Opcode.DATA_END, bytes(4)))[2:])
    lost = [(one.offset, one.bytes, one.problem) for one in report.files[0].lost]
    assert lost == [
        (place, 0, f"messages of channel {number}, which the file does not describe")
        for place, number in ((offset, 7), (offset, 8), (later, 7))
    ]


@pytest.mark.parametrize(("there", "in_summary"), [(True, True), (True, False), (False, False)])
def test_a_schema_that_was_lost_before_its_channel(tmp_path: Path, *, there: bool, in_summary: bool) -> None:
    """It comes from the summary, else its topic has none: the mcap library reads no channel whose schema is nowhere."""
    messages = b"".join(message(4, b"\0\1\0\0%04d" % number, 10 * number) for number in range(5))
    lost, kept = chunk(schema(3, b"std_msgs/msg/String")), chunk(channel(4, 3, b"/chatter") + messages)
    data = sealed(MAGIC + HEADER + (lost if there else b"") + kept)
    if there:
        place = data.index(lost) + len(lost) - 5
        data = data[:place] + b"\xff\xff" + data[place + 2 :]
    (tmp_path / "x.mcap").write_bytes(data if in_summary or not there else data[: data.index(kept) + len(kept)])
    report = repair_bag(tmp_path / "x.mcap")
    with (tmp_path / "x_repaired" / "x.mcap").open("rb") as stream:
        found = [(definition, one.data) for definition, _, one in make_reader(stream).iter_messages()]
    definition = Schema(3, b"8" * 8, "ros2msg", "std_msgs/msg/String") if in_summary else None
    assert found == [(definition, b"\0\1\0\0%04d" % number) for number in range(5)]
    lacks = "1 topics without a definition in the file"
    assert (lacks in report.files[0].problems) == (not in_summary)
    assert repair_bag(tmp_path / "x_repaired").output is None


# Files of other writers


def test_topics_without_messages_are_kept_and_outlive_the_summary_section(foreign: Path, tmp_path: Path) -> None:
    """Of a file that has lost its end, ``metadata.yaml`` alone names them."""
    file = foreign / "foreign_0.mcap"
    last = records(file, Opcode.CHUNK)[-1]
    overwrite(file, last.end - 5, b"\xff\xff\xff")
    report = repair_bag(foreign, tmp_path / "new")
    assert 0 < report.messages < 100
    assert topics_in(tmp_path / "new") == {"/chatter": report.messages, "/silent": 0}
    reader = open_bag(tmp_path / "new")
    reader.check()
    (silent,) = (one for one in reader.channels if one.name == "/silent")
    assert (silent.ros_type, silent.type_hash) == ("std_msgs/msg/Empty", "RIHS01_cd")
    assert {topic.name: topic.lost for topic in report.topics} == {"/chatter": 100 - report.messages, "/silent": 0}
    describe(foreign, {"/chatter": 100, "/silent": 0, "/lost": 3})
    os.truncate(file, last.offset)
    report = repair_bag(foreign, tmp_path / "cut")
    assert topics_in(tmp_path / "cut") == {"/chatter": report.messages, "/silent": 0}
    described = metadata_of(tmp_path / "cut")["topics_with_message_count"][1]["topic_metadata"]
    assert (described["type"], described["type_description_hash"]) == ("std_msgs/msg/String", "RIHS01_ab")
    assert described["offered_qos_profiles"][0]["depth"] == 7
    for folder in ("new", "cut"):
        assert repair_bag(tmp_path / folder).output is None


def test_messages_of_another_writer_get_indexes_and_chunks_their_times(tmp_path: Path) -> None:
    """The topic of those outside of chunks may come from the summary."""
    path, made = tmp_path / "x.mcap", tmp_path / "x_repaired"
    qos = "[{history: 1, depth: 5, reliability: 2, durability: 1, deadline: {sec: 1, nsec: 2}}]"
    with Recorded(path, use_chunking=False) as bag:
        number = bag.channel("/chatter", offered_qos_profiles=qos)
        for place in range(50):
            bag.message(number, b"\0\1\0\0%04d" % place, 1000 - place)
        bag.writer.add_attachment(1, 2, "note.txt", "text/plain", b"keep me")
    report = repair_bag(path)
    assert (report.lost_bytes, report.attachments) == (0, ("note.txt",))
    assert report.files[0].problems == ("50 messages outside of chunks",)
    with (made / "x.mcap").open("rb") as file:
        found = [one.data[-4:] for _, _, one in make_reader(file, validate_crcs=True).iter_messages()]
    assert found == [b"%04d" % place for place in range(49, -1, -1)]
    (profile,) = metadata_of(made)["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"]
    assert (profile["reliability"], profile["durability"], profile["depth"]) == ("best_effort", "transient_local", 5)
    assert repair_bag(made).output is None
    overwrite(path, records(path, Opcode.CHANNEL)[0].offset, b"\x7f")
    report = repair_bag(path, tmp_path / "again")
    assert [(topic.name, topic.messages) for topic in report.topics] == [("/chatter", 50)]
    assert [one.problem for one in report.files[0].lost] == [
        "record of unknown kind: a record of kind 0x7f, which is not allowed here"
    ]
    with Recorded(path) as bag:
        number = bag.channel("/chatter")
        for time in (9, 5):
            bag.message(number, b"data", time)
    overwrite(path, records(path, Opcode.CHUNK)[0].offset + HEAD_SIZE, b"\x04")
    assert repair_bag(path, tmp_path / "times").files[0].problems == (
        "1 chunks with wrong or missing message indexes or times",
    )
    (index,) = open_bag(tmp_path / "times").index.chunks
    assert (index.message_start_time, index.message_end_time) == (5, 9)


# In place, refusals, and what is left on the disk


def test_in_place_the_damaged_file_is_kept(copy: Path, tmp_path: Path, run: list[Message]) -> None:
    file = copy / "bag_0.mcap"
    os.truncate(file, 20_000)
    before = files_in(copy)
    report = repair_bag(copy, in_place=True)
    assert report.output == str(copy)
    after = files_in(copy)
    assert after.keys() == {*before, "bag_0.mcap.damaged", "metadata.yaml.damaged"}
    assert (after["bag_0.mcap.damaged"], after["metadata.yaml.damaged"]) == tuple(before.values())
    assert read_everywhere(copy) == payloads(run[: report.messages])
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    os.truncate(file, 15_000)
    again = files_in(copy)
    with pytest.raises(BagFolderError, match=r"bag_0\.mcap\.damaged exists from an earlier repair"):
        repair_bag(copy, in_place=True)
    assert files_in(copy) == again


@pytest.mark.parametrize(
    ("cut_at", "problem"),
    [
        (lambda _: 0, "nothing can be recovered: .* has only 0 bytes"),
        (lambda _: 8, "nothing can be recovered: .* has only 8 bytes"),
        (None, r"no message can be recovered: at byte .* chunk: "),
        # A scenario, but no message: no bag of a run can be made of that.
        (lambda chunks: chunks[0].offset, r"no message can be recovered: its end, with"),
    ],
)
def test_a_file_in_which_nothing_is_left_cannot_be_repaired(
    cut_at: Callable[[list[Record]], int] | None, problem: str, copy: Path, tmp_path: Path
) -> None:
    file = copy / "bag_0.mcap"
    chunks = records(file, Opcode.CHUNK)
    for found in chunks:
        overwrite(file, found.offset + 60, bytes(8))
    if cut_at is not None:
        os.truncate(file, cut_at(chunks))
    with pytest.raises(DamagedBagError, match=problem):
        repair_bag(copy)
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


def test_what_is_in_the_way_is_refused_or_kept(copy: Path, tmp_path: Path) -> None:
    metadata, file = copy / "metadata.yaml", copy / "bag_0.mcap"
    metadata.unlink()
    metadata.symlink_to("metadata.yaml")
    assert repair_bag(copy, in_place=True).output == str(copy)
    assert (copy / "metadata.yaml.damaged").readlink() == Path("metadata.yaml")
    assert metadata.is_file() and not metadata.is_symlink()
    (copy / "metadata.yaml.damaged").unlink()
    os.truncate(file, 20_000)
    (tmp_path / "there").mkdir()
    repair_bag(copy, tmp_path / "there")  # an empty folder is taken
    with pytest.raises(BagFolderError, match="there exists: name a new folder with -o"):
        repair_bag(copy, tmp_path / "there")
    with pytest.raises(BagFolderError, match="--in-place and -o exclude each other"):
        repair_bag(copy, tmp_path / "new", in_place=True)
    repair_bag(copy)
    with pytest.raises(BagFolderError, match="bag_repaired exists"):
        repair_bag(copy)
    metadata.unlink()
    metadata.mkdir()
    with pytest.raises(BagFolderError, match=r"metadata\.yaml is a folder: move it away"):
        repair_bag(copy, in_place=True)
    assert {path.name for path in copy.iterdir()} == {"bag_0.mcap", "metadata.yaml"}
    assert file.stat().st_size == 20_000


def test_of_less_than_a_step_no_step_is_said_to_be_complete(
    tmp_path: Path, run: list[Message], write_bag: WriteBag, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag", run[:2])
    (bag / "metadata.yaml").unlink()
    assert main(["repair", str(bag)]) == 0
    shown = capfd.readouterr().out
    assert "none of the steps 0 to 40 is complete" in shown
    assert "-1" not in shown.replace(str(tmp_path), "")


def test_a_disk_that_is_full_leaves_nothing_behind(copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.truncate(copy / "bag_0.mcap", 20_000)
    before = files_in(copy)

    def full(self: RecordFile) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for output, in_place in ((tmp_path / "a" / "b", False), (None, True)):
        with monkeypatch.context() as patch:
            patch.setattr(RecordFile, "commit", full)
            with pytest.raises(BagWriteError, match="No space left on device; free space"):
                repair_bag(copy, output, in_place=in_place)
        assert [path.name for path in tmp_path.iterdir()] == ["bag"]
        assert files_in(copy) == before
    assert repair_bag(copy).messages > 0


# Split bags


@pytest.mark.parametrize("left", [0, 100, 4000])
def test_a_split_bag_whose_writer_was_killed(left: int, split: Path, tmp_path: Path, run: list[Message]) -> None:
    """Killed while it was writing the fourth file: those before are whole and stay as they are."""
    (split / "metadata.yaml").unlink()
    (split / "bag_4.mcap").unlink()
    os.truncate(split / "bag_3.mcap", left)
    with pytest.raises(DamagedBagError, match=r"bag_3\.mcap"):
        open_bag(split)
    before = [payload for _, _, payload in open_bag(split, damaged=True).messages()]
    report, found = repaired(split, tmp_path / "new")
    assert found == payloads(run[: len(found)])
    assert before == found[: len(before)]
    assert len(found) >= len(before) >= 211
    for name in ("bag_0.mcap", "bag_1.mcap"):
        assert (tmp_path / "new" / name).read_bytes() == (split / name).read_bytes()
    assert "cut off" in (open_bag(tmp_path / "new").aborted() or "")
    assert (tmp_path / "new" / "bag_3.mcap").exists() == (left > 0)
    assert report.files[3].problems
    files = sorted(path.name for path in (tmp_path / "new").glob("*.mcap"))
    assert metadata_of(tmp_path / "new")["relative_file_paths"] == files


def test_lost_topics_of_a_file_come_from_another_file(split: Path, tmp_path: Path, run: list[Message]) -> None:
    os.truncate(split / "bag_0.mcap", 3)
    file = split / "bag_2.mcap"
    first, *_, last = records(file, Opcode.CHUNK)
    overwrite(file, first.offset + 60, bytes(8))
    os.truncate(file, last.end)
    report, found = repaired(split, tmp_path / "new")
    assert set(payloads(one for one in run if one.step == 29)) <= set(found)
    assert (report.lost_attachments, report.attachments[0]) == ((), "scenario.yaml")
    assert len(run) - 71 > len(found) > len(run) - 141


def test_a_file_of_a_split_bag_that_is_missing_closes_the_row(split: Path, tmp_path: Path, run: list[Message]) -> None:
    (split / "bag_1.mcap").unlink()
    with pytest.raises(BagFolderError, match=r"cannot be repaired in place: bag_1\.mcap is missing"):
        repair_bag(split, in_place=True)
    report, found = repaired(split, tmp_path / "new")
    assert report.problems == ("bag_1.mcap is missing",)
    assert found == [encode(one) for one in run if not 10 <= one.step < 20]
    assert len(list((tmp_path / "new").glob("*.mcap"))) == 4
    (split / "bag_1.mcap").touch()
    with pytest.raises(BagFolderError, match=r"cannot be repaired in place: bag_1\.mcap has only 0 bytes"):
        repair_bag(split, in_place=True)
    assert repaired(split, tmp_path / "again")[1] == found


def test_what_is_no_file_is_not_waited_for_and_wrong_headers(split: Path, tmp_path: Path, run: list[Message]) -> None:
    """It would be one on channel 4, the length of the profile's name, which another file of the bag describes."""
    (split / "metadata.yaml").unlink()
    os.mkfifo(split / "metadata.yaml")
    report, found = repaired(split, tmp_path / "new")
    assert (report.problems, found) == (("metadata.yaml cannot be read",), payloads(run))
    file = split / "bag_4.mcap"
    overwrite(file, len(MAGIC), bytes([Opcode.MESSAGE]))
    overwrite(file, file.stat().st_size - 60, b"\xff\xff")
    assert repaired(split, tmp_path / "again")[1] == payloads(run)
    (split / "bag_2.mcap").unlink()
    os.mkfifo(split / "bag_2.mcap")
    with pytest.raises(NotABagError, match=r"bag_2\.mcap is not a regular file: move it away"):
        repair_bag(split)

"""Reading bags that are whole, foreign, no bags at all, or cut off and changed anywhere."""

import io
import json
import os
import random
import shutil
from collections.abc import Callable
from dataclasses import asdict
from io import BytesIO
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType
from rich.console import Console
from rosbags.rosbag2 import Reader
from tests.processes import ROOT
from tests.swarmabs_bag.answers import kept, read_everywhere
from tests.swarmabs_bag.conftest import SCENARIO, STEPS_PER_FILE, WriteBag
from tests.swarmabs_bag.mcap_files import MAGIC, Recorded, rewritten, split
from tests.swarmabs_bag.sample_run import PERIOD, bag_writer, payloads

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.attached import scenario_of
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.info import ScenarioInfo, bag_info, render
from swarmabs_bag.mcap.index import scan_index, tail
from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair import repair_bag
from swarmabs_bag.run_folder import Split, find_bag
from swarmabs_cli import main
from swarmabs_core.cdr import encode
from swarmabs_core.messages import AGENT_STATE, EVENTS, MAIN_TOPICS, PLANE_STATE, TOPIC_OF, Message


def read_everything(path: Path) -> list[bytes]:
    """Use all of a reader; a damaged bag must make some of it raise."""
    reader = open_bag(path)
    found = [message.payload for _, message in reader.stored_messages()]
    for entry in reader.index.attachments:
        reader.attachment(entry.name)
    reader.rosbag2_metadata()
    reader.check()
    return found


@pytest.fixture
def file(bag: Path, tmp_path: Path) -> Path:
    """Return the MCAP file of a bag that may be changed."""
    return Path(shutil.copy(bag / "bag_0.mcap", tmp_path / "bag_0.mcap"))


# Other storages of rosbag2


@pytest.mark.parametrize(
    ("name", "storage"), [("x.mcap.zstd", "compressed file by file"), ("x.db3", "in SQLite"), ("x.mcap", "by message")]
)
def test_bags_in_other_forms_of_rosbag2_are_named_with_their_conversion(
    bag: Path, tmp_path: Path, name: str, storage: str
) -> None:
    file = tmp_path / name
    rewritten(bag, file, lambda _, data: zstandard.compress(data))
    for named in (file, tmp_path):
        with pytest.raises(NotABagError, match=f"{name} is .*{storage}.*; convert it with ros2 bag convert"):
            open_bag(named)


# What is whole


def test_messages_come_as_they_were_written(bag: Path, run: list[Message]) -> None:
    reader = open_bag(bag)
    written = [(TOPIC_OF[type(m)], m.stamp, encode(m)) for m in run]
    assert list(zip(reader.messages(), reader.messages(), strict=True)) == [(one, one) for one in written]
    assert [message for _, _, message in reader.decoded()] == run
    assert [m for _, _, m in reader.decoded([EVENTS])] == [m for m in run if TOPIC_OF[type(m)] is EVENTS]
    assert [record.payload for record in reader.records([EVENTS])] == [p for topic, _, p in written if topic is EVENTS]
    assert list(reader.published([EVENTS])) == [(t, time, time, p) for t, time, p in written if t is EVENTS]


def test_reader_tells_what_the_bag_holds(copy: Path, run: list[Message]) -> None:
    file = copy / "bag_0.mcap"
    assert find_bag(copy.parent) == find_bag(copy) == find_bag(file) == file
    reader = open_bag(str(copy))
    assert (reader.start, reader.end, reader.message_count) == (0, run[-1].stamp, len(run))
    assert (reader.namespace, reader.problem, reader.aborted()) == ("/", None, None)
    assert [entry.name for entry in reader.index.attachments] == ["scenario.yaml", "provenance.json", "run.log"]
    assert (reader.attachment("run.log"), reader.attachment("other")) == (b"all went well\n", None)
    assert reader.rosbag2_metadata()["ros_distro"] == "jazzy"
    assert {channel.name: channel.message_count for channel in reader.channels}["/swarm/agent_state"] == 123


# What is no bag


def files(*names: str) -> Callable[[Path], object]:
    return lambda folder: [(folder / name).touch() for name in names]


@pytest.mark.parametrize(
    ("problem", "make", "name"),
    [
        ("No such file or directory; name a run folder", files(), "missing"),
        ("null", files(), "a\0b"),
        ("contains no bag", files("notes.txt"), ""),
        ("contains no bag", lambda folder: (folder / "bag").symlink_to(folder), ""),
        ("contains 2 .mcap files: name one of them", files("a.mcap", "b.mcap"), ""),
        ("contains 2 .mcap files: name one of them", files("a_0.mcap", "b_1.mcap"), ""),
        ("does not begin as an MCAP file", lambda folder: (folder / "x").write_bytes(b"SQLite format 3\0"), "x"),
        ("does not begin as", lambda folder: (folder / "x").write_bytes(b"\x89MCAP1\r\n" + bytes(100)), "x"),
        ("neither a folder nor a file", lambda folder: os.mkfifo(folder / "x.mcap"), "x.mcap"),
        ("neither a folder nor a file", lambda folder: os.mkfifo(folder / "x.mcap"), ""),
        ("neither a folder nor a file", lambda folder: (folder / "x.mcap").symlink_to("/dev/zero"), ""),
        ("Too many levels of symbolic links", lambda folder: (folder / "x.mcap").symlink_to("x.mcap"), ""),
        ("Is a directory", lambda folder: (folder / "x.mcap").mkdir(), ""),
    ],
)
def test_what_is_no_bag_is_refused(problem: str, make: Callable[[Path], object], name: str, tmp_path: Path) -> None:
    make(tmp_path)
    for door in (open_bag, bag_info, load_arrays):
        with pytest.raises(NotABagError, match=problem) as caught:
            door(tmp_path / name)
        assert "\n" not in str(caught.value)
    with pytest.raises(NotABagError):
        repair_bag(tmp_path / name)


# What is damaged


def boundaries(data: bytes) -> list[int]:
    """Return where the records of the data section begin, and where it ends."""
    return list(accumulate((found.size for found in split(data)), initial=len(MAGIC)))


def damaged(path: Path, problem: str | None = None) -> None:
    with pytest.raises(DamagedBagError, match=problem) as caught:
        read_everything(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_wherever_a_file_is_cut_all_before_is_read_and_saved(file: Path, tmp_path: Path, run: list[Message]) -> None:
    data, written = file.read_bytes(), payloads(run)
    chunks = [found for found in split(data) if found.opcode == Opcode.CHUNK]
    last = len([one for one in run if one.step == 0 and TOPIC_OF[type(one)] is not EVENTS])
    draw, counts = random.Random(1), []
    anywhere = draw.sample(range(chunks[0].offset + 100, len(data)), 4)
    for size in sorted(
        {0, 3, 8, 20, *anywhere, *(chunk.end for chunk in chunks), *(chunk.end - 1 for chunk in chunks)}
    ):
        file.write_bytes(data[:size])
        damaged(file, f"has only {size} bytes: nothing was written to it" if size < len(MAGIC) else None)
        if size < chunks[0].end:
            continue
        reader = open_bag(file, damaged=True)
        found = [payload for _, _, payload in reader.messages()]
        assert found == written[: len(found)] != []
        assert (bag_info(file).complete, bag_info(file).message_count) == (False, len(found))
        arrays = load_arrays(file, damaged=True)
        assert np.count_nonzero(arrays.agents.status) == sum(
            TOPIC_OF[type(m)] is AGENT_STATE for m in run[: len(found)]
        )
        if size not in anywhere:
            continue
        report = repair_bag(file, tmp_path / str(size))
        repaired = open_bag(tmp_path / str(size))
        repaired.check()
        saved = [payload for _, _, payload in repaired.messages()]
        assert saved == written[: len(saved)]
        assert len(found) <= len(saved) == report.messages
        assert report.last_complete_step == (len(saved) - (len(saved) > 3 * last)) // last - 1
        assert report.attachments[:2] == ("scenario.yaml", "provenance.json")
        assert "cut off" in (repaired.aborted() or "") or size > chunks[-1].end
        counts.append(len(saved))
    assert counts == sorted(counts)
    assert len(set(counts)) > 3


def test_no_change_of_a_byte_goes_unnoticed_and_nothing_wrong_is_kept(bag: Path, file: Path, tmp_path: Path) -> None:
    data, written = bytearray(file.read_bytes()), kept(open_bag(bag))
    draw = random.Random(1)
    heads = [begin + draw.randrange(9) for begin in boundaries(bytes(data))]
    everywhere = draw.sample(range(8, len(data)), 25)
    for place in {*heads, *everywhere, *range(len(data) - 45, len(data))}:
        old = data[place]
        data[place] ^= 1 << draw.randrange(8)
        file.write_bytes(data)
        damaged(file)
        if place in everywhere[:6]:
            assert not bag_info(file).complete
            report = repair_bag(file, tmp_path / str(place))
            found = kept(open_bag(tmp_path / str(place)))
            assert found <= written
            assert report.messages + sum(topic.lost for topic in report.topics) == written.total()
            assert (report.lost_bytes > 0) == (bag_info(tmp_path / str(place)).repaired is not None)
            assert report.lost_bytes or found == written
        data[place] = old
    file.write_bytes(data)
    assert len(read_everything(file)) == written.total()


# What other writers put into a file


LEFT_OUT: dict[str, dict[str, Any]] = {
    "statistics": {"use_statistics": False},
    "schemas": {"repeat_schemas": False},
    "channels": {"repeat_channels": False},
    "chunk index": {"index_types": IndexType.ALL & ~IndexType.CHUNK},
    "attachment index": {"index_types": IndexType.ALL & ~IndexType.ATTACHMENT},
    "metadata index": {"index_types": IndexType.ALL & ~IndexType.METADATA},
    "summary offsets": {"use_summary_offsets": False},
}
LEFT_OUT["the whole summary"] = {name: value for options in LEFT_OUT.values() for name, value in options.items()} | {
    "index_types": IndexType.MESSAGE
}
OTHERWISE: dict[str, dict[str, Any]] = {
    "lz4": {"compression": CompressionType.LZ4},
    "not compressed": {"compression": CompressionType.NONE},
    "without chunks": {"use_chunking": False},
    "without CRCs": {"enable_crcs": False, "enable_data_crcs": False},
    "without message indexes": {"index_types": IndexType.NONE},
}


@pytest.mark.parametrize("name", [*LEFT_OUT, *OTHERWISE])
def test_a_file_as_the_format_lets_others_write_it_is_whole(name: str, tmp_path: Path, bag: Path) -> None:
    path = rewritten(bag, tmp_path / "x.mcap", **(LEFT_OUT | OTHERWISE)[name])
    reader, own = open_bag(path), open_bag(bag)
    assert reader.problem is None
    assert read_everything(path) == read_everything(bag)
    assert {channel.name: channel.message_count for channel in reader.channels} == {
        channel.name: channel.message_count for channel in own.channels if channel.message_count
    }
    assert (reader.start, reader.end, reader.message_count) == (own.start, own.end, own.message_count)
    for entry in own.index.attachments:
        assert reader.attachment(entry.name) == own.attachment(entry.name)
    assert reader.rosbag2_metadata() == own.rosbag2_metadata() != {}
    info = bag_info(path)
    assert (info.complete, info.problem) == (True, None)
    assert info.chunks == len(reader.index.chunks)
    assert (info.chunks > 5) == (name != "without chunks")
    if name in LEFT_OUT:
        report = repair_bag(path)
        assert (report.output, report.problems) == (None, ())


@pytest.mark.parametrize("name", ["statistics", "chunk index", "the whole summary"])
def test_what_is_missing_in_a_summary_hides_no_damage(name: str, tmp_path: Path, bag: Path) -> None:
    path = rewritten(bag, tmp_path / "x.mcap", **LEFT_OUT[name])
    data = path.read_bytes()
    begins = [one.chunk_start_offset for one in scan_index(BytesIO(data), len(data)).chunks]
    changed = data[: begins[2] + 80] + bytes([data[begins[2] + 80] ^ 1]) + data[begins[2] + 81 :]
    for wrong in (changed, data[: begins[2]] + data[begins[3] :], data[:-1]):
        path.write_bytes(wrong)
        assert not bag_info(path).complete
        damaged(path)
    path.write_bytes(changed)
    if name == "chunk index":
        assert next(open_bag(path).messages()), "whoever reads it finds the damage where it is"
    else:
        with pytest.raises(DamagedBagError, match="is incomplete"):
            open_bag(path)


def test_flipped_bit_or_missing_end_is_named_with_its_place_after_all_before_it(file: Path, run: list[Message]) -> None:
    data = bytearray(file.read_bytes())
    _, second, chunk, *_ = (found for found in split(bytes(data)) if found.opcode == Opcode.CHUNK)
    file.write_bytes(data[: second.end + 5])
    damaged(
        file, r"bag_0\.mcap is incomplete: at byte \d+: .* \d+ messages before it, up to 0\.\d+ s, can be read; rep"
    )
    data[(chunk.offset + chunk.end) // 2] ^= 1
    file.write_bytes(data)
    read: list[bytes] = []
    with pytest.raises(DamagedBagError, match=rf"at byte {chunk.offset}: .*, up to 0\.\d+ s, can be read"):
        read.extend(payload for _, _, payload in open_bag(file).messages())
    assert read == payloads(run[: len(read)]) != []
    assert "the chunk" in (bag_info(file).problem or "")


def test_tail_made_from_a_scan_is_that_of_the_library_and_a_changed_attachment_is_found(file: Path) -> None:
    data = file.read_bytes()
    index = scan_index(BytesIO(data), len(data))
    assert data[index.data_end :] == b"".join(tail(index))
    assert boundaries(data)[-1] == index.data_end
    file.write_bytes(data.replace(b"all went well", b"all went Well"))
    reader = open_bag(file)
    with pytest.raises(DamagedBagError, match=r"CRC of the attachment 'run\.log' does not match"):
        reader.attachment("run.log")
    assert reader.attachment("scenario.yaml") is not None, "found without reading the rest"


def test_topics_of_others_are_not_ours_and_swarms_must_be_told_apart(tmp_path: Path, run: list[Message]) -> None:
    with Recorded(tmp_path / "x.mcap") as bag:
        bag.message(bag.channel("/plane/state", "aero_msgs/msg/PlaneState"), b"x")
        bag.message(bag.channel("/swarm/agent_state", AGENT_STATE.ros_type, "json"), b"{}")
        for profiles in ("[[[", "[1]"):
            bag.message(bag.channel("/camera", "sensor_msgs/msg/Image", offered_qos_profiles=profiles), b"")
    reader, info = open_bag(tmp_path), bag_info(tmp_path)
    assert (reader.topics(), reader.namespace, list(reader.messages())) == ((), None, [])
    assert sum(1 for _ in reader.stored_messages()) == 4
    assert [channel.topic for channel in reader.channels] == [None] * 4
    assert (info.complete, info.scenario, [topic.qos for topic in info.topics]) == (True, None, [""] * 4)
    with Recorded(tmp_path / "x.mcap") as bag:
        for namespace in ("/east", "/west"):
            bag.message(bag.channel(f"{namespace}/plane/state", PLANE_STATE.ros_type), encode(run[3]))
    with pytest.raises(NotABagError, match=r"several swarms; select one with --namespace: /east, /west$"):
        open_bag(tmp_path)
    for name in ("/west", "west", "/west/"):
        assert len(list(open_bag(tmp_path, namespace=name).messages())) == 1
    both = open_bag(tmp_path, several=True)
    assert (both.namespace, both.swarms, both.topics()) == (None, ("/east/", "/west/"), ())
    assert [channel.name for channel, _ in both.stored_messages()] == ["/east/plane/state", "/west/plane/state"]


def test_files_that_number_their_channels_differently_are_one_bag(tmp_path: Path, run: list[Message]) -> None:
    planes = [(message, encode(message)) for message in run if TOPIC_OF[type(message)] is PLANE_STATE][:2]
    topics = [("/plane/state", PLANE_STATE.ros_type), ("/camera", "sensor_msgs/msg/Image")]
    for number, (plane, names) in enumerate(zip(planes, (topics, topics[::-1]), strict=True)):
        with Recorded(tmp_path / f"bag_{number}.mcap") as bag:
            channels = {name: bag.channel(name, ros_type) for name, ros_type in names}
            bag.message(channels["/camera"], b"image", plane[0].stamp)
            bag.message(channels["/plane/state"], plane[1], plane[0].stamp)
    reader = open_bag(tmp_path)
    assert [(channel.name, channel.message_count) for channel in reader.channels] == [(name, 2) for name, _ in topics]
    stored = [(channel.name, message.payload) for channel, message in reader.stored_messages()]
    assert stored == [pair for _, data in planes for pair in (("/camera", b"image"), ("/plane/state", data))]


def test_of_attachments_the_first_counts_and_of_descriptions_the_last(tmp_path: Path) -> None:
    with Recorded(tmp_path / "x.mcap") as bag:
        bag.message(bag.channel("/plane/state", PLANE_STATE.ros_type), b"\0\1\0\0short", 1_500_000_000)
        for number, content in enumerate((b"first", b"second")):
            bag.writer.add_attachment(0, 0, "scenario.yaml", "text/plain", content)
            bag.writer.add_metadata("rosbag2", {"serialized_metadata": f"message_count: {number}"})
        bag.writer.add_metadata("other", {"serialized_metadata": "message_count: 2"})
    reader = open_bag(tmp_path)
    assert (reader.attachment("scenario.yaml"), list(reader.attachments("scenario.yaml"))[1]) == (b"first", b"second")
    assert reader.rosbag2_metadata() == {"message_count": 1}
    for read in (reader.decoded, reader.records):
        with pytest.raises(DamagedBagError, match=r"/plane/state at 1\.5 s: malformed PlaneState: 9 bytes"):
            list(read())


# A bag in several files: each complete in itself, and all of them one run


NAMES = [f"bag_{number}.mcap" for number in range(5)]


def test_each_file_is_complete_in_itself_and_all_are_the_run(split_bag: Path, run: list[Message]) -> None:
    assert sorted(file.name for file in split_bag.glob("*.mcap")) == NAMES
    found = []
    for number, file in enumerate(split_bag / name for name in NAMES):
        alone = open_bag(file)
        alone.check()
        assert alone.attachment("scenario.yaml") == SCENARIO
        assert len(alone.index.attachments) == (3 if number == 4 else 2)
        assert {time // PERIOD // STEPS_PER_FILE for _, time, _ in alone.messages()} == {number}
        with Reader(file) as other:
            assert (other.message_count, len(other.connections)) == (alone.message_count, 6)
        found += [payload for _, _, payload in alone.messages()]
    assert found == read_everywhere(split_bag) == payloads(run)


def test_split_by_size_ends_files_between_steps(tmp_path: Path, run: list[Message], write_bag: WriteBag) -> None:
    files = sorted(write_bag(tmp_path / "bag", chunk_bytes=2000, split=Split(bytes=20_000)).glob("*.mcap"))
    assert len(files) > 1
    assert all(file.stat().st_size > 20_000 for file in files[:-1])
    steps = [{time // PERIOD for _, time, _ in open_bag(file).messages()} for file in files]
    assert sorted(step for part in steps for step in part) == list(range(41))
    assert [payload for _, _, payload in open_bag(tmp_path / "bag").messages()] == payloads(run)


def test_all_files_are_read_as_one_and_listed_as_by_rosbag2(split_bag: Path, run: list[Message], bag: Path) -> None:
    whole, split = open_bag(bag), open_bag(split_bag)
    assert split.channels == whole.channels
    assert (split.start, split.end, split.message_count) == (0, run[-1].stamp, len(run))
    assert [entry.name for entry in split.index.attachments] == [entry.name for entry in whole.index.attachments]
    assert split.attachment("run.log") == b"all went well\n"
    assert split.rosbag2_metadata()["relative_file_paths"] == ["bag_4.mcap"]
    assert np.array_equal(load_arrays(bag).angle, load_arrays(split_bag).angle)
    info = bag_info(split_bag)
    assert (info.complete, info.size) == (True, sum(file.stat().st_size for file in split_bag.glob("*.mcap")))
    assert scenario_of(str(split_bag)).name == "sample"
    found = yaml.safe_load((split_bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert found["relative_file_paths"] == NAMES == [entry["path"] for entry in found["files"]]
    starts = [entry["starting_time"]["nanoseconds_since_epoch"] for entry in found["files"]]
    assert starts == [number * STEPS_PER_FILE * PERIOD for number in range(5)]
    assert [entry["duration"]["nanoseconds"] for entry in found["files"]] == [9 * PERIOD] * 4 + [0]
    assert sum(entry["message_count"] for entry in found["files"]) == found["message_count"] == len(run)
    assert found["duration"]["nanoseconds"] == run[-1].stamp
    assert {entry["message_count"] for entry in found["topics_with_message_count"]} == {123, 41, 1}


def test_namespace_in_some_of_the_files(tmp_path: Path, run: list[Message], write_bag: WriteBag, bag: Path) -> None:
    """A recorder that writes down what it hears names a topic first in the file in which it is first heard."""
    (tmp_path / "both").mkdir()
    for number, name in enumerate(("east", "west")):
        reader = open_bag(write_bag(tmp_path / name, namespace=f"/{name}"))
        assert (reader.namespace, sum(1 for _ in reader.messages())) == (f"/{name}/", len(run))
        shutil.copy(tmp_path / name / "bag_0.mcap", tmp_path / "both" / f"bag_{number}.mcap")
    for path, known in ((tmp_path / "east", "/east"), (bag, "/")):
        with pytest.raises(NotABagError, match=rf"no swarm in the namespace /hall; its swarms: {known}$"):
            open_bag(path, namespace="/hall")
    for name in ("east", "west"):
        assert len(list(open_bag(tmp_path / "both", namespace=name).messages())) == len(run)
    with pytest.raises(NotABagError, match="its swarms: /east, /west"):
        open_bag(tmp_path / "both", namespace="/")


def test_a_file_that_is_missing_is_named(split: Path, tmp_path: Path, run: list[Message]) -> None:
    (split / "bag_1.mcap").unlink()
    with pytest.raises(DamagedBagError, match=r"bag_1\.mcap is missing"):
        open_bag(split)
    info = bag_info(split)
    assert (info.complete, info.problem, info.message_count) == (False, "bag_1.mcap is missing", len(run) - 70)
    (split / "bag_4.mcap").rename(split / "bag_999999999.mcap")
    named = r"bag_1\.mcap is missing, bag_4\.mcap is missing, bag_5\.mcap is missing; name one"
    with pytest.raises(DamagedBagError, match=named):
        open_bag(split)
    assert len(repair_bag(split, tmp_path / "new").problems) == 3


# What bag_info says of whole and aborted bags, and how it is shown


def shown(folder: Path) -> str:
    console = Console(file=io.StringIO(), width=200, color_system=None)
    console.print(render(bag_info(folder)))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_complete_bag(bag: Path, run: list[Message]) -> None:
    info = bag_info(bag)
    assert info.complete
    assert info.problem is info.aborted is info.repaired is None
    assert info.file == str(bag / "bag_0.mcap")
    assert info.size == (bag / "bag_0.mcap").stat().st_size
    assert (info.profile, info.compression, info.namespace, info.swarms) == ("ros2", "zstd", "/", ("/",))
    assert (info.start, info.duration, info.message_count) == (0.0, 0.4, len(run))
    assert info.chunks > 3
    assert info.uncompressed_size > info.size
    assert [topic.name for topic in info.topics] == [f"/{topic.name}" for topic in (*MAIN_TOPICS, EVENTS)]
    assert info.topics[0].qos == "best_effort volatile 10"
    assert info.topics[5].qos == "reliable transient_local 1000"
    assert info.topics[0].type == "swarmabs_msgs/msg/AgentState"
    assert info.topics[0].type_hash.startswith("RIHS01_")
    assert info.scenario == ScenarioInfo("sample", seed=5, agents=3, duration=0.4, step=0.01)
    assert (info.versions, info.arithmetic) == ({"swarmabs": "1.2.3"}, 2)
    assert info.attachments["run.log"] == 14
    plain = json.loads(json.dumps(asdict(info), allow_nan=False))
    assert plain["scenario"] == {"name": "sample", "seed": 5, "agents": 3, "duration": 0.4, "step": 0.01}


def test_table_shows_what_matters_and_a_cut_off_bag_as_far_as_it_goes(copy: Path) -> None:
    text, whole, data = shown(copy), bag_info(copy), (copy / "bag_0.mcap").read_bytes()
    for part in (
        *("complete", "sample, seed 5, 3 agents, 0.4 s", "/swarm/agent_state", "123"),
        *("swarmabs 1.2.3", "arithmetic   2", "0 s to 0.4 s", "run.log (14 bytes)", "(zstd; ", "QoS offered"),
    ):
        assert part in text
    assert "swarms in" not in text
    assert "the former one" not in text
    assert "1, the former one" in shown(ROOT / "tests/data/schema_1")
    (copy / "bag_0.mcap").write_bytes(data[:-10])
    info = bag_info(copy)
    assert info.problem is not None
    assert (info.complete, info.message_count, info.scenario) == (False, whole.message_count, whole.scenario)
    assert "damaged: " in shown(copy)


def test_texts_in_a_bag_cannot_steer_the_terminal(tmp_path: Path) -> None:
    names = {"\x1b[2Jx\nfile  /etc": b"", "[bold]y": b""}
    bag_writer(tmp_path / "bag", names).abort(reason="agent 17 is [red]dead[/red]")
    assert (bag_info(tmp_path).complete, bag_info(tmp_path).aborted) == (True, "agent 17 is [red]dead[/red]")
    assert "intact, up to the early end of the run" in shown(tmp_path)
    text = shown(tmp_path)
    assert "\x1b" not in text
    for part in (
        "\N{REPLACEMENT CHARACTER}[2Jx\N{REPLACEMENT CHARACTER}file",
        "[bold]y",
        "agent 17 is [red]dead[/red]",
    ):
        assert part in text


def test_pipe_has_topic_lines(bag: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    assert main(["info", str(bag)]) == 0
    words = [line.split() for line in capfd.readouterr().out.splitlines()]
    (plane,) = [line for line in words if line[:1] == ["/plane/state"]]
    assert (plane[1], plane[2:4], plane[-1]) == ("swarmabs_msgs/msg/PlaneState", ["reliable", "volatile"], "41")

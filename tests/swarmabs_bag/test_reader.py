"""Reading bags that are whole, cut off, changed, foreign or hostile."""

from __future__ import annotations

import os
import random
import resource
import shutil
import struct
import sys
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.index import scan_index, tail
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair import repair_bag
from swarmabs_bag.run_folder import find_bag
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import AGENT_STATE, EVENTS, PLANE_STATE, TOPIC_OF, Message

if TYPE_CHECKING:
    from typing_extensions import Self

MAGIC = b"\x89MCAP0\r\n"


def read_everything(path: Path) -> list[bytes]:
    """Use all of a reader; a damaged bag must make some of it raise."""
    reader = open_bag(path)
    payloads = [message.payload for _, message in reader.stored_messages()]
    assert all(payload is not None for _, _, payload in reader.messages())
    for name in tuple(entry.name for entry in reader.index.attachments):
        reader.attachment(name)
    reader.rosbag2_metadata()
    reader.check()
    return payloads


@pytest.fixture
def copy(tmp_path: Path, bag: Path) -> Path:
    """Return the MCAP file of a bag that may be changed."""
    return Path(shutil.copy(bag / "bag_0.mcap", tmp_path / "copy.mcap"))


def top_level(data: bytes | bytearray) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of each record of a file."""
    position = len(MAGIC)
    while position < len(data) - len(MAGIC):
        (length,) = struct.unpack_from("<Q", data, position + 1)
        yield data[position], position, position + 9 + length
        position += 9 + length


# What is whole


def test_run_folder_bag_folder_and_file_are_the_same_bag(tmp_path: Path, bag: Path) -> None:
    shutil.copytree(bag, tmp_path / "bag")
    expected = tmp_path / "bag/bag_0.mcap"
    assert find_bag(tmp_path) == find_bag(tmp_path / "bag") == find_bag(expected) == expected


def test_messages_come_as_they_were_written(bag: Path, run: list[Message]) -> None:
    reader = open_bag(bag)
    assert list(reader.messages()) == [(TOPIC_OF[type(m)], m.stamp, encode(m)) for m in run]
    assert [message for _, _, message in reader.decoded()] == run
    assert [m for _, _, m in reader.decoded([EVENTS])] == [m for m in run if TOPIC_OF[type(m)] is EVENTS]


def test_two_iterations_do_not_disturb_each_other(bag: Path, run: list[Message]) -> None:
    reader = open_bag(bag)
    pairs = list(zip(reader.messages(), reader.messages(), strict=True))
    assert len(pairs) == len(run)
    assert all(one == other for one, other in pairs)


def test_reader_tells_what_the_bag_holds(bag: Path, run: list[Message]) -> None:
    reader = open_bag(str(bag))
    assert (reader.start, reader.end, reader.message_count) == (0, run[-1].stamp, len(run))
    assert reader.namespace == "/"
    assert reader.problem is None
    assert tuple(entry.name for entry in reader.index.attachments) == ("scenario.yaml", "provenance.json", "run.log")
    assert reader.attachment("run.log") == b"all went well\n"
    assert reader.attachment("other") is None
    assert reader.aborted() is None
    assert reader.rosbag2_metadata()["ros_distro"] == "jazzy"
    counts = {channel.name: channel.message_count for channel in reader.channels}
    assert counts["/swarm/agent_state"] == 123
    reader.check()


def test_swarm_in_a_namespace(tmp_path: Path, run: list[Message], write_bag: Callable[..., Path]) -> None:
    reader = open_bag(write_bag(tmp_path / "bag", namespace="/lab"))
    assert reader.namespace == "/lab/"
    assert sum(1 for _ in reader.messages()) == len(run)
    assert open_bag(tmp_path / "bag", namespace="/lab").topics() == reader.topics()
    with pytest.raises(NotABagError, match=r"no swarm in the namespace /hall, but in /lab$"):
        open_bag(tmp_path / "bag", namespace="/hall")


# What is no bag


def no_bag(path: Path) -> NotABagError:
    with pytest.raises(NotABagError) as caught:
        open_bag(path)
    assert isinstance(caught.value, InputError)
    assert "\n" not in str(caught.value)
    return caught.value


def test_nothing_there(tmp_path: Path) -> None:
    assert "No such file or directory; name a run folder" in str(no_bag(tmp_path / "missing"))


def test_folder_without_a_bag(tmp_path: Path) -> None:
    assert "holds no bag" in str(no_bag(tmp_path))


def test_folder_with_several_bags(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / name).touch()
    assert "holds 2 .mcap files: name one of them" in str(no_bag(tmp_path))


@pytest.mark.parametrize("content", [b"# notes\n", b"SQLite format 3\0", b"\x89MCAP1\r\n" + bytes(100)])
def test_file_of_another_kind(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    assert "does not begin as an MCAP file" in str(no_bag(tmp_path))


def test_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert "neither a folder nor a file" in str(no_bag(tmp_path / "pipe"))


def test_loop_of_links(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    assert "Too many levels of symbolic links" in str(no_bag(tmp_path / "a"))


def test_folder_that_has_the_name_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").mkdir()
    assert "Is a directory" in str(no_bag(tmp_path))


def test_name_with_a_nul(tmp_path: Path) -> None:
    assert "null" in str(no_bag(tmp_path / "a\0b"))


# What is damaged


def damaged(path: Path) -> DamagedBagError:
    with pytest.raises(DamagedBagError) as caught:
        read_everything(path)
    assert isinstance(caught.value, RunError)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    return caught.value


def test_every_cut_is_found_and_what_is_before_it_can_be_read(copy: Path, run: list[Message]) -> None:
    data = copy.read_bytes()
    chunks = [end for opcode, _, end in top_level(data) if opcode == Opcode.CHUNK]
    payloads = [encode(message) for message in run]
    kept = 0
    for size in {*range(0, len(data), 211), *chunks, *(end - 1 for end in chunks)}:
        copy.write_bytes(data[:size])
        damaged(copy)
        if size > 200:
            found = [payload for _, _, payload in open_bag(copy, damaged=True).messages()]
            assert found == payloads[: len(found)]
            assert (len(found) > 0) == (size >= chunks[0])
            kept = max(kept, len(found))
    assert kept == len(run)


def test_error_says_what_can_still_be_read(copy: Path) -> None:
    data = copy.read_bytes()
    second = [end for opcode, _, end in top_level(data) if opcode == Opcode.CHUNK][1]
    copy.write_bytes(data[: second + 5])
    with pytest.raises(
        DamagedBagError,
        match=r"copy\.mcap is incomplete: at byte \d+: .* \d+ messages before it, up to 0.*; repair saves what can be",
    ):
        open_bag(copy)


def test_empty_file_is_what_a_crash_leaves(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").touch()
    assert "has only 0 bytes" in str(damaged(tmp_path / "x.mcap"))


def test_no_change_of_a_byte_goes_unnoticed(copy: Path) -> None:
    data = bytearray(copy.read_bytes())
    heads = {position for _, begin, _ in top_level(data) for position in range(begin, begin + 9)}
    generator = random.Random(1)
    places = {*range(8, 40), *heads, *generator.sample(range(8, len(data)), 400), *range(len(data) - 60, len(data))}
    for place in sorted(places):
        old = data[place]
        data[place] ^= 1 << generator.randrange(8)
        copy.write_bytes(data)
        damaged(copy)
        data[place] = old
    copy.write_bytes(data)
    read_everything(copy)


def test_random_garbage_never_raises_anything_else(copy: Path) -> None:
    data = copy.read_bytes()
    generator = random.Random(2)
    for _ in range(400):
        changed = bytearray(data)
        for _ in range(generator.randrange(1, 8)):
            begin = generator.randrange(8, len(data))
            length = generator.choice([1, 4, 8, 100])
            kind = generator.randrange(4)
            if kind == 0:
                changed[begin : begin + length] = generator.randbytes(length)
            elif kind == 1:
                changed[begin : begin + length] = b"\xff" * length
            elif kind == 2:
                del changed[begin : begin + length]
            else:
                changed[begin:begin] = changed[: generator.randrange(200)]
        copy.write_bytes(changed)
        damaged(copy)
        try:
            for _ in open_bag(copy, damaged=True).decoded():
                pass
        except (DamagedBagError, NotABagError):
            pass


def test_flipped_bit_is_named_with_its_place_after_all_before_it(copy: Path, run: list[Message]) -> None:
    data = bytearray(copy.read_bytes())
    _, begin, end = [record for record in top_level(data) if record[0] == Opcode.CHUNK][2]
    data[(begin + end) // 2] ^= 1
    copy.write_bytes(data)
    read = []
    with pytest.raises(DamagedBagError, match=rf"at byte {begin}: .*, up to 0\.\d+ s, can be read"):  # noqa: PT012
        for _, _, payload in open_bag(copy).messages():
            read.append(payload)
    assert read
    assert read == [encode(message) for message in run[: len(read)]]


def test_changed_attachment_is_found_without_reading_the_rest(copy: Path) -> None:
    data = copy.read_bytes()
    copy.write_bytes(data.replace(b"all went well", b"all went Well"))
    reader = open_bag(copy)
    with pytest.raises(DamagedBagError, match=r"CRC of the attachment 'run\.log' does not match"):
        reader.attachment("run.log")
    assert reader.attachment("scenario.yaml") is not None


@pytest.mark.parametrize("number", ["message_count", "message_start_time", "message_end_time", "chunk_count"])
def test_summary_that_miscounts_is_found(number: str, copy: Path) -> None:
    data = copy.read_bytes()
    index = scan_index(BytesIO(data), len(data))
    setattr(index.statistics, number, 7)
    copy.write_bytes(data[: index.data_end] + b"".join(tail(index)))
    assert f"the summary says {number} = 7, but it is" in str(damaged(copy))


def test_tail_made_from_a_scan_is_that_of_the_library(copy: Path) -> None:
    data = copy.read_bytes()
    index = scan_index(BytesIO(data), len(data))
    assert data[index.data_end :] == b"".join(tail(index))


# What other writers, or people with bad intentions, put into a file


class Recorded:
    """A foreign bag, written with the library's writer."""

    def __init__(self, path: Path, **options: Any) -> None:
        self._stream: IO[bytes] = path.open("wb")
        self.writer = Writer(self._stream, **options)
        self.writer.start("ros2", "somebody else")

    def channel(self, topic: str, ros_type: str, encoding: str = "cdr") -> int:
        schema = self.writer.register_schema(ros_type, "ros2msg", b"")
        return self.writer.register_channel(topic, encoding, schema)

    def message(self, channel: int, data: bytes, time: int = 0) -> None:
        self.writer.add_message(channel, time, data, time)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.finish()
        self._stream.close()


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"enable_crcs": False},
        {"index_types": IndexType.NONE},
        {"use_summary_offsets": False},
        {"enable_data_crcs": True},
    ],
    ids=str,
)
def test_bags_of_other_writers_are_read(options: dict[str, Any], tmp_path: Path, run: list[Message]) -> None:
    path = tmp_path / "x.mcap"
    with Recorded(path, chunk_size=1000, **options) as bag:
        plane = bag.channel("/plane/state", PLANE_STATE.ros_type)
        other = bag.channel("/camera", "sensor_msgs/msg/Image")
        for message in run:
            if TOPIC_OF[type(message)] is PLANE_STATE:
                bag.message(plane, encode(message), message.stamp)
                bag.message(other, b"pixels", message.stamp)
    reader = open_bag(path)
    reader.check()
    assert [payload for _, _, payload in reader.messages()] == [
        encode(message) for message in run if TOPIC_OF[type(message)] is PLANE_STATE
    ]
    assert sum(1 for channel, _ in reader.stored_messages() if channel.name == "/camera") == 41
    assert [channel.topic for channel in reader.channels] == [PLANE_STATE, None]


LEFT_OUT: dict[str, dict[str, Any]] = {
    "statistics": {"use_statistics": False},
    "schemas": {"repeat_schemas": False},
    "channels": {"repeat_channels": False},
    "chunk index": {"index_types": IndexType.ALL & ~IndexType.CHUNK},
    "attachment index": {"index_types": IndexType.ALL & ~IndexType.ATTACHMENT},
    "metadata index": {"index_types": IndexType.ALL & ~IndexType.METADATA},
    "summary offsets": {"use_summary_offsets": False},
}
LEFT_OUT["statistics and indexes"] = {"use_statistics": False, "index_types": IndexType.MESSAGE}
LEFT_OUT["the whole summary"] = {name: value for options in LEFT_OUT.values() for name, value in options.items()} | {
    "index_types": IndexType.MESSAGE
}


def rewritten(bag: Path, path: Path, **options: Any) -> Path:
    """Write a whole bag once more by the library's writer; chunks are as large as those of the bag."""
    writer = Writer(str(path), chunk_size=4000, enable_data_crcs=True, **options)
    with (bag / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        writer.start("ros2", "somebody else")
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                assert schema is not None
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, known, channel.metadata
                )
            number = channels[channel.id]
            writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)
        for one in reader.iter_attachments():
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
    writer.finish()
    return path


@pytest.mark.parametrize("options", LEFT_OUT.values(), ids=LEFT_OUT)
def test_a_file_without_what_the_format_leaves_to_its_writer_is_whole(
    options: dict[str, Any], tmp_path: Path, bag: Path
) -> None:
    path = rewritten(bag, tmp_path / "x.mcap", **options)
    reader, own = open_bag(path), open_bag(bag)
    assert reader.problem is None
    assert read_everything(path) == read_everything(bag)
    assert {channel.name: channel.message_count for channel in reader.channels} == {
        channel.name: channel.message_count for channel in own.channels if channel.message_count
    }
    assert (reader.start, reader.end, reader.message_count) == (own.start, own.end, own.message_count)
    assert {name: reader.attachment(name) for name in tuple(entry.name for entry in reader.index.attachments)} == {
        name: own.attachment(name) for name in tuple(entry.name for entry in own.index.attachments)
    }
    assert reader.rosbag2_metadata() == own.rosbag2_metadata() != {}
    info = bag_info(path)
    assert (info.complete, info.problem) == (True, None)
    assert info.chunks == len(reader.index.chunks) > 5
    report = repair_bag(path)
    assert (report.output, report.problems) == (None, ())


@pytest.mark.parametrize("name", ["statistics", "the whole summary"])
def test_what_is_missing_in_a_summary_hides_no_damage(name: str, tmp_path: Path, bag: Path) -> None:
    data = rewritten(bag, tmp_path / "x.mcap", **LEFT_OUT[name]).read_bytes()
    found = scan_index(BytesIO(data), len(data))
    begin = found.chunks[2].chunk_start_offset
    (tmp_path / "changed.mcap").write_bytes(data[: begin + 80] + bytes([data[begin + 80] ^ 1]) + data[begin + 81 :])
    cut = data[:begin] + data[found.chunks[3].chunk_start_offset :]
    (tmp_path / "shorter.mcap").write_bytes(cut)
    (tmp_path / "end.mcap").write_bytes(data[:-1])
    for one in ("changed", "shorter", "end"):
        assert not bag_info(tmp_path / f"{one}.mcap").complete
        with pytest.raises(DamagedBagError):
            read_everything(tmp_path / f"{one}.mcap")


def test_topic_of_another_type_or_encoding_is_not_ours(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with Recorded(path) as bag:
        bag.message(bag.channel("/plane/state", "aero_msgs/msg/PlaneState"), b"x")
        bag.message(bag.channel("/swarm/agent_state", AGENT_STATE.ros_type, "json"), b"{}")
    reader = open_bag(path)
    assert reader.topics() == ()
    assert reader.namespace is None
    assert list(reader.messages()) == []
    assert sum(1 for _ in reader.stored_messages()) == 2


def test_two_swarms_in_a_bag_must_be_told_apart(tmp_path: Path, run: list[Message]) -> None:
    path = tmp_path / "x.mcap"
    with Recorded(path) as bag:
        for namespace in ("/east", "/west"):
            bag.message(bag.channel(f"{namespace}/plane/state", PLANE_STATE.ros_type), encode(run[3]))
    with pytest.raises(NotABagError, match=r"several swarms: choose one with --namespace: /east, /west$"):
        open_bag(path)
    for name in ("/west", "west", "/west/"):
        assert len(list(open_bag(path, namespace=name).messages())) == 1
    both = open_bag(path, several=True)
    assert (both.namespace, both.swarms, both.topics()) == (None, ("/east/", "/west/"), ())
    assert [channel.name for channel, _ in both.stored_messages()] == ["/east/plane/state", "/west/plane/state"]


def test_message_that_is_none_of_ours_is_named(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with Recorded(path) as bag:
        bag.message(bag.channel("/plane/state", PLANE_STATE.ros_type), b"\0\1\0\0short", 1_500_000_000)
    with pytest.raises(DamagedBagError, match=r"/plane/state at 1\.5 s: malformed PlaneState: 9 bytes"):
        list(open_bag(path).decoded())


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, "!!python/object/apply:os.system ['exit 1']", "a: [", "2000-99-99", "x" * 2**21, "\0", "- 1"],
)
def test_hostile_yaml_is_no_description(text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with Recorded(path) as bag:
        bag.writer.add_metadata("rosbag2", {"serialized_metadata": text})
    reader = open_bag(path)
    assert reader.rosbag2_metadata() == {}
    assert reader.aborted() is None


def test_latest_description_counts(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with Recorded(path) as bag:
        for number in (1, 2):
            bag.writer.add_metadata("rosbag2", {"serialized_metadata": f"message_count: {number}"})
    assert open_bag(path).rosbag2_metadata() == {"message_count": 2}


def test_attachments_of_one_name_the_first_counts(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with Recorded(path) as bag:
        for text in (b"first", b"second"):
            bag.writer.add_attachment(0, 0, "scenario.yaml", "text/plain", text)
    reader = open_bag(path)
    assert tuple(entry.name for entry in reader.index.attachments) == ("scenario.yaml", "scenario.yaml")
    assert reader.attachment("scenario.yaml") == b"first"


# Files made by hand, one lie each


def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(content) if length is None else length) + content


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def chunk(
    data: bytes, *, size: int | None = None, crc: int | None = None, name: bytes = b"zstd", length: int | None = None
) -> bytes:
    packed = zstandard.compress(data) if name == b"zstd" else data
    content = struct.pack("<QQQI", 0, 0, len(data) if size is None else size, zlib.crc32(data) if crc is None else crc)
    return record(
        Opcode.CHUNK, content + text(name) + struct.pack("<Q", len(packed) if length is None else length) + packed
    )


HEADER = record(Opcode.HEADER, text(b"ros2") + text(b""))
MESSAGE = record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 0, 0, 0) + b"data")


@pytest.mark.parametrize(
    ("lie", "problem"),
    [
        (chunk(MESSAGE, size=2**40), "a chunk of 1099511627776 bytes when uncompressed"),
        (chunk(MESSAGE, size=5), "its zstd frame says"),
        (chunk(MESSAGE, crc=5), "CRC of the chunk is"),
        (chunk(MESSAGE, name=b"rar"), "unknown compression 'rar'"),
        (chunk(MESSAGE, name=b"lz4"), "cannot be uncompressed"),
        (chunk(MESSAGE, name=b"\xff"), "malformed Chunk record"),
        (chunk(MESSAGE, length=3), "a chunk of 3 bytes in a record"),
        (chunk(MESSAGE[:-1], name=b""), "reaches beyond its chunk"),
        (chunk(MESSAGE + b"\x05", name=b""), "ends within the head of a record"),
        (chunk(record(Opcode.MESSAGE, b"short"), name=b""), "a message record is cut off"),
        (record(Opcode.CHUNK, b""), "malformed Chunk record: a field of 8 bytes, but 0 are left"),
        (record(Opcode.CHUNK, b"", length=2**63), "a record of 9223372036854775808 bytes begins"),
        (record(Opcode.MESSAGE, b"short"), "a message record is cut off"),
        (record(Opcode.SCHEMA, b"\1"), "malformed Schema record"),
        (record(Opcode.CHANNEL, struct.pack("<HHI", 1, 1, 2**32 - 1)), "malformed Channel record"),
        (record(Opcode.ATTACHMENT, bytes(16) + text(b"") * 2 + b"\xff" * 8), "malformed Attachment record"),
        (record(Opcode.METADATA, text(b"\xff")), "malformed Metadata record"),
        (record(Opcode.FOOTER, bytes(20)), "a footer without an end of the data section"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_lie_is_named(lie: bytes, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(MAGIC + HEADER + lie + bytes(40))
    with pytest.raises(DamagedBagError) as caught:
        open_bag(path)
    assert problem in str(caught.value)
    assert f"at byte {len(MAGIC + HEADER)}" in str(caught.value) or "ootage" in problem or "footer" in problem


def test_file_without_a_header(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(MAGIC + chunk(MESSAGE) + bytes(40))
    with pytest.raises(DamagedBagError, match="no header; nothing can be read"):
        open_bag(tmp_path)


def test_summary_that_points_nowhere(copy: Path) -> None:
    data = bytearray(copy.read_bytes())
    struct.pack_into("<Q", data, len(data) - 8 - 20, 2**60)
    copy.write_bytes(data)
    assert "is said to begin at byte 1152921504606846976" in str(damaged(copy))


def test_small_file_cannot_make_the_reader_allocate_much(tmp_path: Path) -> None:
    """A frame of zeros without stated size, said to be small, must not be unpacked to its real size."""
    packer = zstandard.ZstdCompressor(write_content_size=False)
    packed = packer.compress(bytes(2**28))
    assert len(packed) < 2**16
    for size in (100, 2**28 + 1):
        content = struct.pack("<QQQI", 0, 0, size, 0) + text(b"zstd") + struct.pack("<Q", len(packed)) + packed
        (tmp_path / "x.mcap").write_bytes(MAGIC + HEADER + record(Opcode.CHUNK, content) + bytes(40))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with pytest.raises(DamagedBagError):
            open_bag(tmp_path)
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        assert grown * (1 if sys.platform == "darwin" else 1024) < 2**26

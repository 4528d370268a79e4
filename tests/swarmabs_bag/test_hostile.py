"""What damage and bad intentions once achieved, one test for each."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from tests.swarmabs_bag.damage import MAGIC, chunk, joined, record, sealed, split, text

from swarmabs_analysis.figures.runs import find_runs
from swarmabs_bag import index
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.attached import scenario_of
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.examination import recorded_steps
from swarmabs_bag.index import FileIndex
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair import repair_bag
from swarmabs_bag.writer import BagWriter
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, TOPIC_OF, Message

HEADER = record(Opcode.HEADER, text(b"ros2") + text(b""))
TERABYTE = 2**40


@pytest.fixture
def whole(bag: Path) -> bytes:
    return (bag / "bag_0.mcap").read_bytes()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "x.mcap"


def attachment(name: bytes, data: bytes) -> bytes:
    content = bytes(16) + text(name) + text(b"") + struct.pack("<Q", len(data)) + data
    return record(Opcode.ATTACHMENT, content + struct.pack("<I", zlib.crc32(content)))


def described(metadata: str) -> bytes:
    """Return a bag with this text as rosbag2's description."""
    pair = text(b"serialized_metadata") + text(metadata.encode())
    return sealed(MAGIC + HEADER + record(Opcode.METADATA, text(b"rosbag2") + text(pair)))


def test_chunk_that_became_something_unknown_is_missed(whole: bytes, file: Path, run: list[Message]) -> None:
    """The format tells readers to pass over records of kinds that they do not know."""

    def change(found: FileIndex) -> None:
        found.statistics.message_count = len(run)

    records = split(whole)
    number = [number for number, found in enumerate(records) if found.opcode == Opcode.CHUNK][1]
    records[number] = records[number]._replace(opcode=0x80)
    file.write_bytes(sealed(joined(records), change))
    with pytest.raises(DamagedBagError, match=f"the summary says message_count = {len(run)}, but it is "):
        list(open_bag(file).messages())
    with pytest.raises(DamagedBagError, match="message_count"):
        load_arrays(file)


def test_chunk_that_became_something_else_while_another_record_became_a_message(
    tmp_path: Path, run: list[Message], write_bag: Callable[..., Path]
) -> None:
    """The number of messages is right then, but not the CRC of the data section."""
    data = bytearray((write_bag(tmp_path / "bag", run[:1]) / "bag_0.mcap").read_bytes())
    for found in split(bytes(data)):
        if found.opcode in {Opcode.CHUNK, Opcode.MESSAGE_INDEX}:
            data[found.offset] = {Opcode.CHUNK: 0x80, Opcode.MESSAGE_INDEX: Opcode.MESSAGE}[Opcode(found.opcode)]
    (tmp_path / "x.mcap").write_bytes(data)
    with pytest.raises(DamagedBagError, match="CRC of the data section is"):
        list(open_bag(tmp_path / "x.mcap").messages())


@pytest.mark.parametrize("place", [2**63, 2**64 - 1, 2**40])
def test_attachment_beyond_the_end(place: int, whole: bytes, file: Path) -> None:
    def change(found: FileIndex) -> None:
        found.attachments[0].offset = place

    file.write_bytes(sealed(joined(split(whole)), change))
    with pytest.raises(DamagedBagError, match=rf"at byte {place}: a record is said to be here, but the file has \d+"):
        open_bag(file).attachment("scenario.yaml")


def test_attachment_of_another_name(whole: bytes, file: Path) -> None:
    def change(found: FileIndex) -> None:
        found.attachments[-1].name = "scenario.yaml"
        found.attachments.reverse()

    file.write_bytes(sealed(joined(split(whole)), change))
    with pytest.raises(DamagedBagError, match=r"the attachment here is not 'scenario\.yaml', as the summary says"):
        open_bag(file).attachment("scenario.yaml")


def test_scenario_that_is_no_text(file: Path) -> None:
    file.write_bytes(sealed(MAGIC + HEADER + attachment(b"scenario.yaml", b"\xff\xfe")))
    with pytest.raises(InputError, match=r"x\.mcap:scenario\.yaml is not UTF-8 text, so it is not"):
        scenario_of(str(file))
    with pytest.raises(InputError, match=r"x\.mcap:scenario\.yaml is not UTF-8 text, so it is not"):
        find_runs([file], {"sample"})


@pytest.mark.parametrize(
    "reason",
    ["0x" + "f" * 20_000, "[[]]", "{a: b}", "2000-01-01", "!!binary aGk=", "1e400", "!!python/name:os.system"],
    ids=lambda reason: reason[:10],
)
def test_reason_of_an_early_end_is_a_text_or_nothing(reason: str, file: Path) -> None:
    file.write_bytes(described(f"custom_data: {{swarmabs.aborted: {reason}}}"))
    found = bag_info(file).aborted
    assert found is None or reason.startswith(found)


def test_merge_keys_and_aliases_do_not_multiply(file: Path) -> None:
    merged = "".join(f"k{n + 1}: &k{n + 1} {{<<: [{', '.join([f'*k{n}'] * 9)}]}}\n" for n in range(40))
    doubled = "".join(f"l{n + 1}: &l{n + 1} [*l{n}, *l{n}]\n" for n in range(40))
    for bomb in (f"k0: &k0 {{x: 1}}\n{merged}", f"l0: &l0 [x]\n{doubled}custom_data: {{swarmabs.aborted: *l40}}\n"):
        file.write_bytes(described(bomb))
        assert open_bag(file).rosbag2_metadata() == {}
        assert bag_info(file).aborted is None


def test_names_of_topics_cannot_break_the_line_of_an_error(file: Path) -> None:
    kind = text(MAIN_TOPICS[1].ros_type.encode()) + text(b"ros2msg") + text(b"")
    definitions = record(Opcode.SCHEMA, struct.pack("<H", 1) + kind)
    for number, prefix in enumerate((b"/a\n\x1b[2J", b"/" + b"b" * 10_000, *(b"/c%d" % n for n in range(20)))):
        topic = text(prefix + b"/plane/state") + text(b"cdr") + text(b"")
        definitions += record(Opcode.CHANNEL, struct.pack("<HH", number, 1) + topic)
    file.write_bytes(sealed(MAGIC + HEADER + definitions))
    for namespace in (None, "/other"):
        with pytest.raises(NotABagError) as caught:
            open_bag(file, namespace=namespace)
        assert str(caught.value).isprintable()
        assert "/a\\n\\x1b[2J, " in str(caught.value)
        assert str(caught.value).endswith(", 17 more")
        assert len(str(caught.value)) < 1000


def test_pipe_in_the_folder_of_a_bag_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.mcap")
    with pytest.raises(NotABagError, match=r"x\.mcap is neither a folder nor a file"):
        open_bag(tmp_path)


def test_devices_and_loops_in_the_folder_of_a_bag(tmp_path: Path) -> None:
    (tmp_path / "bag").symlink_to(tmp_path)
    with pytest.raises(NotABagError, match="holds no bag"):
        open_bag(tmp_path)
    (tmp_path / "x.mcap").symlink_to("/dev/zero")
    with pytest.raises(NotABagError, match=r"x\.mcap is neither a folder nor a file"):
        open_bag(tmp_path)
    (tmp_path / "x.mcap").unlink()
    (tmp_path / "x.mcap").symlink_to("x.mcap")
    with pytest.raises(NotABagError, match="Too many levels of symbolic links"):
        open_bag(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_file_that_must_not_be_read(file: Path) -> None:
    file.touch(mode=0)
    with pytest.raises(NotABagError, match="Permission denied"):
        open_bag(file)


def test_what_stands_beside_the_file_is_not_read(whole: bytes, file: Path, run: list[Message]) -> None:
    file.write_bytes(whole)
    os.mkfifo(file.parent / "metadata.yaml")
    assert bag_info(file.parent).message_count == len(run)


def test_zeros_are_not_taken_for_records(file: Path) -> None:
    with file.open("wb") as stream:
        stream.write(MAGIC + HEADER)
        stream.truncate(TERABYTE)
    with pytest.raises(DamagedBagError, match=f"at byte {len(MAGIC + HEADER)}: zeros instead of a record"):
        open_bag(file)


def test_summary_section_as_large_as_a_disk(file: Path) -> None:
    end = record(Opcode.DATA_END, bytes(4))
    start = len(MAGIC + HEADER + end)
    with file.open("wb") as stream:
        stream.write(MAGIC + HEADER + end)
        stream.truncate(TERABYTE)
        stream.seek(TERABYTE)
        stream.write(record(Opcode.FOOTER, struct.pack("<QQI", start, 0, 1)) + MAGIC)
    with pytest.raises(DamagedBagError, match="is incomplete"):
        open_bag(file)
    assert not bag_info(file).complete


@pytest.mark.parametrize("content", [b"", struct.pack("<HI", 1, 2**32 - 1), struct.pack("<HI", 1, 17) + bytes(17)])
def test_message_index_that_cannot_be(content: bytes, file: Path) -> None:
    file.write_bytes(MAGIC + HEADER + chunk(b"") + record(Opcode.MESSAGE_INDEX, content) + bytes(40))
    with pytest.raises(DamagedBagError, match="malformed MessageIndex record"):
        open_bag(file)


def test_a_robot_that_joins_after_a_lifetime(tmp_path: Path, run: list[Message]) -> None:
    robots = b", ".join(b"{id: %d, kind: single_integrator, mass: 1.0, position: 0.0%d}" % (i, i) for i in (1, 2, 7, 9))
    scenario = b"schema: 1\nduration: 2147483647.0\nstep: 1.0e-9\nswarm: {agents: [%s]}\n" % robots
    scenario += b"faults: [{kind: join, at: 2147483000.0, agent: 9}]\n"
    with BagWriter(tmp_path / "bag", topics=(*MAIN_TOPICS, EVENTS), attachments={"scenario.yaml": scenario}) as writer:
        for message in run:
            writer.write(TOPIC_OF[type(message)], message.stamp, encode(message))
    found = recorded_steps(tmp_path / "bag")
    assert found is not None
    assert (found.first, found.last_complete, found.last_planned) == (0, 40, 2147483647 * 10**9)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_chunk_that_grows_beyond_all_measure(compression: str, file: Path) -> None:
    stated = 2**27
    made = chunk(bytes(2**16), compression, size=stated, crc=0)
    file.write_bytes(MAGIC + HEADER + made + bytes(40))
    with pytest.raises(DamagedBagError, match=f"a chunk of {stated} bytes when uncompressed, made from"):
        open_bag(file)


def test_index_has_an_end(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index, "MOST_ENTRIES", 10)
    monkeypatch.setattr(index, "MOST_DEFINITIONS", 100)
    schema = record(Opcode.SCHEMA, struct.pack("<H", 1) + text(b"x" * 30) + text(b"") + text(b""))
    other = record(Opcode.SCHEMA, struct.pack("<H", 1) + text(b"y" * 30) + text(b"") + text(b""))
    for many, problem in (
        (chunk(b"") * 11, "more than 10 chunks"),
        (attachment(b"a", b"") * 11, "more than 10 attachments"),
        (record(Opcode.METADATA, text(b"a") + text(b"")) * 11, "more than 10 metadata records"),
        ((schema + other) * 2, "schemas and channels of more than 100 bytes"),
    ):
        file.write_bytes(MAGIC + HEADER + many + bytes(40))
        with pytest.raises(DamagedBagError, match=problem):
            open_bag(file)
    file.write_bytes(sealed(MAGIC + HEADER + schema * 20))
    open_bag(file).check()


def test_repair_refuses_more_entries_than_an_index_holds(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index, "MOST_ENTRIES", 10)
    file.write_bytes(MAGIC + HEADER + attachment(b"a", b"") * 11 + bytes(40))
    with pytest.raises(DamagedBagError, match=r"x\.mcap: at byte \d+: more than 10 attachments; nothing can be saved"):
        repair_bag(file)
    assert [path.name for path in file.parent.iterdir()] == ["x.mcap"]


@pytest.mark.parametrize("chunked", [True, False])
def test_field_that_reaches_beyond_its_record(chunked: bool, file: Path) -> None:  # noqa: FBT001
    """A reader that does not stop there takes the next records for its content."""
    schema = record(Opcode.SCHEMA, struct.pack("<H", 1) + text(b"x") + text(b"y") + struct.pack("<I", 9) + b"12345678")
    file.write_bytes(MAGIC + HEADER + (chunk(schema) if chunked else schema) + bytes(40))
    with pytest.raises(DamagedBagError, match="malformed Schema record: a field of 9 bytes, but 8 are left"):
        open_bag(file)


def test_schema_larger_than_any(file: Path) -> None:
    content = struct.pack("<H", 1) + text(b"x" * 2**24) + text(b"") + text(b"")
    file.write_bytes(MAGIC + HEADER + record(Opcode.SCHEMA, content) + bytes(40))
    with pytest.raises(DamagedBagError, match="a Schema record of more than 16777216 bytes"):
        open_bag(file)


@pytest.mark.parametrize(
    "provenance",
    [b'{"versions": {"a": [[]], "b": 1e999, "c": "1"}}', b'{"versions": {"c": "1"}, "libm_fingerprint": 9}'],
)
def test_versions_are_texts(provenance: bytes, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", topics=MAIN_TOPICS, attachments={"provenance.json": provenance}):
        pass
    info = bag_info(tmp_path)
    assert (info.versions, info.fingerprint) == ({"c": "1"}, None)

"""What damage and bad intentions once achieved: each lie is named with its place, and none does harm."""

import resource
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zstandard
from mcap.opcode import Opcode
from tests.swarmabs_bag.conftest import WriteBag
from tests.swarmabs_bag.damage import HOSTILE_TEXTS
from tests.swarmabs_bag.mcap_files import (
    HEADER,
    MAGIC,
    attachment,
    channel,
    chunk,
    described,
    joined,
    message,
    record,
    schema,
    sealed,
    split,
    text,
)
from tests.swarmabs_bag.sample_run import make_run, write_bag as write

from swarmabs_analysis.figures.runs import find_runs
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.attached import scenario_of
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.info import bag_info
from swarmabs_bag.mcap import index
from swarmabs_bag.mcap.index import FileIndex
from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair import repair_bag
from swarmabs_bag.repair.completeness import complete_steps
from swarmabs_bag.run.writer import BAG_FILE
from swarmabs_core.errors import InputError
from swarmabs_core.messages import MAIN_TOPICS, Message

MESSAGE = message()
TERABYTE = 2**40


@pytest.fixture
def whole(bag: Path) -> bytes:
    return (bag / "bag_0.mcap").read_bytes()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "x.mcap"


# Files made by hand, one lie each


def longer(lie: bytes, length: int) -> bytes:
    """Return a record that says to be of another length."""
    return lie[:1] + struct.pack("<Q", length) + lie[9:]


def unpacked(compression: bytes, length: int) -> bytes:
    """Return a chunk that says to be compressed, and of some length."""
    head = struct.pack("<QQQI", 0, 0, len(MESSAGE), 0) + text(compression)
    return record(Opcode.CHUNK, head + struct.pack("<Q", length) + MESSAGE)


@pytest.mark.parametrize(
    ("lie", "problem"),
    [
        (chunk(MESSAGE, size=2**40), "a chunk of 1099511627776 bytes when uncompressed"),
        (chunk(MESSAGE, size=5), "its zstd frame states"),
        (chunk(MESSAGE, crc=5), "CRC of the chunk is"),
        (chunk(MESSAGE, "rar"), "unknown compression 'rar'"),
        (unpacked(b"lz4", len(MESSAGE)), "the chunk cannot be uncompressed"),
        (unpacked(b"\xff", len(MESSAGE)), "malformed Chunk record"),
        (unpacked(b"", 3), "a chunk of 3 bytes in a record"),
        (chunk(MESSAGE[:-1], ""), "exceeds its chunk"),
        (chunk(MESSAGE + b"\x05", ""), "ends within the head of a record"),
        (chunk(record(Opcode.MESSAGE, b"short"), ""), "a message record is cut off"),
        (chunk(bytes(2**16), "zstd", size=2**27, crc=0), "a chunk of 134217728 bytes uncompressed, but"),
        (chunk(bytes(2**16), "lz4", size=2**27, crc=0), "a chunk of 134217728 bytes uncompressed, but"),
        (chunk(schema(1, b"x", reaching=1)), "malformed Schema record: a field of 9 bytes, but only 8 are left"),
        (record(Opcode.CHUNK, b""), "malformed Chunk record: a field of 8 bytes, but only 0 are left"),
        (longer(record(Opcode.CHUNK, b""), 2**63), "a record of 9223372036854775808 bytes begins"),
        (record(Opcode.MESSAGE, b"short"), "a message record is cut off"),
        (schema(1, b"x", reaching=1), "malformed Schema record: a field of 9 bytes, but only 8 are left"),
        (schema(1, b"x" * 2**24), "a Schema record of more than 16777216 bytes"),
        (record(Opcode.CHANNEL, struct.pack("<HHI", 1, 1, 2**32 - 1)), "malformed Channel record"),
        (record(Opcode.ATTACHMENT, bytes(16) + text(b"") * 2 + b"\xff" * 8), "malformed Attachment record"),
        (record(Opcode.METADATA, text(b"\xff")), "malformed Metadata record"),
        (record(Opcode.MESSAGE_INDEX, b""), "malformed MessageIndex record"),
        (record(Opcode.MESSAGE_INDEX, struct.pack("<HI", 1, 2**32 - 1)), "malformed MessageIndex record"),
        (record(Opcode.MESSAGE_INDEX, struct.pack("<HI", 1, 17) + bytes(17)), "malformed MessageIndex record"),
        (record(Opcode.FOOTER, bytes(20)), "a footer without an end of the data section"),
        (b"", "zeros instead of a record"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_lie_is_named_with_its_place(lie: bytes, problem: str, file: Path) -> None:
    file.write_bytes(MAGIC + HEADER + lie + bytes(40))
    place = len(MAGIC + HEADER) + (len(lie) if "footer" in problem else 0)
    with pytest.raises(DamagedBagError, match=rf"at byte {place}: .*{problem}"):
        open_bag(file)


def test_small_file_cannot_make_the_reader_allocate_much(file: Path) -> None:
    """A frame of zeros without stated size, said to be small, must not be unpacked to its real size."""
    packed = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(2**28))
    assert len(packed) < 2**16
    for size in (100, 2**28 + 1):
        content = struct.pack("<QQQI", 0, 0, size, 0) + text(b"zstd") + struct.pack("<Q", len(packed)) + packed
        file.write_bytes(MAGIC + HEADER + record(Opcode.CHUNK, content) + bytes(40))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with pytest.raises(DamagedBagError):
            open_bag(file)
        assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 < 2**26


def test_index_has_an_end(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index, "MOST_ENTRIES", 10)
    monkeypatch.setattr(index, "MOST_DEFINITIONS", 100)
    for many, problem in (
        (chunk(b"") * 11, "more than 10 chunks"),
        (attachment(b"a", b"") * 11, "more than 10 attachments"),
        (described(b"") * 11, "more than 10 metadata records"),
        ((schema(1, b"x" * 30) + schema(1, b"y" * 30)) * 2, "schemas and channels of more than 100 bytes"),
    ):
        file.write_bytes(MAGIC + HEADER + many + bytes(40))
        with pytest.raises(DamagedBagError, match=problem):
            open_bag(file)
        with pytest.raises(DamagedBagError, match=rf"x\.mcap: at byte \d+: {problem}; nothing can be recovered"):
            repair_bag(file)
        assert [path.name for path in file.parent.iterdir()] == ["x.mcap"]
    file.write_bytes(sealed(MAGIC + HEADER + schema(1, b"x") * 20))
    open_bag(file).check()


# Whole files whose summary section lies


Change = Callable[[FileIndex], object]


def number(name: str, value: int = 7) -> Change:
    return lambda found: setattr(found.statistics, name, value)


@pytest.mark.parametrize(
    ("problem", "change"),
    [
        *((f"the summary states {name} = 7, but it is", number(name)) for name in (
            "message_count", "message_start_time", "message_end_time", "chunk_count", "attachment_count",
        )),
        ("the summary states messages of channel 2 = 40, but it is 41",
         lambda found: found.statistics.channel_message_counts.update({2: 40})),
        ("the summary lists other chunks than those in the file", lambda found: found.chunks.reverse()),
        ("the summary lists other attachments", lambda found: setattr(found.attachments[1], "data_size", 7)),
        ("the summary lists other metadata records", lambda found: setattr(found.metadata[0], "name", "x")),
        ("the summary describes other topics", lambda found: setattr(found.channels[2], "topic", "/x")),
        ("the summary describes other topics", lambda found: setattr(found.schemas[2], "name", "x")),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_info_and_repair_agree_on_what_is_wrong_with_a_summary(
    problem: str, change: Change, whole: bytes, file: Path, run: list[Message]
) -> None:
    file.write_bytes(sealed(joined(split(whole)), change))
    with pytest.raises(DamagedBagError, match=problem):
        open_bag(file).check()
    assert problem in (bag_info(file).problem or "")
    report = repair_bag(file)
    assert report.files[0].problems[0].startswith(problem)
    assert (report.messages, report.lost_bytes) == (len(run), 0)
    assert bag_info(str(report.output)).complete


def test_a_start_that_the_go_library_takes_for_unknown_is_no_damage(tmp_path: Path) -> None:
    """Its writer states the start of the first chunk that does not begin at time 0."""
    file = write(tmp_path / "bag", make_run(steps=100), chunk_bytes=4000) / BAG_FILE
    starts = [chunk.message_start_time for chunk in open_bag(file).index.chunks]
    assert starts[0] == 0
    later = next(start for start in starts if start)
    (file.parent / "metadata.yaml").unlink()
    file.write_bytes(sealed(file.read_bytes()[: open_bag(file).index.data_end], number("message_start_time", later)))
    bag = open_bag(file)
    bag.check()
    assert bag.start == 0
    assert repair_bag(file).output is None  # there is nothing to repair
    known = schema(1, b"std_msgs/msg/String") + channel(1, 1, b"/chatter")
    empty, later_chunk = chunk(b"", times=(0, 0)), chunk(known + message(time=5), times=(5, 5))
    file.write_bytes(sealed(MAGIC + HEADER + empty + later_chunk))
    assert open_bag(file).start == 5, "a chunk without messages does not begin at time 0"


def test_of_several_scenarios_info_and_repair_say_the_same(tmp_path: Path, whole: bytes) -> None:
    """No repair can tell which of them is the right one, also if there is something else to repair."""
    twice = joined(split(whole)) + attachment(b"scenario.yaml", b"schema: 1\n")
    for name, data in (("whole", sealed(twice)), ("cut", twice)):
        (tmp_path / f"{name}.mcap").write_bytes(data)
        report = repair_bag(tmp_path / f"{name}.mcap")
        assert (report.output is None) == (name == "whole")
        info = bag_info(report.output or tmp_path / f"{name}.mcap")
        assert info.problem == report.undecided == "it contains several scenarios and does not state which one was run"
    same = joined(split(whole)) + attachment(b"run.log", b"another")
    (tmp_path / "same.mcap").write_bytes(sealed(same))
    assert repair_bag(tmp_path / "same.mcap").undecided is bag_info(tmp_path / "same.mcap").problem is None


def test_files_as_large_as_a_disk_are_not_searched_and_lies_that_a_summary_hides_are_named(file: Path) -> None:
    """The first is of zeros, the second has them for its summary section, the third lies in a chunk."""
    end = record(Opcode.DATA_END, bytes(4))
    footer = record(Opcode.FOOTER, struct.pack("<QQI", len(MAGIC + HEADER + end), 0, 1)) + MAGIC
    for last, problem in ((b"", f"at byte {len(MAGIC + HEADER)}: zeros"), (footer, "is incomplete")):
        with file.open("wb") as stream:
            stream.write(MAGIC + HEADER + (end if last else b""))
            stream.truncate(TERABYTE)
            stream.seek(TERABYTE)
            stream.write(last)
        with pytest.raises(DamagedBagError, match=problem):
            open_bag(file)
        assert not bag_info(file).complete
    file.write_bytes(sealed(MAGIC + HEADER + chunk(record(Opcode.MESSAGE, b"short"), "")))
    with pytest.raises(DamagedBagError, match=rf"at byte {len(MAGIC + HEADER)}: a message record is cut off"):
        list(open_bag(file).stored_messages())


def test_summary_or_attachment_that_is_elsewhere(whole: bytes, file: Path) -> None:
    def elsewhere(number: int, offset: int | None = None) -> Change:
        def change(found: FileIndex) -> None:
            found.attachments[0].offset = found.attachments[number].offset if offset is None else offset

        return change

    for change, problem in (
        (elsewhere(0, 2**64 - 1), "18446744073709551615: a record should be here"),
        (elsewhere(0, len(MAGIC)), "the summary states an attachment here"),
        (elsewhere(1), r"the attachment is not 'scenario\."),
    ):
        file.write_bytes(sealed(joined(split(whole)), change))
        with pytest.raises(DamagedBagError, match=problem):
            open_bag(file).attachment("scenario.yaml")
    for place, problem in ((2**60, "cannot begin at byte 1152921504606846976"), (9, "CRC of")):
        file.write_bytes(whole[:-28] + struct.pack("<Q", place) + whole[-20:])
        with pytest.raises(DamagedBagError, match=problem):
            open_bag(file)


def test_chunk_that_became_something_unknown_is_missed(
    whole: bytes, file: Path, tmp_path: Path, run: list[Message], write_bag: WriteBag
) -> None:
    """The format tells readers to pass over records of kinds that they do not know."""
    records = split(whole)
    place = [place for place, found in enumerate(records) if found.opcode == Opcode.CHUNK][1]
    records[place] = records[place]._replace(opcode=0x80)
    file.write_bytes(sealed(joined(records), number("message_count", len(run))))
    with pytest.raises(DamagedBagError, match=f"the summary states message_count = {len(run)}, but it is "):
        list(open_bag(file).messages())
    with pytest.raises(DamagedBagError, match="message_count"):
        load_arrays(file)
    # If another record becomes a message, the number of messages is right, but not the CRC of the data section.
    data = bytearray((write_bag(tmp_path / "bag", run[:1]) / "bag_0.mcap").read_bytes())
    became = {Opcode.CHUNK: 0x80, Opcode.MESSAGE_INDEX: Opcode.MESSAGE}
    for found in split(bytes(data)):
        data[found.offset] = became.get(Opcode(found.opcode), found.opcode)
    file.write_bytes(data)
    with pytest.raises(DamagedBagError, match="CRC of the data section is"):
        list(open_bag(file).messages())


# Texts


@pytest.mark.parametrize("hostile", HOSTILE_TEXTS, ids=lambda value: repr(value[:20]))
def test_hostile_texts_say_nothing(hostile: bytes, file: Path) -> None:
    """Read as a scenario, a provenance and a description, which has to be a text."""
    provenance = hostile.replace(b"1e999", b'1e999, "c": "1"')
    attached = attachment(b"scenario.yaml", hostile) + attachment(b"provenance.json", provenance)
    is_text = hostile.decode(errors="ignore").encode() == hostile
    file.write_bytes(sealed(MAGIC + HEADER + attached + (described(hostile) if is_text else b"")))
    info = bag_info(file)
    assert (info.scenario, info.repaired) == (None, None)
    assert (info.aborted or "").encode() in hostile
    assert info.versions == ({"c": "1"} if b"1e999" in hostile else {"a": "\ud800"} if b"ud800" in hostile else {})
    assert info.arithmetic in {None, 2}
    with pytest.raises(InputError, match=r"x\.mcap:scenario\.yaml") as caught:
        scenario_of(str(file))
    assert str(caught.value).isprintable()
    with pytest.raises(InputError):
        find_runs([file], {"sample"})


@pytest.mark.parametrize(
    ("reason", "said"),
    [("stalled", "stalled"), ("2000-01-01", "2000-01-01"), ("[[]]", None), ("{a: b}", None), ("!!binary aGk=", None)],
)
def test_reason_of_an_early_end_is_a_text_or_nothing(reason: str, said: str | None, file: Path) -> None:
    for key in ("aborted", "repaired"):
        file.write_bytes(sealed(MAGIC + HEADER + described(f"custom_data: {{swarmabs.{key}: {reason}}}".encode())))
        assert getattr(bag_info(file), key) == said


def test_names_of_topics_cannot_break_the_line_of_an_error(file: Path) -> None:
    definitions = schema(1, MAIN_TOPICS[1].ros_type.encode())
    for place, prefix in enumerate((b"/a\n\x1b[2J", b"/" + b"b" * 10_000, *(b"/c%d" % n for n in range(20)))):
        definitions += channel(place, 1, prefix + b"/plane/state")
    file.write_bytes(sealed(MAGIC + HEADER + definitions))
    for namespace in (None, "/other"):
        with pytest.raises(NotABagError) as caught:
            open_bag(file, namespace=namespace)
        assert str(caught.value).isprintable()
        assert "/a\\n\\x1b[2J, " in str(caught.value)
        assert str(caught.value).endswith(", 17 more")
        assert len(str(caught.value)) < 1000


def test_a_robot_that_joins_after_a_lifetime(tmp_path: Path, run: list[Message]) -> None:
    robots = b", ".join(b"{id: %d, kind: single_integrator, mass: 1.0, position: 0.0%d}" % (i, i) for i in (1, 2, 7, 9))
    scenario = b"schema: 1\nduration: 2147483647.0\nstep: 1.0e-9\nswarm: {agents: [%s]}\n" % robots
    scenario += b"faults: [{kind: join, at: 2147483000.0, agent: 9}]\n"
    found: Any = complete_steps(write(tmp_path / "bag", run, {"scenario.yaml": scenario}))
    assert (found.first, found.last_complete, found.last_planned) == (0, 40, 2147483647 * 10**9)

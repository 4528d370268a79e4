"""Bags of steps: byte for byte those of their messages one after the other, and those of the mcap library."""

import io
from pathlib import Path
from random import Random

import pytest
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from tests.swarmabs_bag.sample_run import PERIOD
from tests.swarmabs_bag.test_step import at_random, run
from tests.swarmabs_bag.test_writer import Clock, Disk, on_disk
from tests.swarmabs_core.helpers import together

from swarmabs_bag.errors import BagWriteError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run.writer import CHUNK_BYTES, BagWriter
from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_core.messages import EVENTS, STANDING

pytestmark = pytest.mark.usefixtures("systems")


def bag_writer(name: str, folder: Path, **options: object) -> BagWriter:
    scenario, steps = run(name)
    family = scenario.family
    divided = any(record.topic is STANDING for step in steps for record in step.records)
    topics = (*family.once, *family.main, *((STANDING,) if divided else ()), EVENTS)
    return BagWriter(folder, topics=topics, attachments={"scenario.yaml": b"name: x\n"}, **options)


def files(name: str, folder: Path, seed: int | None, **options: object) -> dict[str, bytes]:
    """Write a run to a bag, message by message or some steps at once by a seed, and return its files."""
    steps = run(name)[1]
    with bag_writer(name, folder, monotonic=Clock(), **options) as writer:
        for step in [] if seed is None else at_random(steps, Random(seed)):
            writer.write_step(step)
        for stored in () if seed is not None else (stored for step in steps for stored in step.stored()):
            writer.write(*stored)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("name", "chunk_bytes", "split", "number"),
    [
        ("pd_di_4", 1, ONE_FILE, 1),
        ("pd_di_4", 1, Split(bytes=6000), 2),
        ("pd_di_4", 3001, Split(bytes=1), 3),
        ("pd_di_4", CHUNK_BYTES, Split(nanoseconds=4 * PERIOD), 6),
        ("arise_het_20", 3001, ONE_FILE, 1),
        ("arise_het_20", 3001, Split(5000, 5 * PERIOD), 5),
        ("sheet", 3001, ONE_FILE, 1),
        ("sheet", 3001, Split(5000, 5 * PERIOD), 5),
        ("sheet", CHUNK_BYTES, ONE_FILE, 1),
    ],
)
def test_steps_are_written_as_their_messages_are(
    name: str, chunk_bytes: int, split: Split, number: int, tmp_path: Path
) -> None:
    single = files(name, tmp_path / "single", None, split=split, chunk_bytes=chunk_bytes)
    assert len(single) > number, "so many files, and metadata.yaml"
    assert files(name, tmp_path / "together", 1, split=split, chunk_bytes=chunk_bytes) == single


@pytest.mark.parametrize("chunk_bytes", [1, 3001, CHUNK_BYTES])
@pytest.mark.parametrize("name", ["pd_di_4", "sheet", ""])
def test_files_are_those_of_the_mcap_library(name: str, chunk_bytes: int, tmp_path: Path) -> None:
    if name:
        written = files(name, tmp_path / "bag", 3, chunk_bytes=chunk_bytes)["bag_0.mcap"]
    else:
        with BagWriter(tmp_path / "bag", topics=(EVENTS,), attachments={}) as empty:
            pass
        written = empty.path.read_bytes()
    output = io.BytesIO()
    library = Writer(output, chunk_size=chunk_bytes, enable_data_crcs=True)
    read = StreamReader(io.BytesIO(written), validate_crcs=True).records
    definitions: set[tuple[type, int]] = set()
    for record in read:
        match record:
            case Header(profile, made_by):
                library.start(profile, made_by)
            case Attachment(created, logged, label, media_type, data):
                library.add_attachment(created, logged, label, media_type, data)
            case Schema(number, data, encoding, label) if (Schema, number) not in definitions:
                definitions.add((Schema, library.register_schema(label, encoding, data)))
            case Channel(number, topic, encoding, metadata, schema) if (Channel, number) not in definitions:
                definitions.add((Channel, library.register_channel(topic, encoding, schema, metadata)))
            case Message(channel, logged, data, published, sequence):
                library.add_message(channel, logged, data, published, sequence)
            case Metadata(label, described):
                library.flush()
                library.add_metadata(label, described)
    library.finish()
    assert output.getvalue() == written


def test_steps_reach_the_disk_when_their_chunk_is_full_or_old(tmp_path: Path) -> None:
    clock, steps = Clock(), run("pd_het_4")[1]
    with bag_writer("pd_het_4", tmp_path / "bag", chunk_bytes=17_000, monotonic=clock) as writer:
        one, other = together(steps, [1, len(steps)])
        writer.write_step(one)
        assert on_disk(writer.path) == []
        clock.now += 1.0
        writer.poll()
        assert on_disk(writer.path) == [0] * 8
        writer.write_step(other)
        full = len(on_disk(writer.path)) - 8
        assert 0 < full < 20 * 8, "as much as fills a chunk"
        clock.now += 0.5
        writer.poll()
        assert len(on_disk(writer.path)) == 8 + full
        clock.now += 0.5
        writer.poll()
        assert len(on_disk(writer.path)) == 21 * 8, "the rest was as old"


@pytest.mark.parametrize("free", [0, 2000, 5000, 9000])
def test_full_disk_keeps_the_chunks_before_that_of_the_steps(
    free: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, steps = Disk(monkeypatch), run("pd_het_4")[1]
    (whole,) = together(steps, [len(steps)])
    writer = bag_writer("pd_het_4", tmp_path / "bag", chunk_bytes=3000)
    disk.free = free
    with pytest.raises(BagWriteError, match="No space left") as first:
        writer.write_step(whole)
    with pytest.raises(BagWriteError) as later:
        writer.write_step(whole)
    assert later.value is first.value
    writer.abort("full")
    found = list(open_bag(tmp_path / "bag").messages())
    assert found == list(whole.stored())[: len(found)]
    assert (len(found) > 0) == (free > 2000)

"""What stands in the file, record by record, read with the mcap library and by hand."""

from __future__ import annotations

import shutil
import struct
import subprocess
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from swarmabs_config.graph import LOCKSTEP, OFFERED
from swarmabs_core.cdr import encode
from swarmabs_core.messages import AGENT_STATE, EVENTS, MAIN_TOPICS, PLANE_STATE, TOPIC_OF, Message

NAMES = [f"/{topic.name}" for topic in (*MAIN_TOPICS, EVENTS)]
INFINITE = {"sec": 9223372036, "nsec": 854775807}


@pytest.fixture
def file(bag: Path) -> Path:
    return bag / "bag_0.mcap"


def summary_of(file: Path) -> Summary:
    with file.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None
    return summary


def records_of(file: Path, *, emit_chunks: bool = True) -> list[McapRecord]:
    with file.open("rb") as stream:
        return list(StreamReader(stream, emit_chunks=emit_chunks, validate_crcs=True).records)


def test_file_says_what_it_is_and_who_wrote_it(file: Path) -> None:
    header = records_of(file)[0]
    assert isinstance(header, Header)
    assert header.profile == "ros2"
    assert header.library.split()[0] == "swarmabs"


def test_schemas_are_complete_and_complete_in_the_data_section_too(file: Path) -> None:
    schemas = summary_of(file).schemas
    assert {schema.name for schema in schemas.values()} == {topic.ros_type for topic in (*MAIN_TOPICS, EVENTS)}
    for schema in schemas.values():
        assert schema.encoding == "ros2msg"
        head, *nested = schema.data.decode().split("=" * 80 + "\n")
        assert "std_msgs/Header header" in head
        assert [text.splitlines()[0] for text in nested] == [
            "MSG: builtin_interfaces/Time",
            "MSG: std_msgs/Header",
        ]
    inside = {record.id: record for record in records_of(file, emit_chunks=False) if isinstance(record, Schema)}
    assert inside == schemas


def test_channels_tell_qos_and_type_hash(file: Path) -> None:
    channels = summary_of(file).channels
    assert [channel.topic for channel in channels.values()] == NAMES
    for channel, topic in zip(channels.values(), (*MAIN_TOPICS, EVENTS), strict=True):
        assert channel.message_encoding == "cdr"
        assert channel.metadata.keys() == {"offered_qos_profiles", "topic_type_hash"}
        assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
        assert yaml.safe_load(channel.metadata["offered_qos_profiles"]) == [
            {
                "history": "keep_last",
                "depth": OFFERED[LOCKSTEP][topic].depth,
                "reliability": OFFERED[LOCKSTEP][topic].reliability,
                "durability": OFFERED[LOCKSTEP][topic].durability,
                "deadline": INFINITE,
                "lifespan": INFINITE,
                "liveliness": "automatic",
                "liveliness_lease_duration": INFINITE,
                "avoid_ros_namespace_conventions": False,
            }
        ]


def test_chunks_are_compressed_checked_and_indexed(file: Path, run: list[Message]) -> None:
    data = file.read_bytes()
    summary = summary_of(file)
    assert len(summary.chunk_indexes) > 3
    offsets_seen = 0
    for entry in summary.chunk_indexes:
        assert entry.compression == "zstd"
        assert data[entry.chunk_start_offset] == Opcode.CHUNK
        chunk = record_at(data, entry.chunk_start_offset)
        assert isinstance(chunk, Chunk)
        assert chunk.uncompressed_crc != 0
        for channel, offset in entry.message_index_offsets.items():
            index = record_at(data, offset)
            assert isinstance(index, MessageIndex)
            assert index.channel_id == channel
            offsets_seen += len(index.records)
    assert offsets_seen == len(run)


def record_at(data: bytes, offset: int) -> McapRecord:
    return next(iter(StreamReader(BytesIO(data[offset:]), skip_magic=True, emit_chunks=True).records))


def test_summary_counts_every_message(file: Path, run: list[Message]) -> None:
    statistics = summary_of(file).statistics
    assert isinstance(statistics, Statistics)
    assert statistics.message_count == len(run)
    assert (statistics.message_start_time, statistics.message_end_time) == (0, run[-1].stamp)
    assert statistics.channel_count == statistics.schema_count == len(NAMES)
    assert statistics.attachment_count == 3
    assert statistics.metadata_count == 1
    assert statistics.channel_message_counts == {1: 123, 2: 41, 3: 41, 4: 41, 5: 41, 6: 1}
    assert sum(1 for record in records_of(file) if isinstance(record, ChunkIndex)) == statistics.chunk_count


def test_every_record_of_the_data_section_lies_under_its_crc(file: Path) -> None:
    data = file.read_bytes()
    position = 8
    while data[position] != Opcode.DATA_END:
        (length,) = struct.unpack_from("<Q", data, position + 1)
        position += 9 + length
    (crc,) = struct.unpack_from("<I", data, position + 9)
    assert crc == zlib.crc32(data[:position])


def test_messages_stand_in_the_order_they_were_written(file: Path, run: list[Message]) -> None:
    with file.open("rb") as stream:
        found = [
            (channel.topic, message.log_time, message.publish_time, message.data)
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        ]
    assert found == [
        (f"/{TOPIC_OF[type(message)].name}", message.stamp, message.stamp, encode(message)) for message in run
    ]


def test_sequence_numbers_count_the_messages_of_each_channel(file: Path) -> None:
    sequences: dict[str, list[int]] = {name: [] for name in NAMES}
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            sequences[channel.topic].append(message.sequence)
    assert all(numbers == list(range(len(numbers))) for numbers in sequences.values())


def test_attachments_stand_where_they_are_needed(file: Path) -> None:
    kinds = [(type(record).__name__, getattr(record, "name", "")) for record in records_of(file)]
    data_section = kinds[: kinds.index(("DataEnd", ""))]
    attached = [kind for kind in data_section if kind[0] in {"Attachment", "Chunk"}]
    assert attached[:2] == [("Attachment", "scenario.yaml"), ("Attachment", "provenance.json")]
    assert attached[-1] == ("Attachment", "run.log")
    assert {kind[0] for kind in attached[2:-1]} == {"Chunk"}
    with file.open("rb") as stream:
        media = {entry.name: entry.media_type for entry in make_reader(stream).iter_attachments()}
    assert media == {
        "scenario.yaml": "application/yaml",
        "provenance.json": "application/json",
        "run.log": "text/plain",
    }


def description_in(file: Path) -> dict[str, Any]:
    with file.open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    assert isinstance(record, Metadata)
    assert record.name == "rosbag2"
    found = yaml.safe_load(record.metadata["serialized_metadata"])
    assert isinstance(found, dict)
    return found


def test_rosbag2_metadata_in_the_file_is_that_beside_it(file: Path) -> None:
    beside = yaml.safe_load((file.parent / "metadata.yaml").read_text(encoding="utf-8"))
    assert beside == {"rosbag2_bagfile_information": description_in(file)}


def test_rosbag2_metadata_agrees_with_the_file(file: Path, run: list[Message]) -> None:
    found = description_in(file)
    summary = summary_of(file)
    assert summary.statistics is not None
    topics = found.pop("topics_with_message_count")
    assert found == {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": run[-1].stamp},
        "starting_time": {"nanoseconds_since_epoch": 0},
        "message_count": len(run),
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": ["bag_0.mcap"],
        "files": [
            {
                "path": "bag_0.mcap",
                "starting_time": {"nanoseconds_since_epoch": 0},
                "duration": {"nanoseconds": run[-1].stamp},
                "message_count": len(run),
            }
        ],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    for topic, channel in zip(topics, summary.channels.values(), strict=True):
        assert isinstance(channel, Channel)
        assert topic == {
            "topic_metadata": {
                "name": channel.topic,
                "type": summary.schemas[channel.schema_id].name,
                "serialization_format": "cdr",
                "offered_qos_profiles": yaml.safe_load(channel.metadata["offered_qos_profiles"]),
                "type_description_hash": channel.metadata["topic_type_hash"],
            },
            "message_count": summary.statistics.channel_message_counts.get(channel.id, 0),
        }


def test_metadata_has_no_yaml_that_other_parsers_stumble_over(bag: Path) -> None:
    text = (bag / "metadata.yaml").read_text(encoding="utf-8")
    assert not {"&", "*", "!"} & set(text)
    assert text.isascii()


def test_folder_holds_nothing_else(bag: Path) -> None:
    assert sorted(path.name for path in bag.iterdir()) == ["bag_0.mcap", "metadata.yaml"]


@pytest.mark.skipif(shutil.which("mcap") is None, reason="the mcap command-line tool is not installed")
def test_mcap_doctor_has_no_complaint(file: Path) -> None:
    found = subprocess.run(["mcap", "doctor", str(file)], capture_output=True, text=True, check=False, timeout=15)
    assert found.returncode == 0, found.stderr


def test_offered_qos_of_agents_and_plane_differ_as_the_table_says(file: Path) -> None:
    profiles = {
        channel.topic: yaml.safe_load(channel.metadata["offered_qos_profiles"])[0]
        for channel in summary_of(file).channels.values()
    }
    assert profiles[f"/{AGENT_STATE.name}"]["reliability"] == "best_effort"
    assert profiles[f"/{PLANE_STATE.name}"]["reliability"] == "reliable"
    assert profiles[f"/{EVENTS.name}"]["durability"] == "transient_local"

"""What stands in the file, record by record, and what the readers that people have make of it."""

import json
import os
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
import yaml
from mcap.opcode import Opcode
from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.records import Header, McapRecord, MessageIndex, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tests.swarmabs_bag.mcap_files import split

from swarmabs_bag.errors import UnknownTypeError
from swarmabs_bag.mcap.records import parse, read_record
from swarmabs_bag.run.metadata import BagChannel, FileRecord, bag_metadata, dump_yaml, qos_profile, write_metadata
from swarmabs_bag.run.schemas import message_schema
from swarmabs_config.graph import LOCKSTEP, OFFERED, Qos
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, TOPIC_OF, TOPICS, Message

FIELDS = {f"/{topic.name}": topic.message._fields for topic in (*MAIN_TOPICS, EVENTS)}


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


def test_records_stand_where_they_are_needed(file: Path) -> None:
    records = records_of(file)
    header = records[0]
    assert isinstance(header, Header)
    assert (header.profile, header.library.split()[0]) == ("ros2", "swarmabs")
    kinds = [(type(record).__name__, getattr(record, "name", "")) for record in records]
    end = kinds.index(("DataEnd", ""))
    first, second, *chunks, last = (kind for kind in kinds[:end] if kind[0] in {"Attachment", "Chunk"})
    attached = [("Attachment", name) for name in ("scenario.yaml", "provenance.json", "run.log")]
    assert ([first, second, last], {*chunks}) == (attached, {("Chunk", "")})
    parts = "DataEnd Schema Channel Statistics ChunkIndex AttachmentIndex MetadataIndex SummaryOffset Footer"
    assert {kind for kind, _ in kinds[end:]} == {*parts.split()}
    with file.open("rb") as stream:
        media = [entry.media_type for entry in make_reader(stream).iter_attachments()]
    assert media == ["application/yaml", "application/json", "text/plain"]


def test_schemas_are_complete_and_complete_in_the_data_section_too(file: Path) -> None:
    schemas = summary_of(file).schemas
    assert {schema.name for schema in schemas.values()} == {topic.ros_type for topic in (*MAIN_TOPICS, EVENTS)}
    for schema in schemas.values():
        head, *nested = schema.data.decode().split("=" * 80 + "\n")
        assert "std_msgs/Header header" in head
        assert [text.splitlines()[0] for text in nested] == ["MSG: builtin_interfaces/Time", "MSG: std_msgs/Header"]
    assert {one.id: one for one in records_of(file, emit_chunks=False) if isinstance(one, Schema)} == schemas


def test_chunks_are_compressed_checked_and_indexed(file: Path, run: list[Message]) -> None:
    data, chunks = file.read_bytes(), summary_of(file).chunk_indexes
    records = {found.offset: found for found in split(data)}
    assert len(chunks) > 3
    indexed = 0
    for entry in chunks:
        assert entry.compression == "zstd"
        assert records[entry.chunk_start_offset].opcode == Opcode.CHUNK
        assert int.from_bytes(records[entry.chunk_start_offset].content[24:28], "little") != 0, "no CRC"
        for channel, offset in entry.message_index_offsets.items():
            index = parse(MessageIndex, records[offset])
            assert index.channel_id == channel
            indexed += len(index.records)
    assert indexed == len(run)
    end = split(data)[-1].end
    with file.open("rb") as stream:
        assert int.from_bytes(read_record(stream, end, len(data)).content, "little") == zlib.crc32(data[:end])


def test_rosbag2_metadata_in_the_file_and_beside_it_is_that_of_the_file(file: Path, run: list[Message]) -> None:
    with file.open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    assert record.name == "rosbag2"
    found = yaml.safe_load(record.metadata["serialized_metadata"])
    text = (file.parent / "metadata.yaml").read_text(encoding="utf-8")
    assert yaml.safe_load(text) == {"rosbag2_bagfile_information": found}
    assert not {"&", "*", "!"} & set(text), "other parsers stumble over these"
    assert text.isascii()
    assert sorted(path.name for path in file.parent.iterdir()) == ["bag_0.mcap", "metadata.yaml"]
    assert (found["message_count"], found["duration"]) == (len(run), {"nanoseconds": run[-1].stamp})
    assert (found["custom_data"], found["relative_file_paths"]) == (None, ["bag_0.mcap"])
    summary = summary_of(file)
    assert summary.statistics is not None
    topics = zip(found["topics_with_message_count"], summary.channels.values(), (*MAIN_TOPICS, EVENTS), strict=True)
    for listed, channel, topic in topics:
        offered, type_hash = [qos_profile(OFFERED[LOCKSTEP][topic])], message_schema(topic.ros_type).type_hash
        assert yaml.safe_load(channel.metadata["offered_qos_profiles"]) == offered
        assert channel.metadata["topic_type_hash"] == type_hash
        assert listed == {
            "topic_metadata": {
                "name": channel.topic,
                "type": summary.schemas[channel.schema_id].name,
                "serialization_format": "cdr",
                "offered_qos_profiles": offered,
                "type_description_hash": type_hash,
            },
            "message_count": summary.statistics.channel_message_counts.get(channel.id, 0),
        }


# Other readers

Decoded = Iterator[tuple[str, int, object]]


def read_with_mcap(make: Callable[..., McapReader], bag: Path) -> Decoded:
    sequence = dict.fromkeys(FIELDS, 0)
    with (bag / "bag_0.mcap").open("rb") as stream:
        reader = make(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            assert (message.sequence, message.publish_time) == (sequence[channel.topic], message.log_time)
            sequence[channel.topic] += 1
            yield channel.topic, message.log_time, decoded


def read_with_rosbags(bag: Path) -> Decoded:
    with AnyReader([bag]) as reader:
        for connection, time, data in reader.messages():
            yield connection.topic, time, reader.deserialize(data, connection.msgtype)


@pytest.mark.parametrize(
    "read", [partial(read_with_mcap, make_reader), partial(read_with_mcap, NonSeekingReader), read_with_rosbags]
)
def test_every_field_reads_as_written(read: Callable[[Path], Decoded], bag: Path, run: list[Message]) -> None:
    for (topic, time, found), message in zip(read(bag), run, strict=True):
        assert (topic, time) == (f"/{TOPIC_OF[type(message)].name}", message.stamp)
        header = getattr(found, "header")  # noqa: B009 - its class is made at run time
        assert (header.stamp.sec, header.stamp.nanosec, header.frame_id) == (*divmod(message.stamp, 10**9), "plane")
        assert tuple(getattr(found, name) for name in FIELDS[topic][1:]) == message[1:]


# rosbag2's texts, word for word


RELIABLE = qos_profile(Qos("reliable", 10))


def test_qos_is_a_full_profile_in_lower_case() -> None:
    endless = {"sec": 9223372036, "nsec": 854775807}
    full = {"history": "keep_last", "depth": 1000, "reliability": "reliable", "durability": "transient_local"}
    full |= {"deadline": endless, "lifespan": endless, "liveliness": "automatic", "liveliness_lease_duration": endless}
    found = qos_profile(Qos("reliable", 1000, "transient_local"))
    assert list(found.items()) == [*full.items(), ("avoid_ros_namespace_conventions", False)]
    leased = qos_profile(Qos("reliable", 1, lease=1.5))
    assert leased["liveliness"] == "manual_by_topic"
    assert leased["liveliness_lease_duration"] == {"sec": 1, "nsec": 500_000_000}


@pytest.mark.parametrize(
    ("stated", "becomes"),
    [
        ("{}", {}),
        ("{history: 2, reliability: 2, durability: 1, liveliness: 3, depth: 7}", {
            "history": "keep_all", "reliability": "best_effort", "durability": "transient_local",
            "liveliness": "manual_by_topic", "depth": 7,
        }),
        ("{history: KEEP_ALL, durability: Unknown, depth: 0}", {
            "history": "keep_all", "durability": "unknown", "depth": 0,
        }),
        ("{history: 4, reliability: -1, durability: hard, liveliness: 2, depth: 1.5}", {}),
        ("{deadline: 5, lifespan: {sec: a, nsec: 1}, liveliness_lease_duration: {sec: 1}}", {}),
        ("{deadline: {sec: 1, nsec: 2, x: 3}, lifespan: {sec: -1, nsec: 7}}", {
            "deadline": {"sec": 1, "nsec": 2}, "lifespan": {"sec": 0, "nsec": 7},
        }),
        ("{avoid_ros_namespace_conventions: true, x: 1}", {"avoid_ros_namespace_conventions": True}),
    ],
)  # fmt: skip
def test_profiles_of_other_versions_are_completed(stated: str, becomes: dict[str, object]) -> None:
    def completed(text: str) -> object:
        found = bag_metadata([BagChannel("/a", "a_msgs/msg/A", "", text)], files=[], custom_data={})
        return found["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"]

    assert completed(f"- {stated}\n- 1\n") == [RELIABLE | becomes]
    assert completed(stated) == completed("[[[") == []


def test_metadata_file_word_for_word(tmp_path: Path) -> None:
    topics = [
        BagChannel("/a", "a_msgs/msg/A", "RIHS01_1", dump_yaml([RELIABLE]), message_count=3),
        BagChannel("/b", "a_msgs/msg/A", "RIHS01_1", ""),
    ]
    files = [FileRecord("x.mcap", 5, 12, 3), FileRecord("y.mcap", 0, 0, 0)]
    write_metadata(tmp_path, bag_metadata(topics, files=files, custom_data={"key": "no: thing"}))

    def span(start: int, length: int) -> dict[str, object]:
        return {"starting_time": {"nanoseconds_since_epoch": start}, "duration": {"nanoseconds": length}}

    def topic(name: str, profiles: list[object], count: int) -> dict[str, object]:
        described = {"name": name, "type": "a_msgs/msg/A", "serialization_format": "cdr"}
        described |= {"offered_qos_profiles": profiles, "type_description_hash": "RIHS01_1"}
        return {"topic_metadata": described, "message_count": count}

    expected = {"version": 9, "storage_identifier": "mcap", **dict(reversed(span(5, 7).items())), "message_count": 3}
    expected |= {"topics_with_message_count": [topic("/a", [RELIABLE], 3), topic("/b", [], 0)]}
    expected |= {"compression_format": "", "compression_mode": "", "relative_file_paths": ["x.mcap", "y.mcap"]}
    parts = [("x.mcap", span(5, 7), 3), ("y.mcap", span(0, 0), 0)]
    expected["files"] = [{"path": path, **times, "message_count": count} for path, times, count in parts]
    expected |= {"custom_data": {"key": "no: thing"}, "ros_distro": "jazzy"}
    text = yaml.safe_dump({"rosbag2_bagfile_information": expected}, sort_keys=False)
    assert (tmp_path / "metadata.yaml").read_text(encoding="utf-8") == text


def test_metadata_is_escaped_and_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "two\nlines \x1b[31m"
    dumped = dump_yaml({"reason": text})
    assert "\x1b" not in dumped
    assert yaml.safe_load(dumped) == {"reason": text}
    assert dump_yaml({"reason": "why " * 200}).count("\n") == 1, "long text stays on one line"

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    write_metadata(tmp_path, {"version": 9})
    (before,) = ((path.name, path.read_bytes()) for path in tmp_path.iterdir())
    monkeypatch.setattr("os.fsync", refuse)
    with pytest.raises(OSError, match="No space left"):
        write_metadata(tmp_path, {"version": 10})
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [before]


# Definitions and hashes of message types, found among the installed packages


def install(prefix: Path, ros_type: str, text: str, nested: tuple[str, ...] = (), type_hash: str = "RIHS01_aa") -> None:
    package, _, short = ros_type.split("/")
    folder = prefix / "share" / package / "msg"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{short}.msg").write_text(text, encoding="utf-8")
    description = {
        "type_description_msg": {
            "type_description": {"type_name": ros_type},
            "referenced_type_descriptions": [{"type_name": name} for name in nested],
        },
        "type_hashes": [{"type_name": ros_type, "hash_string": type_hash}],
    }
    (folder / f"{short}.json").write_text(json.dumps(description), encoding="utf-8")


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(["", str(tmp_path), str(tmp_path / "under")]))
    return tmp_path


def test_text_is_the_definition_and_behind_it_every_nested_one(prefix: Path) -> None:
    nested = ("b_msgs/msg/Inner", "a_msgs/msg/Deep")
    install(prefix, "a_msgs/msg/Outer", "b_msgs/Inner inner  # größe\nDeep deep\n", nested)
    install(prefix, "a_msgs/msg/Deep", "uint8 x\n")
    install(prefix, "b_msgs/msg/Inner", "a_msgs/Deep[] deeps\n", ("a_msgs/msg/Deep",))
    install(prefix / "under", "a_msgs/msg/Outer", "# under\n", type_hash="RIHS01_under")
    schema = message_schema("a_msgs/msg/Outer")
    line = "=" * 80
    assert schema.text == (
        "b_msgs/Inner inner  # größe\nDeep deep\n"
        f"\n{line}\nMSG: a_msgs/Deep\nuint8 x\n"
        f"\n{line}\nMSG: b_msgs/Inner\na_msgs/Deep[] deeps\n"
    )
    assert (schema.name, schema.type_hash) == ("a_msgs/msg/Outer", "RIHS01_aa"), "the first prefix wins"


@pytest.mark.parametrize("ros_type", [*(topic.ros_type for topic in TOPICS), "sensor_msgs/msg/JointState"])
def test_hash_is_that_of_the_definition(ros_type: str) -> None:
    schema = message_schema(ros_type)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.text, ros_type))
    assert store.hash_rihs01(ros_type) == schema.type_hash


def test_missing_package_is_named(prefix: Path) -> None:
    with pytest.raises(UnknownTypeError, match="build or install the package nowhere_msgs") as caught:
        message_schema("nowhere_msgs/msg/Thing")
    assert str(prefix) in str(caught.value)
    install(prefix, "a_msgs/msg/Outer", "b_msgs/Inner inner\n", ("b_msgs/msg/Inner",))
    with pytest.raises(UnknownTypeError, match=r"message type b_msgs/msg/Inner: .* the package b_msgs"):
        message_schema("a_msgs/msg/Outer")
    for name in ("Header", "std_msgs/Header", "std_msgs/srv/Header", "../msg/Header", "a/msg/B/C", ""):
        with pytest.raises(UnknownTypeError, match="is not the full name of a message type"):
            message_schema(name)
    for description in ("", "[]", "{}", '{"type_description_msg": 1}', '{"type_hashes": []}'):
        (prefix / "share/a_msgs/msg/Outer.json").write_text(description, encoding="utf-8")
        with pytest.raises(UnknownTypeError, match="its type description is"):
            message_schema("a_msgs/msg/Outer")

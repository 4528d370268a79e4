"""Faults that bags written from Python have had, seen with the real tools: ours has none of them.

Each fault is put into a bag of ours, alone; the inspection must find it there, and nothing in the bag as it was. Of
bags with such faults rosbag2 refuses some, of others it leaves topics out; rosbags reads and Foxglove shows nothing of
some; ``mcap doctor`` is content with most.
"""

from __future__ import annotations

import copy
import re
import struct
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, McapRecord, Message as McapMessage, MessageIndex, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from tests.swarmabs_bag.damage import MAGIC, chunk, record, sealed

from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.simulated_run import simulate_run

YAML_KEYS = {
    "version", "storage_identifier", "duration", "starting_time", "message_count", "topics_with_message_count",
    "compression_format", "compression_mode", "relative_file_paths", "files", "custom_data", "ros_distro",
}  # fmt: skip
QOS_KEYS = {
    "history", "depth", "reliability", "durability", "deadline", "lifespan", "liveliness",
    "liveliness_lease_duration", "avoid_ros_namespace_conventions",
}  # fmt: skip
QOS_NAMES = {
    "history": {"keep_last", "keep_all"},
    "reliability": {"reliable", "best_effort"},
    "durability": {"volatile", "transient_local"},
    "liveliness": {"automatic", "manual_by_topic"},
}
SECOND = 1_000_000_000
YEAR = 365 * 24 * 3600 * SECOND


class Bag(NamedTuple):
    """A bag taken apart: its file, and its metadata.yaml as data."""

    data: bytes
    metadata: dict[str, Any]


def taken_apart(folder: Path) -> Bag:
    description = yaml.safe_load((folder / "metadata.yaml").read_text(encoding="utf-8"))
    return Bag((folder / "bag_0.mcap").read_bytes(), description["rosbag2_bagfile_information"])


@pytest.fixture
def ours(bag: Path) -> Bag:
    return taken_apart(bag)


# The inspection


def faults(bag: Bag) -> list[str]:
    """Return the faults of a bag, in a word each."""
    return sorted({*_faults_of_file(bag), *_faults_of_yaml(bag)})


def _faults_of_file(bag: Bag) -> Iterator[str]:
    records = list(StreamReader(BytesIO(bag.data), emit_chunks=True).records)
    header = records[0]
    assert isinstance(header, Header)
    if header.profile != "ros2":
        yield "profile"
    chunks = [found for found in records if isinstance(found, Chunk)]
    inner = [(number, found) for number, one in enumerate(chunks) for found in breakup_chunk(one)]
    schemas = {found.id: found for _, found in inner if isinstance(found, Schema)}
    channels = {found.id: found for _, found in inner if isinstance(found, Channel)}
    messages = [(number, found) for number, found in inner if isinstance(found, McapMessage)]
    for schema in schemas.values():
        yield from _faults_of_schema(schema)
    for channel in channels.values():
        if channel.message_encoding != "cdr":
            yield "encoding"
        if not channel.metadata.get("topic_type_hash", "").startswith("RIHS01_"):
            yield "type hash"
        yield from _faults_of_qos(yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")))
    times = [message.log_time for _, message in messages]
    if times != sorted(times):
        yield "order"
    if times[-1] - times[0] < SECOND // 10 or times[-1] > YEAR:
        yield "time unit"
    if any(message.data[:4] != b"\0\1\0\0" for _, message in messages):
        yield "CDR header"
    yield from _faults_of_index(bag.data, records, len(messages))


def _faults_of_schema(schema: Schema) -> Iterator[str]:
    if schema.encoding != "ros2msg":
        yield "schema encoding"
    if not re.fullmatch(r"\w+/msg/\w+", schema.name):
        yield "type name"
    parts = schema.data.decode().split("=" * 80 + "\n")
    defined = {part.splitlines()[0].removeprefix("MSG: ") for part in parts[1:]}
    used = {found for part in parts for found in re.findall(r"^(\w+/\w+)(?:\[\d*\])? +\w+", part, re.MULTILINE)}
    if not used <= defined:
        yield "nested types"


def _faults_of_qos(profiles: object) -> Iterator[str]:
    if not isinstance(profiles, list) or not profiles:
        yield "qos missing"
        return
    for profile in profiles:
        if not isinstance(profile, dict) or profile.keys() != QOS_KEYS:
            yield "qos incomplete"
            continue
        for name, values in QOS_NAMES.items():
            if profile[name] not in values:
                yield "qos names"
        for name in ("deadline", "lifespan", "liveliness_lease_duration"):
            span = profile[name]
            if (
                not isinstance(span, dict)
                or span.keys() != {"sec", "nsec"}
                or any(type(v) is not int for v in span.values())
            ):
                yield "qos durations"


def _faults_of_index(data: bytes, records: list[McapRecord], count: int) -> Iterator[str]:
    indexed = sum(len(found.records) for found in records if isinstance(found, MessageIndex))
    if indexed != count:
        yield "message index"
    summary_start, offsets, _ = struct.unpack("<QQI", data[-28:-8])
    end = [type(found).__name__ for found in records[[type(found).__name__ for found in records].index("DataEnd") :]]
    if not summary_start or not offsets:
        yield "summary"
    for kind in ("Schema", "Channel", "Statistics", "ChunkIndex", "SummaryOffset", "AttachmentIndex", "MetadataIndex"):
        if kind not in end:
            yield "summary"


def _faults_of_yaml(bag: Bag) -> Iterator[str]:
    found = bag.metadata
    if found.keys() != YAML_KEYS or found["version"] != 9:
        yield "yaml keys"
        return
    if found["custom_data"] is not None and not isinstance(found["custom_data"], dict):
        yield "custom data"
    numbers = [
        found["duration"]["nanoseconds"],
        found["starting_time"]["nanoseconds_since_epoch"],
        found["message_count"],
    ]
    for entry in found["files"]:
        numbers += [entry["duration"]["nanoseconds"], entry["starting_time"]["nanoseconds_since_epoch"]]
    if any(type(number) is not int or number < 0 for number in numbers):
        yield "yaml numbers"
    if any(Path(path).name != path for path in found["relative_file_paths"]):
        yield "path"
    if found["relative_file_paths"] != [entry["path"] for entry in found["files"]] or "bag_0.mcap" not in str(found):
        yield "files"
    counts = _counts(bag.data)
    said = {}
    for topic in found["topics_with_message_count"]:
        described = topic["topic_metadata"]
        said[described["name"]] = topic["message_count"]
        if not described["type_description_hash"].startswith("RIHS01_") or described["serialization_format"] != "cdr":
            yield "yaml topic"
        yield from _faults_of_qos(described["offered_qos_profiles"])
    if said != counts or found["message_count"] != sum(counts.values()):
        yield "yaml counts"


def _counts(data: bytes) -> dict[str, int]:
    channels, counts = {}, {}
    for found in StreamReader(BytesIO(data)).records:
        if isinstance(found, Channel):
            channels[found.id] = found.topic
            counts.setdefault(found.topic, 0)
        elif isinstance(found, McapMessage):
            counts[channels[found.channel_id]] += 1
    return counts


# The faults

Change = Callable[[list[McapRecord]], None]


def rewritten(data: bytes, change: Change = lambda _: None, *, profile: str = "ros2", indexed: bool = True) -> bytes:
    """Return the file with the records of its chunks changed, in one chunk, all else right."""
    made, inner = b"", []
    for found in StreamReader(BytesIO(data), emit_chunks=True).records:
        if isinstance(found, Chunk):
            inner += breakup_chunk(found)
        elif type(found).__name__ in {"Attachment", "Metadata"}:
            made += encoded(found)
        elif type(found).__name__ == "DataEnd":
            break
    change(inner)
    body = b"".join(map(encoded, inner))
    made = MAGIC + encoded(Header(profile, "")) + chunk(body) + (_indexes(inner) if indexed else b"") + made
    return sealed(made)


def encoded(found: McapRecord) -> bytes:
    builder = RecordBuilder()
    found.write(builder)
    return bytes(builder.end())


def _indexes(inner: list[McapRecord]) -> bytes:
    place, entries = 0, dict[int, list[tuple[int, int]]]()
    for found in inner:
        if isinstance(found, McapMessage):
            entries.setdefault(found.channel_id, []).append((found.log_time, place))
        place += len(encoded(found))
    return b"".join(encoded(MessageIndex(channel, records)) for channel, records in entries.items())


def of_kind(kind: type[Any], name: str, value: Callable[[Any], object]) -> Change:
    """Return a change of a field of the last record of a kind."""

    def change(inner: list[McapRecord]) -> None:
        found = next(found for found in reversed(inner) if isinstance(found, kind))
        setattr(found, name, value(getattr(found, name)))

    return change


def qos(edit: Callable[[dict[str, Any]], object]) -> Change:
    """Return a change of the QoS profile of a channel."""

    def changed(metadata: dict[str, str]) -> dict[str, str]:
        profiles = yaml.safe_load(metadata["offered_qos_profiles"])
        edit(profiles[0])
        return {**metadata, "offered_qos_profiles": yaml.safe_dump(profiles)}

    return of_kind(Channel, "metadata", changed)


def in_seconds(inner: list[McapRecord]) -> None:
    for found in inner:
        if isinstance(found, McapMessage):
            found.log_time //= SECOND


@pytest.mark.parametrize(
    ("fault", "change"),
    [
        ("qos missing", of_kind(Channel, "metadata", lambda m: {k: m[k] for k in m if k != "offered_qos_profiles"})),
        ("qos incomplete", qos(lambda profile: profile.pop("liveliness"))),
        ("qos durations", qos(lambda profile: profile.update(deadline=2**63 - 1))),
        ("qos names", qos(lambda profile: profile.update(reliability="RELIABLE"))),
        ("type hash", of_kind(Channel, "metadata", lambda m: {k: m[k] for k in m if k != "topic_type_hash"})),
        ("time unit", in_seconds),
        ("nested types", of_kind(Schema, "data", lambda data: data.split(b"=" * 80)[0])),
        ("schema encoding", of_kind(Schema, "encoding", lambda _: "ros1msg")),
        ("type name", of_kind(Schema, "name", lambda name: name.replace("/msg/", "/"))),
        ("encoding", of_kind(Channel, "message_encoding", lambda _: "")),
        ("CDR header", of_kind(McapMessage, "data", lambda data: data[4:])),
        ("order", of_kind(McapMessage, "log_time", lambda time: time // 2)),
    ],
)
def test_fault_in_the_file_is_found(fault: str, change: Change, ours: Bag) -> None:
    assert faults(ours._replace(data=rewritten(ours.data, change))) == [fault]


def test_other_faults_of_the_file_are_found(ours: Bag) -> None:
    assert faults(ours._replace(data=rewritten(ours.data, profile=""))) == ["profile"]
    assert faults(ours._replace(data=rewritten(ours.data, indexed=False))) == ["message index"]
    (start,) = struct.unpack("<Q", ours.data[-28:-20])
    footer = record(Opcode.FOOTER, bytes(20)) + MAGIC
    assert faults(ours._replace(data=ours.data[:start] + footer)) == ["summary"]


def topic_left_out(metadata: dict[str, Any]) -> None:
    metadata["topics_with_message_count"].pop()


def first_topic(edit: Callable[[dict[str, Any]], object]) -> Callable[[dict[str, Any]], object]:
    return lambda metadata: edit(metadata["topics_with_message_count"][0]["topic_metadata"])


@pytest.mark.parametrize(
    ("fault", "edit"),
    [
        ("yaml keys", lambda m: m.pop("message_count")),
        ("yaml keys", lambda m: m.pop("files")),
        ("yaml keys", lambda m: m.pop("custom_data")),
        ("yaml keys", lambda m: m.pop("ros_distro")),
        ("yaml keys", lambda m: m.update(version=5)),
        ("custom data", lambda m: m.update(custom_data=[])),
        ("yaml numbers", lambda m: m["duration"].update(nanoseconds=4e8)),
        ("yaml numbers", lambda m: m["duration"].update(nanoseconds=-1)),
        ("yaml numbers", lambda m: m["files"][0]["starting_time"].update(nanoseconds_since_epoch=0.0)),
        ("yaml counts", lambda m: m.update(message_count=7)),
        ("yaml counts", topic_left_out),
        ("files", lambda m: m.update(relative_file_paths=["other.mcap"])),
        ("yaml topic", first_topic(lambda t: t.update(type_description_hash=""))),
        ("yaml topic", first_topic(lambda t: t.update(serialization_format=""))),
        ("qos missing", first_topic(lambda t: t.update(offered_qos_profiles="- history: 3\n  depth: 0\n"))),
    ],
)
def test_fault_in_the_yaml_is_found(fault: str, edit: Callable[[dict[str, Any]], object], ours: Bag) -> None:
    metadata = copy.deepcopy(ours.metadata)
    edit(metadata)
    assert faults(ours._replace(metadata=metadata)) == [fault]


def test_absolute_path_in_the_yaml_is_found(ours: Bag) -> None:
    metadata = copy.deepcopy(ours.metadata)
    metadata["relative_file_paths"] = ["/data/bag_0.mcap"]
    metadata["files"][0]["path"] = "/data/bag_0.mcap"
    assert faults(ours._replace(metadata=metadata)) == ["path"]


def test_ours_has_none(ours: Bag) -> None:
    assert faults(ours) == []
    assert faults(ours._replace(data=rewritten(ours.data))) == []


def test_bag_of_a_run_has_none(tmp_path: Path) -> None:
    run = new_run_folder(tmp_path / "run")
    assert simulate_run(find_scenario("pd_het_4", ["duration=1.0"]), run).status == "ok"
    assert faults(taken_apart(run.bag)) == []

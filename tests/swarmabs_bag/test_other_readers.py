"""A bag opens with the readers people have, and every field has the value that was written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from swarmabs_config.graph import LOCKSTEP, OFFERED
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, TOPIC_OF, Message

Field = int | float | str
Fields = tuple[Field, ...]


def written(run: list[Message]) -> list[tuple[str, int, Fields]]:
    return [(f"/{TOPIC_OF[type(message)].name}", message.stamp, fields_written(message)) for message in run]


def fields_written(message: Message) -> Fields:
    seconds, nanoseconds = divmod(message.stamp, 1_000_000_000)
    return (seconds, nanoseconds, "plane", *message[1:])


def fields_read(message: object, names: tuple[str, ...]) -> Fields:
    header = getattr(message, "header")  # noqa: B009 - its class is made at run time
    return (
        header.stamp.sec,
        header.stamp.nanosec,
        header.frame_id,
        *(getattr(message, name) for name in names if name != "stamp"),
    )


NAMES = {f"/{topic.name}": topic.message._fields for topic in (*MAIN_TOPICS, EVENTS)}


def read_by_seeking(bag: Path) -> Iterator[tuple[str, int, object]]:
    with (bag / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            yield channel.topic, message.log_time, decoded


def read_as_stream(bag: Path) -> Iterator[tuple[str, int, object]]:
    with (bag / "bag_0.mcap").open("rb") as stream:
        reader = NonSeekingReader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            yield channel.topic, message.log_time, decoded


def read_with_rosbags(bag: Path) -> Iterator[tuple[str, int, object]]:
    with AnyReader([bag]) as reader:
        for connection, time, data in reader.messages():
            yield connection.topic, time, reader.deserialize(data, connection.msgtype)


@pytest.mark.parametrize("read", [read_by_seeking, read_as_stream, read_with_rosbags])
def test_every_field_reads_as_written(
    read: Callable[[Path], Iterator[tuple[str, int, object]]], bag: Path, run: list[Message]
) -> None:
    found = [(topic, time, fields_read(message, NAMES[topic])) for topic, time, message in read(bag)]
    assert found == written(run)


def test_rosbags_sees_types_hashes_and_qos(bag: Path, run: list[Message]) -> None:
    with Reader(bag) as reader:
        assert reader.message_count == len(run)
        assert reader.ros_distro == "jazzy"
        for connection, topic in zip(reader.connections, (*MAIN_TOPICS, EVENTS), strict=True):
            assert connection.topic == f"/{topic.name}"
            assert connection.msgtype == topic.ros_type
            assert isinstance(connection.ext, ConnectionExtRosbag2)
            (profile,) = connection.ext.offered_qos_profiles
            assert profile.reliability.name.lower() == OFFERED[LOCKSTEP][topic].reliability
            assert profile.durability.name.lower() == OFFERED[LOCKSTEP][topic].durability
            assert profile.depth == OFFERED[LOCKSTEP][topic].depth
            assert (profile.deadline.sec, profile.deadline.nsec) == (9223372036, 854775807)


def test_type_hashes_are_those_that_rosbags_computes_from_the_definitions(bag: Path) -> None:
    store = get_typestore(Stores.EMPTY)
    with AnyReader([bag], default_typestore=store) as reader:
        for connection in reader.connections:
            assert reader.typestore.hash_rihs01(connection.msgtype) == connection.digest


def test_rosbags_opens_the_bare_file(bag: Path, run: list[Message]) -> None:
    with Reader(bag / "bag_0.mcap") as reader:
        assert sum(1 for _ in reader.messages()) == len(run)


def test_bag_in_a_namespace_has_its_topics_there(
    tmp_path: Path, write_bag: Callable[..., Path], run: list[Message]
) -> None:
    with Reader(write_bag(tmp_path / "bag", namespace="/lab/west")) as reader:
        assert [connection.topic for connection in reader.connections] == [f"/lab/west{name}" for name in NAMES]
        assert reader.message_count == len(run)

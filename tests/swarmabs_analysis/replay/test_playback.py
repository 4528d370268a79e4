"""Which topics of a bag can be played, and with which quality of service."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import Writer
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_msgs.msg import String

from swarmabs_analysis.replay.playback import USUAL_QOS, choose_topics
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.schemas import message_schema
from swarmabs_core.errors import InputError
from swarmabs_core.messages import PLANE_STATE

TEXT = message_schema("std_msgs/msg/String")
LATCHED = "- {history: keep_last, depth: 3, reliability: reliable, durability: transient_local}\n"
WEAK = "- {history: keep_last, depth: 3, reliability: best_effort, durability: volatile}\n"


def foreign_bag(
    folder: Path, *channels: tuple[str, str, str, dict[str, str]], namespace: str | None = None
) -> BagReader:
    """Return a bag of another robot: topic, type, encoding and metadata of each channel."""
    path = folder / "foreign.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        for topic, ros_type, encoding, metadata in channels:
            schema = writer.register_schema(ros_type, "ros2msg", TEXT.text.encode())
            channel = writer.register_channel(topic, encoding, schema, metadata)
            writer.add_message(channel, 10**9, b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00", 10**9)
        writer.finish()
    return open_bag(path, namespace=namespace, several=True)


def test_topics_of_other_robots_are_played_with_their_recorded_qos(tmp_path: Path) -> None:
    metadata = {"offered_qos_profiles": LATCHED, "topic_type_hash": TEXT.type_hash}
    bag = foreign_bag(tmp_path, ("/chatter", TEXT.name, "cdr", metadata), ("/other", TEXT.name, "cdr", {}))
    (chatter, other), warnings = choose_topics(bag)
    assert warnings == []
    assert chatter.message_class is String
    assert isinstance(chatter.qos, QoSProfile)
    assert (chatter.qos.depth, chatter.qos.durability) == (3, QoSDurabilityPolicy.TRANSIENT_LOCAL)
    assert (other.channel.name, other.qos) == ("/other", USUAL_QOS)


def test_what_cannot_be_played_is_left_out_and_named(tmp_path: Path) -> None:
    bag = foreign_bag(
        tmp_path,
        ("/chatter", TEXT.name, "cdr", {"offered_qos_profiles": LATCHED + WEAK}),
        ("/scan", "their_msgs/msg/Scan", "cdr", {}),
        ("/old", TEXT.name, "cdr", {"topic_type_hash": "RIHS01_" + "0" * 64}),
        ("/text", TEXT.name, "json", {}),
    )
    playable, warnings = choose_topics(bag)
    assert [topic.channel.name for topic in playable] == ["/chatter"]
    told = "\n".join(warnings)
    assert "/chatter: its publishers offered 2 different QoS; the first is taken" in told
    assert "/scan is left out: message type their_msgs/msg/Scan: " in told
    assert "install the package their_msgs" in told
    assert "/old is left out: the installed definition of std_msgs/msg/String is not the one that was recorded" in told
    assert "/text is left out: its messages are in the encoding 'json'" in told


def test_names_that_no_topic_of_ros_can_have(tmp_path: Path) -> None:
    long = "std_msgs/msg/" + "S" * 500
    bag = foreign_bag(
        tmp_path,
        ("/chatter", TEXT.name, "cdr", {}),
        ("/a\n\x1b[2J", TEXT.name, "cdr", {}),
        ("/" + "x" * 5000, TEXT.name, "cdr", {}),
        ("/long_type", long, "cdr", {}),
        ("/encoded", TEXT.name, "\x1b[2J" * 99, {}),
    )
    playable, warnings = choose_topics(bag)
    assert [topic.channel.name for topic in playable] == ["/chatter"]
    assert r"/a\n\x1b[2J is left out: no topic of ROS can have this name" in warnings
    assert all(line.isprintable() and len(line) < 300 for line in warnings)
    assert len(warnings) == 4
    with pytest.raises(InputError, match=r"/chatter, /encoded, ") as error:
        choose_topics(bag, ["/nothing"])
    assert str(error.value).isprintable() and len(str(error.value)) < 500


def test_a_topic_that_is_asked_for_is_not_left_out_in_silence(tmp_path: Path) -> None:
    bag = foreign_bag(tmp_path, ("/chatter", TEXT.name, "cdr", {}), ("/scan", "their_msgs/msg/Scan", "cdr", {}))
    assert [topic.channel.name for topic in choose_topics(bag, ["chatter"])[0]] == ["/chatter"]
    with pytest.raises(InputError, match="their_msgs/msg/Scan"):
        choose_topics(bag, ["/scan"])
    with pytest.raises(InputError, match=r"--topics: .* has no topic /nothing; it has /chatter, /scan"):
        choose_topics(bag, ["/nothing"])


def test_a_bag_with_nothing_to_play_is_refused(tmp_path: Path) -> None:
    bag = foreign_bag(tmp_path, ("/scan", "their_msgs/msg/Scan", "cdr", {}))
    with pytest.raises(InputError, match=r"has no topic that can be played; /scan is left out"):
        choose_topics(bag)


def test_of_several_swarms_all_topics_are_played_or_those_of_one(tmp_path: Path) -> None:
    names = ("/plane/state", "/camera", "/west/plane/state", "/west/camera", "/west/low/plane/state")
    channels = [(n, PLANE_STATE.ros_type if "plane" in n else TEXT.name, "cdr", {}) for n in names]

    def chosen(namespace: str | None) -> list[str]:
        bag = foreign_bag(tmp_path, *channels, namespace=namespace)
        return [topic.channel.name for topic in choose_topics(bag, one_swarm=namespace is not None)[0]]

    assert chosen(None) == list(names)
    assert chosen("/") == ["/plane/state", "/camera"]
    assert chosen("/west") == ["/west/plane/state", "/west/camera"]
    with pytest.raises(InputError, match=r"--topics: .* has no topic /camera; it has /west/camera, /west/plane/state"):
        choose_topics(foreign_bag(tmp_path, *channels, namespace="/west"), ["/camera"], one_swarm=True)

"""A playback: which topics of a bag can be played, when messages are due, and with which quality of service."""

from itertools import islice
from pathlib import Path
from typing import TypeAlias

import pytest
from mcap.writer import Writer
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from swarmabs_analysis.replay.playback import USUAL_QOS, Pace, choose_topics, recorded_profiles
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.run.metadata import dump_yaml, qos_profile
from swarmabs_bag.run.schemas import message_schema
from swarmabs_config.graph import LOCKSTEP, OFFERED
from swarmabs_core.errors import InputError
from swarmabs_core.messages import PLANE_STATE
from swarmabs_ros.endpoints import profile

TEXT = message_schema("std_msgs/msg/String")
LATCHED = "- {history: keep_last, depth: 3, reliability: reliable, durability: transient_local}\n"
WEAK = "- {history: keep_last, depth: 3, reliability: best_effort, durability: volatile}\n"


Channel: TypeAlias = "tuple[str, str, str, dict[str, str]]"


def of_text(topic: str, **metadata: str) -> Channel:
    return (topic, TEXT.name, "cdr", metadata)


def foreign_bag(folder: Path, *channels: Channel, namespace: str | None = None) -> BagReader:
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
    latched = of_text("/chatter", offered_qos_profiles=LATCHED, topic_type_hash=TEXT.type_hash)
    bag = foreign_bag(tmp_path, latched, of_text("/other"))
    (chatter, other), warnings = choose_topics(bag)
    assert warnings == []
    assert chatter.message_class is String
    assert isinstance(chatter.qos, QoSProfile)
    assert (chatter.qos.depth, chatter.qos.durability) == (3, DurabilityPolicy.TRANSIENT_LOCAL)
    assert (other.channel.name, other.qos) == ("/other", USUAL_QOS)


def test_what_cannot_be_played_is_left_out_and_named(tmp_path: Path) -> None:
    bag = foreign_bag(
        tmp_path,
        of_text("/chatter", offered_qos_profiles=LATCHED + WEAK),
        ("/scan", "their_msgs/msg/Scan", "cdr", {}),
        of_text("/old", topic_type_hash="RIHS01_" + "0" * 64),
        ("/text", TEXT.name, "json", {}),
    )
    playable, warnings = choose_topics(bag)
    assert [topic.channel.name for topic in playable] == ["/chatter"]
    for told in (
        "/chatter: its publishers offered 2 different QoS; the first is used",
        "/scan is skipped: message type their_msgs/msg/Scan: ",
        "install the package their_msgs",
        "/old is skipped: the installed definition of std_msgs/msg/String differs from the recorded one",
        "/text is skipped: its messages have the encoding 'json'",
    ):
        assert told in "\n".join(warnings)


def test_names_that_no_topic_of_ros_can_have(tmp_path: Path) -> None:
    strange = (("/long_type", "std_msgs/msg/" + "S" * 500, "cdr", {}), ("/encoded", TEXT.name, "\x1b[2J" * 99, {}))
    bag = foreign_bag(tmp_path, *map(of_text, ("/chatter", "/a\n\x1b[2J", "/" + "x" * 5000)), *strange)
    playable, warnings = choose_topics(bag)
    assert [topic.channel.name for topic in playable] == ["/chatter"]
    assert r"/a\n\x1b[2J is skipped: its name is not valid in ROS" in warnings
    assert all(line.isprintable() and len(line) < 300 for line in warnings)
    assert len(warnings) == 4
    with pytest.raises(InputError, match=r"/chatter, /encoded, ") as error:
        choose_topics(bag, ["/nothing"])
    assert str(error.value).isprintable() and len(str(error.value)) < 500


def test_a_topic_that_is_asked_for_is_not_left_out_in_silence(tmp_path: Path) -> None:
    bag = foreign_bag(tmp_path, of_text("/chatter"), ("/scan", "their_msgs/msg/Scan", "cdr", {}))
    assert [topic.channel.name for topic in choose_topics(bag, ["chatter"])[0]] == ["/chatter"]
    with pytest.raises(InputError, match="their_msgs/msg/Scan"):
        choose_topics(bag, ["/scan"])
    with pytest.raises(InputError, match=r"has no topic that can be played; /scan is skipped"):
        choose_topics(foreign_bag(tmp_path, ("/scan", "their_msgs/msg/Scan", "cdr", {})))
    with pytest.raises(InputError, match=r"--topics: .* has no topic /nothing; it has /chatter, /scan"):
        choose_topics(bag, ["/nothing"])


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


SECOND = 1_000_000_000
FIRST = 5 * SECOND
BAG = [(FIRST + number * SECOND // 10, number) for number in range(11)]
"""Eleven messages in one second of a bag that begins at 5 s."""


@pytest.mark.parametrize(
    ("pace", "expected"),
    [
        (Pace(0.5), [(number / 5, number) for number in range(11)]),
        (Pace(4.0), [(number / 40, number) for number in range(11)]),
        (Pace(2.0, start=0.3, duration=0.4), [(0.0, 3), (0.05, 4), (0.1, 5), (0.15, 6), (0.2, 7)]),
        (Pace(start=0.9, loop=True), [((n + 1) // 2 / 10, 9 + n % 2) for n in range(3000)]),
        (Pace(start=7.0, loop=True), []),
    ],
)
def test_messages_are_due_at_their_recorded_times_over_the_rate(pace: Pace, expected: list[tuple[float, int]]) -> None:
    schedule = list(islice(pace.schedule(FIRST, lambda: BAG), 3000))
    assert [number for _, number in schedule] == [number for _, number in expected]
    assert [due for due, _ in schedule] == pytest.approx([due for due, _ in expected])


def test_times_that_go_back_do_not_reorder() -> None:
    bag = [(FIRST + SECOND, "a"), (FIRST, "b"), (FIRST + 2 * SECOND, "c")]
    assert list(Pace().schedule(FIRST, lambda: bag)) == [(1.0, "a"), (1.0, "b"), (2.0, "c")]


def policies(qos: QoSProfile) -> tuple[object, ...]:
    durations = (qos.deadline, qos.lifespan, qos.liveliness_lease_duration)
    return qos.history, qos.depth, qos.reliability, qos.durability, qos.liveliness, *map(str, durations)


@pytest.mark.parametrize("topic", OFFERED[LOCKSTEP], ids=lambda topic: topic.name)
def test_what_a_run_offers_comes_back_once(topic: object) -> None:
    qos = OFFERED[LOCKSTEP][topic]  # type: ignore[index]
    other = {**qos_profile(qos), "depth": 77}
    first, second = recorded_profiles(dump_yaml([qos_profile(qos), other, qos_profile(qos)]))
    assert second.depth == 77
    assert policies(first)[:4] == policies(profile(qos))[:4]
    assert policies(first)[4:] == (LivelinessPolicy.AUTOMATIC, *policies(QoSProfile(depth=1))[5:])


NUMBERS = """
- {history: 1, depth: 7, reliability: 2, durability: 1, liveliness: 3, avoid_ros_namespace_conventions: false,
   deadline: {sec: 9223372036, nsec: 854775807}, lifespan: {sec: 0, nsec: 0},
   liveliness_lease_duration: {sec: 2, nsec: 500000000}}
"""


def test_older_bags_have_numbers_for_policies_and_what_nobody_can_offer_is_left_as_usual() -> None:
    (recorded,) = recorded_profiles(NUMBERS)
    assert recorded == QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=7,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=2.5),
    )
    usual = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10)
    for text in ("", "[]", "{}", "4", "[1, 2]"):
        assert recorded_profiles(text) == []
    for text in (
        "- {history: unknown, depth: -3, reliability: best_available}",
        "[{depth: 1e9}]",
        "[{depth: 2147483648, history: true, deadline: {sec: 1}, lifespan: {sec: x, nsec: 1}}]",
    ):
        assert recorded_profiles(text) == [usual]

"""The recorded quality of service as rclpy's."""

from __future__ import annotations

import pytest
from rclpy.duration import Duration
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)

from swarmabs_analysis.replay.playback import recorded_profiles
from swarmabs_bag.metadata import dump_yaml, qos_profile
from swarmabs_config.graph import LOCKSTEP, OFFERED
from swarmabs_ros.endpoints import profile


def policies(made: QoSProfile) -> tuple[object, ...]:
    durations = (made.deadline, made.lifespan, made.liveliness_lease_duration)
    return made.history, made.depth, made.reliability, made.durability, made.liveliness, *map(str, durations)


@pytest.mark.parametrize("topic", OFFERED[LOCKSTEP], ids=lambda topic: topic.name)
def test_what_a_run_offers_comes_back(topic: object) -> None:
    qos = OFFERED[LOCKSTEP][topic]  # type: ignore[index]
    (found,) = recorded_profiles(dump_yaml([qos_profile(qos)]))
    assert policies(found)[:4] == policies(profile(qos))[:4]
    assert policies(found)[4:] == (QoSLivelinessPolicy.AUTOMATIC, *policies(QoSProfile(depth=1))[5:])


NUMBERS = """
- history: 1
  depth: 7
  reliability: 2
  durability: 1
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 0, nsec: 0}
  liveliness: 3
  liveliness_lease_duration: {sec: 2, nsec: 500000000}
  avoid_ros_namespace_conventions: false
"""


def test_older_bags_have_numbers_for_policies() -> None:
    (found,) = recorded_profiles(NUMBERS)
    assert found == QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=7,
        reliability=QoSReliabilityPolicy.BEST_EFFORT,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=QoSLivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=2.5),
    )


def test_each_different_offer_is_returned_once() -> None:
    one, other = (qos_profile(qos) for qos in list(OFFERED[LOCKSTEP].values())[:2])
    found = recorded_profiles(dump_yaml([one, other, one]))
    assert [made.depth for made in found] == [one["depth"], other["depth"]]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "4",
        "[1, 2]",
        "- history: unknown\n  depth: -3\n  reliability: best_available\n",
        "[{depth: 1e9}]",
    ],
)
def test_what_nobody_can_offer_is_left_as_usual(text: str) -> None:
    for found in recorded_profiles(text):
        assert found == QoSProfile(history=QoSHistoryPolicy.KEEP_LAST, depth=10)

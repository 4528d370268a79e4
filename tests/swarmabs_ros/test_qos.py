"""The table of qualities of service against the contract."""

from __future__ import annotations

import pytest
from rclpy.qos import QoSCompatibility, QoSHistoryPolicy, QoSLivelinessPolicy, qos_check_compatible

from swarmabs_config.graph import LEASE, LOCKSTEP, OFFERED, REALTIME, Qos, requested
from swarmabs_config.model.scenario import Realtime
from swarmabs_core.messages import BROADCASTS, EVENTS, MAIN_TOPICS, PLANE_STATE, Topic
from swarmabs_core.realtime.base import Schedule
from swarmabs_ros.endpoints import profile

topics = pytest.mark.parametrize("topic", OFFERED[LOCKSTEP], ids=lambda topic: topic.name)


@pytest.mark.parametrize("topic", [*BROADCASTS, PLANE_STATE], ids=lambda topic: topic.name)
def test_broadcasts_and_plane_are_reliable_and_volatile(topic: Topic) -> None:
    assert (OFFERED[LOCKSTEP][topic].reliability, OFFERED[LOCKSTEP][topic].durability) == ("reliable", "volatile")


def test_events_wait_for_those_who_come_later() -> None:
    assert OFFERED[LOCKSTEP][EVENTS] == Qos("reliable", 1000, "transient_local")


@topics
def test_history_is_bounded_and_there_is_no_deadline(topic: Topic) -> None:
    offered = profile(OFFERED[LOCKSTEP][topic])
    assert offered.history is QoSHistoryPolicy.KEEP_LAST
    assert offered.depth == OFFERED[LOCKSTEP][topic].depth > 0
    assert offered.deadline.nanoseconds == offered.liveliness_lease_duration.nanoseconds == 0


@topics
@pytest.mark.parametrize("reliable", [False, True])
def test_a_reader_never_asks_for_more_than_is_offered(topic: Topic, reliable: bool) -> None:  # noqa: FBT001
    wanted = requested(topic, depth=7, reliable=reliable)
    assert wanted.depth == 7
    compatible, reason = qos_check_compatible(profile(OFFERED[LOCKSTEP][topic]), profile(wanted))
    assert compatible != QoSCompatibility.ERROR, reason


@topics
def test_reliable_is_asked_for_only_where_it_is_wanted(topic: Topic) -> None:
    assert requested(topic, depth=1).reliability == "best_effort"
    assert requested(topic, depth=1, reliable=True).reliability == OFFERED[LOCKSTEP][topic].reliability


@pytest.mark.parametrize("topic", OFFERED[REALTIME], ids=lambda topic: topic.name)
def test_in_real_time_whoever_publishes_every_period_asserts_that_it_lives(topic: Topic) -> None:
    offered = profile(OFFERED[REALTIME][topic])
    asserts = offered.liveliness is QoSLivelinessPolicy.MANUAL_BY_TOPIC
    assert asserts == (topic in MAIN_TOPICS)
    assert offered.liveliness_lease_duration.nanoseconds == (500_000_000 if asserts else 0)
    assert offered.deadline.nanoseconds == 0
    wanted = requested(topic, REALTIME, depth=7)
    assert (wanted.reliability, wanted.lease) == ("best_effort", 0.0)
    assert qos_check_compatible(offered, profile(wanted))[0] != QoSCompatibility.ERROR


def test_ages_decide_before_the_middleware_does() -> None:
    limits = Realtime()
    assert max(limits.broadcast_age_limit, limits.state_age_limit, limits.plane_age_limit) < LEASE
    assert Schedule(10_000_000).steps(LEASE) > 10, "a lost message or two is no death"

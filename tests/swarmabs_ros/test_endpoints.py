"""Publishers, receiving over real DDS in one process, and the contract's qualities of service."""

import _ctypes
import time
from collections.abc import Iterator

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSHistoryPolicy, QoSLivelinessPolicy, qos_check_compatible
from tests.processes import until
from tests.swarmabs_ros.nodes import started_node

from swarmabs_config.graph import LEASE, LOCKSTEP, OFFERED, REALTIME, STANDBY_TOPICS, Driver, Qos, requested
from swarmabs_config.model.scenario import Realtime
from swarmabs_core.cdr import canonical, encode
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    AGENT_STATE,
    EVENTS,
    FAMILIES,
    PLANE_STATE,
    RELAY,
    STANDING,
    AgentState,
    EventKind,
    PlaneState,
    SwarmEvent,
    Topic,
)
from swarmabs_core.realtime.base import Schedule
from swarmabs_ros.endpoints import LoopGroup, Receiver, advertise, profile
from swarmabs_ros.start import SwarmNode

SUBSCRIPTIONS = {topic: requested(topic, depth=100, reliable=True) for topic in (PLANE_STATE, EVENTS)}
MESSAGES = [encode(PlaneState(step, step, 0.1 * step, -1.0 / (step + 1))) for step in range(20)]
BOTH = (PLANE_STATE, EVENTS)


@pytest.fixture
def node(ros: None) -> Iterator[SwarmNode]:
    with started_node() as node:
        yield node


def matched(publishers: dict[Topic, Publisher], *inboxes: Receiver) -> None:
    until(
        lambda: all(
            publisher.get_subscription_count() == len(inboxes) and inbox.publisher_count(topic) == 1
            for topic, publisher in publishers.items()
            for inbox in inboxes
        ),
        "endpoints meet",
    )


def receive(inbox: Receiver, topic: Topic, count: int) -> list[bytes]:
    messages: list[bytes] = []
    while len(messages) < count:
        until(lambda: inbox.wait((topic,), 0.1), f"{count} messages arrive")
        messages.extend(iter(lambda: inbox.take(topic), None))
    return messages


def test_writers_of_messages_are_those_of_the_graph(node: SwarmNode, capfd: pytest.CaptureFixture[str]) -> None:
    qos = {AGENT_STATE: Qos("best_effort", 100), PLANE_STATE: SUBSCRIPTIONS[PLANE_STATE]}
    inbox = Receiver(node, qos, identified=(AGENT_STATE,))
    senders = [advertise(node, AGENT_STATE) for _ in range(2)]
    until(lambda: all(s.get_subscription_count() for s in senders) and inbox.publisher_count(AGENT_STATE) == 2, "meet")
    sent = [[encode(AgentState(k, k, 0, n + 1, 1, 1, 0.5, 0.0, 0.1, 0.0, 0.0)) for k in range(3)] for n in range(2)]
    heard: dict[bytes, list[bytes]] = {}
    for pair in zip(*sent, strict=True):
        for sender, data in zip(senders, pair, strict=True):
            sender.publish(data)
            (arrived,) = receive(inbox, AGENT_STATE, 1)
            heard.setdefault(inbox.writer(AGENT_STATE), []).append(canonical(AgentState, arrived))
    assert {*heard} == {bytes(info.endpoint_gid) for info in node.get_publishers_info_by_topic(AGENT_STATE.name)}
    assert [*heard.values()] == sent
    assert (inbox.take(AGENT_STATE), inbox.writer(PLANE_STATE)) == (None, b"")
    inbox._identifying[AGENT_STATE]._implementation += 1  # noqa: SLF001 - as with another layout
    for data in sent[0][:2]:
        senders[0].publish(data)
        assert [canonical(AgentState, arrived) for arrived in receive(inbox, AGENT_STATE, 1)] == [data]
        assert inbox.writer(AGENT_STATE) == b""
    assert capfd.readouterr().err.count("a second sender cannot be told from the first") == 1


def test_messages_of_any_length_arrive_whole_with_their_writer_and_a_destroyed_subscription_is_refused(
    node: SwarmNode,
) -> None:
    inbox = Receiver(node, {EVENTS: SUBSCRIPTIONS[EVENTS]}, identified=(EVENTS,))
    publisher = advertise(node, EVENTS)
    matched({EVENTS: publisher}, inbox)
    for length in (10, 5000, 10, 20_000, 7000):
        event = encode(SwarmEvent(0, length, 3, EventKind.DEAD, 0.1, "abcdefghij" * (length // 10)))
        publisher.publish(event)
        assert [canonical(SwarmEvent, data) for data in receive(inbox, EVENTS, 1)] == [event]
        assert len(inbox.writer(EVENTS)) == 16
    node.destroy_subscription(inbox._subscriptions[EVENTS])  # noqa: SLF001 - what happens if a node is torn down
    with pytest.raises(RunError, match="cannot be taken"):
        inbox.take(EVENTS)


@pytest.mark.parametrize("missing", ["library", "handle"])
def test_without_access_to_rcl_messages_are_taken_and_their_writers_unknown(
    missing: str, node: SwarmNode, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    if missing == "library":
        monkeypatch.setattr("swarmabs_ros.endpoints.rclpy_implementation.__file__", _ctypes.__file__)
    else:
        monkeypatch.delattr("swarmabs_ros.endpoints.rclpy_implementation.Subscription.pointer")
    inbox = Receiver(node, {PLANE_STATE: SUBSCRIPTIONS[PLANE_STATE]}, identified=(PLANE_STATE,))
    assert "a second sender cannot be told from the first" in capfd.readouterr().err
    publisher = advertise(node, PLANE_STATE)
    matched({PLANE_STATE: publisher}, inbox)
    publisher.publish(MESSAGES[0])
    assert receive(inbox, PLANE_STATE, 1) == [MESSAGES[0]]
    assert inbox.writer(PLANE_STATE) == b""


def test_topics_are_kept_apart_and_nothing_there_is_none_and_a_wait_that_ends(node: SwarmNode) -> None:
    inbox = Receiver(node, SUBSCRIPTIONS)
    began = time.monotonic()
    assert inbox.wait(BOTH, 0.01) is False
    assert time.monotonic() - began > 0.005
    assert (inbox.take(PLANE_STATE), inbox.publisher_count(PLANE_STATE)) == (None, 0)
    publishers = {topic: advertise(node, topic) for topic in BOTH}
    matched(publishers, inbox)
    # Fast DDS pads the payload to a multiple of four: that may come with it.
    event = encode(SwarmEvent(0, 0, 3, EventKind.DEAD, 0.1, "silent"))
    publishers[EVENTS].publish(event)
    until(lambda: inbox.wait(BOTH, 0.1), "one of two is enough")
    publishers[PLANE_STATE].publish(MESSAGES[0])
    (taken,) = receive(inbox, EVENTS, 1)
    assert taken.rstrip(b"\0") == event.rstrip(b"\0")
    assert receive(inbox, PLANE_STATE, 1) == [MESSAGES[0]]
    assert inbox.take(EVENTS) is None


def test_an_executor_leaves_alone_what_a_loop_takes(node: SwarmNode) -> None:
    publisher = advertise(node, PLANE_STATE)
    inbox = Receiver(node, {PLANE_STATE: SUBSCRIPTIONS[PLANE_STATE]}, LoopGroup())
    matched({PLANE_STATE: publisher}, inbox)
    served = []
    node.create_timer(0.01, lambda: served.append(1))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    for data in MESSAGES:
        publisher.publish(data)
        executor.spin_once(timeout_sec=1.0)
    assert len(served) == len(MESSAGES), "it serves the timer, and nothing else is ready for it"
    assert receive(inbox, PLANE_STATE, len(MESSAGES)) == MESSAGES
    executor.shutdown()


def test_an_rclpy_that_has_changed_is_named_with_the_way_out(node: SwarmNode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("swarmabs_ros.endpoints.rclpy_implementation.WaitSet")
    with pytest.raises(ImportError, match="use that of ROS 2 Jazzy"):
        Receiver(node, SUBSCRIPTIONS)


@pytest.mark.parametrize(("driver", "topic"), [(driver, topic) for driver in OFFERED for topic in OFFERED[driver]])
def test_offers_suffice_each_reader_and_assert_life_in_real_time_where_every_period_is_published(
    driver: Driver, topic: Topic
) -> None:
    offered = profile(OFFERED[driver][topic])
    periodic = {STANDING, RELAY, *(topic for family in FAMILIES for topic in family.main)}
    periodic |= {STANDBY_TOPICS[topic] for topic in periodic & STANDBY_TOPICS.keys()}
    asserts = driver is REALTIME and topic in periodic
    assert offered.history is QoSHistoryPolicy.KEEP_LAST
    assert offered.depth == OFFERED[driver][topic].depth > 0
    assert offered.deadline.nanoseconds == 0
    assert (offered.liveliness is QoSLivelinessPolicy.MANUAL_BY_TOPIC) is asserts
    assert offered.liveliness_lease_duration.nanoseconds == (500_000_000 if asserts else 0)
    for reliable in (False, True):
        wanted = requested(topic, driver, depth=7, reliable=reliable)
        assert (wanted.depth, wanted.lease) == (7, 0.0)
        assert reliable or wanted.reliability == "best_effort"
        compatible, reason = qos_check_compatible(offered, profile(wanted))
        assert compatible != QoSCompatibility.ERROR, reason


def test_events_wait_for_those_who_come_later_and_ages_decide_before_the_middleware_does() -> None:
    assert OFFERED[LOCKSTEP][EVENTS] == Qos("reliable", 1000, "transient_local")
    limits = Realtime()
    assert max(limits.broadcast_age_limit, limits.state_age_limit, limits.plane_age_limit) < LEASE
    assert Schedule(10_000_000).steps(LEASE) > 10, "a lost message or two is no death"

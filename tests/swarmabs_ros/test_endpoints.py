"""Publishers and both ways of receiving, over real DDS in one process."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.publisher import Publisher
from tests.swarmabs_ros.nodes import started_node

from swarmabs_config.graph import requested
from swarmabs_core.cdr import encode
from swarmabs_core.messages import EVENTS, PLANE_STATE, TOPICS, EventKind, PlaneState, SwarmEvent, Topic
from swarmabs_ros.endpoints import (
    ExecutorReceiver,
    LoopGroup,
    Receiver,
    WaitSetReceiver,
    advertise,
    receiver,
    ros_type,
)
from swarmabs_ros.start import SwarmNode

pytestmark = pytest.mark.usefixtures("ros")

SUBSCRIPTIONS = {topic: requested(topic, depth=100, reliable=True) for topic in (PLANE_STATE, EVENTS)}
MESSAGES = [encode(PlaneState(step, step, 0.1 * step, -1.0 / (step + 1))) for step in range(20)]
BOTH = (PLANE_STATE, EVENTS)


@pytest.fixture
def node() -> Iterator[SwarmNode]:
    with started_node() as node:
        yield node


@pytest.fixture(params=["wait_set", "executor"])
def inbox(request: pytest.FixtureRequest, node: SwarmNode) -> Receiver:
    return receiver(node, SUBSCRIPTIONS, request.param)


def matched(publishers: dict[Topic, Publisher], *inboxes: Receiver) -> None:
    """Wait until publishers and subscriptions have met."""
    deadline = time.monotonic() + 10.0
    while not all(
        publisher.get_subscription_count() == len(inboxes) and inbox.publisher_count(topic) == 1
        for topic, publisher in publishers.items()
        for inbox in inboxes
    ):
        assert time.monotonic() < deadline, "endpoints do not meet"
        time.sleep(0.01)


def receive(inbox: Receiver, topic: Topic, count: int) -> list[bytes]:
    """Wait for messages of a topic."""
    found: list[bytes] = []
    deadline = time.monotonic() + 10.0
    while len(found) < count:
        assert time.monotonic() < deadline, f"{len(found)} of {count} messages arrived"
        inbox.wait((topic,), 0.1)
        while (data := inbox.take(topic)) is not None:
            found.append(data)
    return found


def test_both_ways_deliver_the_same_bytes_in_order(node: SwarmNode) -> None:
    publisher = advertise(node, PLANE_STATE)
    plane_only = {PLANE_STATE: SUBSCRIPTIONS[PLANE_STATE]}
    direct = receiver(node, plane_only, "wait_set")
    other = SwarmNode("other")  # an executor takes whatever comes for its node
    with_callbacks = receiver(other, plane_only, "executor")
    assert isinstance(direct, WaitSetReceiver)
    assert isinstance(with_callbacks, ExecutorReceiver)
    matched({PLANE_STATE: publisher}, direct, with_callbacks)
    for data in MESSAGES:
        publisher.publish(data)
    assert receive(direct, PLANE_STATE, len(MESSAGES)) == MESSAGES
    assert receive(with_callbacks, PLANE_STATE, len(MESSAGES)) == MESSAGES
    other.destroy_node()  # type: ignore[no-untyped-call]


def test_topics_are_kept_apart(node: SwarmNode, inbox: Receiver) -> None:
    publishers = {topic: advertise(node, topic) for topic in BOTH}
    matched(publishers, inbox)
    # Fast DDS pads the payload to a multiple of four: that may come with it.
    event = encode(SwarmEvent(0, 0, 3, EventKind.DEAD, 0.1, "silent"))
    publishers[EVENTS].publish(event)
    publishers[PLANE_STATE].publish(MESSAGES[0])
    (found,) = receive(inbox, EVENTS, 1)
    assert found.rstrip(b"\0") == event.rstrip(b"\0")
    assert receive(inbox, PLANE_STATE, 1) == [MESSAGES[0]]
    assert inbox.take(EVENTS) is None


def test_nothing_there_is_none_and_a_wait_that_ends(inbox: Receiver) -> None:
    assert inbox.take(PLANE_STATE) is None
    assert inbox.wait(BOTH, 0.01) is False
    assert inbox.publisher_count(PLANE_STATE) == 0


def test_a_wait_ends_when_something_is_there(node: SwarmNode, inbox: Receiver) -> None:
    publishers = {topic: advertise(node, topic) for topic in BOTH}
    matched(publishers, inbox)
    publishers[EVENTS].publish(encode(SwarmEvent(0, 0, 0, EventKind.JOINED, 0.0, "")))
    deadline = time.monotonic() + 10.0
    while not inbox.wait(BOTH, 5.0):
        assert time.monotonic() < deadline
    assert inbox.take(EVENTS) is not None


def test_an_executor_leaves_alone_what_a_loop_takes(node: SwarmNode) -> None:
    publisher = advertise(node, PLANE_STATE)
    inbox = WaitSetReceiver(node, {PLANE_STATE: SUBSCRIPTIONS[PLANE_STATE]}, LoopGroup())
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
    with pytest.raises(ImportError, match="receive:=executor"):
        receiver(node, SUBSCRIPTIONS, "wait_set")


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_every_topic_has_its_ros_type(topic: Topic) -> None:
    assert ros_type(topic).__name__ == topic.message.__name__
    assert ros_type(topic).__module__.startswith("swarmabs_msgs.msg")

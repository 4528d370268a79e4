"""Publishers and subscriptions of serialized messages, and waiting for messages.

Only this module uses non-public parts of rclpy: waiting on a wait set and taking messages directly has a quarter of the
cost of an executor with callbacks, which makes hundreds of processes on two cores possible. `ExecutorReceiver` does the
same with rclpy's public interface, as a fallback if a future rclpy changes its internals.
"""

from __future__ import annotations

import importlib
from collections import deque
from typing import TYPE_CHECKING, Any, Literal, Protocol

from rclpy.callback_groups import CallbackGroup
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)

from swarmabs_config.graph import LOCKSTEP, OFFERED, Driver, Qos

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.subscription import Subscription

    from swarmabs_core.messages import Topic

Waiting = Literal["wait_set", "executor"]

_RELIABILITY = {"reliable": QoSReliabilityPolicy.RELIABLE, "best_effort": QoSReliabilityPolicy.BEST_EFFORT}
_DURABILITY = {"volatile": QoSDurabilityPolicy.VOLATILE, "transient_local": QoSDurabilityPolicy.TRANSIENT_LOCAL}


def ros_type(topic: Topic) -> Any:
    """Return the ROS message class of a topic."""
    package, _, name = topic.ros_type.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def profile(qos: Qos) -> QoSProfile:
    """Convert a quality of service to an rclpy profile."""
    found = QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=_RELIABILITY[qos.reliability],
        durability=_DURABILITY[qos.durability],
    )
    if qos.lease:
        found.liveliness = QoSLivelinessPolicy.MANUAL_BY_TOPIC
        found.liveliness_lease_duration = Duration(seconds=qos.lease)
    return found


def advertise(node: Node, topic: Topic, driver: Driver = LOCKSTEP) -> Publisher:
    """Create the publisher of a topic, which accepts serialized messages."""
    return node.create_publisher(ros_type(topic), topic.name, profile(OFFERED[driver][topic]))


class Receiver(Protocol):
    """Access to the messages that have arrived."""

    def take(self, topic: Topic) -> bytes | None:
        """Return the oldest message of a topic that has not been taken yet, None if there is none."""
        ...

    def wait(self, topics: tuple[Topic, ...], timeout: float) -> bool:
        """Wait until a message of one of the topics arrives; return False after `timeout` (s)."""
        ...

    def publisher_count(self, topic: Topic) -> int:
        """Return the number of matched publishers of a topic."""
        ...


class WaitSetReceiver:
    """Waits on a wait set of only the given topics and takes serialized messages directly.

    If an executor also serves the node, `group` keeps it from taking the messages. Raises `ImportError` if this rclpy
    has no such interface; the text names the alternative.
    """

    def __init__(self, node: Node, subscriptions: Mapping[Topic, Qos], group: CallbackGroup | None = None) -> None:
        self._context = node.context.handle
        self._types = {topic: ros_type(topic) for topic in subscriptions}
        self._subscriptions: dict[Topic, Any] = {
            topic: node.create_subscription(
                self._types[topic], topic.name, unheard, profile(qos), callback_group=group, raw=True
            )
            for topic, qos in subscriptions.items()
        }
        self._wait_sets: dict[tuple[Topic, ...], Any] = {}
        try:
            self._make_wait_set: Any = rclpy_implementation.WaitSet
            self._take = {topic: s.handle.take_message for topic, s in self._subscriptions.items()}
        except AttributeError as error:
            raise ImportError(
                f"this rclpy does not support direct waiting ({error}); start with the parameter receive:=executor"
            ) from error

    def take(self, topic: Topic) -> bytes | None:
        """Return the oldest message of a topic that has not been taken yet, None if there is none."""
        taken = self._take[topic](self._types[topic], True)
        return None if taken is None else taken[0]

    def wait(self, topics: tuple[Topic, ...], timeout: float) -> bool:
        """Wait until a message of one of the topics arrives; return False after `timeout` (s)."""
        wait_set = self._wait_sets.get(topics)
        if wait_set is None:
            wait_set = self._make_wait_set(len(topics), 0, 0, 0, 0, 0, self._context)
            self._wait_sets[topics] = wait_set
        wait_set.clear_entities()
        for topic in topics:
            wait_set.add_subscription(self._subscriptions[topic].handle)
        wait_set.wait(int(timeout * 1e9))
        return bool(wait_set.get_ready_entities("subscription"))

    def publisher_count(self, topic: Topic) -> int:
        """Return the number of matched publishers of a topic."""
        return int(self._subscriptions[topic].get_publisher_count())


class LoopGroup(CallbackGroup):
    """Callback group of the entities that a loop serves itself: no executor executes any of them."""

    def can_execute(self, entity: object) -> bool:  # noqa: ARG002 - the interface of rclpy
        """Return False."""
        return False

    def beginning_execution(self, entity: object) -> bool:  # noqa: ARG002 - the interface of rclpy
        """Return False."""
        return False

    def ending_execution(self, entity: object) -> None:
        """Do nothing, because no execution starts."""


_IDLE_SPINS = 2
"""Spins without a message after which none is left: one ends a round in which each subscription had its turn."""


class ExecutorReceiver:
    """A receiver that uses rclpy's public executor; several times slower."""

    def __init__(self, node: Node, subscriptions: Mapping[Topic, Qos]) -> None:
        self._arrived: dict[Topic, deque[bytes]] = {topic: deque() for topic in subscriptions}
        self._subscriptions: dict[Topic, Subscription] = {
            topic: node.create_subscription(ros_type(topic), topic.name, self._keeping(topic), profile(qos), raw=True)
            for topic, qos in subscriptions.items()
        }
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    def _keeping(self, topic: Topic) -> Callable[[bytes], None]:
        """Return the callback of a topic; rclpy requires one with a Python signature."""
        arrived = self._arrived[topic]

        def keep(data: bytes) -> None:
            arrived.append(data)

        return keep

    def take(self, topic: Topic) -> bytes | None:
        """Return the oldest message of a topic that has not been taken yet, None if there is none."""
        arrived = self._arrived[topic]
        return arrived.popleft() if arrived else None

    def wait(self, topics: tuple[Topic, ...], timeout: float) -> bool:
        """Wait until a message arrives, and store all that have arrived; return False after `timeout` (s)."""
        try:
            before, idle = sum(map(len, self._arrived.values())), 0
            while idle < _IDLE_SPINS:
                self._executor.spin_once(timeout_sec=timeout)
                kept = sum(map(len, self._arrived.values()))
                idle = idle + 1 if kept == before else 0
                before, timeout = kept, 0.0
        except ExternalShutdownException:
            return False
        return any(self._arrived[topic] for topic in topics)

    def publisher_count(self, topic: Topic) -> int:
        """Return the number of matched publishers of a topic."""
        return self._subscriptions[topic].get_publisher_count()


def receiver(node: Node, subscriptions: Mapping[Topic, Qos], waiting: Waiting) -> Receiver:
    """Subscribe to topics and return the selected kind of receiver."""
    if waiting == "executor":
        return ExecutorReceiver(node, subscriptions)
    return WaitSetReceiver(node, subscriptions)


def unheard(_: object) -> None:
    """Serve as callback where no executor runs."""

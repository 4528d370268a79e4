"""Publishers and subscriptions of serialized messages, and waiting for messages.

Only this module uses non-public parts of rclpy: waiting on a wait set and taking messages directly has a quarter of the
cost of an executor with callbacks, which makes hundreds of processes on two cores possible.

rclpy of Jazzy does not tell who wrote a message. `IdentifyingTake` asks rcl, to which rclpy passes the call on.
"""

from __future__ import annotations

import ctypes
import importlib
import struct
import weakref
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import CallbackGroup
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)

from swarmabs_config.graph import LOCKSTEP, OFFERED, Driver, Qos, usual_topic
from swarmabs_core.errors import RunError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.subscription import Subscription

    from swarmabs_core.messages import Topic

    Take = Callable[[type, bool], tuple[bytes, object] | tuple[bytes] | None]

_RELIABILITY = {"reliable": QoSReliabilityPolicy.RELIABLE, "best_effort": QoSReliabilityPolicy.BEST_EFFORT}
_DURABILITY = {"volatile": QoSDurabilityPolicy.VOLATILE, "transient_local": QoSDurabilityPolicy.TRANSIENT_LOCAL}


def ros_type(topic: Topic) -> Any:
    """Return the ROS message class of a topic."""
    package, _, name = topic.ros_type.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def profile(qos: Qos) -> QoSProfile:
    """Convert a quality of service to an rclpy profile."""
    policies = QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=_RELIABILITY[qos.reliability],
        durability=_DURABILITY[qos.durability],
    )
    if qos.lease:
        policies.liveliness = QoSLivelinessPolicy.MANUAL_BY_TOPIC
        policies.liveliness_lease_duration = Duration(seconds=qos.lease)
    return policies


def advertise(node: Node, topic: Topic, driver: Driver = LOCKSTEP) -> Publisher:
    """Create the publisher of a topic, which accepts serialized messages."""
    return node.create_publisher(ros_type(topic), topic.name, profile(OFFERED[driver][usual_topic(topic)]))


class _Allocator(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")]


class _Bytes(ctypes.Structure):
    """``rcutils_uint8_array_t``, the serialized message."""

    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


_WRITER = struct.Struct("32xP16s")
"""Where ``rmw_message_info_t`` of Jazzy has the address of the middleware's name and the GID of the writer."""
_INFO_SIZE = 256
"""Bytes for it, with room for another layout."""
_OK, _TAKE_FAILED = 0, 401
_FIRST_CAPACITY = 1024
"""Bytes of the buffer for a message at first; the middleware enlarges it if necessary."""


class IdentifyingTake:
    """Takes serialized messages by rcl's own function, which also tells the GID of the writer.

    Raises `ImportError` if rcl cannot be called in this way. Whether the GID is where Jazzy has it shows with the first
    message: the address of the middleware's name, which is known, stands before it. If it does not, `note` is called
    with a text, messages are taken as usual, and their writers are unknown.

    Attributes
    ----------
    writer : bytes
        GID of the writer of the message taken last; empty if unknown.
    """

    def __init__(self, subscription: Subscription, note: Callable[[str], object]) -> None:
        self._handle = subscription.handle
        self._note: Callable[[str], object] | None = note
        self.writer = b""
        message, self._info = _Bytes(), ctypes.create_string_buffer(_INFO_SIZE)
        try:
            # Holds the GIL, as rclpy's own call does: taking never waits.
            library = ctypes.PyDLL(rclpy_implementation.__file__)
            topic_name, allocator = library.rcl_subscription_get_topic_name, library.rcutils_get_default_allocator
            make, end = library.rcutils_uint8_array_init, library.rcutils_uint8_array_fini
            implementation, self._forget_error = library.rmw_get_implementation_identifier, library.rcutils_reset_error
            self._take = library.rcl_take_serialized_message
            topic_name.argtypes, topic_name.restype = (ctypes.c_void_p,), ctypes.c_char_p
            with self._handle:
                topic = topic_name(self._handle.pointer)
        except (AttributeError, OSError) as error:
            raise ImportError(f"this rclpy does not give access to rcl: {error}") from error
        if topic != subscription.topic_name.encode():
            raise ImportError("this rclpy does not give access to rcl: a subscription is not what rcl knows")
        allocator.restype = _Allocator
        make.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
        implementation.restype = ctypes.c_void_p
        self._take.argtypes = (ctypes.c_void_p,) * 4
        if make(ctypes.byref(message), _FIRST_CAPACITY, ctypes.byref(allocator())) != _OK:
            raise MemoryError("no memory for a message")
        weakref.finalize(self, end, ctypes.byref(message))
        self._message, self._content, self._implementation = message, memoryview(b""), implementation()
        self._arguments = ctypes.addressof(message), ctypes.addressof(self._info), None

    def __call__(self, _type: object, _raw: bool) -> tuple[bytes] | None:  # noqa: FBT001 - the interface of rclpy
        """Return the oldest message that has not been taken yet, None if there is none."""
        # A destroyed subscription has no address, which rcl refuses.
        code = self._take(self._handle.pointer, *self._arguments)
        if code == _TAKE_FAILED:
            return None
        if code != _OK:
            self._forget_error()
            raise RunError(f"a message cannot be taken: rcl_take_serialized_message returned {code}")
        implementation, self.writer = _WRITER.unpack_from(self._info)
        if implementation != self._implementation:
            self._doubt()
        message = self._message
        if message.capacity != len(self._content):
            self._content = memoryview((ctypes.c_char * message.capacity).from_address(message.buffer))
        return (self._content[: message.length].tobytes(),)

    def _doubt(self) -> None:
        """Forget the writer, which is elsewhere."""
        self.writer = b""
        if self._note is not None:
            self._note("this rcl does not tell the writers of messages where Jazzy does")
            self._note = None


class Receiver:
    """Waits on a wait set of only the given topics and takes serialized messages directly.

    If an executor also serves the node, `group` keeps it from taking the messages. The writers of the `identified`
    topics are known, unless this rclpy does not give access to rcl; then the node's log says so. Raises `ImportError`
    if this rclpy has no such interface.
    """

    def __init__(
        self,
        node: Node,
        subscriptions: Mapping[Topic, Qos],
        group: CallbackGroup | None = None,
        identified: Collection[Topic] = (),
    ) -> None:
        self._context = node.context.handle
        self._types = {topic: ros_type(topic) for topic in subscriptions}
        self._subscriptions: dict[Topic, Subscription] = {
            topic: node.create_subscription(
                self._types[topic], topic.name, unheard, profile(qos), callback_group=group, raw=True
            )
            for topic, qos in subscriptions.items()
        }
        self._wait_sets: dict[tuple[Topic, ...], Any] = {}
        try:
            self._make_wait_set = rclpy_implementation.WaitSet
            self._take: dict[Topic, Take] = {topic: s.handle.take_message for topic, s in self._subscriptions.items()}
        except AttributeError as error:
            raise ImportError(
                f"this rclpy does not support direct waiting ({error}); use that of ROS 2 Jazzy"
            ) from error
        self._identifying: dict[Topic, IdentifyingTake] = {}
        self._warn = node.get_logger().warning
        for topic in identified:
            if topic in subscriptions:
                self._identify(topic)

    def _identify(self, topic: Topic) -> None:
        """Take the messages of a topic so that their writers are known, if possible."""

        def note(problem: str) -> None:
            self._warn(f"{topic.name}: {problem}; a second sender cannot be told from the first")

        try:
            self._take[topic] = self._identifying[topic] = IdentifyingTake(self._subscriptions[topic], note)
        except ImportError as error:
            note(str(error))

    def take(self, topic: Topic) -> bytes | None:
        """Return the oldest message of a topic that has not been taken yet, None if there is none."""
        taken = self._take[topic](self._types[topic], True)
        return None if taken is None else taken[0]

    def writer(self, topic: Topic) -> bytes:
        """Return the GID of the writer of the message taken last from a topic; empty if unknown."""
        take = self._identifying.get(topic)
        return b"" if take is None else take.writer

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


def unheard(_: object) -> None:
    """Serve as callback where no executor runs."""

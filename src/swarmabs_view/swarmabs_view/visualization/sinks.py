"""Where the messages of a view go: topics of ROS, or a WebSocket for Foxglove."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from rclpy.serialization import serialize_message

from swarmabs_bag.schemas import message_schema
from swarmabs_core.errors import RunError
from swarmabs_ros.endpoints import profile
from swarmabs_view.ports import ADDRESS, need_foxglove
from swarmabs_view.visualization.topics import DESCRIPTION, available_topics, message_class

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rclpy.node import Node

    from swarmabs_core.messages import Topic
    from swarmabs_view.visualization.topics import VisualTopic

BACKLOG = 64
"""Messages that wait for a slow client before the oldest are dropped."""


class Sink(Protocol):
    """Takes messages."""

    def publish(self, topic: VisualTopic, message: Any) -> None:
        """Take a message of a standard type."""
        ...

    def forward(self, topic: Topic, payload: bytes) -> None:
        """Take a message of the swarm as it came."""
        ...

    def repeat(self) -> None:
        """Tell again, about once a second, what those need who have come since."""
        ...

    def close(self) -> None:
        """Take no more."""
        ...


class RosSink:
    """Publishes on the topics of a node; the swarm's own messages are there already."""

    def __init__(self, node: Node) -> None:
        self._publishers = {
            topic: node.create_publisher(message_class(topic.ros_type), topic.name, profile(topic.qos))
            for topic in available_topics()
        }

    def publish(self, topic: VisualTopic, message: Any) -> None:
        """Publish a message."""
        self._publishers[topic].publish(message)

    def forward(self, topic: Topic, payload: bytes) -> None:
        """Do nothing."""

    def repeat(self) -> None:
        """Do nothing: the middleware does it."""

    def close(self) -> None:
        """Do nothing: the node takes its publishers with it."""


class FoxgloveSink:
    """Serves the same messages to Foxglove, on the loopback interface.

    Parameters
    ----------
    port : int
        TCP port, 0 for any that is free.
    namespace : str
        Of the swarm.
    topics : iterable of Topic
        The swarm's own topics that will be forwarded.

    Raises
    ------
    InputError
        If the package foxglove-sdk is not installed.
    RunError
        If the port is taken.
    """

    def __init__(self, port: int, namespace: str, topics: Iterable[Topic]) -> None:
        need_foxglove()
        import foxglove  # noqa: PLC0415 - only where it is asked for

        self._prefix = namespace.rstrip("/")
        self._context = foxglove.Context()
        own = {topic.name: topic.ros_type for topic in topics}
        shown = {topic.name: topic.ros_type for topic in available_topics()}
        self._channels = {name: self._channel(foxglove, name, kind) for name, kind in (own | shown).items()}
        self._latched: tuple[VisualTopic, bytes] | None = None
        try:
            self._server = foxglove.start_server(
                name="swarmabs", host=ADDRESS, port=port, context=self._context, message_backlog_size=BACKLOG
            )
        except RuntimeError as error:
            raise RunError(f"cannot serve Foxglove on {ADDRESS}:{port}: {error}; choose another port") from error
        self.port = int(self._server.port)

    def publish(self, topic: VisualTopic, message: Any) -> None:
        """Send a message."""
        payload = serialize_message(message)
        if topic is DESCRIPTION:
            self._latched = (topic, payload)
        self._log(topic.name, payload)

    def forward(self, topic: Topic, payload: bytes) -> None:
        """Send a message of the swarm."""
        self._log(topic.name, payload)

    def repeat(self) -> None:
        """Send the description of the plane again."""
        if self._latched is not None:
            self._log(self._latched[0].name, self._latched[1])

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()

    def _channel(self, foxglove: Any, name: str, ros_type: str) -> Any:
        schema = foxglove.Schema(name=ros_type, encoding="ros2msg", data=message_schema(ros_type).text.encode())
        topic = f"{self._prefix}/{name}"
        return foxglove.Channel(topic, schema=schema, message_encoding="cdr", context=self._context)

    def _log(self, name: str, payload: bytes) -> None:
        self._channels[name].log(payload)

"""A node without a network: its sensors say what a test says, and it keeps what is published."""

from types import SimpleNamespace
from typing import Any

from rclpy.time import Time

from swarmabs_ros.endpoints import LoopGroup

NOW = 1_700_000_000_250_000_000
"""Time of its clock, and of each arrival, ns since 1970."""


class FakeNode:
    """What drivers of sensors and drives need of a node."""

    def __init__(self) -> None:
        self.loop_group = LoopGroup()
        self.sensors: dict[str, list[Any]] = {}
        self.published: dict[str, list[Any]] = {}

    def create_subscription(self, _kind: type, topic: str, _callback: object, _qos: object, **options: object) -> Any:
        assert options == {"callback_group": self.loop_group}, "an executor would take the messages away"
        waiting = self.sensors.setdefault(topic, [])

        def take(_kind: type, _raw: bool) -> Any:  # noqa: FBT001 - as rclpy has it
            return (waiting.pop(0), {"received_timestamp": NOW}) if waiting else None

        return SimpleNamespace(handle=SimpleNamespace(take_message=take))

    def create_publisher(self, _kind: type, topic: str, _qos: object) -> Any:
        return SimpleNamespace(publish=self.published.setdefault(topic, []).append)

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: Time(nanoseconds=NOW))

"""A stock ROS node that looks at a swarm in real time and operates it, told what to do.

Usage: python realtime_client.py [NAMESPACE [ID...]], see `stock_node`. It hears the own topics of the robots with
these ids; without ids, the topics that robots share.
"""

import sys
from collections import Counter, deque
from math import nan
from typing import Any

from rcl_interfaces.msg import Log
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSLivelinessPolicy, QoSProfile, QoSReliabilityPolicy
from tests.system.health_client import HealthClient
from tests.system.stock_node import serve

from swarmabs_msgs.msg import AbstractState, AgentState, DesiredAbstractState, PlaneState, SwarmEvent

STATES, EVENTS = "swarm/agent_state", "swarm/events"
"""What robots say, on whatever topic."""
TOPICS = {
    "swarm/abstract_state": AbstractState,
    "swarm/desired_abstract_state": DesiredAbstractState,
    "plane/state": PlaneState,
}


class Client(HealthClient):
    """Hears everything, besides."""

    def __init__(self, node: Node, *own_topics: str) -> None:
        super().__init__(node)
        self.newest: dict[str, dict[str, Any]] = {}
        self.heard: Counter[str] = Counter()
        self.repeated = 0
        self.modes: list[int] = []
        self.logged: list[list[str]] = []
        self.events: list[list[Any]] = []
        self.fallen_silent: Counter[str] = Counter()
        self.come_alive: Counter[str] = Counter()
        self.angles: deque[float] = deque(maxlen=10_000)
        robots = [f"agent_{int(number):03d}" for number in own_topics]
        states = {f"{robot}/state": STATES for robot in robots} or {STATES: STATES}
        topics = [(topic, known_as, AgentState) for topic, known_as in states.items()]
        for topic, known_as, kind in topics + [(topic, topic, kind) for topic, kind in TOPICS.items()]:
            qos = QoSProfile(
                depth=100,
                reliability=QoSReliabilityPolicy.BEST_EFFORT,
                liveliness=QoSLivelinessPolicy.MANUAL_BY_TOPIC,
                liveliness_lease_duration=Duration(seconds=0.5),
            )
            changed = SubscriptionEventCallbacks(liveliness=self._liveliness(known_as), use_default_callbacks=False)
            self.node.create_subscription(kind, topic, self._hear(known_as), qos, event_callbacks=changed)
        for topic in (EVENTS, *(f"{robot}/events" for robot in robots)):
            self.node.create_subscription(SwarmEvent, topic, self._event, 100)
        self.node.create_subscription(Log, "/rosout", lambda log: self.logged.append([log.name, log.msg]), 100)

    def _liveliness(self, topic: str) -> Any:
        # Changes, not totals: of those Fast DDS loses count (eProsima/Fast-DDS#4610).
        def changed(status: Any) -> None:
            self.fallen_silent[topic] += max(status.not_alive_count_change, 0)
            self.come_alive[topic] += max(status.alive_count_change, 0)

        return changed

    def _hear(self, topic: str) -> Any:
        def hear(message: Any) -> None:
            values = {name: getattr(message, name) for name in message.get_fields_and_field_types() if name != "header"}
            key = f"{topic} {values.get('agent_id', '')}".strip()
            before = self.newest.get(key)
            # Within a step there may be another mode: an operator is answered at once.
            same_mode = before is not None and values.get("mode") == before.get("mode")
            if same_mode and values["step"] <= before["step"]:
                self.repeated += 1
            self.newest[key] = values
            self.heard[key] += 1
            if "angle" in values:
                self.angles.append(values["angle"])
            if "mode" in values and (not self.modes or self.modes[-1] != values["mode"]):
                self.modes.append(values["mode"])

        return hear

    def _event(self, event: SwarmEvent) -> None:
        self.events.append([event.agent_id, event.kind, event.detail])

    def look(self) -> dict[str, Any]:
        """Return all that was heard so far."""
        names = (
            "logged",
            "diagnostics",
            "newest",
            "heard",
            "repeated",
            "modes",
            "events",
            "fallen_silent",
            "come_alive",
        )
        return {name: getattr(self, name) for name in names}

    def calm(self, limit: float) -> list[float]:
        """Return how many states of the plane were heard since one beyond an angle, rad, and the newest angle."""
        angles = list(self.angles)
        within = next((k for k, angle in enumerate(reversed(angles)) if abs(angle) > limit), len(angles))
        return [within, angles[-1] if angles else nan]


if __name__ == "__main__":
    sys.exit(serve(Client, *sys.argv[1:2], arguments=sys.argv[2:]))

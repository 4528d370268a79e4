"""A stock ROS node with stolen keys that forges what others of a swarm say, as fast as the broadcasts come.

Usage: python intruder.py NAMESPACE, see `stock_node`.
"""

import sys
from collections import Counter
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger
from tests.system.stock_node import StockNode, serve

from swarmabs_config.graph import OFFERED, REALTIME
from swarmabs_core.messages import ABSTRACT_STATE, AGENT_STATE, DESIRED_ABSTRACT_STATE, EVENTS, PLANE_STATE, REMOVALS
from swarmabs_msgs.msg import AbstractState, AgentState, DesiredAbstractState, PlaneState, SwarmEvent
from swarmabs_ros.endpoints import profile

MARK = "forged"
POSITION = 0.3125
"""Where a forged robot says it is, m."""
ANGLE = 0.25
"""Angle of a forged plane, rad."""


def _event(robot: int, kind: int) -> SwarmEvent:
    return SwarmEvent(agent_id=robot, kind=kind, value=POSITION, detail=MARK)


def _state(robot: int, step: int) -> AgentState:
    # It has the dynamics of a single integrator, as the honest robots 1 and 4.
    return AgentState(
        agent_id=robot,
        kind=AgentState.SINGLE_INTEGRATOR,
        status=AgentState.ACTIVE,
        mass=0.3552,
        position=POSITION,
        broadcast_step=step - 1,
    )


class Intruder(StockNode):
    """Answers requests."""

    def __init__(self, node: Node) -> None:
        super().__init__(node)
        self._read: Counter[str] = Counter()
        self._sent: Counter[str] = Counter()
        self._forging: list[tuple[str, Any, Any]] = []
        self._listen(DesiredAbstractState, DESIRED_ABSTRACT_STATE)
        self._listen(PlaneState, PLANE_STATE)

    def _listen(self, kind: Any, topic: Any, name: str = "") -> None:
        def take(message: Any) -> None:
            if getattr(message, "position", None) != POSITION and getattr(message, "angle", None) != ANGLE:
                self._read[name or topic.name] += 1
            if kind is DesiredAbstractState and message.mode != DesiredAbstractState.STOP:
                self._forge(message)

        qos = profile(OFFERED[REALTIME][topic])
        self.node.create_subscription(kind, name or topic.name, take, qos)

    def forge_events(self, topic: str, robot: int, kind: int) -> None:
        """Report events of a robot on a topic from now on."""
        self._publish(EVENTS, topic, SwarmEvent, lambda _: _event(robot, kind))

    def forge_robot(self, robot: int) -> None:
        """Speak for a robot from now on, on its own topics and on those that robots share on other levels; read it."""
        own = f"agent_{robot:03d}"
        for name in (f"{own}/state", AGENT_STATE.name):
            self._publish(AGENT_STATE, name, AgentState, lambda step: _state(robot, step))
        for name in (f"{own}/events", EVENTS.name, REMOVALS.name):
            self.forge_events(name, robot, SwarmEvent.LEFT)
        self._listen(AgentState, AGENT_STATE, f"{own}/state")

    def forge_coordinators(self, prefix: str) -> None:
        """Speak for observer, controller and plane from now on, or with a prefix for their standbys."""
        stop = DesiredAbstractState(mode=DesiredAbstractState.STOP)
        sums: dict[str, Any] = {"agent_count": 3, "torque": 0.5, "inertia": 0.05}
        self._publish(ABSTRACT_STATE, prefix + ABSTRACT_STATE.name, AbstractState, lambda _: AbstractState(**sums))
        desired = DESIRED_ABSTRACT_STATE
        self._publish(desired, prefix + desired.name, DesiredAbstractState, lambda _: stop)
        self._publish(PLANE_STATE, prefix + PLANE_STATE.name, PlaneState, lambda _: PlaneState(angle=ANGLE))

    def _publish(self, topic: Any, name: str, kind: Any, make: Any) -> None:
        publisher = self.node.create_publisher(kind, name, profile(OFFERED[REALTIME][topic]))
        self._forging.append((name, publisher, make))

    def _forge(self, heard: DesiredAbstractState) -> None:
        for name, publisher, make in list(self._forging):
            forged = make(heard.step)
            forged.step, forged.header = heard.step, heard.header
            publisher.publish(forged)
            self._sent[name] += 1

    def read(self) -> dict[str, int]:
        """Return how many messages of others were read, by topic."""
        return self._read

    def sent(self) -> dict[str, int]:
        """Return how many messages were forged, by topic."""
        return self._sent

    def called(self, service: str) -> bool:
        """Call a service twenty times without waiting for it; tell whether anyone has answered before another call."""
        client = self.node.create_client(Trigger, service)
        calls = [client.call_async(Trigger.Request()) for _ in range(20) if not client.wait_for_service(0.25)]
        return len(calls) < 20 or any(call.done() for call in calls)


if __name__ == "__main__":
    sys.exit(serve(Intruder, *sys.argv[1:]))

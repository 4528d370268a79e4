"""A stock ROS node that looks at a swarm in real time and operates it, told by lines of JSON what to do.

Each line on standard input is a list of a request's name and its arguments; each line on standard output its answer.

Usage: python realtime_client.py [NAMESPACE]
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import Counter, deque
from math import nan
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSLivelinessPolicy, QoSProfile, QoSReliabilityPolicy, qos_profile_sensor_data
from std_srvs.srv import Trigger

from swarmabs_msgs.msg import AbstractState, AgentState, DesiredAbstractState, PlaneState, SwarmEvent

TOPICS = {
    "swarm/agent_state": AgentState,
    "swarm/abstract_state": AbstractState,
    "swarm/desired_abstract_state": DesiredAbstractState,
    "plane/state": PlaneState,
}
WAIT = 20.0


class Client:
    """Answers requests; spins in a thread of its own."""

    def __init__(self) -> None:
        self.node = Node("client", enable_rosout=False, start_parameter_services=False)
        self.diagnostics: dict[str, dict[str, Any]] = {}
        self.states: dict[int, dict[str, Any]] = {}
        self.newest: dict[str, dict[str, Any]] = {}
        self.heard: Counter[str] = Counter()
        self.repeated = 0
        self.modes: list[int] = []
        self.events: list[list[Any]] = []
        self.alive: dict[str, int] = {}
        self.angles: deque[float] = deque(maxlen=10_000)
        for topic, kind in TOPICS.items():
            qos = QoSProfile(
                depth=100,
                reliability=QoSReliabilityPolicy.BEST_EFFORT,
                liveliness=QoSLivelinessPolicy.MANUAL_BY_TOPIC,
                liveliness_lease_duration=Duration(seconds=0.5),
            )
            changed = SubscriptionEventCallbacks(liveliness=self._alive(topic), use_default_callbacks=False)
            self.node.create_subscription(kind, topic, self._hear(topic), qos, event_callbacks=changed)
        self.node.create_subscription(SwarmEvent, "swarm/events", self._event, 100)
        self.node.create_subscription(DiagnosticArray, "diagnostics", self._diagnose, 100)
        self._garbage = self.node.create_publisher(PlaneState, "plane/state", qos_profile_sensor_data)

    def _alive(self, topic: str) -> Any:
        def changed(status: Any) -> None:
            self.alive[topic] = status.alive_count

        return changed

    def _hear(self, topic: str) -> Any:
        def hear(message: Any) -> None:
            values = {name: getattr(message, name) for name in message.get_fields_and_field_types() if name != "header"}
            key = f"{topic} {values.get('agent_id', '')}".strip()
            before = self.newest.get(key)
            # Within a step there may be another mode: an operator is answered at once.
            known = before is not None and values.get("mode") == before.get("mode")
            if known and values["step"] <= before["step"]:
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

    def _diagnose(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.diagnostics[status.hardware_id] = {
                "name": status.name,
                "level": int.from_bytes(status.level, "little"),
                "message": status.message,
                "values": {value.key: value.value for value in status.values},
                "count": self.diagnostics.get(status.hardware_id, {"count": 0})["count"] + 1,
            }

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        try:
            if not client.wait_for_service(WAIT):
                return None
            future = client.call_async(request)
            deadline = time.monotonic() + WAIT
            while not future.done():
                if time.monotonic() > deadline:
                    return None
                time.sleep(0.005)
            return future.result()
        finally:
            self.node.destroy_client(client)

    # Requests

    def change(self, node: str, transition: str) -> bool | None:
        request = ChangeState.Request()
        request.transition.label = transition
        answer = self.call(ChangeState, f"{node}/change_state", request)
        return None if answer is None else answer.success

    def change_by_id(self, node: str, number: int) -> bool | None:
        request = ChangeState.Request()
        request.transition.id = number
        answer = self.call(ChangeState, f"{node}/change_state", request)
        return None if answer is None else answer.success

    def state(self, node: str) -> str | None:
        answer = self.call(GetState, f"{node}/get_state", GetState.Request())
        return None if answer is None else answer.current_state.label

    def trigger(self, service: str) -> list[Any] | None:
        answer = self.call(Trigger, service, Trigger.Request())
        return None if answer is None else [answer.success, answer.message]

    def parameter(self, node: str, name: str) -> list[Any]:
        value = self.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=[name])).values[0]
        described = self.call(
            DescribeParameters, f"{node}/describe_parameters", DescribeParameters.Request(names=[name])
        ).descriptors[0]
        return [Parameter.from_parameter_msg(_named(name, value)).value, described.description, described.read_only]

    def set_parameter(self, node: str, name: str, value: Any) -> bool:
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return bool(self.call(SetParameters, f"{node}/set_parameters", request).results[0].successful)

    def look(self) -> dict[str, Any]:
        """Return all that was heard so far."""
        return {
            "diagnostics": self.diagnostics,
            "newest": self.newest,
            "heard": self.heard,
            "repeated": self.repeated,
            "modes": self.modes,
            "events": self.events,
            "alive": self.alive,
        }

    def calm(self, limit: float) -> list[float]:
        """Return how many states of the plane were heard since one beyond an angle, rad, and the newest angle."""
        angles = list(self.angles)
        within = next((k for k, angle in enumerate(reversed(angles)) if abs(angle) > limit), len(angles))
        return [within, angles[-1] if angles else nan]

    def nodes(self) -> list[str]:
        return sorted(self.node.get_node_names())

    def graph(self, node: str) -> dict[str, list[str]]:
        names = (
            ("hears", self.node.get_subscriber_names_and_types_by_node),
            ("publishes", self.node.get_publisher_names_and_types_by_node),
            ("serves", self.node.get_service_names_and_types_by_node),
        )
        return {kind: sorted(name for name, _ in find(node, "/")) for kind, find in names}

    def garbage(self) -> int:
        """Publish states of the plane that are of another frame."""
        message = PlaneState()
        message.header.frame_id = "elsewhere"
        self._garbage.publish(message)
        return int(self._garbage.get_subscription_count())


def _named(name: str, value: Any) -> Any:
    from rcl_interfaces.msg import Parameter as Message  # noqa: PLC0415 - its name is taken above

    return Message(name=name, value=value)


def _spin(node: Node) -> None:
    try:
        rclpy.spin(node)
    except rclpy.executors.ExternalShutdownException:
        return


def main() -> int:
    namespace = sys.argv[1] if len(sys.argv) > 1 else "/"
    rclpy.init(args=["--ros-args", "--disable-external-lib-logs", "-r", f"__ns:={namespace}"])
    client = Client()
    thread = threading.Thread(target=_spin, args=(client.node,), daemon=True)
    thread.start()
    for line in sys.stdin:
        name, *arguments = json.loads(line)
        sys.stdout.write(json.dumps(getattr(client, name)(*arguments)) + "\n")
        sys.stdout.flush()
    rclpy.shutdown()
    thread.join()
    return 0


if __name__ == "__main__":
    sys.exit(main())

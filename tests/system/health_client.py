"""A stock ROS node that hears only the diagnostics of a swarm in real time and operates it, told what to do.

Usage: python health_client.py [NAMESPACE], see `stock_node`.
"""

import sys
import threading
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import Trigger
from tests.system.stock_node import StockNode, serve

WAIT = 60.0


class HealthClient(StockNode):
    """Answers requests."""

    def __init__(self, node: Node) -> None:
        super().__init__(node)
        self.diagnostics: dict[str, dict[str, Any]] = {}
        self.node.create_subscription(DiagnosticArray, "diagnostics", self._diagnose, 100)

    def look(self) -> dict[str, Any]:
        """Return all that was heard so far."""
        return {"diagnostics": self.diagnostics}

    def _diagnose(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.diagnostics[status.hardware_id] = {
                "name": status.name,
                "level": int.from_bytes(status.level, "little"),
                "message": status.message,
                "values": {value.key: value.value for value in status.values},
                "count": self.diagnostics.get(status.hardware_id, {"count": 0})["count"] + 1,
            }

    # Requests

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        try:
            if not client.wait_for_service(WAIT):
                return None
            answered = threading.Event()
            future = client.call_async(request)
            future.add_done_callback(lambda _: answered.set())
            return future.result() if answered.wait(WAIT) else None
        finally:
            self.node.destroy_client(client)

    def change(self, node: str, transition: str) -> bool | None:
        request = ChangeState.Request()
        request.transition.label = transition
        answer = self.call(ChangeState, f"{node}/change_state", request)
        return None if answer is None else answer.success

    def state(self, node: str) -> str | None:
        answer = self.call(GetState, f"{node}/get_state", GetState.Request())
        return None if answer is None else answer.current_state.label

    def trigger(self, service: str) -> list[Any] | None:
        answer = self.call(Trigger, service, Trigger.Request())
        return None if answer is None else [answer.success, answer.message]

    def set_parameter(self, node: str, name: str, value: Any) -> str | None:
        """Set a parameter; return why that was refused, "" if it was not."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        answer = self.call(SetParameters, f"{node}/set_parameters", request)
        return None if answer is None else answer.results[0].reason

    def parameter(self, node: str, name: str) -> Any:
        answer = self.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=[name]))
        return None if answer is None else parameter_value_to_python(answer.values[0])


if __name__ == "__main__":
    sys.exit(serve(HealthClient, *sys.argv[1:2]))

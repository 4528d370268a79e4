"""The operator client: a node that calls the services of a swarm's nodes and hears their diagnostics."""

from __future__ import annotations

import os
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.messages import EVENTS, EventKind, SwarmEvent
from swarmabs_ros.endpoints import advertise
from swarmabs_run.tracing_files import tracing_files_removed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.node import Node

    from swarmabs_fleet.operate.health import HealthMonitor
    from swarmabs_fleet.operate.target import Target

SLICE = 0.1
"""Longest wait, s, before looking whether enough was heard."""


class OperatorClient:
    """A node in the network of a swarm.

    Parameters
    ----------
    node : Node
        The node.
    target : Target
        The swarm.
    """

    def __init__(self, node: Node, target: Target) -> None:
        self._node = node
        self._target = target
        self._swarm = target.name

    def call(self, service: str, patience: float) -> str:
        """Call a ``std_srvs/Trigger`` service and return what it answers.

        Parameters
        ----------
        service : str
            Name relative to the swarm's namespace.
        patience : float
            Time, s, within which it must be found, and then answer.

        Raises
        ------
        RunError
            If nobody offers it or answers, the node says no, or the run has ended meanwhile.
        """
        client = self._node.create_client(Trigger, service)
        who = f"{self._swarm}: {client.srv_name}"
        try:
            if not client.wait_for_service(patience):
                raise RunError(f"{who} is not there; is the node running, and this the host of the parent controller?")
            self._check()
            future = client.call_async(Trigger.Request())
            rclpy.spin_until_future_complete(self._node, future, timeout_sec=patience)
            answer = future.result()
            if answer is None:
                raise RunError(f"{who} has not answered within {patience:g} s")
            if not answer.success:
                raise RunError(f"{who}: {answer.message}")
            return str(answer.message)
        finally:
            self._node.destroy_client(client)

    def _check(self) -> None:
        """Refuse to speak into a network that may be another swarm's by now: whoever was found may belong to it."""
        if not self._target.goes_on():
            raise RunError(f"{self._swarm}: the run has ended meanwhile")

    @contextmanager
    def announced(self, agent_id: int, detail: str, patience: float) -> Iterator[None]:
        """Publish the event that a robot has left; it is there for whoever hears it during the block.

        Raises
        ------
        RunError
            If nobody listens in time (s), or the run has ended meanwhile.
        """
        publisher = advertise(self._node, EVENTS)
        try:
            deadline = time.monotonic() + patience
            while not publisher.get_subscription_count():
                if time.monotonic() > deadline:
                    raise RunError(f"{self._swarm}: nobody hears {publisher.topic_name}; is the observer running?")
                time.sleep(SLICE)
            self._check()
            publisher.publish(encode(SwarmEvent(time.time_ns(), 0, agent_id, EventKind.LEFT, 0.0, detail)))
            yield
        finally:
            self._node.destroy_publisher(publisher)

    def listen(self, monitor: HealthMonitor, patience: float, enough: Callable[[], bool]) -> None:
        """Let a monitor hear the diagnostics until it is enough, or the time (s) is over.

        Raises
        ------
        RunError
            If the run has ended meanwhile.
        """

        def hear(array: DiagnosticArray) -> None:
            for status in array.status:
                values = {str(item.key): str(item.value) for item in status.values}
                monitor.hear(str(status.hardware_id), status.level[0], str(status.message), values, time.monotonic())

        subscription = self._node.create_subscription(DiagnosticArray, "diagnostics", hear, 100)
        try:
            deadline = time.monotonic() + patience
            while not enough() and time.monotonic() < deadline:
                self._check()
                rclpy.spin_once(self._node, timeout_sec=SLICE)
        finally:
            self._node.destroy_subscription(subscription)


@contextmanager
def joined(target: Target) -> Iterator[OperatorClient]:
    """Join the network of a swarm for a while.

    Raises
    ------
    RunError
        If the middleware cannot join, such as from a host that has not the address.
    """
    os.environ.update(target.environment)
    with tracing_files_removed():
        try:
            rclpy.init(args=["--ros-args", "--disable-external-lib-logs", "--disable-rosout-logs"])
            node = rclpy.create_node(
                f"operator_{os.getpid()}",
                namespace=target.namespace,
                enable_rosout=False,
                start_parameter_services=False,
                parameter_overrides=[Parameter("start_type_description_service", value=False)],
            )
        except Exception as error:  # rclpy names no common base
            rclpy.try_shutdown()
            raise RunError(f"{target.name}: cannot join its network: {' '.join(str(error).split())}") from error
        try:
            yield OperatorClient(node, target)
        finally:
            node.destroy_node()
            rclpy.try_shutdown()

"""Operating a swarm in real time: stop, reset, drain, join, remove, status.

The swarm is a fleet, named by its file, or a run in real time, named by its folder.
"""

from __future__ import annotations

import os
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from swarmabs_config.fleet.loader import load_fleet
from swarmabs_config.fleet.participants import DISCOVERY, node_plans
from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, RECORDER, agent_name
from swarmabs_config.scenario import load_scenario
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import EVENTS, EventKind, SwarmEvent
from swarmabs_core.realtime.base import Level
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_fleet.node_files import profile, tool_environment
from swarmabs_ros.endpoints import advertise
from swarmabs_run.orchestration.network import dds_environment
from swarmabs_run.orchestration.run_files import environment_of_run, is_realtime, is_running
from swarmabs_run.tracing_files import tracing_files_removed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from rclpy.node import Node

SLICE = 0.1
"""Longest wait, s, before looking whether enough was heard."""
SILENT_AFTER = 3.0
"""Time, s, without a word after which a node is not taken to live; it speaks once a second."""
SILENT, STALE = "silent", "STALE"


@dataclass(frozen=True, slots=True)
class Target:
    """A swarm that can be spoken to.

    Parameters
    ----------
    name, namespace : str
        What people call it, and the ROS namespace of its nodes.
    hosts : mapping
        Host by node, in the order in which they are shown.
    robots : tuple of int
        Ids of the robots, ascending.
    environment : mapping
        Environment variables by which a process joins its network.
    run : Path, optional
        The folder of the run that it is, whose domain is given to another when it is over.
    """

    name: str
    namespace: str
    hosts: Mapping[str, str]
    robots: tuple[int, ...]
    environment: Mapping[str, str]
    run: Path | None = None

    def robot(self, agent_id: int) -> str:
        """Return the node of a robot.

        Raises
        ------
        InputError
            If the swarm has none of this id.
        """
        if agent_id not in self.robots:
            known = ", ".join(map(str, self.robots[:20]))
            raise InputError(f"{self.name} has no robot {agent_id}; it has {known}")
        return agent_name(agent_id)

    def check(self) -> None:
        """Refuse to speak into a network that may be another swarm's by now: whoever was found may belong to it."""
        if self.run is not None and not is_running(self.run):
            raise RunError(f"{self.name}: the run has ended; start it again")


@contextmanager
def target(path: Path) -> Iterator[Target]:
    """Find out how to speak to the swarm of a fleet file or of a run's folder; what this needs is removed at the end.

    Raises
    ------
    InputError
        If it is neither, a run that is over, or one in lockstep.
    """
    if path.is_dir():
        yield _run(path)
        return
    fleet = load_fleet(path).fleet
    host = HostPlan(fleet, fleet.coordinators.controller.host)
    hosts = {node.name: node.host for node in node_plans(fleet) if node.name != DISCOVERY}
    robots = tuple(robot.id for robot in fleet.members)
    with TemporaryDirectory(prefix="swarmabs-operator-") as folder:
        file = Path(folder) / "operator.xml"
        file.write_text(profile(host, "operator"), encoding="utf-8")
        # Everything as in the installed bundle, whose keys may be needed, but the profile: it is made anew.
        environment = tool_environment(host, "operator") | dds_environment(fleet.network.domain, str(file))
        yield Target(fleet.name, fleet.namespace, hosts, robots, environment)


def _run(folder: Path) -> Target:
    environment = environment_of_run(folder)
    if not is_realtime(folder):
        raise InputError(
            f"{folder}: a run in lockstep has no operator; look at it with top, change it with run --steer"
        )
    scenario = load_scenario(folder / "scenario.yaml")
    robots = tuple(agent.id for agent in scenario.agents)
    hosts = dict.fromkeys((PLANE, OBSERVER, CONTROLLER, RECORDER, *map(agent_name, robots)), "this one")
    return Target(scenario.name, "/", hosts, robots, environment, folder)


class OperatorClient:
    """A node in the network of a swarm, which calls the services of its nodes and hears their diagnostics."""

    def __init__(self, node: Node, target: Target) -> None:
        self._node = node
        self._target = target

    def call(self, service: str, patience: float) -> None:
        """Call a ``std_srvs/Trigger`` service below the swarm's namespace that is found, and then answers, in time (s).

        Raises
        ------
        RunError
            If nobody offers it or answers, the node says no, or the run has ended meanwhile.
        """
        client = self._node.create_client(Trigger, service)
        who = f"{self._target.name}: {client.srv_name}"
        try:
            if not client.wait_for_service(patience):
                raise RunError(
                    f"{who} was not found; check that its node runs, and start this on the controller's host"
                )
            self._target.check()
            future = client.call_async(Trigger.Request())
            rclpy.spin_until_future_complete(self._node, future, timeout_sec=patience)
            answer = future.result()
            if answer is None:
                raise RunError(f"{who} has not answered within {patience:g} s; check its node with 'swarm status'")
            if not answer.success:
                raise RunError(f"{who}: {answer.message}")
        finally:
            self._node.destroy_client(client)

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
                    raise RunError(
                        f"{self._target.name}: no node receives {publisher.topic_name}; check that the observer runs"
                    )
                time.sleep(SLICE)
            self._target.check()
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
                self._target.check()
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


class Row(NamedTuple):
    """A node: its host, how it is (OK, WARN, ERROR, silent), what it says, and its figures by name."""

    node: str
    host: str
    level: str
    text: str
    values: Mapping[str, str]


@dataclass(slots=True)
class HealthMonitor:
    """Keeps the newest word of every node; `hosts` names the host of each that there should be."""

    hosts: Mapping[str, str]
    _words: dict[str, tuple[float, int, str, Mapping[str, str]]] = field(default_factory=dict)

    def hear(self, node: str, level: int, text: str, values: Mapping[str, str], now: float) -> None:
        """Note what a node says of itself at a steady time, s."""
        self._words[node] = (now, level, text, values)

    def complete(self) -> bool:
        """Tell whether every node has been heard."""
        return all(node in self._words for node in self.hosts)

    def value(self, node: str, name: str) -> str:
        """Return a figure that a node has told last, empty if it has not."""
        return self._words[node][3].get(name, "") if node in self._words else ""

    def rows(self, now: float) -> list[Row]:
        """Return one row per node that there should be, and behind them those that nobody expects."""
        strangers = sorted(node for node in self._words if node not in self.hosts)
        return [self._row(node, self.hosts.get(node, "unknown"), now) for node in (*self.hosts, *strangers)]

    def _row(self, node: str, host: str, now: float) -> Row:
        if node not in self._words:
            return Row(node, host, SILENT, "has not been heard", {})
        heard, level, text, values = self._words[node]
        if now - heard > SILENT_AFTER:
            return Row(node, host, SILENT, f"not heard for {now - heard:.0f} s; then: {text}", values)
        names = {int(each): each.name for each in Level}
        return Row(node, host, names.get(level, STALE), text, values)


def in_order(rows: list[Row]) -> bool:
    """Tell whether no node is silent or in error."""
    return not any(row.level in (SILENT, Level.ERROR.name, STALE) for row in rows)

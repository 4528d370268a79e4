"""Operating a realtime swarm: stop, reset, drain, join, remove, status.

The swarm is a fleet, given by its file, or a realtime run, given by its folder.
"""

from __future__ import annotations

import os
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from swarmabs_config import realtime
from swarmabs_config.fleet.loader import load_fleet
from swarmabs_config.fleet.participants import DISCOVERY, node_plans, operator_hosts
from swarmabs_config.graph import (
    CONTROLLER,
    OBSERVER,
    PLANE,
    REALTIME,
    RECORDER,
    SILENCE,
    own_topic,
    requested,
    standby_name,
)
from swarmabs_config.scenario import load_scenario
from swarmabs_core.cdr import decode, encode, misplaced
from swarmabs_core.errors import InputError, MalformedMessageError, RunError
from swarmabs_core.events import EventCode
from swarmabs_core.messages import AGENT_STATE, REMOVALS, AgentState, Removal, Status
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime.base import Level
from swarmabs_fleet.check import expiring
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_fleet.node_files import profile, tool_environment
from swarmabs_fleet.own_address import problem_of
from swarmabs_ros.endpoints import LoopGroup, Receiver, advertise
from swarmabs_run.orchestration.network import dds_environment
from swarmabs_run.orchestration.run_files import environment_of_run, epoch_of, is_realtime, is_running
from swarmabs_run.tracing_files import tracing_files_removed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from rclpy.client import Client
    from rclpy.node import Node
    from rclpy.task import Future

    from swarmabs_core.realtime.base import Schedule

SLICE = 0.01
"""Longest wait, s, before checking again whether enough has been received."""
GRACE = 1.0
"""Time, s, for which the other services of several are still waited for when one has reported success."""
SILENT, STALE = "silent", "STALE"


@dataclass(frozen=True, slots=True)
class Target:
    """A swarm to operate.

    Parameters
    ----------
    name, namespace : str
        Its name in messages, and the ROS namespace of its nodes.
    hosts : mapping
        Host of each node, in display order.
    robots : tuple of int
        Ids of the robots, ascending.
    environment : mapping
        Environment variables with which a process joins its network.
    run : Path, optional
        The folder, if the swarm is a run, whose domain another run may use after its end.
    schedule : Schedule, optional
        The steps of its messages; None while a run is starting.
    warnings : tuple of str
        What will need attention, such as certificates that expire soon.
    elsewhere : str
        Why this host cannot join its network, empty if it can.
    own_topics : bool
        Whether each robot publishes its state on a topic of its own.
    """

    name: str
    namespace: str
    hosts: Mapping[str, str]
    robots: tuple[int, ...]
    environment: Mapping[str, str]
    run: Path | None = None
    schedule: Schedule | None = None
    warnings: tuple[str, ...] = ()
    elsewhere: str = ""
    own_topics: bool = False

    def robot(self, agent_id: int) -> str:
        """Return the name of a robot's node.

        Raises
        ------
        InputError
            If the swarm has no robot with this id.
        """
        if agent_id not in self.robots:
            ids = ", ".join(map(str, self.robots[:20]))
            raise InputError(f"{self.name} has no robot {agent_id}; it has {ids}")
        return agent_name(agent_id)

    def pair(self, coordinator: str) -> tuple[str, ...]:
        """Return the names of a coordinator and, if it has one, of its standby."""
        return tuple(name for name in (coordinator, standby_name(coordinator)) if name in self.hosts)

    @property
    def decentralised(self) -> bool:
        """Whether each robot sums up and controls the swarm by itself, so that an operator talks to any of them."""
        return CONTROLLER not in self.hosts

    def check(self) -> None:
        """Raise `RunError` if the run has ended: another swarm may use its network by now."""
        if self.run is not None and not is_running(self.run):
            raise RunError(f"{self.name}: the run has ended; start it again")


@contextmanager
def target(path: Path) -> Iterator[Target]:
    """Yield the swarm of a fleet file or run folder; temporary files are removed at the end.

    Raises
    ------
    InputError
        If the path is neither, or the run has ended or runs in lockstep.
    """
    if path.is_dir():
        yield _run(path)
        return
    loaded = load_fleet(path)
    fleet = loaded.fleet
    places = operator_hosts(fleet)
    here = [name for name in places if problem_of(fleet.address(name)) == ""]
    host = HostPlan(fleet, (here or places)[0])
    named = " or ".join(f"{name} ({fleet.address(name)})" for name in places)
    elsewhere = "" if here else f"{fleet.name}: this host does not have the address; run this on {named}"
    hosts = {node.name: node.host for node in node_plans(fleet) if node.name != DISCOVERY}
    robots = tuple(robot.id for robot in fleet.members)
    with TemporaryDirectory(prefix="swarmabs-operator-") as folder:
        file = Path(folder) / "operator.xml"
        file.write_text(profile(host, "operator"), encoding="utf-8")
        # As in the installed bundle, whose keys may be needed, except for a freshly generated profile.
        environment = tool_environment(host, "operator") | dds_environment(fleet.network.domain, str(file))
        schedule = realtime.schedule(loaded.scenario, fleet.epoch_ns)
        warnings = tuple(expiring(fleet, path))
        swarm = Target(fleet.name, fleet.namespace, hosts, robots, environment, schedule=schedule, warnings=warnings)
        yield replace(swarm, elsewhere=elsewhere, own_topics=fleet.own_topics)


def _run(folder: Path) -> Target:
    environment = environment_of_run(folder)
    if not is_realtime(folder):
        raise InputError(
            f"{folder}: operator commands need a realtime run; for lockstep, use top to watch and run --steer to change"
        )
    scenario = load_scenario(folder / "scenario.yaml")
    robots = tuple(agent.id for agent in scenario.agents)
    central = () if scenario.decentralised else (OBSERVER, CONTROLLER)
    hosts = dict.fromkeys((PLANE, *central, RECORDER, *map(agent_name, robots)), "this one")
    epoch = epoch_of(folder)
    schedule = None if epoch is None else realtime.schedule(scenario, epoch)
    return Target(scenario.name, "/", hosts, robots, environment, folder, schedule)


@dataclass(slots=True)
class _Call:
    """A call of a service: waits for the service, then for its answer, until a monotonic time, s.

    DDS may lose an answer to a client that the service has not discovered yet, so a call is repeated every `interval`
    seconds if that does no harm.
    """

    client: Client
    patience: float
    deadline: float
    interval: float
    futures: list[Future] = field(default_factory=list)
    repeated: float = 0.0

    def begins(self) -> bool:
        """Return whether the service has been found and not been called."""
        return not self.futures and bool(self.client.service_is_ready())

    def advance(self, now: float) -> None:
        """Call the service if it has been found, and again if it does not answer."""
        if self.begins():
            self.deadline = now + self.patience
        elif not self.futures or now < self.repeated:
            return
        self.futures.append(self.client.call_async(Trigger.Request()))
        self.repeated = now + self.interval

    def _answer(self) -> Any:
        """Return the first answer, None before it."""
        return next((future.result() for future in self.futures if future.done()), None)

    def waits(self, now: float) -> bool:
        """Return whether there is still something to wait for."""
        return now < self.deadline and self._answer() is None

    def problem(self) -> str:
        """Return what is wrong so far, empty once the service has reported success."""
        name, answer = self.client.srv_name, self._answer()
        if not self.futures:
            return f"{name} was not found; check that its node is running, and run this on an operator's host"
        if answer is None:
            return f"{name} did not answer within {self.patience:g} s; check its node with 'swarm status'"
        return "" if answer.success else f"{name}: {answer.message}"


class OperatorClient:
    """A ROS node that calls the services of a swarm's nodes and receives their diagnostics."""

    def __init__(self, node: Node, target: Target) -> None:
        self._node = node
        self._target = target
        self._clients: dict[str, Client] = {}

    def finds(self, service: str) -> bool:
        """Return whether a ``std_srvs/Trigger`` service of the swarm has been found; the first call starts to look."""
        return bool(self._client(service).service_is_ready())

    def _client(self, service: str) -> Client:
        if service not in self._clients:
            self._clients[service] = self._node.create_client(Trigger, service)
        return self._clients[service]

    def call(self, service: str, patience: float) -> None:
        """Call a ``std_srvs/Trigger`` service of the swarm; `patience`, s, limits discovery and answer each.

        Raises
        ------
        RunError
            If the service is not found, does not answer or reports failure, or the run has ended.
        """
        (problem,) = self.call_each((service,), patience).values()
        if problem:
            raise RunError(problem)

    def call_each(self, services: Sequence[str], patience: float, *, interval: float = inf) -> dict[str, str]:
        """Call ``std_srvs/Trigger`` services at the same time, and return by name what went wrong, empty if nothing.

        One that does not answer is called again every `interval` seconds. Once one of them has reported success, the
        others have `GRACE` at most.

        Raises
        ------
        RunError
            If the run has ended.
        """
        start = time.monotonic()
        calls = {name: _Call(self._client(name), patience, start + patience, interval) for name in services}
        while any(call.waits(time.monotonic()) for call in calls.values()):
            if any(call.begins() for call in calls.values()):
                self._target.check()
            for call in calls.values():
                call.advance(time.monotonic())
            rclpy.spin_once(self._node, timeout_sec=SLICE)
            if not all(call.problem() for call in calls.values()):
                for call in calls.values():
                    call.deadline = min(call.deadline, time.monotonic() + GRACE)
        return {name: call.problem() and f"{self._target.name}: {call.problem()}" for name, call in calls.items()}

    def watch(self) -> RobotWatch:
        """Subscribe to the states of all robots of the swarm."""
        return RobotWatch(self._node, self._target)

    @contextmanager
    def carried_away(self, agent_id: int, patience: float) -> Iterator[None]:
        """Publish that a robot was removed; this stays available to subscribers during the block.

        Raises
        ------
        RunError
            If no subscriber appears within `patience`, s, or the run is starting or has ended.
        """
        schedule = self._target.schedule
        if schedule is None:
            raise RunError(f"{self._target.name}: the run is still starting; try again in a moment")
        publisher = advertise(self._node, REMOVALS, REALTIME)
        try:
            deadline = time.monotonic() + patience
            while not publisher.get_subscription_count():
                if time.monotonic() > deadline:
                    raise RunError(
                        f"{self._target.name}: no node receives {publisher.topic_name}; check that the nodes run"
                    )
                time.sleep(SLICE)
            self._target.check()
            now = time.time_ns()
            step = max(0, schedule.step(now))
            publisher.publish(encode(Removal(*EventCode.CARRIED_AWAY.event(now, step, robot=agent_id))))
            yield
        finally:
            self._node.destroy_publisher(publisher)

    def listen(self, monitor: HealthMonitor, patience: float, enough: Callable[[], bool]) -> None:
        """Pass diagnostics to a monitor until `enough` returns true or `patience`, s, has passed.

        Raises
        ------
        RunError
            If the run has ended.
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


@dataclass(slots=True)
class StopMonitor:
    """Keeps which robots are in their safe stop, by their states; times are monotonic, s.

    Parameters
    ----------
    robots : tuple of int
        Ids of the robots.
    """

    robots: tuple[int, ...]
    _asked: float = 0.0
    _confirmed: float = 0.0
    _latest: dict[int, float] = field(default_factory=dict)
    _stopped: dict[int, float] = field(default_factory=dict)

    def ask(self, now: float) -> None:
        """Note that the robots are told to stop: what they reported before does not count."""
        self._asked, self._confirmed = now, inf
        self._latest.clear()
        self._stopped.clear()

    def confirm(self, now: float) -> None:
        """Note that the controller has confirmed the stop; only robots heard after that are known to have stopped."""
        self._confirmed = now

    def hear(self, robot: int, status: int, now: float) -> None:
        """Take the status in a robot's state; a drained robot has stopped, too."""
        self._latest[robot] = now
        if status in (Status.SAFE_STOP, Status.LEFT):
            self._stopped.setdefault(robot, now)
        else:
            self._stopped.pop(robot, None)

    def heard(self) -> int:
        """Return of how many robots a state has arrived."""
        return sum(robot in self._latest for robot in self.robots)

    def problem(self, robot: int) -> str:
        """Return why a robot is not known to have stopped, empty if it is."""
        if self._latest.get(robot, -inf) <= self._confirmed:
            return "not heard"
        return "" if robot in self._stopped else "not stopped"

    def problems(self) -> dict[int, str]:
        """Return the robots that are not known to have stopped, with the reasons."""
        return {robot: problem for robot in self.robots if (problem := self.problem(robot))}

    def delay(self, robot: int) -> float:
        """Return the time, s, after which a robot that has stopped reported it."""
        return self._stopped[robot] - self._asked


class RobotWatch:
    """Passes the states of robots to a `StopMonitor`, without callbacks: in large fleets they would take too long."""

    def __init__(self, node: Node, target: Target) -> None:
        self.monitor = StopMonitor(target.robots)
        self._target = target
        topics = [own_topic(AGENT_STATE, robot) for robot in target.robots] if target.own_topics else [AGENT_STATE]
        depth = max(100, 4 * len(target.robots))
        states = {topic: requested(topic, REALTIME, depth=depth) for topic in topics}
        self._depths = dict.fromkeys(topics, depth)
        self._receiver = Receiver(node, states, LoopGroup())

    def ask(self) -> None:
        """Tell the monitor that the robots are about to be told to stop."""
        self._take()
        self.monitor.ask(time.monotonic())

    def confirm(self) -> None:
        """Tell the monitor that the controller has confirmed the stop."""
        self._take()
        self.monitor.confirm(time.monotonic())

    def listen(self, patience: float, enough: Callable[[], bool]) -> None:
        """Take states until `enough` returns true or `patience`, s, has passed.

        Raises
        ------
        RunError
            If the run has ended.
        """
        deadline = time.monotonic() + patience
        self._take()
        while not enough() and time.monotonic() < deadline:
            self._target.check()
            self._receiver.wait(tuple(self._depths), SLICE)
            self._take()

    def _take(self) -> None:
        for topic, depth in self._depths.items():
            for _ in range(depth):
                payload = self._receiver.take(topic)
                if payload is None:
                    break
                with suppress(MalformedMessageError):
                    state = decode(AgentState, payload)
                    if isinstance(state, AgentState) and not misplaced(state, topic):
                        self.monitor.hear(state.agent_id, state.status, time.monotonic())


@contextmanager
def joined(target: Target) -> Iterator[OperatorClient]:
    """Join the network of a swarm for the duration of the block.

    Raises
    ------
    InputError
        If this host does not have the address of an operator's host.
    RunError
        If the middleware cannot join.
    """
    if target.elsewhere:
        raise InputError(target.elsewhere)
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
        except Exception as error:  # rclpy has no common base class
            rclpy.try_shutdown()
            raise RunError(f"{target.name}: cannot join its network: {' '.join(str(error).split())}") from error
        try:
            yield OperatorClient(node, target)
        finally:
            node.destroy_node()
            rclpy.try_shutdown()


class Row(NamedTuple):
    """A node: its host, its level (OK, WARN, ERROR, silent), its message, and its values by name."""

    node: str
    host: str
    level: str
    text: str
    values: Mapping[str, str]


@dataclass(slots=True)
class HealthMonitor:
    """Keeps the latest diagnostics of every node; `hosts` gives the host of each expected node."""

    hosts: Mapping[str, str]
    _latest: dict[str, tuple[float, int, str, Mapping[str, str]]] = field(default_factory=dict)

    def hear(self, node: str, level: int, text: str, values: Mapping[str, str], now: float) -> None:
        """Store the diagnostics of a node, received at a monotonic time, s."""
        self._latest[node] = (now, level, text, values)

    def complete(self) -> bool:
        """Return whether every expected node has sent diagnostics."""
        return all(node in self._latest for node in self.hosts)

    def value(self, node: str, name: str) -> str:
        """Return the latest value of a name from a node, empty if it has not sent any."""
        return self._latest[node][3].get(name, "") if node in self._latest else ""

    def rows(self, now: float) -> list[Row]:
        """Return one row per expected node, followed by the unexpected ones."""
        unexpected = sorted(node for node in self._latest if node not in self.hosts)
        return [self._row(node, self.hosts.get(node, "unknown"), now) for node in (*self.hosts, *unexpected)]

    def _row(self, node: str, host: str, now: float) -> Row:
        if node not in self._latest:
            return Row(node, host, SILENT, "no diagnostics received", {})
        heard, level, text, values = self._latest[node]
        if now - heard > SILENCE:
            return Row(node, host, SILENT, f"no diagnostics for {now - heard:.0f} s; last: {text}", values)
        names = {int(value): value.name for value in Level}
        return Row(node, host, names.get(level, STALE), text, values)


def in_order(rows: list[Row]) -> bool:
    """Return whether no node is silent, stale or in error."""
    return not any(row.level in (SILENT, Level.ERROR.name, STALE) for row in rows)

"""What each node may do under DDS Security: the topics that its enclave may use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_config.fleet.participants import DISCOVERY
from swarmabs_config.fleet.parts import MeasuredPlane, path_of
from swarmabs_config.graph import DIAGNOSTICS, PLANE_DRIVER, REALTIME, RECORDER, ROBOT, SERVICES, endpoints
from swarmabs_core.messages import EVENTS
from swarmabs_core.realtime.instruments import TopicSettings

if TYPE_CHECKING:
    from swarmabs_config.fleet.checked import Fleet
    from swarmabs_config.fleet.participants import NodePlan
    from swarmabs_fleet.host_plan import HostPlan

_DISCOVERY_INFO = "ros_discovery_info"
"""The topic by which ROS nodes say which endpoints are theirs."""
_PARAMETER_EVENTS, _LOG = "rt/parameter_events", "rt/rosout"
_DRIVERS_DIAGNOSTICS = "rt/diagnostics"
"""Where nodes that are not the swarm's say how they are."""
_PLAIN = (RECORDER, DISCOVERY)
"""Nodes without a life cycle and a log by topic."""
_COMMAND_LINE = "_ros2cli"
"""With what the names of nodes of ROS's command line begin, which have services themselves."""
_MEASURED = {"odometry": "odom", "joint_state": "joint_states", "imu": "imu"}
_COMMANDED = {"twist": "cmd_vel", "force": "force", "joint": "joint_command"}
"""Names of topics below a node's own where the fleet file gives none."""


@dataclass(frozen=True, slots=True)
class Rights:
    """Topics of DDS, some with the wildcard ``*``, that an enclave may publish and subscribe to; nothing else."""

    publish: tuple[str, ...]
    subscribe: tuple[str, ...]


def host_rights(host: HostPlan) -> dict[str, Rights]:
    """Return the rights of a host's enclaves by name: one per node, and those of tools."""
    found = {node.name: node_rights(host.fleet, node) for node in host.nodes}
    if "driver" in host.roles:
        found[host.tools("driver")] = _driver_rights(host)
    if "operator" in host.roles:
        found[host.tools("operator")] = _operator_rights(host.fleet)
    return found


def node_rights(fleet: Fleet, node: NodePlan) -> Rights:
    """Return what a node may do: a robot publishes its own state, and nobody but the controller the desired one."""
    ns, own = fleet.namespace, path_of(fleet.namespace, node.name)
    managed = node.name not in _PLAIN
    publish = [_DISCOVERY_INFO, _PARAMETER_EVENTS]
    subscribe = [_DISCOVERY_INFO]
    if managed:  # it has a log, and a life cycle, whose topic is its own
        publish += [_LOG, f"rt{own}/*"]
    if node.name != DISCOVERY:
        publish.append(_topic(ns, DIAGNOSTICS))
    role = ROBOT if node.robot else node.name
    ends = endpoints(role, REALTIME)
    publish += [_topic(ns, topic.name) for topic in ends.publications]
    subscribe += [_topic(ns, topic.name) for topic in ends.subscriptions]
    if node.name != RECORDER:  # services: those of its parameters and its life cycle among them
        publish.append(f"rr{own}/*Reply")
        subscribe.append(f"rq{own}/*Request")
    for service in SERVICES.get(role, ()):
        if service.startswith("~/"):  # below its own name
            continue
        publish.append(f"rr{path_of(ns, service)}Reply")
        subscribe.append(f"rq{path_of(ns, service)}Request")
    measured, commanded = _body_topics(fleet, node)
    publish += [topic for topic in commanded if not topic.startswith(f"rt{own}/")]
    return Rights(tuple(publish), (*subscribe, *measured))


def _body_topics(fleet: Fleet, node: NodePlan) -> tuple[list[str], list[str]]:
    """Return the topics by which a node learns of its body, or of the plane, and those by which it commands it."""
    own = path_of(fleet.namespace, node.name)
    plane = fleet.coordinators.plane
    if node.name == PLANE_DRIVER and isinstance(plane, MeasuredPlane):
        return [_topic(fleet.namespace, plane.instrument.topic or f"{own}/{_MEASURED[plane.instrument.source]}")], []
    if node.robot is None or not isinstance(node.robot.drive, TopicSettings):
        return [], []
    drive = node.robot.drive
    measured = [drive.topic or f"{own}/{_MEASURED[drive.source]}"]
    if drive.gravity == "imu":
        measured.append(drive.imu.topic or f"{own}/{_MEASURED['imu']}")
    by_kind = "twist" if node.robot.kind == "single_integrator" else "force"
    command = by_kind if drive.command == "auto" else drive.command
    commanded = [drive.command_topic or f"{own}/{_COMMANDED[command]}"]
    return [_topic(fleet.namespace, name) for name in measured], [_topic(fleet.namespace, name) for name in commanded]


def _driver_rights(host: HostPlan) -> Rights:
    """Return what the robots' own nodes behind topic drives may do: the other side of these drives.

    What a node has of its own, such as the services of its parameters, must be below the name of the enclave.
    """
    own = path_of(host.fleet.namespace, host.tools("driver"))
    publish = [_DISCOVERY_INFO, _PARAMETER_EVENTS, _LOG, _DRIVERS_DIAGNOSTICS, f"rt{own}/*", f"rr{own}/*Reply"]
    subscribe = [_DISCOVERY_INFO, _PARAMETER_EVENTS, f"rt{own}/*", f"rq{own}/*Request"]
    for node in host.nodes:
        measured, commanded = _body_topics(host.fleet, node)
        publish += measured
        subscribe += commanded
    return Rights(tuple(dict.fromkeys(publish)), tuple(dict.fromkeys(subscribe)))


def _operator_rights(fleet: Fleet) -> Rights:
    """Return what an operator's tools may do: see everything, call every service, say of a robot that it is gone."""
    ns = fleet.namespace.rstrip("/")
    services, own_services = f"rq{ns}/*Request", f"rr/{_COMMAND_LINE}*Reply"
    publish = (_DISCOVERY_INFO, _PARAMETER_EVENTS, _LOG, _topic(ns, EVENTS.name), services, own_services)
    return Rights(publish, (_DISCOVERY_INFO, "rt/*", f"rr{ns}/*Reply", f"rq/{_COMMAND_LINE}*Request"))


def _topic(namespace: str, name: str) -> str:
    return f"rt{path_of(namespace, name)}"

"""Permissions of each node under DDS Security: the topics that its enclave may use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_config.fleet.parts import MeasuredPlane, path_of
from swarmabs_config.graph import (
    DIAGNOSTICS,
    PLANE_DRIVER,
    REALTIME,
    RECORDER,
    Option,
    endpoints,
    options_of,
    services,
)
from swarmabs_core.messages import REMOVALS, Kind
from swarmabs_core.nodes import ROBOT_PREFIX
from swarmabs_core.realtime.instruments import MEASURED, TopicSettings

if TYPE_CHECKING:
    from swarmabs_config.fleet.model import Fleet
    from swarmabs_config.fleet.participants import NodePlan
    from swarmabs_core.messages import Topic
    from swarmabs_fleet.host_plan import HostPlan

_DISCOVERY_INFO = "ros_discovery_info"
"""The topic on which ROS nodes announce their endpoints."""
_PARAMETER_EVENTS, _LOG = "rt/parameter_events", "rt/rosout"
_DRIVERS_DIAGNOSTICS = "rt/diagnostics"
"""The diagnostics topic of nodes outside the swarm."""
_COMMAND_LINE = "_ros2cli"
"""Prefix of the names of the nodes that the ``ros2`` command line creates; they offer services, too."""


@dataclass(frozen=True, slots=True)
class Rights:
    """DDS topics, some with the wildcard ``*``, that an enclave may publish and subscribe to; all others are denied."""

    publish: tuple[str, ...]
    subscribe: tuple[str, ...]


def host_rights(host: HostPlan) -> dict[str, Rights]:
    """Return the rights of a host's enclaves by name: one per node, and one per role of tools."""
    rights = {node.name: node_rights(host.fleet, node) for node in host.nodes}
    if "driver" in host.roles:
        rights[host.tools("driver")] = _driver_rights(host)
    if "operator" in host.roles:
        rights[host.tools("operator")] = _operator_rights(host.fleet)
    return rights


def node_rights(fleet: Fleet, node: NodePlan) -> Rights:
    """Return the rights of a node; only a robot publishes its own state, and only the controller the desired state.

    A standby publishes what its primary does on topics of standbys only. Without DDS Security nobody enforces these
    rights, and robots share the topics of states and events.
    """
    ns, own = fleet.namespace, path_of(fleet.namespace, node.name)
    publish = [_DISCOVERY_INFO, _PARAMETER_EVENTS, _topic(ns, DIAGNOSTICS)]
    subscribe = [_DISCOVERY_INFO]
    if node.kind != RECORDER:  # has /rosout, and lifecycle topics below its name
        publish += [_LOG, f"rt{own}/*"]
    options = options_of({"pair": node.pair, "paired": fleet.paired, "own_topics": fleet.own_topics})
    everybody = [robot.id for robot in fleet.members]
    members = [node.robot.id] if node.robot else everybody
    # Whether a robot has that sensor is up to the scenario.
    options |= {Option.SENSING, Option.SEALED} if fleet.sealed else {Option.SENSING}
    relaying = everybody if fleet.decentralised else []
    ends = endpoints(node.kind, REALTIME, options, members=members, neighbours=relaying)
    publish += [_topic(ns, topic.name) for topic in ends.publications if not topic.agent_id]  # covered by the wildcard
    subscribe += dict.fromkeys(_topic(ns, _of_any_robot(topic)) for topic in ends.subscriptions)
    if node.kind != RECORDER:  # services, including those of parameters and lifecycle
        publish.append(f"rr{own}/*Reply")
        subscribe.append(f"rq{own}/*Request")
    for service in services(node.kind, options):
        if service.startswith("~/"):  # covered by the wildcard above
            continue
        publish.append(f"rr{path_of(ns, service)}Reply")
        subscribe.append(f"rq{path_of(ns, service)}Request")
    measured, commanded = _body_topics(fleet, node)
    publish += [topic for topic in commanded if not topic.startswith(f"rt{own}/")]
    return Rights(tuple(publish), (*subscribe, *measured))


def _body_topics(fleet: Fleet, node: NodePlan) -> tuple[list[str], list[str]]:
    """Return the topics on which a node receives measurements of its body or the plane, and those of its commands."""
    own = path_of(fleet.namespace, node.name)

    def named(*names: str) -> list[str]:
        return [_topic(fleet.namespace, name.replace("~", own, 1)) for name in names]

    plane = fleet.coordinators.plane
    if node.kind == PLANE_DRIVER and isinstance(plane, MeasuredPlane):
        return named(plane.instrument.topic or MEASURED[plane.instrument.source]), []
    if node.robot is None or not isinstance(node.robot.drive, TopicSettings):
        return [], []
    drive = node.robot.drive.resolved(by_force=Kind.of(node.robot.kind).by_force)
    return named(drive.topic, *([drive.imu.topic] if drive.gravity == "imu" else [])), named(drive.command_topic)


def _of_any_robot(topic: Topic) -> str:
    """Return the name of a topic, with a wildcard for a robot's own: a list of all would be sent in each handshake."""
    return topic.name if not topic.agent_id else f"{ROBOT_PREFIX}*/{topic.name.partition('/')[2]}"


def _driver_rights(host: HostPlan) -> Rights:
    """Return the rights of driver nodes: the opposite direction of the topics of the host's topic drives.

    A driver's private topics and services, such as those of its parameters, must be below the name of the enclave.
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
    """Return the rights of operator tools: read every topic, call every service, report that a robot was removed."""
    ns = fleet.namespace.rstrip("/")
    services, own_services = f"rq{ns}/*Request", f"rr/{_COMMAND_LINE}*Reply"
    publish = (_DISCOVERY_INFO, _PARAMETER_EVENTS, _LOG, _topic(ns, REMOVALS.name), services, own_services)
    return Rights(publish, (_DISCOVERY_INFO, "rt/*", f"rr{ns}/*Reply", f"rq/{_COMMAND_LINE}*Request"))


def _topic(namespace: str, name: str) -> str:
    return f"rt{path_of(namespace, name)}"

"""What each node may do under DDS Security: governance of the domain, and the topics that an enclave may use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

from swarmabs_bringup.fleet.environment import tool_enclave
from swarmabs_bringup.fleet.names import path_of
from swarmabs_bringup.fleet.participants import DISCOVERY, PLANE_DRIVER, node_plans
from swarmabs_bringup.fleet.profile import profile_roles
from swarmabs_bringup.fleet.robots import TopicDrive
from swarmabs_bringup.orchestration.plan import CONTROLLER, OBSERVER, PLANE, RECORDER
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BASIS,
    BROADCASTS,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    MAIN_TOPICS,
    PLANE_STATE,
    Topic,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_bringup.fleet.model import Fleet
    from swarmabs_bringup.fleet.participants import NodePlan

_DISCOVERY_INFO = "ros_discovery_info"
"""The topic by which ROS nodes say which endpoints are theirs."""
_OF_EVERY_NODE = ("rt/rosout", "rt/parameter_events", "rt/diagnostics")
_PUBLISHED: dict[str, tuple[Topic, ...]] = {
    PLANE: (PLANE_STATE, BASIS, EVENTS),
    PLANE_DRIVER: (PLANE_STATE, EVENTS),
    OBSERVER: (ABSTRACT_STATE, AUXILIARY_STATE, BASIS, EVENTS),
    CONTROLLER: (DESIRED_ABSTRACT_STATE, BASIS, EVENTS),
    RECORDER: (),
    DISCOVERY: (),
}
_HEARD: dict[str, tuple[Topic, ...]] = {
    PLANE: (AGENT_STATE, EVENTS),
    PLANE_DRIVER: (),
    OBSERVER: (AGENT_STATE, PLANE_STATE),
    CONTROLLER: (PLANE_STATE,),
    RECORDER: (*MAIN_TOPICS, EVENTS, BASIS),
    DISCOVERY: (),
}
_SERVICES = {CONTROLLER: ("swarm/stop", "swarm/reset")}
"""Services that are not below the node's own name."""

_GOVERNANCE = """\
<?xml version="1.0" encoding="utf-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_governance.xsd">
  <domain_access_rules>
    <domain_rule>
      <domains>
        <id>{domain}</id>
      </domains>
      <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
      <enable_join_access_control>true</enable_join_access_control>
      <discovery_protection_kind>ENCRYPT</discovery_protection_kind>
      <liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
      <rtps_protection_kind>SIGN</rtps_protection_kind>
      <topic_access_rules>
        <topic_rule>
          <topic_expression>*</topic_expression>
          <enable_discovery_protection>true</enable_discovery_protection>
          <enable_liveliness_protection>true</enable_liveliness_protection>
          <enable_read_access_control>true</enable_read_access_control>
          <enable_write_access_control>true</enable_write_access_control>
          <metadata_protection_kind>ENCRYPT</metadata_protection_kind>
          <data_protection_kind>ENCRYPT</data_protection_kind>
        </topic_rule>
      </topic_access_rules>
    </domain_rule>
  </domain_access_rules>
</dds>
"""

_PERMISSIONS = """\
<?xml version="1.0" encoding="utf-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd">
  <permissions>
    <grant name="{enclave}">
      <subject_name>CN={enclave}</subject_name>
      <validity>
        <not_before>{not_before}</not_before>
        <not_after>{not_after}</not_after>
      </validity>
      <allow_rule>
        <domains>
          <id>{domain}</id>
        </domains>
        <publish>
          <topics>
{publish}
          </topics>
        </publish>
        <subscribe>
          <topics>
{subscribe}
          </topics>
        </subscribe>
      </allow_rule>
      <default>DENY</default>
    </grant>
  </permissions>
</dds>
"""


@dataclass(frozen=True, slots=True)
class Rights:
    """Topics of DDS, some with the wildcard ``*``, that an enclave may publish and subscribe to; nothing else."""

    publish: tuple[str, ...]
    subscribe: tuple[str, ...]


def governance(domain: int) -> str:
    """Return the rules of a domain: nobody without a certificate, everything encrypted, every topic controlled."""
    return _GOVERNANCE.format(domain=domain)


def permissions(domain: int, enclave: str, rights: Rights, not_before: str, not_after: str) -> str:
    """Return the permissions of an enclave."""
    return _PERMISSIONS.format(
        domain=domain,
        enclave=escape(enclave),
        not_before=not_before,
        not_after=not_after,
        publish=_topics(rights.publish),
        subscribe=_topics(rights.subscribe),
    )


def host_enclaves(fleet: Fleet, host: str) -> dict[str, Rights]:
    """Return the enclaves of a host by name: one per node, and those of tools."""
    found = {node.name: node_rights(fleet, node) for node in node_plans(fleet) if node.host == host}
    for role in ("driver", "operator"):
        if role in profile_roles(fleet, host):
            rights = _driver_rights(fleet, host) if role == "driver" else _operator_rights(fleet)
            found[tool_enclave(role, host)] = rights
    return found


def node_rights(fleet: Fleet, node: NodePlan) -> Rights:
    """Return what a node may do: a robot publishes its own state, and nobody but the controller the desired one."""
    ns = fleet.namespace
    robot = node.robot
    published = (AGENT_STATE, EVENTS) if robot else _PUBLISHED[node.name]
    heard = BROADCASTS if robot else _HEARD[node.name]
    publish = [_DISCOVERY_INFO, *_OF_EVERY_NODE, *(_topic(ns, topic.name) for topic in published)]
    subscribe = [_DISCOVERY_INFO, "rt/parameter_events", *(_topic(ns, topic.name) for topic in heard)]
    # The node's own topics and services, those of its parameters and its life cycle among them.
    own = path_of(ns, node.name)
    publish += [f"rt{own}/*", f"rr{own}/*Reply"]
    subscribe += [f"rq{own}/*Request"]
    for service in _SERVICES.get(node.name, ()):
        publish.append(f"rr{path_of(ns, service)}Reply")
        subscribe.append(f"rq{path_of(ns, service)}Request")
    if node.name in {PLANE, PLANE_DRIVER}:
        publish.append(_topic(ns, "plane/joint_states"))
    if node.name == PLANE_DRIVER and fleet.coordinators.plane.type == "driver":
        subscribe.append(_topic(ns, fleet.coordinators.plane.topic or f"{PLANE_DRIVER}/*"))
    if robot is not None and isinstance(robot.drive, TopicDrive):
        named = {what: _topic(ns, topic) for what, topic in robot.drive.topics.items()}
        publish += [topic for what, topic in named.items() if what == "command"]
        subscribe += [topic for what, topic in named.items() if what != "command"]
        subscribe.append(f"rt{own}/*")
    return Rights(tuple(publish), tuple(subscribe))


def _driver_rights(fleet: Fleet, host: str) -> Rights:
    """Return what the robots' own nodes behind topic drives may do: the other side of these drives."""
    publish = [_DISCOVERY_INFO, *_OF_EVERY_NODE]
    subscribe = [_DISCOVERY_INFO]
    for node in node_plans(fleet):
        if node.host != host:
            continue
        plane = fleet.coordinators.plane
        if node.name == PLANE_DRIVER and plane.type == "driver":
            publish.append(_topic(fleet.namespace, plane.topic or f"{PLANE_DRIVER}/*"))
        if node.robot is None or not isinstance(node.robot.drive, TopicDrive):
            continue
        own = path_of(fleet.namespace, node.name)
        publish += [f"rt{own}/odom", f"rt{own}/joint_states", f"rt{own}/imu"]
        subscribe += [f"rt{own}/cmd_vel", f"rt{own}/force", f"rt{own}/joint_command"]
        for what, topic in node.robot.drive.topics.items():
            (subscribe if what == "command" else publish).append(_topic(fleet.namespace, topic))
    return Rights(tuple(dict.fromkeys(publish)), tuple(dict.fromkeys(subscribe)))


def _operator_rights(fleet: Fleet) -> Rights:
    """Return what an operator's tools may do: see everything, and call every service."""
    ns = fleet.namespace.rstrip("/")
    return Rights((_DISCOVERY_INFO, *_OF_EVERY_NODE, f"rq{ns}/*Request"), (_DISCOVERY_INFO, "rt/*", f"rr{ns}/*Reply"))


def _topic(namespace: str, name: str) -> str:
    return f"rt{path_of(namespace, name)}"


def _topics(names: Iterable[str]) -> str:
    return "\n".join(f"            <topic>{escape(name)}</topic>" for name in names)

"""The Fast DDS profiles of a fleet: one address of one host, and only the peers that a node has to meet.

A robot announces itself to the coordinators and to its own drivers; robots never discover each other. The coordinators
announce themselves to everybody, so that one that starts anew is known at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_config.fleet.participants import DISCOVERY_SERVER, DRIVERS, OPERATOR, node_plans
from swarmabs_config.ports import metatraffic_port
from swarmabs_core.realtime.topic_drive import TopicSettings
from swarmabs_run.orchestration.dds_profile import Discovery, network_profile_xml

if TYPE_CHECKING:
    from swarmabs_config.fleet.model import Fleet

DISCOVERY_GROUP = "239.255.0.1"
"""Where participants announce themselves by multicast: the group that the DDS standard names."""


def profile_roles(fleet: Fleet, host: str) -> tuple[str, ...]:
    """Return the names of the profiles that a host needs: those of its nodes, of drivers and of an operator's tools."""
    nodes = [node for node in node_plans(fleet) if node.host == host]
    roles = {str(node.role) for node in nodes}
    if any(node.robot and isinstance(node.robot.drive, TopicSettings) for node in nodes):
        roles.add("driver")
    plane = fleet.coordinators.plane
    if plane.type == "driver" and plane.host == host:
        roles.add("driver")
    if fleet.coordinators.controller.host == host:
        roles.add("operator")
    return tuple(sorted(roles))


def fleet_profile(fleet: Fleet, host: str, role: str) -> str:
    """Return the profile of the nodes of one role on a host.

    Parameters
    ----------
    fleet : Fleet
        The fleet.
    host : str
        Name of the host.
    role : str
        One of `profile_roles`; the participant id comes from the environment.
    """
    return network_profile_xml(fleet.address(host), _discovery(fleet, host, role))


def peers(fleet: Fleet, host: str, role: str) -> list[tuple[str, int]]:
    """Return address and participant id of those to whom nodes of a role on a host announce themselves."""
    nodes = node_plans(fleet)
    coordinators = [(fleet.address(node.host), node.participant) for node in nodes if node.role == "coordinator"]
    robots = [(fleet.address(node.host), node.participant) for node in nodes if node.robot is not None]
    operator = [(fleet.address(fleet.coordinators.controller.host), OPERATOR)]
    drivers = [(fleet.address(host), number) for number in DRIVERS] if "driver" in profile_roles(fleet, host) else []
    if role == "robot":
        return [*coordinators, *operator, *drivers]
    if role == "driver":
        own = fleet.address(host)
        return [peer for peer in [*coordinators, *robots] if peer[0] == own] + drivers
    return [*coordinators, *operator, *drivers, *robots]


def _discovery(fleet: Fleet, host: str, role: str) -> Discovery:
    """Return how the nodes of a role on a host find the others."""
    network = fleet.network
    if network.discovery == "static":
        announced = peers(fleet, host, role)
        return Discovery(peers=tuple((peer, metatraffic_port(network.domain, number)) for peer, number in announced))
    if network.discovery != "server" or network.server is None:
        return Discovery()
    port = metatraffic_port(network.domain, DISCOVERY_SERVER)
    return Discovery("SERVER" if role == "server" else "CLIENT", server=(fleet.address(network.server), port))

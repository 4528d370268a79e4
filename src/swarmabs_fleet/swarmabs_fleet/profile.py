"""The Fast DDS profiles of a fleet: one address of one host, and only the peers that a node has to meet.

A robot announces itself to the coordinators and to its own drivers; robots never discover each other. The coordinators
announce themselves to everybody, so that one that starts anew is known at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_config.fleet.participants import DISCOVERY_SERVER, DRIVERS, OPERATOR, node_plans
from swarmabs_config.ports import metatraffic_port
from swarmabs_core.realtime.topic_drive import TopicSettings
from swarmabs_run.orchestration.dds_profile import FROM_ENVIRONMENT, REALTIME_LEASE
from swarmabs_run.orchestration.dds_template import SIMPLE, Discovery, locator, render, unicast_locators

if TYPE_CHECKING:
    from swarmabs_config.fleet.model import Fleet

DISCOVERY_GROUP = "239.255.0.1"
"""Where participants announce themselves by multicast: the group that the DDS standard names."""
_SERVER_PREFIX = "44.53.00.5f.45.50.52.4f.53.49.4d.41"
"""GUID prefix of the discovery server: the one that Fast DDS gives to the discovery server of id 0."""


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
    discovery = Discovery(_protocol(fleet, role), _locators(fleet, host, role), REALTIME_LEASE, 1, liveliness=True)
    return render(
        transport="swarm",
        address=fleet.address(host),
        participant=f"<prefix>{_SERVER_PREFIX}</prefix>{FROM_ENVIRONMENT}" if role == "server" else FROM_ENVIRONMENT,
        discovery=discovery,
    )


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


def _protocol(fleet: Fleet, role: str) -> str:
    if fleet.network.discovery != "server" or fleet.network.server is None:
        return SIMPLE
    if role == "server":
        return f"<discoveryProtocol>SERVER</discoveryProtocol>\n            {_clients()}"
    port = metatraffic_port(fleet.network.domain, DISCOVERY_SERVER)
    server = locator(fleet.address(fleet.network.server), port)
    return (
        "<discoveryProtocol>CLIENT</discoveryProtocol>\n"
        "            <discoveryServersList>\n"
        f'              <RemoteServer prefix="{_SERVER_PREFIX}">\n'
        f"                <metatrafficUnicastLocatorList>{server}</metatrafficUnicastLocatorList>\n"
        "              </RemoteServer>\n"
        "            </discoveryServersList>"
    )


def _clients() -> str:
    """Return how often the server looks after its clients."""
    return "<clientAnnouncementPeriod><sec>1</sec></clientAnnouncementPeriod>"


def _locators(fleet: Fleet, host: str, role: str) -> str:
    discovery = fleet.network.discovery
    if discovery == "static":
        return unicast_locators(fleet.address(host), fleet.network.domain, peers(fleet, host, role))
    if role == "server":
        port = metatraffic_port(fleet.network.domain, DISCOVERY_SERVER)
        return (
            "          <metatrafficUnicastLocatorList>\n"
            f"            {locator(fleet.address(host), port)}\n"
            "          </metatrafficUnicastLocatorList>\n"
        )
    return ""

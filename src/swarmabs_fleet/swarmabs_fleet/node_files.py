"""The files with which systemd starts the nodes of a host: DDS profiles, environment files and units.

A node uses one address of its host and announces itself only to the peers that it needs. A robot announces itself to
the coordinators and its own drivers, so robots never discover each other, unless there is no observer. Coordinators
announce themselves to all nodes, so a restarted coordinator is discovered at once.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from swarmabs_config.fleet.participants import (
    DISCOVERY,
    DISCOVERY_SERVER,
    DRIVERS,
    OPERATOR,
    node_plans,
    operator_hosts,
)
from swarmabs_config.fleet.robots import PluginDrive
from swarmabs_config.graph import CONTROLLER, OBSERVER, RECORDER
from swarmabs_config.ports import metatraffic_port
from swarmabs_core.realtime.leadership import STANDBY
from swarmabs_run.orchestration.network import (
    PARTICIPANT_VARIABLE,
    REALTIME_LEASE,
    SECURE_LEASE,
    Discovery,
    dds_environment,
    network_profile_xml,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from swarmabs_config.fleet.participants import NodePlan
    from swarmabs_fleet.host_plan import HostPlan

DISCOVERY_GROUP = "239.255.0.1"
"""Multicast group for discovery, as defined by the DDS standard."""
WATCHDOG = 2
"""Time, s, without a watchdog notification after which systemd restarts a node of the control loop."""
SLOW_WATCHDOG = 10
"""The same for nodes that may have to wait for a disk, and for nodes that no robot waits for."""
REFUSED = 2
"""Exit code of a node that rejects its parameters; restarting it would not help."""
_PLAIN = re.compile(r"[A-Za-z0-9_./:-]+")


def node_files(host: HostPlan) -> dict[str, str]:
    """Return all files except parameter files, by their paths in the bundle."""
    files = {f"nodes/{node.name}.env": _environment_file(_node_environment(host, node)) for node in host.nodes}
    for role in host.roles:
        files[f"dds/{role}.xml"] = profile(host, role)
        if role in {"operator", "driver"}:
            files[f"nodes/{role}.env"] = _environment_file(tool_environment(host, role))
    units = {f"{host.service}-{node.name}.service": _unit(host, node) for node in restart_order(host.nodes)}
    units[host.target] = host.render("nodes.target", units=" ".join(units))
    files["units.txt"] = "".join(f"{name}\n" for name in units)
    return files | {f"systemd/{name}": text for name, text in units.items()}


def restart_order(nodes: tuple[NodePlan, ...]) -> tuple[NodePlan, ...]:
    """Return nodes in the order of a rolling restart: the robots first, then standbys, the controller last."""
    robots = [node for node in nodes if node.robot is not None]
    others = [node for node in nodes if node.robot is None]
    return (
        *robots,
        *sorted(others, key=lambda node: (node.pair != STANDBY, node.kind == CONTROLLER, node.participant)),
    )


def profile(host: HostPlan, role: str) -> str:
    """Return the Fast DDS profile of one of a host's `roles`; the participant id comes from the environment."""
    network, discovery = host.fleet.network, Discovery()
    if network.discovery == "static":
        announced = _peers(host, role)
        discovery = Discovery(
            peers=tuple((peer, metatraffic_port(network.domain, number)) for peer, number in announced)
        )
    elif network.discovery == "server" and network.server is not None:
        port = metatraffic_port(network.domain, DISCOVERY_SERVER)
        server = (host.fleet.address(network.server), port)
        discovery = Discovery("SERVER" if role == "server" else "CLIENT", server=server)
    lease = SECURE_LEASE if host.fleet.security.level == "sros2" else REALTIME_LEASE
    return network_profile_xml(host.address, discovery, lease=lease)


def _peers(host: HostPlan, role: str) -> list[tuple[str, int]]:
    """Return address and participant id of each peer to which nodes of a role on a host announce themselves."""
    fleet, nodes = host.fleet, node_plans(host.fleet)
    coordinators = [(fleet.address(node.host), node.participant) for node in nodes if node.role == "coordinator"]
    robots = [(fleet.address(node.host), node.participant) for node in nodes if node.robot is not None]
    operator = [(fleet.address(name), OPERATOR) for name in operator_hosts(fleet)]
    drivers = [(host.address, number) for number in DRIVERS] if "driver" in host.roles else []
    if role == "robot" and not fleet.decentralised:
        return [*coordinators, *operator, *drivers]
    if role == "driver":
        return [peer for peer in [*coordinators, *robots] if peer[0] == host.address] + drivers
    return [*coordinators, *operator, *drivers, *robots]


def _environment_file(variables: Mapping[str, str]) -> str:
    """Return the text of an environment file that systemd and a shell read alike, since no value needs quotes.

    Raises
    ------
    ValueError
        If a value needs quotes: a programming error, since values of fleet files are validated.
    """
    for name, value in variables.items():
        if not _PLAIN.fullmatch(value):
            raise ValueError(f"{name}={value!r} needs quotes")
    return "".join(f"{name}={value}\n" for name, value in variables.items())


def _node_environment(host: HostPlan, node: NodePlan) -> dict[str, str]:
    """Return the environment of a node in addition to that of the workspace."""
    return _environment(host, node.role, node.participant) | {
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONNOUSERSITE": "1",
        "PYTHONSAFEPATH": "1",
        "PYTHONUNBUFFERED": "1",
    }


def tool_environment(host: HostPlan, role: str) -> dict[str, str]:
    """Return the environment of tools of a role, ``operator`` or ``driver``, on a host."""
    variables = _environment(host, role, OPERATOR if role == "operator" else DRIVERS[0])
    if "ROS_SECURITY_KEYSTORE" in variables:
        variables["ROS_SECURITY_ENCLAVE_OVERRIDE"] = host.enclave(host.tools(role))
    return variables


def _environment(host: HostPlan, role: str, participant: int) -> dict[str, str]:
    variables = dds_environment(host.fleet.network.domain, f"{host.installed}/dds/{role}.xml")
    variables[PARTICIPANT_VARIABLE] = str(participant)
    if host.fleet.security.level == "sros2":
        variables |= {
            "ROS_SECURITY_ENABLE": "true",
            "ROS_SECURITY_STRATEGY": "Enforce",
            "ROS_SECURITY_KEYSTORE": host.keystore,
        }
    return variables


def _unit(host: HostPlan, node: NodePlan) -> str:
    """Return the systemd unit of a node, with watchdog and sandbox."""
    devices = node.robot is None or not isinstance(node.robot.drive, PluginDrive)
    return host.render(
        "node.service",
        node=node,
        command=_command(host, node),
        refused=REFUSED,
        watchdog=SLOW_WATCHDOG if node.kind in {RECORDER, DISCOVERY} else WATCHDOG,
        state=host.service if node.kind in {OBSERVER, RECORDER} else None,
        private_devices="yes" if devices else "no",
        addresses=_addresses(host, node),
        interfaces=(host.fleet.interface(host.name), *host.fleet.host(host.name).further_interfaces),
    )


def _command(host: HostPlan, node: NodePlan) -> Iterator[str]:
    # Nodes log to standard error, which goes to the journal.
    yield from (host.python, "-m", node.module, "--ros-args", "--disable-external-lib-logs")
    yield from ("-r", f"__node:={node.name}", "-r", f"__ns:={host.fleet.namespace}")
    yield from ("--params-file", f"{host.installed}/nodes/{node.name}.yaml")
    if host.fleet.security.level == "sros2":
        yield from ("--enclave", host.enclave(node.name))


def _addresses(host: HostPlan, node: NodePlan) -> list[str]:
    """Return the addresses that a node may communicate with: its peers and the further addresses of its host."""
    network = host.fleet.network
    met = [host.address, *(address for address, _ in _peers(host, node.role))]
    if network.discovery == "server" and network.server is not None:
        met.append(host.fleet.address(network.server))
    if network.discovery == "multicast":
        met.append(DISCOVERY_GROUP)
    return [*dict.fromkeys(met), *host.fleet.host(host.name).further_addresses]

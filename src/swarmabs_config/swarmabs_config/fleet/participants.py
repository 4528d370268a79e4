"""Host, DDS participant id and ports of each node.

Participant ids are assigned per host: the ports of a node are known before it starts, and adding a robot on its own
host changes no other node's ports.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from swarmabs_config.graph import (
    CONTROLLER,
    COORDINATORS,
    FIRST_SPARE,
    NODES,
    OBSERVER,
    PLANE,
    PLANE_DRIVER,
    REALTIME,
    RECORDER,
    ROBOT,
    agent_name,
)
from swarmabs_config.ports import DATA_OFFSET, METATRAFFIC_OFFSET, metatraffic_port

if TYPE_CHECKING:
    from swarmabs_config.fleet.model import UncheckedFleet
    from swarmabs_config.fleet.robots import Robot

OPERATOR = FIRST_SPARE
"""Participant id of the operator's tool; only one runs at a time."""
DISCOVERY_SERVER = 5
DRIVERS = (6, 7)
"""Participant ids of the robot's driver nodes behind a topic drive, one per process."""
LARGEST_PARTICIPANT = 44
"""Up to this id, ports stay below those of the next domain."""

DISCOVERY = "discovery_server"
Role = Literal["coordinator", "robot", "server"]


@dataclass(frozen=True, slots=True)
class NodePlan:
    """One node of a fleet: its name, also that of its unit and files, the module whose ``main`` it runs, and its host.

    The DDS participant id is unique on the host. The role determines discovery: coordinators announce themselves to all
    nodes, robots to coordinators.
    """

    name: str
    module: str
    host: str
    participant: int
    role: Role
    robot: Robot | None = None


def node_plans(fleet: UncheckedFleet) -> tuple[NodePlan, ...]:
    """Return all nodes of a fleet: the coordinators first, then the robots by id."""
    parts = fleet.coordinators
    hosts = {
        PLANE if parts.plane.type == "simulated" else PLANE_DRIVER: parts.plane.host,
        OBSERVER: parts.observer.host,
        CONTROLLER: parts.controller.host,
    }
    if parts.recorder is not None:
        hosts[RECORDER] = parts.recorder.host
    nodes = [
        NodePlan(name, NODES[name].modules[REALTIME], host, NODES[name].participant, "coordinator")
        for name, host in hosts.items()
    ]
    if fleet.network.discovery == "server" and fleet.network.server is not None:
        module = "swarmabs_fleet.discovery_server"
        nodes.append(NodePlan(DISCOVERY, module, fleet.network.server, DISCOVERY_SERVER, "server"))
    on_host: dict[str, int] = {}
    for robot in fleet.members:
        number = on_host.setdefault(robot.host, COORDINATORS)
        on_host[robot.host] += 1
        nodes.append(NodePlan(agent_name(robot.id), NODES[ROBOT].modules[REALTIME], robot.host, number, "robot", robot))
    return tuple(nodes)


def nodes_on(fleet: UncheckedFleet, host: str) -> tuple[NodePlan, ...]:
    """Return the nodes of a host."""
    return tuple(node for node in node_plans(fleet) if node.host == host)


def ports(fleet: UncheckedFleet, node: NodePlan) -> tuple[int, int]:
    """Return the two UDP ports of a node: for discovery and for data."""
    first = metatraffic_port(fleet.network.domain, node.participant)
    return first, first + DATA_OFFSET - METATRAFFIC_OFFSET

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
    FIRST_TOOL,
    NODES,
    OBSERVER,
    PEER,
    PLANE,
    PLANE_DRIVER,
    REALTIME,
    RECORDER,
    ROBOT,
    standby_name,
)
from swarmabs_config.ports import DATA_OFFSET, METATRAFFIC_OFFSET, metatraffic_port
from swarmabs_core.messages import PARENT
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime.leadership import PRIMARY, SINGLE, STANDBY

if TYPE_CHECKING:
    from swarmabs_config.fleet.model import Fleet
    from swarmabs_config.fleet.robots import Robot

OPERATOR = FIRST_TOOL
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
    """One node of a fleet: its kind (a name of `NODES`), the module whose ``main`` it runs, and its host.

    The DDS participant id is unique on the host. The role determines discovery: coordinators announce themselves to all
    nodes, robots to coordinators and, without an observer, to each other. Of a `pair` of coordinators the primary has
    the usual name; standbys are on other hosts and have the same participant id.
    """

    kind: str
    module: str
    host: str
    participant: int
    role: Role
    robot: Robot | None = None
    pair: str = SINGLE

    @property
    def name(self) -> str:
        """The name of the node, of its unit, and of its files."""
        if self.robot is not None:
            return agent_name(self.robot.id)
        return standby_name(self.kind) if self.pair == STANDBY else self.kind

    @property
    def author(self) -> int | None:
        """Its number among the authors of states: the id of a robot, `PARENT` for the plane, None for others."""
        if self.robot is not None:
            return self.robot.id
        return PARENT if self.kind in {PLANE, PLANE_DRIVER} else None


def node_plans(fleet: Fleet) -> tuple[NodePlan, ...]:
    """Return all nodes of a fleet: the coordinators first, each before its standby, then the robots by id."""
    parts = fleet.coordinators
    hosts: dict[str, tuple[str, str | None]] = {
        PLANE if parts.plane.type == "simulated" else PLANE_DRIVER: (parts.plane.host, None),
    }
    for kind, part in ((OBSERVER, parts.observer), (CONTROLLER, parts.controller), (RECORDER, parts.recorder)):
        if part is not None:
            hosts[kind] = (part.host, part.standby)
    nodes = []
    for kind, (host, standby) in hosts.items():
        pair = [(host, SINGLE)] if standby is None else [(host, PRIMARY), (standby, STANDBY)]
        module, number = NODES[kind].modules[REALTIME], NODES[kind].participant
        assert number is not None  # noqa: S101 - every coordinator of a fleet has one
        nodes += [NodePlan(kind, module, place, number, "coordinator", pair=rank) for place, rank in pair]
    if fleet.network.discovery == "server" and fleet.network.server is not None:
        module = "swarmabs_fleet.discovery_server"
        nodes.append(NodePlan(DISCOVERY, module, fleet.network.server, DISCOVERY_SERVER, "server"))
    on_host: dict[str, int] = {}
    for robot in fleet.members:
        number = on_host.setdefault(robot.host, COORDINATORS)
        on_host[robot.host] += 1
        kind = PEER if fleet.decentralised else ROBOT
        nodes.append(NodePlan(kind, NODES[kind].modules[REALTIME], robot.host, number, "robot", robot))
    return tuple(nodes)


def operator_hosts(fleet: Fleet) -> tuple[str, ...]:
    """Return the hosts on which an operator's tools run: that of the controller, then that of its standby.

    Without a controller they are those of the recorder and the plane.
    """
    parts = fleet.coordinators
    if parts.controller is None:
        recorders = [] if parts.recorder is None else [parts.recorder.host, parts.recorder.standby]
        return tuple(dict.fromkeys(host for host in (*recorders, parts.plane.host) if host is not None))
    standby = parts.controller.standby
    return (parts.controller.host,) if standby is None else (parts.controller.host, standby)


def nodes_on(fleet: Fleet, host: str) -> tuple[NodePlan, ...]:
    """Return the nodes of a host."""
    return tuple(node for node in node_plans(fleet) if node.host == host)


def ports(fleet: Fleet, node: NodePlan) -> tuple[int, int]:
    """Return the two UDP ports of a node: for discovery and for data."""
    first = metatraffic_port(fleet.network.domain, node.participant)
    return first, first + DATA_OFFSET - METATRAFFIC_OFFSET

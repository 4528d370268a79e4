"""Which node runs where, under which DDS participant id, and which ports that takes.

A participant id is fixed per host, so a node's ports are known before it starts, and a robot that is added on a host
of its own changes nobody else's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from swarmabs_run.orchestration.dds_profile import CONTROLLER_PARTICIPANT, COORDINATORS
from swarmabs_run.orchestration.domain import DATA_OFFSET, METATRAFFIC_OFFSET, metatraffic_port
from swarmabs_run.orchestration.plan import CONTROLLER, OBSERVER, PLANE, RECORDER, agent_name

if TYPE_CHECKING:
    from swarmabs_config.fleet.model import Fleet
    from swarmabs_config.fleet.robots import Robot

OPERATOR = 4
"""Participant id of the tool that an operator uses, one at a time."""
DISCOVERY_SERVER = 5
DRIVERS = (6, 7)
"""Participant ids of the robot's own nodes behind a topic drive, one per process."""
LARGEST_PARTICIPANT = 44
"""Up to here the ports stay below those of the next domain."""

DISCOVERY = "discovery_server"
PLANE_DRIVER = "plane_driver"
Role = Literal["coordinator", "robot", "server"]


@dataclass(frozen=True, slots=True)
class NodePlan:
    """One node of a fleet.

    Parameters
    ----------
    name : str
        Name of the node, of its unit and of its files.
    module : str
        Module whose ``main`` it runs.
    host : str
        Where it runs.
    participant : int
        Its DDS participant id, unique on its host.
    role : str
        Whom it announces itself to: coordinators to everybody, robots to coordinators.
    robot : Robot, optional
        The robot it is the node of.
    """

    name: str
    module: str
    host: str
    participant: int
    role: Role
    robot: Robot | None = None


def node_plans(fleet: Fleet) -> tuple[NodePlan, ...]:
    """Return all nodes of a fleet: the coordinators first, then the robots by id."""
    parts = fleet.coordinators
    simulated = parts.plane.type == "simulated"
    nodes = [
        NodePlan(
            PLANE if simulated else PLANE_DRIVER,
            "plane_sim.realtime" if simulated else "plane_sim.driver",
            parts.plane.host,
            0,
            "coordinator",
        ),
        NodePlan(OBSERVER, "abstraction_observer.realtime", parts.observer.host, 1, "coordinator"),
        NodePlan(
            CONTROLLER, "parent_controller.realtime", parts.controller.host, CONTROLLER_PARTICIPANT, "coordinator"
        ),
    ]
    if parts.recorder is not None:
        nodes.append(NodePlan(RECORDER, "swarmabs_bag.recorder.realtime", parts.recorder.host, 3, "coordinator"))
    if fleet.network.discovery == "server" and fleet.network.server is not None:
        module = "swarmabs_fleet.discovery_server"
        nodes.append(NodePlan(DISCOVERY, module, fleet.network.server, DISCOVERY_SERVER, "server"))
    on_host: dict[str, int] = {}
    for robot in fleet.members:
        number = on_host.setdefault(robot.host, COORDINATORS)
        on_host[robot.host] += 1
        nodes.append(NodePlan(agent_name(robot.id), "agent_node.realtime", robot.host, number, "robot", robot))
    return tuple(nodes)


def nodes_on(fleet: Fleet, host: str) -> tuple[NodePlan, ...]:
    """Return the nodes of a host."""
    return tuple(node for node in node_plans(fleet) if node.host == host)


def ports(fleet: Fleet, node: NodePlan) -> tuple[int, int]:
    """Return the two UDP ports of a node: for discovery and for data."""
    first = metatraffic_port(fleet.network.domain, node.participant)
    return first, first + DATA_OFFSET - METATRAFFIC_OFFSET

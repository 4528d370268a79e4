"""systemd units: one per node, watched and locked in, and a target for all nodes of a host."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_config.fleet.participants import DISCOVERY
from swarmabs_config.fleet.robots import PluginDrive
from swarmabs_config.graph import OBSERVER, RECORDER
from swarmabs_fleet.places import Places, enclave, state_folder, target_name, unit_name
from swarmabs_fleet.profile import DISCOVERY_GROUP, peers
from swarmabs_fleet.rendering import render

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_config.fleet.model import Fleet
    from swarmabs_config.fleet.participants import NodePlan

WATCHDOG = 2
"""Time, s, without a sign of life after which systemd restarts a node of the control loop."""
SLOW_WATCHDOG = 10
"""The same of nodes that may have to wait for a disk, and of those that no robot waits for."""
REFUSED = 2
"""Exit code of a node that refuses its parameters: starting it again would not help."""


def units(fleet: Fleet, host: str, nodes: tuple[NodePlan, ...]) -> dict[str, str]:
    """Return the units of a host by name: those of its nodes in the order of a rolling restart, then the target."""
    made = {unit_name(fleet, node.name): _unit(fleet, node) for node in restart_order(nodes)}
    made[target_name(fleet)] = render("nodes.target", fleet=fleet.name, host=host, units=" ".join(made))
    return made


def restart_order(nodes: tuple[NodePlan, ...]) -> tuple[NodePlan, ...]:
    """Return nodes in the order in which they are restarted one by one: the robots first, the controller last."""
    robots = [node for node in nodes if node.robot is not None]
    others = [node for node in nodes if node.robot is None]
    return (*robots, *sorted(others, key=lambda node: (node.name == "parent_controller", node.participant)))


def _unit(fleet: Fleet, node: NodePlan) -> str:
    places = Places.of(fleet, node.host)
    host = fleet.host(node.host)
    slow = node.name in {RECORDER, DISCOVERY}
    devices = node.robot is None or not isinstance(node.robot.drive, PluginDrive)
    keeps = node.name in (OBSERVER, RECORDER)
    return render(
        "node.service",
        fleet=fleet,
        node=node,
        places=places,
        target=target_name(fleet),
        command=_command(fleet, node, places),
        refused=REFUSED,
        watchdog=SLOW_WATCHDOG if slow else WATCHDOG,
        state=state_folder(fleet) if keeps else None,
        private_devices="yes" if devices else "no",
        addresses=_addresses(fleet, node),
        interfaces=(fleet.interface(node.host), *host.further_interfaces),
    )


def _command(fleet: Fleet, node: NodePlan, places: Places) -> Iterator[str]:
    # What a node logs goes to its standard error, and from there to the journal.
    yield from (places.python, "-m", node.module, "--ros-args", "--disable-external-lib-logs")
    yield from ("-r", f"__node:={node.name}", "-r", f"__ns:={fleet.namespace}")
    yield from ("--params-file", f"{places.installed}/nodes/{node.name}.yaml")
    if fleet.security.level == "sros2":
        yield from ("--enclave", enclave(fleet, node.name))


def _addresses(fleet: Fleet, node: NodePlan) -> list[str]:
    """Return whom a node may talk to: those it announces itself to, and what its host names besides."""
    met = [fleet.address(node.host), *(address for address, _ in peers(fleet, node.host, node.role))]
    if fleet.network.discovery == "server" and fleet.network.server is not None:
        met.append(fleet.address(fleet.network.server))
    if fleet.network.discovery == "multicast":
        met.append(DISCOVERY_GROUP)
    return [*dict.fromkeys(met), *fleet.host(node.host).further_addresses]

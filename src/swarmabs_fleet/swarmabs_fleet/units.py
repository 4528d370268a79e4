"""systemd units: one per node, watched and locked in, and a target for all nodes of a host."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_config.fleet.participants import DISCOVERY
from swarmabs_config.fleet.robots import PluginDrive
from swarmabs_fleet.places import Places, enclave, state_folder, target_name, unit_name
from swarmabs_fleet.profile import DISCOVERY_GROUP, peers
from swarmabs_run.orchestration.plan import OBSERVER, RECORDER

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

_UNIT = """\
[Unit]
Description=swarmabs fleet {fleet}: {node} on {host}
PartOf={target}
Wants=network-online.target
After=network-online.target time-sync.target{after}
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
User={user}
EnvironmentFile={installed}/workspace.env
EnvironmentFile={installed}/nodes/{node}.env
ExecStartPre={python} -m swarmabs_fleet.own_address {address}
ExecStart={command}
Restart=on-failure
RestartSec=1
RestartPreventExitStatus={refused}
WatchdogSec={watchdog}
TimeoutStartSec=60
TimeoutStopSec=10
{further}
# Locked in: it reads its bundle, and talks to the fleet.
NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
UMask=0077
ProtectSystem=strict
ProtectHome=read-only
PrivateTmp=yes
PrivateDevices={private_devices}
ProtectClock={private_devices}
ProtectHostname=yes
ProtectControlGroups=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectProc=invisible
RestrictAddressFamilies=AF_INET AF_NETLINK AF_UNIX
RestrictNamespaces=yes
RestrictSUIDSGID=yes
LockPersonality=yes
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM
IPAddressDeny=any
IPAddressAllow=localhost {addresses}
RestrictNetworkInterfaces=lo {interfaces}

[Install]
WantedBy={target}
"""

_TARGET = """\
[Unit]
Description=swarmabs fleet {fleet}: all nodes on {host}
Wants={units}

[Install]
WantedBy=multi-user.target
"""


def units(fleet: Fleet, host: str, nodes: tuple[NodePlan, ...]) -> dict[str, str]:
    """Return the units of a host by name: those of its nodes in the order of a rolling restart, then the target."""
    made = {unit_name(fleet, node.name): _unit(fleet, node) for node in restart_order(nodes)}
    made[target_name(fleet)] = _TARGET.format(fleet=fleet.name, host=host, units=" ".join(made))
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
    return _UNIT.format(
        fleet=fleet.name,
        node=node.name,
        host=node.host,
        target=target_name(fleet),
        after=f" wg-quick@{fleet.tunnel.interface}.service" if fleet.tunnel else "",
        user=fleet.user(node.host),
        installed=places.installed,
        python=places.python,
        address=fleet.address(node.host),
        command=" ".join(_command(fleet, node, places)),
        refused=REFUSED,
        watchdog=SLOW_WATCHDOG if slow else WATCHDOG,
        further=f"StateDirectory={state_folder(fleet)}\nStateDirectoryMode=0750\n" if keeps else "",
        private_devices="yes" if devices else "no",
        addresses=" ".join(_addresses(fleet, node)),
        interfaces=" ".join([fleet.interface(node.host), *host.further_interfaces]),
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

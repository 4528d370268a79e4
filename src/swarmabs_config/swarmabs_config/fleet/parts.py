"""Parts of a fleet file: hosts, coordinators, network, time, security, installation.

Texts that are used in paths, units and scripts contain no character that a shell interprets.
"""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, TypeAlias

from pydantic import AfterValidator, Field

from swarmabs_config.model.declared import model_of
from swarmabs_config.model.errors import show
from swarmabs_config.model.fields import WORD, AsTuple, Model, Name, Positive, Tagged, matching, problem
from swarmabs_config.ports import LARGEST_DOMAIN
from swarmabs_core.declaration import part, setting
from swarmabs_core.realtime.instruments import PlaneInstrument

if TYPE_CHECKING:
    from collections.abc import Callable


def _address(*, loopback: bool) -> Callable[[str], str]:
    def check(text: str) -> str:
        try:
            address = ipaddress.IPv4Address(text)
        except ValueError:
            raise problem(f"{show(text)} is not an IPv4 address", "write four numbers, e.g. 192.168.10.1") from None
        if address.is_multicast or address.is_unspecified or address.is_reserved:
            raise problem(f"{text} is not the address of a host", "give the address of the host's interface")
        if address.is_loopback and not loopback:
            raise problem(f"{text} is a loopback address", "give an address in the tunnel, e.g. 10.83.0.1")
        return text

    return check


def _not_root(text: str) -> str:
    if text == "root":
        raise problem("nodes must not run as root", "name a dedicated account, e.g. swarmabs")
    return text


def _network(text: str) -> str:
    try:
        ipaddress.IPv4Network(text)
    except ValueError:
        raise problem(f"{show(text)} is not an IPv4 network", "write e.g. 192.168.1.5 or 192.168.1.0/24") from None
    return text


Address: TypeAlias = Annotated[str, AfterValidator(_address(loopback=True))]
TunnelAddress: TypeAlias = Annotated[str, AfterValidator(_address(loopback=False))]
Network: TypeAlias = Annotated[str, AfterValidator(_network)]

Interface: TypeAlias = Annotated[
    str,
    matching(r"[A-Za-z0-9][A-Za-z0-9_.-]*", "network interface name", "write e.g. eth0; see 'ip link' on the host", 15),
]

Account: TypeAlias = Annotated[
    str,
    matching(r"[a-z_][a-z0-9_-]*", "account name", "use lowercase letters, digits, - and _", 31),
    AfterValidator(_not_root),
]

FolderPath: TypeAlias = Annotated[
    str,
    matching(
        r"(?!.*/\.{1,2}(/|$))(/[A-Za-z0-9._-]+)+",
        "absolute path",
        "write e.g. /opt/swarmabs; letters, digits, '.', '-' and '_', without '..'",
    ),
]
"""An absolute path that never needs quoting; not the root folder."""

Namespace: TypeAlias = Annotated[
    str, matching(rf"/|(/{WORD})+", "ROS namespace", "write / or e.g. /hall_a; letters, digits and _")
]
PluginName: TypeAlias = Annotated[
    str,
    matching(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", "entry point name", "use letters, digits, '_', '.' and '-'", 80),
]
SettingName: TypeAlias = Annotated[
    str,
    matching(rf"{WORD}(\.{WORD})*", "setting name", "use letters, digits and _; dots nest", 80),
]


def path_of(namespace: str, name: str) -> str:
    """Resolve a relative or absolute ROS name in a namespace."""
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"


Ros: TypeAlias = Literal["wheels", "sourced"]


class Host(Model):
    """A computer that runs nodes."""

    name: Name = Field(description="name of the host")
    address: Address = Field(description="IPv4 address of its interface in the fleet's network")
    interface: Interface | None = Field(default=None, description="network interface; null: network.interface")
    tunnel_address: TunnelAddress | None = Field(
        default=None, description="address in the tunnel; required with 'security: {level: tunnel}', else not allowed"
    )
    user: Account | None = Field(default=None, description="account that runs its nodes; null: installation.user")
    ros: Ros | None = Field(default=None, description="source of its ROS 2; null: installation.ros")
    further_addresses: Annotated[tuple[Network, ...], AsTuple] = Field(
        default=(), description="addresses outside the fleet that its nodes may use, such as a motor controller's"
    )
    further_interfaces: Annotated[tuple[Interface, ...], AsTuple] = Field(default=(), description="interfaces to them")


class SimulatedPlane(Model):
    """The scenario's plane, simulated."""

    type: Literal["simulated"] = Field(default="simulated", description="the plane is simulated")
    host: Name = Field(description="host on which its node runs")


@dataclass(frozen=True, slots=True)
class MeasuredPlane:
    """A plane whose motion is measured."""

    type: ClassVar[str] = "driver"

    host: str = setting("", "host on which its node runs", names="name", required=True)
    instrument: PlaneInstrument = part(PlaneInstrument, name="")


PLANES: dict[str, type[Model]] = {"simulated": SimulatedPlane, "driver": model_of(MeasuredPlane, tag="type")}


_STANDBY = "host of a second one, which takes over when this one falls silent; null: none"


class Observer(Model):
    """The node that computes the swarm's abstract state."""

    host: Name = Field(description="host on which it runs")
    standby: Name | None = Field(default=None, description=_STANDBY)


class Controller(Model):
    """The parent controller."""

    host: Name = Field(description="host on which it runs")
    standby: Name | None = Field(default=None, description=_STANDBY)
    start_mode: Literal["stop", "run"] = Field(
        default="stop", description="stop: robots do not move until a reset; run: they move once all nodes are present"
    )


class Recorder(Model):
    """The node that writes the bag."""

    host: Name = Field(description="host on which it runs; its bags are in /var/lib/swarmabs-NAME")
    standby: Name | None = Field(
        default=None, description="host of a second one, which records a bag of its own; null: none"
    )


class Coordinators(Model):
    """Hosts of the nodes that are not robots; they may share one, or be those of robots."""

    plane: Annotated[SimulatedPlane | MeasuredPlane, Tagged("type", PLANES, "simulated")] = Field(
        description="the plane, simulated or measured"
    )
    observer: Observer | None = Field(default=None, description="the observer; null with 'coordination: each_robot'")
    controller: Controller | None = Field(
        default=None, description="the parent controller; null with 'coordination: each_robot'"
    )
    recorder: Recorder | None = Field(default=None, description="the recorder; null: nothing is recorded")


class NetworkConfig(Model):
    """How the nodes find each other."""

    domain: int = Field(ge=0, le=LARGEST_DOMAIN, description="ROS domain of the fleet; no other fleet may use it")
    interface: Interface | None = Field(default=None, description="interface of the hosts that do not name one")
    discovery: Literal["static", "multicast", "server"] = Field(
        default="static",
        description="static: by listed addresses; multicast: by multicast; server: by a server on the host 'server'",
    )
    server: Name | None = Field(default=None, description="host of the discovery server")


class Time(Model):
    """How closely the hosts' clocks must agree."""

    max_offset: Positive = Field(
        default=0.005, description="largest permitted error of a host's clock, s; checked on the host"
    )


class NoSecurity(Model):
    """No protection: anyone on the network can read the traffic and move robots within their limits."""

    level: Literal["none"] = Field(default="none", description="no protection beyond the network's own")


class TunnelSecurity(Model):
    """All traffic in a WireGuard tunnel between the hosts."""

    level: Literal["tunnel"] = Field(default="tunnel", description="WireGuard between the hosts")
    interface: Interface = Field(default="swarmabs0", description="name of the tunnel's interface on all hosts")
    port: int = Field(default=51820, ge=1024, le=65535, description="UDP port of the tunnel")
    keepalive: int = Field(default=25, ge=0, le=65535, description="period of keep-alive packets, s; 0: none")


class Sros2Security(Model):
    """DDS Security: certificates and permissions per node; for full ROS 2 installations."""

    level: Literal["sros2"] = Field(default="sros2", description="certificates and permissions per node")
    valid_days: int = Field(default=3650, ge=1, le=36500, description="validity of new certificates, days")


Security: TypeAlias = NoSecurity | TunnelSecurity | Sros2Security
LEVELS: dict[str, type[Model]] = {"none": NoSecurity, "tunnel": TunnelSecurity, "sros2": Sros2Security}


class Installation(Model):
    """The software that bundles expect on a host, and where they are installed."""

    checkout: FolderPath = Field(default="/opt/swarmabs", description="prepared checkout of swarmabs on each host")
    ros: Ros = Field(
        default="wheels", description="wheels: the checkout's .venv; sourced: an installed ROS 2 Jazzy, as on ARM"
    )
    setup: FolderPath = Field(default="/opt/ros/jazzy/setup.sh", description="setup script of the installed ROS 2")
    prefix: FolderPath = Field(default="/etc/swarmabs", description="folder below which bundles are installed")
    user: Account = Field(default="swarmabs", description="account under which nodes run")

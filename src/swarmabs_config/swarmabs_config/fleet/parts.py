"""Parts of a fleet file: hosts, coordinators, network, time, security, installation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias

from pydantic import Field

from swarmabs_config.fleet.names import Account, Address, FolderPath, Interface, Network, TunnelAddress
from swarmabs_config.ports import LARGEST_DOMAIN
from swarmabs_config.scenario.declared import model_of
from swarmabs_config.scenario.fields import AsTuple, Model, Positive, Tagged
from swarmabs_config.scenario.texts import Name
from swarmabs_core.declaration import part, setting
from swarmabs_core.realtime.instruments import PlaneInstrument

Ros: TypeAlias = Literal["wheels", "sourced"]


class Host(Model):
    """A computer that runs nodes."""

    name: Name = Field(description="name of the host")
    address: Address = Field(description="IPv4 address of its interface in the fleet's network")
    interface: Interface | None = Field(default=None, description="the interface; null: network.interface")
    tunnel_address: TunnelAddress | None = Field(
        default=None, description="address in the tunnel; needed with 'security: {level: tunnel}', and only then"
    )
    user: Account | None = Field(default=None, description="account of its nodes; null: installation.user")
    ros: Ros | None = Field(default=None, description="where ROS 2 comes from there; null: installation.ros")
    further_addresses: Annotated[tuple[Network, ...], AsTuple] = Field(
        default=(), description="what its nodes may talk to besides the fleet, such as a motor controller"
    )
    further_interfaces: Annotated[tuple[Interface, ...], AsTuple] = Field(default=(), description="interfaces to these")


class SimulatedPlane(Model):
    """A plane that is computed, of the scenario."""

    type: Literal["simulated"] = Field(default="simulated", description="the plane is computed")
    host: Name = Field(description="host on which its node runs")


@dataclass(frozen=True, slots=True)
class MeasuredPlane:
    """A plane whose motion is measured."""

    type: ClassVar[str] = "driver"

    host: str = setting("", "host on which its node runs", names="name", required=True)
    instrument: PlaneInstrument = part(PlaneInstrument, name="")


PLANES: dict[str, type[Model]] = {"simulated": SimulatedPlane, "driver": model_of(MeasuredPlane, tag="type")}


class Observer(Model):
    """The node that sums up the robots."""

    host: Name = Field(description="host on which it runs")


class Controller(Model):
    """The parent controller."""

    host: Name = Field(description="host on which it runs")
    start_mode: Literal["stop", "run"] = Field(
        default="stop", description="stop: robots stand until somebody resets; run: they move once all is there"
    )


class Recorder(Model):
    """The node that writes the bag."""

    host: Name = Field(description="host on which it runs, below /var/lib/swarmabs-NAME")


class Coordinators(Model):
    """Where the nodes run that are not robots; they may share a host."""

    plane: Annotated[SimulatedPlane | MeasuredPlane, Tagged("type", PLANES, "simulated")] = Field(
        description="the plane, simulated or measured"
    )
    observer: Observer = Field(description="the observer")
    controller: Controller = Field(description="the parent controller")
    recorder: Recorder | None = Field(default=None, description="the recorder; null: nothing is recorded")


class NetworkConfig(Model):
    """How the nodes find each other."""

    domain: int = Field(ge=0, le=LARGEST_DOMAIN, description="ROS domain of the fleet, one that no other fleet has")
    interface: Interface | None = Field(default=None, description="interface of hosts that name none")
    discovery: Literal["static", "multicast", "server"] = Field(
        default="static",
        description="static: addresses are listed; multicast: by multicast; server: by one on the host 'server'",
    )
    server: Name | None = Field(default=None, description="host of the discovery server")


class Time(Model):
    """How well the hosts' clocks must agree."""

    max_offset: Positive = Field(default=0.005, description="largest error of a host's clock, s; it is checked")


class NoSecurity(Model):
    """Nothing but the interface: whoever is in the network can read, and move robots within their limits."""

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
    """What the bundles find on a host, and where they go."""

    checkout: FolderPath = Field(default="/opt/swarmabs", description="prepared checkout of swarmabs on each host")
    ros: Ros = Field(
        default="wheels", description="wheels: the checkout's .venv; sourced: an installed ROS 2 Jazzy, as on ARM"
    )
    setup: FolderPath = Field(default="/opt/ros/jazzy/setup.sh", description="what to source where ROS 2 is installed")
    prefix: FolderPath = Field(default="/etc/swarmabs", description="folder below which bundles are installed")
    user: Account = Field(default="swarmabs", description="account under which nodes run")

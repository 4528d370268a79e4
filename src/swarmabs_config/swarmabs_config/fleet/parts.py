"""Parts of a fleet file: hosts, coordinators, network, time, security, installation."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field, field_validator

from swarmabs_config.fleet.names import Account, Address, FolderPath, Interface, Name, Network, TunnelAddress
from swarmabs_config.ports import LARGEST_DOMAIN
from swarmabs_config.scenario.fields import AsTuple, Model, Number, Positive, Tagged, problem
from swarmabs_config.scenario.texts import FrameName, TopicName

Axis: TypeAlias = Literal["+x", "+y", "+z", "-x", "-y", "-z"]
Stamp: TypeAlias = Literal["header", "arrival"]
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


class PlaneDriver(Model):
    """A plane whose motion is measured."""

    type: Literal["driver"] = Field(default="driver", description="the plane's motion is measured")
    host: Name = Field(description="host on which its node runs")
    source: Literal["joint_state", "imu"] = Field(
        default="joint_state", description="message of angle and angular velocity: sensor_msgs/JointState or Imu"
    )
    topic: TopicName = Field(default="", description="its topic; '': ~/joint_states or ~/imu")
    stamp: Stamp = Field(default="header", description="time of a reading: its header's, or that of its arrival")
    joint: FrameName = Field(default="plane_tilt", description="joint of the encoder")
    scale: Number = Field(default=1.0, description="turn of the plane per unit of the encoder, rad, not 0")
    frame: FrameName = Field(default="imu_link", description="frame_id that the IMU must have; '': any")
    axis: Axis = Field(default="-y", description="axis of the IMU about which the plane's angle is positive")
    offset: Number = Field(default=0.0, description="angle of the plane where the sensor says 0, rad")

    @field_validator("scale")
    @classmethod
    def _check_scale(cls, scale: float) -> float:
        if scale == 0.0:
            raise problem("a scale of 0 measures nothing", "give rad per unit; negative: it counts backwards")
        return scale


PLANES: dict[str, type[Model]] = {"simulated": SimulatedPlane, "driver": PlaneDriver}


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

    plane: Annotated[SimulatedPlane | PlaneDriver, Tagged("type", PLANES, "simulated")] = Field(
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

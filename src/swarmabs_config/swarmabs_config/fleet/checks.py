"""Checks across several fields of a fleet, and warnings about valid but doubtful settings."""

from __future__ import annotations

import ipaddress
import math
from typing import TYPE_CHECKING

from swarmabs_config.fleet import participants
from swarmabs_config.fleet.parts import MeasuredPlane, path_of
from swarmabs_config.graph import OWN, STANDBY_TOPICS, own_topic
from swarmabs_config.model.fields import Finding, Location, nearest
from swarmabs_core.messages import TOPICS
from swarmabs_core.realtime.instruments import TopicSettings

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Iterator

    from swarmabs_config.fleet.model import Fleet

_TUNNEL = ("security", "level")
_LOOPBACK = "lo"


def findings(fleet: Fleet) -> list[Finding]:
    """Return every error of a fleet whose individual fields are valid."""
    # A later check relies on the earlier ones.
    for group in (
        (_hosts, _ids),
        (_references,),
        (_network, _loopback, _security, _installation, _participants, _topics),
    ):
        if errors := [finding for check in group for finding in check(fleet)]:
            return errors
    return []


def warnings(fleet: Fleet) -> tuple[str, ...]:
    """Return one line for each setting that is valid but likely to cause trouble."""
    lines = []
    used = {node.host for node in participants.node_plans(fleet)}
    idle = [host.name for host in fleet.hosts if host.name not in used]
    if idle:
        lines.append(f"hosts: no node runs on {idle[0]}; remove this host, or assign a node to it")
    if fleet.security.level == "none":
        lines.append(
            "security is none: anyone on the network can read all traffic and command the swarm within its limits"
        )
    if fleet.coordinators.controller is not None and fleet.coordinators.controller.start_mode == "run":
        lines.append(
            "coordinators.controller.start_mode is run: robots move as soon as all nodes are present, without a reset"
        )
    return tuple(lines)


def _twice(kind: str, values: Iterable[tuple[Location, Hashable]], remedy: str) -> Iterator[Finding]:
    first: dict[Hashable, Location] = {}
    for location, value in values:
        if value in first:
            yield Finding.of(location, f"{kind} {value} is listed twice", remedy, see=first[value])
        first.setdefault(value, location)


def _hosts(fleet: Fleet) -> Iterator[Finding]:
    if not fleet.hosts:
        yield Finding.of(("hosts",), "no hosts", "list at least one, e.g. {name: base, address: 192.168.10.1}")
    listed = list(enumerate(fleet.hosts))
    yield from _twice("host", ((("hosts", n, "name"), h.name) for n, h in listed), "give every host its own name")
    yield from _twice(
        "address", ((("hosts", n, "address"), h.address) for n, h in listed), "give every host its own address"
    )
    tunnels: list[tuple[Location, Hashable]] = [
        (("hosts", n, "tunnel_address"), h.tunnel_address) for n, h in listed if h.tunnel_address is not None
    ]
    yield from _twice("tunnel address", tunnels, "give every host its own address")
    for n, host in listed:
        if host.interface is None and fleet.network.interface is None:
            yield Finding.of(("hosts", n), f"no interface for {host.name}", "add 'interface: ...' here or in 'network'")


def _ids(fleet: Fleet) -> Iterator[Finding]:
    if len(fleet.robots) < 2:
        yield Finding.of(
            ("robots",),
            f"a swarm needs at least two robots, found {len(fleet.robots)}",
            "add robots: one robot cannot control torque and inertia independently",
        )
    mass = math.fsum(robot.mass for robot in fleet.robots)
    if fleet.swarm_mass is not None and fleet.swarm_mass < mass:
        yield Finding.of(
            ("swarm_mass",),
            f"{fleet.swarm_mass!r} kg is less than the {mass!r} kg of the robots listed",
            f"give at least {mass!r}",
        )
    ids: list[tuple[Location, Hashable]] = [(("robots", n, "id"), robot.id) for n, robot in enumerate(fleet.robots)]
    yield from _twice("robot", ids, "give every robot its own id")


def _references(fleet: Fleet) -> Iterator[Finding]:
    host_names = [host.name for host in fleet.hosts]
    parts = fleet.coordinators
    doubled = {"observer": parts.observer, "controller": parts.controller, "recorder": parts.recorder}
    named: list[tuple[Location, str | None]] = [
        *((("robots", n, "host"), robot.host) for n, robot in enumerate(fleet.robots)),
        (("coordinators", "plane", "host"), parts.plane.host),
        *((("coordinators", name, "host"), part.host) for name, part in doubled.items() if part),
        *((("coordinators", name, "standby"), part.standby) for name, part in doubled.items() if part),
        (("network", "server"), fleet.network.server),
    ]
    for location, name in named:
        if name is not None and name not in host_names:
            yield Finding.of(location, f"unknown host '{name}'", nearest(name, host_names))
    for name, part in doubled.items():
        if part is not None and part.standby == part.host:
            yield Finding.of(
                ("coordinators", name, "standby"),
                f"{part.host} also runs the {name} itself, so both would be lost together",
                "name another host, or remove 'standby'",
                see=("coordinators", name, "host"),
            )


def _network(fleet: Fleet) -> Iterator[Finding]:
    network = fleet.network
    if network.discovery == "server" and network.server is None:
        yield Finding.of(("network", "discovery"), "no server", "add 'server: HOST' to 'network'")
    if network.discovery != "server" and network.server is not None:
        yield Finding.of(
            ("network", "server"),
            f"'discovery: {network.discovery}' uses no server",
            "remove it, or write 'discovery: server'",
            see=("network", "discovery"),
        )
    if network.discovery == "multicast" and fleet.tunnel is not None:
        yield Finding.of(
            ("network", "discovery"),
            "a tunnel carries no multicast",
            "use 'discovery: static' or 'discovery: server'",
            see=_TUNNEL,
        )
    if network.discovery == "server" and fleet.security.level == "sros2":
        # Security changes the GUID prefix of the server; Fast DDS 2.14 compares the old one when it forgets a server.
        yield Finding.of(
            ("network", "discovery"),
            "with 'level: sros2' nodes do not return to a discovery server that has restarted",
            "use 'discovery: static' or 'discovery: multicast'",
            see=_TUNNEL,
        )
    if len(fleet.hosts) > 1:
        for n, host in enumerate(fleet.hosts):
            if ipaddress.IPv4Address(host.address).is_loopback:
                yield Finding.of(
                    ("hosts", n, "address"),
                    f"{host.address} is a loopback address, which other hosts cannot reach",
                    "give the address of the host's network interface",
                )


def _loopback(fleet: Fleet) -> Iterator[Finding]:
    """Reject the loopback interface, except for a fleet on one host."""
    for n, host in enumerate(fleet.hosts):
        alone = len(fleet.hosts) == 1 and ipaddress.IPv4Address(host.address).is_loopback
        if fleet.host_interface(host.name) == _LOOPBACK and not alone:
            location = ("hosts", n, "interface") if host.interface else ("network", "interface")
            yield Finding.of(
                location,
                f"{_LOOPBACK} on {host.name} reaches no other host",
                f"name the interface that has the address {host.address}",
            )
    if fleet.tunnel is not None and fleet.tunnel.interface == _LOOPBACK:
        yield Finding.of(
            ("security", "interface"), f"{_LOOPBACK} is the loopback interface", "choose another name, e.g. swarmabs0"
        )


def _installation(fleet: Fleet) -> Iterator[Finding]:
    """Reject a bundle folder that is the checkout or contains it."""
    place = fleet.installation
    installed = f"{place.prefix}/{fleet.name}"
    if f"{place.checkout}/".startswith(f"{installed}/"):
        yield Finding.of(
            ("installation", "prefix"),
            f"the bundle would replace {installed}, which contains the checkout",
            "name another folder, e.g. /etc/swarmabs",
            see=("name",),
        )


def _security(fleet: Fleet) -> Iterator[Finding]:
    level = fleet.security.level
    for n, host in enumerate(fleet.hosts):
        if fleet.tunnel is not None and host.tunnel_address is None:
            yield Finding.of(
                ("hosts", n), f"no tunnel_address for {host.name}", "add e.g. 'tunnel_address: 10.83.0.1'", see=_TUNNEL
            )
        if fleet.tunnel is None and host.tunnel_address is not None:
            yield Finding.of(
                ("hosts", n, "tunnel_address"),
                f"'security: {{level: {level}}}' has no tunnel",
                "remove it, or write 'security: {level: tunnel}'",
                see=_TUNNEL,
            )
        if fleet.tunnel is not None and fleet.tunnel.interface == fleet.host_interface(host.name):
            yield Finding.of(
                ("security", "interface"),
                f"{fleet.tunnel.interface} is already the network interface of {host.name}",
                "give the tunnel's interface another name",
                see=("hosts", n),
            )
        if level == "sros2" and fleet.ros(host.name) == "wheels":
            yield Finding.of(
                _TUNNEL,
                f"Fast DDS of the wheels on {host.name} has no security plugins",
                "install ROS 2 Jazzy there and write 'ros: sourced', or use 'level: tunnel'",
                see=("hosts", n),
            )


def _topics(fleet: Fleet) -> Iterator[Finding]:
    """Reject topics of drives and of the plane's sensor that are the swarm's: permissions follow from these names."""
    own = (own_topic(topic, robot.id) for topic in OWN for robot in fleet.robots)
    taken = {path_of(fleet.namespace, topic.name) for topic in (*TOPICS, *STANDBY_TOPICS.values(), *own)}
    plane = fleet.coordinators.plane
    named: list[tuple[Location, str]] = []
    if isinstance(plane, MeasuredPlane):
        named.append((("coordinators", "plane", "topic"), plane.instrument.topic))
    for n, robot in enumerate(fleet.robots):
        if isinstance(robot.drive, TopicSettings):
            place, drive = ("robots", n, "drive"), robot.drive
            named += [((*place, "topic"), drive.topic), ((*place, "command_topic"), drive.command_topic)]
            named.append(((*place, "imu", "topic"), drive.imu.topic))
    for location, name in named:
        if name and path_of(fleet.namespace, name) in taken:
            yield Finding.of(location, f"{name} is a topic of the swarm itself", "name another topic")


def _participants(fleet: Fleet) -> Iterator[Finding]:
    for host in fleet.hosts:
        highest = max((node.participant for node in participants.nodes_on(fleet, host.name)), default=0)
        if highest > participants.LARGEST_PARTICIPANT:
            robots = sum(robot.host == host.name for robot in fleet.robots)
            most = robots - (highest - participants.LARGEST_PARTICIPANT)
            yield Finding.of(
                ("robots",),
                f"{robots} robots on the host {host.name} need ports of the next ROS domain",
                f"put at most {most} robots on one host",
            )

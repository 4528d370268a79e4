"""The network of a run on this machine: its ROS domain, its Fast DDS profile and the environment of its processes.

The profile uses loopback only and fixed participant ids; robots never discover each other, unless they sum up the swarm
by themselves: then a robot has a profile of its own and also announces itself to its neighbours, to which its messages
go one by one.

Every other participant announces itself to the coordinators only, so discovery grows with the number of robots, or of
links, not with the square: 200 processes discover each other in seconds. The only transport is UDP, so a killed process
leaves no shared-memory files behind.

Where the machine supports multicast on loopback, a broadcast is sent once to all robots, and a robot's state once to
all coordinators that use it. Robots, coordinators that hear them, and each other coordinator form separate groups, so
no process is woken by messages that are not addressed to it.
"""

from __future__ import annotations

import socket
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import psutil

from swarmabs_config import ports
from swarmabs_config.graph import COORDINATORS
from swarmabs_core.errors import RunError
from swarmabs_run.rendering import templates

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from jinja2 import Template

PARTICIPANT_VARIABLE = "SWARMABS_PARTICIPANT"
"""Environment variable with a process's participant id, so that one profile serves all processes of a run."""
GROUP_VARIABLE = "SWARMABS_GROUP"
"""Environment variable with the address of a process's multicast group."""
_GROUPS = "239.255.83."
_ROBOTS_GROUP, _GATHERERS_GROUP = f"{_GROUPS}1", f"{_GROUPS}3"
_OWN_GROUPS = "239.254"
"""First half of the address of a participant's own group."""

FROM_ENVIRONMENT = PARTICIPANT_VARIABLE
"""The process reads its participant id from its environment."""
FIRST_FREE = ""
"""The process takes the first free participant id."""

_LOCKSTEP_LEASE = 60
REALTIME_LEASE = 5
"""Silence, s, after which a real-time participant is forgotten: it may have restarted as a new one."""
SECURE_LEASE = 100
"""The same with DDS Security, beyond the time that a start under overload may take.

If only one of two participants has forgotten the other, they never authenticate again: Fast DDS does not answer a new
handshake of a participant that it takes for authenticated, and gives up after ten requests.
"""

_LOOPBACK = "127.0.0.1"
_SERVER_PREFIX = "44.53.00.5f.45.50.52.4f.53.49.4d.41"
"""GUID prefix that Fast DDS gives to the discovery server with id 0."""


@contextmanager
def claimed_domain(participants: int = COORDINATORS) -> Iterator[int]:
    """Claim a free ROS domain for the duration of the block, and yield its id; no other run can claim it meanwhile.

    The claim is a bound TCP port on loopback, which the kernel releases however this process ends. All UDP ports of
    participants with ids below `participants` are free, too, whoever else uses the machine. Raises `RunError` if there
    is no such domain, or loopback does not work.
    """
    check_loopback()
    spacing, taken = ports.domains_spanned(participants), 0
    for first in range(ports.SPACING, ports.LARGEST_DOMAIN - spacing, ports.SPACING):
        with ExitStack() as guards:
            if not _claim(range(first, first + spacing, ports.SPACING), guards):
                continue
            if (port := first_taken(udp_ports(first, range(participants)))) is not None:
                taken = taken or port
                continue
            yield first
            return
    why = f", or UDP ports in them, such as {held_port({taken}) or taken}" if taken else ""
    raise RunError(
        f"no ROS domain is free on this machine: the guard ports of all {ports.LARGEST_DOMAIN // ports.SPACING} are "
        f"taken{why}; end other runs, or the processes that hold these ports"
    )


def check_loopback(timeout: float = 2.0) -> None:
    """Send a datagram to this process on loopback; raises `RunError` if it does not arrive within a time, s."""
    try:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        ):
            receiver.bind((_LOOPBACK, 0))
            receiver.settimeout(timeout)
            sender.sendto(b"swarmabs", receiver.getsockname())
            receiver.recv(16)
    except OSError as error:
        raise RunError(
            f"UDP on {_LOOPBACK} does not work ({error}); bring up the interface: ip link set lo up"
        ) from error


def _claim(domains: range, guards: ExitStack) -> bool:
    """Bind the guard ports of all these domains; return whether that was possible."""
    for domain in domains:
        guard = guards.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
        try:
            guard.bind((_LOOPBACK, ports.PORT_BASE + ports.DOMAIN_GAIN * domain + ports.GUARD_OFFSET))
        except OSError:
            return False
    return True


def udp_ports(domain: int, participants: Iterable[int]) -> list[int]:
    """Return the UDP ports on which participants of a domain listen, and that of its multicast groups."""
    first = [ports.metatraffic_port(domain, participant) for participant in participants]
    step = ports.DATA_OFFSET - ports.METATRAFFIC_OFFSET
    return [ports.multicast_port(domain), *(port + offset for port in first for offset in (0, step))]


def first_taken(udp: Iterable[int]) -> int | None:
    """Return the first UDP port that cannot be bound, None if all can.

    A socket on any address counts: participants bind those of multicast groups, too.
    """
    for port in udp:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                return port
    return None


def held_port(udp: Collection[int], own: Collection[int] = ()) -> str:
    """Return the first of these UDP ports that a process holds whose id is not among the `own`, with this process.

    Empty if there is none; the process is named as far as the system tells.
    """
    with suppress(psutil.Error, OSError):
        for held in psutil.net_connections("udp"):
            if held.laddr and held.laddr.port in udp and held.pid not in own:
                name = "" if held.pid is None else f" of process {held.pid} ({psutil.Process(held.pid).name()})"
                return f"{held.laddr.port}{name}"
    return ""


def dds_environment(domain: int, profile_path: str) -> dict[str, str]:
    """Return the environment variables that put a process into a run's domain."""
    return {
        "ROS_DOMAIN_ID": str(domain),
        # With LOCALHOST or SUBNET the middleware would add transports to those of the profile.
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "RMW_FASTRTPS_PUBLICATION_MODE": "SYNCHRONOUS",
        **profile_environment(profile_path),
    }


def profile_environment(path: str) -> dict[str, str]:
    """Return the environment variables that give a process a profile."""
    return {"FASTRTPS_DEFAULT_PROFILES_FILE": path, "FASTDDS_DEFAULT_PROFILES_FILE": path}


def multicast_group(participant: int, *, gathers: bool, robot: bool) -> str:
    """Return the address of the group to which a participant listens: of robots, of who gathers states, or its own."""
    if robot:
        return _ROBOTS_GROUP
    return _GATHERERS_GROUP if gathers else f"{_OWN_GROUPS}.{participant // 256}.{participant % 256}"


@dataclass(frozen=True, slots=True)
class Discovery:
    """How participants discover each other.

    Parameters
    ----------
    protocol : str
        Simple discovery, discovery server, or client of the server.
    peers : tuple, optional
        Address and UDP port of the participants to which this one announces itself; it then receives announcements on
        its own address only. None: discovery by multicast or through the server.
    server : tuple, optional
        Address and UDP port of the server.
    """

    protocol: Literal["SIMPLE", "SERVER", "CLIENT"] = "SIMPLE"
    peers: tuple[tuple[str, int], ...] | None = None
    server: tuple[str, int] | None = None


def multicast_works(timeout: float = 0.5) -> bool:
    """Return whether multicast works on loopback, by sending a datagram to this process; `timeout` in s."""
    loopback = socket.inet_aton(_LOOPBACK)
    group = _ROBOTS_GROUP
    try:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hear,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as speak,
        ):
            hear.bind((group, 0))
            hear.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + loopback)
            hear.settimeout(timeout)
            speak.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            speak.sendto(b"swarmabs", (group, hear.getsockname()[1]))
            return hear.recv(16) == b"swarmabs"
    except OSError:
        return False


def profile_xml(
    domain: int,
    *,
    peers: Iterable[int] = range(COORDINATORS),
    participant: str = FROM_ENVIRONMENT,
    multicast: bool = False,
    realtime: bool = False,
) -> str:
    """Return the profile of a run on this machine.

    Parameters
    ----------
    peers : iterable of int
        Ids of the participants to which this one announces itself: the coordinators for a node of the swarm, all
        participants for a tool that observes the whole run.
    participant : str
        Source of the participant id: `FROM_ENVIRONMENT` or `FIRST_FREE`.
    multicast : bool
        Whether to join the group whose address is in the environment variable `GROUP_VARIABLE`.
    realtime : bool
        Whether silent participants are forgotten quickly and writers assert their liveliness. Real-time nodes need it:
        Fast DDS crashes when a writer without this protocol asserts its liveliness.
    """
    announced = tuple((_LOOPBACK, ports.metatraffic_port(domain, peer)) for peer in peers)
    return _template().render(
        transport="loopback",
        address=_LOOPBACK,
        participant=participant,
        discovery=Discovery(peers=announced),
        realtime=realtime,
        lease=REALTIME_LEASE if realtime else _LOCKSTEP_LEASE,
        group={"variable": GROUP_VARIABLE, "port": ports.multicast_port(domain)} if multicast else None,
    )


def network_profile_xml(
    address: str, discovery: Discovery, participant: str = FROM_ENVIRONMENT, *, lease: int = REALTIME_LEASE
) -> str:
    """Return the profile of real-time nodes on one address of a network; for a single machine see `profile_xml`.

    A participant is forgotten after a silence of `lease` seconds.
    """
    return _template().render(
        transport="swarm",
        address=address,
        participant=participant,
        discovery=discovery,
        realtime=True,
        lease=lease,
        group=None,
    )


@cache
def _template() -> Template:
    variables = {"ports": vars(ports), "prefix": _SERVER_PREFIX}
    return templates("swarmabs_run").get_template("fastdds.xml.j2", globals=variables)

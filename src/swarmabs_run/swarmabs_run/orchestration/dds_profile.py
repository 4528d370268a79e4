"""The Fast DDS profile of a run: loopback only, fixed participant ids, and robots that never discover each other.

Every participant announces itself to the coordinators alone, so discovery grows with the number of robots and not
with its square: that is what lets 200 processes find each other in seconds. Only UDP is used: a process that is
killed leaves no file of shared memory behind.

Where the machine can multicast on loopback, a broadcast is sent once for all robots, and a robot's state once for all
who gather the states. These are groups of their own, and so is the parent controller: nobody is woken by the many
messages that are not for it.
"""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from swarmabs_config.graph import CONTROLLER, COORDINATORS, NODES
from swarmabs_config.ports import multicast_port
from swarmabs_run.orchestration.dds_template import SIMPLE, Discovery, render, unicast_locators

if TYPE_CHECKING:
    from collections.abc import Iterable

PARTICIPANT_VARIABLE = "SWARMABS_PARTICIPANT"
"""Environment variable that holds a process's participant id."""

FROM_ENVIRONMENT = f"<participantID>${{{PARTICIPANT_VARIABLE}}}</participantID>"
"""One file serves all processes of a run: each finds its participant id in its environment."""
FIRST_FREE = ""
"""The process takes the first participant id that nobody has."""

GROUP_VARIABLE = "SWARMABS_GROUP"
"""Environment variable that holds the address of a process's multicast group."""
_ROBOTS, _CONTROLLER, _GATHERERS = "239.255.83.1", "239.255.83.2", "239.255.83.3"

REALTIME_LEASE = 5
"""Silence, s, after which a participant in real time is forgotten: it may have been restarted as another one."""

_LOOPBACK = "127.0.0.1"

# Unicast must be listed too: naming a group would otherwise replace it.
_MULTICAST = """<defaultUnicastLocatorList>
          <locator><udpv4><address>127.0.0.1</address></udpv4></locator>
        </defaultUnicastLocatorList>
        <defaultMulticastLocatorList>
          <locator><udpv4><address>${{{group}}}</address><port>{port}</port></udpv4></locator>
        </defaultMulticastLocatorList>"""


def multicast_group(participant: int) -> str:
    """Return the address of the group to which a participant listens."""
    if participant >= COORDINATORS:
        return _ROBOTS
    # The parent controller is the one coordinator that does not hear the robots.
    return _CONTROLLER if participant == NODES[CONTROLLER].participant else _GATHERERS


def multicast_works(timeout: float = 0.5) -> bool:
    """Try whether this machine carries multicast on loopback, by sending itself a datagram; `timeout` in s."""
    loopback = socket.inet_aton("127.0.0.1")
    group = _ROBOTS
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
    """Return the profile.

    Parameters
    ----------
    domain : int
        ROS domain of the run.
    peers : iterable of int
        Ids of the participants to which this one announces itself. The coordinators suffice for a member of the swarm;
        a tool that wants to see everybody needs everybody.
    participant : str
        How the participant id is found: `FROM_ENVIRONMENT` or `FIRST_FREE`.
    multicast : bool
        Whether to listen to the group whose address is in the environment variable `GROUP_VARIABLE`.
    realtime : bool
        Whether participants that fall silent are forgotten soon, and writers assert that they live. Nodes in real time
        need it: Fast DDS crashes when a writer without this protocol asserts anything.
    """
    locators = unicast_locators(_LOOPBACK, domain, ((_LOOPBACK, peer) for peer in peers))
    lease, announcement = (REALTIME_LEASE, 1) if realtime else (3600, 2)
    return render(
        transport="loopback",
        address=_LOOPBACK,
        participant=participant,
        discovery=Discovery(SIMPLE, locators, lease, announcement, liveliness=realtime),
        multicast=_MULTICAST.format(group=GROUP_VARIABLE, port=multicast_port(domain)) if multicast else "",
    )


def dds_environment(domain: int, profile_path: str) -> dict[str, str]:
    """Return the environment variables that put a process into a run's domain."""
    return {
        "ROS_DOMAIN_ID": str(domain),
        # LOCALHOST and SUBNET would make the middleware add transports of its own to those of the profile.
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "RMW_FASTRTPS_PUBLICATION_MODE": "SYNCHRONOUS",
        "FASTRTPS_DEFAULT_PROFILES_FILE": profile_path,
        "FASTDDS_DEFAULT_PROFILES_FILE": profile_path,
    }

"""The network of a run: claims on ROS domains, and the Fast DDS profile, read as XML."""

import errno
import ipaddress
import os
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack, suppress
from xml.etree import ElementTree as ET

import psutil
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.serialization import serialize_message
from tests.processes import until

from swarmabs_config import ports
from swarmabs_config.graph import COORDINATORS, Qos
from swarmabs_core.errors import RunError
from swarmabs_core.messages import AGENT_STATE
from swarmabs_ros.endpoints import Receiver, profile, ros_type
from swarmabs_run.orchestration.network import (
    FIRST_FREE,
    FROM_ENVIRONMENT,
    GROUP_VARIABLE,
    PARTICIPANT_VARIABLE,
    claimed_domain,
    held_port,
    multicast_group,
    multicast_works,
    profile_xml,
    udp_ports,
)

NAMESPACE = {"d": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}
LARGE_SWARM = COORDINATORS + 195
LARGEST_SWARM = 950
"""Participants whose ports span four claims."""
MULTICAST = {"multicast": True}
HOLDER = """
import sys
from swarmabs_run.orchestration.network import claimed_domain
with claimed_domain() as domain:
    print(domain, flush=True)
    sys.stdin.read()
"""


def said(path: str, domain: int = 5, **options: object) -> list[str]:
    root = ET.fromstring(profile_xml(domain, **options))  # type: ignore[arg-type]
    return [element.text or "" for element in root.findall(f".//d:{path}", NAMESPACE)]


def used_ports(domain: int, participants: int) -> set[int]:
    """Return every port of a run, by the formula of the DDS standard with the profile's own numbers."""
    offsets = (f"offsetd{index}" for index in range(4))
    base, by_domain, gain, d0, d1, d2, d3 = (
        int(said(name, domain)[0]) for name in ("portBase", "domainIDGain", "participantIDGain", *offsets)
    )
    base += by_domain * domain
    multicast = {base + d0, base + d2}
    unicast = {base + offset + gain * participant for offset in (d1, d3) for participant in range(participants)}
    assert len(unicast) == 2 * participants, "two participants share a port"
    assert not multicast & unicast
    return multicast | unicast


@pytest.mark.parametrize("domain", [5, 100, ports.LARGEST_DOMAIN - ports.SPACING])
def test_ports_of_runs_side_by_side_are_disjoint(domain: int) -> None:
    here, there = used_ports(domain, LARGE_SWARM), used_ports(domain + ports.SPACING, LARGE_SWARM)
    assert not here & there
    assert max(here | there) < 2**16
    guard = ports.metatraffic_port(domain, 0) - ports.METATRAFFIC_OFFSET + ports.GUARD_OFFSET
    assert not {guard, ports.multicast_port(domain)} & here
    assert ports.multicast_port(domain) != guard
    assert ports.metatraffic_port(domain, 0) - 1 == ports.metatraffic_port(domain, -1) + ports.PARTICIPANT_GAIN - 1
    assert ports.metatraffic_port(domain, 203) + 1 < 32768, "Linux gives away those above by default"


LIVELINESS = ("use_WriterLivelinessProtocol", "leaseDuration/d:sec", "leaseAnnouncement/d:sec")


@pytest.mark.parametrize(
    ("options", "path", "words"),
    [
        ({}, "initialPeersList//d:port", [str(ports.metatraffic_port(5, peer)) for peer in range(COORDINATORS)]),
        (
            {"peers": range(30)},
            "initialPeersList//d:port",
            [str(ports.metatraffic_port(5, peer)) for peer in range(30)],
        ),
        ({}, "transport_descriptor/d:type", ["UDPv4"]),
        ({}, "useBuiltinTransports", ["false"]),
        ({"participant": FROM_ENVIRONMENT}, "participantID", [f"${{{PARTICIPANT_VARIABLE}}}"]),
        ({"participant": FIRST_FREE}, "participantID", []),
        *(({"realtime": False}, *values) for values in zip(LIVELINESS, (["false"], ["60"], ["2"]), strict=True)),
        *(({"realtime": True}, *values) for values in zip(LIVELINESS, (["true"], ["5"], ["1"]), strict=True)),
        ({}, "defaultMulticastLocatorList", []),
        ({}, "defaultUnicastLocatorList", []),
        (MULTICAST, "defaultMulticastLocatorList/d:locator/d:udpv4/d:address", [f"${{{GROUP_VARIABLE}}}"]),
        (MULTICAST, "defaultMulticastLocatorList/d:locator/d:udpv4/d:port", [str(ports.multicast_port(5))]),
        (MULTICAST, "defaultUnicastLocatorList//d:address", ["127.0.0.1"]),
    ],
)
def test_the_profile_says_who_hears_whom_and_how(options: dict[str, object], path: str, words: list[str]) -> None:
    assert said(path, **options) == words  # type: ignore[arg-type]
    loopback = {"127.0.0.1"} | ({f"${{{GROUP_VARIABLE}}}"} if options is MULTICAST else set())
    assert {*said("address", **options)} == loopback  # type: ignore[arg-type]


def test_robots_share_a_group_and_so_do_those_who_hear_them_while_others_have_their_own() -> None:
    participants = range(LARGE_SWARM + 100)
    robots = {multicast_group(participant, gathers=False, robot=True) for participant in participants}
    gatherers = {multicast_group(participant, gathers=True, robot=False) for participant in participants}
    others = {multicast_group(participant, gathers=False, robot=False) for participant in participants}
    assert (len(robots), len(gatherers), len(others)) == (1, 1, len(participants))
    assert len(robots | gatherers | others) == 2 + len(participants)
    assert all(ipaddress.ip_address(group).is_multicast for group in robots | gatherers | others)


@pytest.mark.parametrize("arrived", [b"swarmabs", b"another", None])
def test_multicast_works_where_the_datagram_arrives(monkeypatch: pytest.MonkeyPatch, arrived: bytes | None) -> None:
    with monkeypatch.context() as patch:
        for method, answer in (("setsockopt", None), ("sendto", 8), *([("recv", arrived)] if arrived else [])):
            patch.setattr(socket.socket, method, lambda *_, answer=answer: answer)
        assert multicast_works(timeout=0.01) == (arrived == b"swarmabs")

    def unable(*_: object) -> None:
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    monkeypatch.setattr(socket.socket, "setsockopt", unable)
    assert not multicast_works(timeout=0.01)


@pytest.mark.usefixtures("ros")
def test_as_many_messages_wait_for_a_reader_as_it_asks_for() -> None:
    """Fast DDS by itself keeps 5,000 at most, whatever the depth: less than a large swarm sends in three steps."""
    messages, block = 6000, 500
    rclpy.init()
    node = Node("patient", enable_rosout=False)
    publisher = node.create_publisher(ros_type(AGENT_STATE), AGENT_STATE.name, profile(Qos("reliable", block)))
    reader = Receiver(node, {AGENT_STATE: Qos("reliable", messages)})
    until(lambda: reader.publisher_count(AGENT_STATE), "the reader has met the publisher")
    data = serialize_message(ros_type(AGENT_STATE)())
    for _ in range(messages // block):
        for _ in range(block):
            publisher.publish(data)
        assert publisher.wait_for_all_acked(Duration(seconds=10))
    assert sum(reader.take(AGENT_STATE) is not None for _ in range(messages)) == messages
    node.destroy_node()


def guard_is_free(claimed: int) -> bool:
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", ports.PORT_BASE + ports.DOMAIN_GAIN * claimed + ports.GUARD_OFFSET))
        return True
    return False


def test_claims_differ_and_are_five_apart() -> None:
    with ExitStack() as stack:
        domains = [stack.enter_context(claimed_domain()) for _ in range(5)]
        assert len(set(domains)) == 5
        assert all(claimed % ports.SPACING == 0 and 0 < claimed <= ports.LARGEST_DOMAIN for claimed in domains)
        assert not any(guard_is_free(claimed) for claimed in domains)
    assert all(guard_is_free(claimed) for claimed in domains)
    with pytest.raises(KeyError), claimed_domain() as claimed:
        raise KeyError
    assert guard_is_free(claimed)


def test_a_claim_over_many_ports_needs_them_all() -> None:
    with claimed_domain(LARGEST_SWARM) as first:
        pass
    taken = first + 2 * ports.SPACING
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as foreign:
        foreign.bind(("127.0.0.1", ports.PORT_BASE + ports.DOMAIN_GAIN * taken + ports.GUARD_OFFSET))
        with claimed_domain(LARGEST_SWARM) as second:
            assert not second <= taken < second + 4 * ports.SPACING


@pytest.mark.parametrize("address", ["127.0.0.1", "0.0.0.0", "::", "239.255.83.1"])
def test_a_domain_of_which_a_stranger_holds_a_port_is_not_claimed(address: str) -> None:
    """Whichever it is, and however it is held, as by a daemon of a former run."""
    with claimed_domain(LARGE_SWARM) as first:
        used = udp_ports(first, range(LARGE_SWARM))
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    assert len(used) == 1 + 2 * LARGE_SWARM
    assert set(used) <= used_ports(first, LARGE_SWARM) | {ports.multicast_port(first)}
    for port in (*used[:20], used[-1]):
        with socket.socket(family, socket.SOCK_DGRAM) as stranger:
            stranger.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            stranger.bind((address, port))
            assert held_port({port}) == f"{port} of process {os.getpid()} ({psutil.Process().name()})"
            assert held_port({port}, {os.getpid()}) == ""
            with claimed_domain(LARGE_SWARM) as claimed:
                assert claimed != first, port


def test_a_claim_ends_with_its_holder_however_that_ends() -> None:
    words = [sys.executable, "-c", HOLDER]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        claimed = int(holder.stdout.readline())
        with claimed_domain() as mine:
            assert mine != claimed
        assert not guard_is_free(claimed)
        os.kill(holder.pid, signal.SIGKILL)
        holder.wait()
    assert guard_is_free(claimed)


def test_no_domain_left_is_named_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []
    bind = socket.socket.bind

    def taken(self: socket.socket, address: tuple[str, int]) -> None:
        if not address[1]:  # any port, to check loopback
            bind(self, address)
            return
        tried.append((address[1] - ports.PORT_BASE - ports.GUARD_OFFSET) // ports.DOMAIN_GAIN)
        raise OSError(errno.EADDRINUSE, "taken")

    monkeypatch.setattr(socket.socket, "bind", taken)
    with pytest.raises(RunError, match=r"no ROS domain is free on this machine: .* end other runs"), claimed_domain():
        pytest.fail("a domain was claimed")
    assert tried[0] == ports.SPACING and tried[-1] + ports.SPACING <= ports.LARGEST_DOMAIN

"""The Fast DDS profile of a run, read as XML."""

from __future__ import annotations

import errno
import ipaddress
import os
import socket
from xml.etree import ElementTree as ET

import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.serialization import serialize_message
from tests.processes import until

from swarmabs_config.graph import CONTROLLER, COORDINATORS, NODES, Qos
from swarmabs_config.ports import (
    GUARD_OFFSET,
    LARGEST_DOMAIN,
    METATRAFFIC_OFFSET,
    PARTICIPANT_GAIN,
    SPACING,
    metatraffic_port,
    multicast_port,
)
from swarmabs_core.messages import AGENT_STATE
from swarmabs_ros.endpoints import WaitSetReceiver, profile, ros_type
from swarmabs_run.orchestration.network import (
    FIRST_FREE,
    FROM_ENVIRONMENT,
    GROUP_VARIABLE,
    PARTICIPANT_VARIABLE,
    dds_environment,
    multicast_group,
    multicast_works,
    profile_xml,
)

NAMESPACE = {"d": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}
LARGE_SWARM = COORDINATORS + 195


def parsed(domain: int = 5, **options: object) -> ET.Element:
    return ET.fromstring(profile_xml(domain, **options))  # type: ignore[arg-type]


def number(root: ET.Element, name: str) -> int:
    element = root.find(f".//d:{name}", NAMESPACE)
    assert element is not None
    assert element.text is not None
    return int(element.text)


def used_ports(domain: int, participants: int) -> set[int]:
    """Return every port of a run, by the formula of the DDS standard with the profile's own numbers."""
    root = parsed(domain)
    base = number(root, "portBase") + number(root, "domainIDGain") * domain
    gain = number(root, "participantIDGain")
    multicast = {base + number(root, f"offsetd{index}") for index in (0, 2)}
    unicast = {
        base + number(root, f"offsetd{index}") + gain * participant
        for index in (1, 3)
        for participant in range(participants)
    }
    assert len(unicast) == 2 * participants, "two participants share a port"
    assert not multicast & unicast
    return multicast | unicast


@pytest.mark.parametrize("domain", [5, 100, LARGEST_DOMAIN - SPACING])
def test_ports_of_runs_side_by_side_are_disjoint(domain: int) -> None:
    here, there = used_ports(domain, LARGE_SWARM), used_ports(domain + SPACING, LARGE_SWARM)
    assert not here & there
    assert max(here | there) < 2**16
    assert metatraffic_port(domain, 0) - 1 == metatraffic_port(domain, -1) + PARTICIPANT_GAIN - 1


def test_the_guard_is_no_port_of_a_participant() -> None:
    base = metatraffic_port(5, 0) - 10
    assert base + GUARD_OFFSET not in used_ports(5, LARGE_SWARM)


def test_members_announce_themselves_to_the_coordinators_only() -> None:
    ports = [int(port.text or "") for port in parsed().findall(".//d:initialPeersList//d:port", NAMESPACE)]
    assert ports == [metatraffic_port(5, participant) for participant in range(COORDINATORS)]


def test_a_tool_announces_itself_to_everybody() -> None:
    ports = parsed(peers=range(30)).findall(".//d:initialPeersList//d:port", NAMESPACE)
    assert len(ports) == 30


def test_only_loopback_is_used() -> None:
    root = parsed()
    addresses = {element.text for element in root.findall(".//d:address", NAMESPACE)}
    assert addresses == {"127.0.0.1"}
    assert [element.text for element in root.findall(".//d:transport_descriptor/d:type", NAMESPACE)] == ["UDPv4"]
    assert root.findtext(".//d:useBuiltinTransports", namespaces=NAMESPACE) == "false"


def test_where_the_participant_id_comes_from() -> None:
    assert parsed(participant=FROM_ENVIRONMENT).findtext(".//d:participantID", namespaces=NAMESPACE) == (
        f"${{{PARTICIPANT_VARIABLE}}}"
    )
    assert parsed(participant=FIRST_FREE).find(".//d:participantID", NAMESPACE) is None


def test_the_environment_puts_a_process_into_the_domain_and_no_transport_beside_the_profiles() -> None:
    variables = dds_environment(15, "/somewhere/fastdds.xml")
    assert variables["ROS_DOMAIN_ID"] == "15"
    assert variables["FASTRTPS_DEFAULT_PROFILES_FILE"] == "/somewhere/fastdds.xml"
    assert variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"


def test_in_real_time_writers_assert_that_they_live_and_silent_participants_are_forgotten() -> None:
    def settings(**options: object) -> tuple[str | None, int, int]:
        root = parsed(**options)
        asserted = root.findtext(".//d:use_WriterLivelinessProtocol", namespaces=NAMESPACE)
        seconds = [
            root.findtext(f".//d:{name}/d:sec", namespaces=NAMESPACE) for name in ("leaseDuration", "leaseAnnouncement")
        ]
        return asserted, int(seconds[0] or ""), int(seconds[1] or "")

    assert settings() == ("false", 3600, 2)
    asserted, lease, announcement = settings(realtime=True)
    assert asserted == "true"
    assert 3 * announcement <= lease <= 10


def test_a_profile_without_multicast_names_no_group() -> None:
    root = parsed()
    assert root.find(".//d:defaultMulticastLocatorList", NAMESPACE) is None
    assert root.find(".//d:defaultUnicastLocatorList", NAMESPACE) is None


def test_a_profile_with_multicast_keeps_unicast_beside_the_group() -> None:
    root = parsed(multicast=True)
    group = root.find(".//d:defaultMulticastLocatorList/d:locator/d:udpv4", NAMESPACE)
    assert group is not None
    assert group.findtext("d:address", namespaces=NAMESPACE) == f"${{{GROUP_VARIABLE}}}"
    assert int(group.findtext("d:port", namespaces=NAMESPACE) or "") == multicast_port(5)
    unicast = root.findall(".//d:defaultUnicastLocatorList//d:address", NAMESPACE)
    assert [address.text for address in unicast] == ["127.0.0.1"]


def test_the_groups_port_is_nobody_elses() -> None:
    assert multicast_port(5) not in used_ports(5, LARGE_SWARM)
    assert multicast_port(5) != metatraffic_port(5, 0) - METATRAFFIC_OFFSET + GUARD_OFFSET


def test_robots_the_controller_and_who_hears_the_robots_are_three_groups() -> None:
    controller = multicast_group(NODES[CONTROLLER].participant)
    gatherers = {multicast_group(n) for n in range(COORDINATORS) if n != NODES[CONTROLLER].participant}
    robots = {multicast_group(participant) for participant in range(COORDINATORS, LARGE_SWARM)}
    assert len(gatherers) == len(robots) == 1
    assert len({controller} | gatherers | robots) == 3
    assert all(ipaddress.ip_address(group).is_multicast for group in {controller} | gatherers | robots)


def test_multicast_is_found_wanting_where_it_cannot_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    class NoMulticast(socket.socket):
        def setsockopt(self, *arguments: object) -> None:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    monkeypatch.setattr(socket, "socket", NoMulticast)
    assert not multicast_works()


def test_multicast_that_never_arrives_is_found_wanting(monkeypatch: pytest.MonkeyPatch) -> None:
    class Swallowing(socket.socket):
        def sendto(self, *arguments: object) -> int:
            return 8

    monkeypatch.setattr(socket, "socket", Swallowing)
    assert not multicast_works(timeout=0.01)


@pytest.mark.usefixtures("ros")
def test_as_many_messages_wait_for_a_reader_as_it_asks_for() -> None:
    """Fast DDS by itself keeps 5,000 at most, whatever the depth: less than a large swarm sends in three steps."""
    messages, block = 6000, 500
    rclpy.init()
    node = Node("patient", enable_rosout=False)
    publisher = node.create_publisher(ros_type(AGENT_STATE), AGENT_STATE.name, profile(Qos("reliable", block)))
    reader = WaitSetReceiver(node, {AGENT_STATE: Qos("reliable", messages)})
    until(lambda: reader.publisher_count(AGENT_STATE), "the reader has met the publisher")
    data = serialize_message(ros_type(AGENT_STATE)())
    for _ in range(messages // block):
        for _ in range(block):
            publisher.publish(data)
        assert publisher.wait_for_all_acked(Duration(seconds=10))
    assert sum(reader.take(AGENT_STATE) is not None for _ in range(messages)) == messages
    node.destroy_node()

"""The Fast DDS profile of a run, read as XML."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest

from swarmabs_bringup.orchestration.dds_profile import (
    COORDINATORS,
    FIRST_FREE,
    FROM_ENVIRONMENT,
    PARTICIPANT_VARIABLE,
    dds_environment,
    profile_xml,
)
from swarmabs_bringup.orchestration.domain import (
    GUARD_OFFSET,
    LARGEST_DOMAIN,
    PARTICIPANT_GAIN,
    SPACING,
    metatraffic_port,
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

"""What the Fast DDS profiles of runs and of fleets have in common: UDP on one address, with the project's own ports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_config.ports import (
    DATA_OFFSET,
    DOMAIN_GAIN,
    METATRAFFIC_OFFSET,
    PARTICIPANT_GAIN,
    PORT_BASE,
    metatraffic_port,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

_BUFFER = 4 * 2**20
_MOST_SAMPLES = 100_000
"""Messages that may wait for a reader; by itself Fast DDS stops at 5,000, whatever depth a reader asks for."""

_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>{transport}</transport_id>
        <type>UDPv4</type>
        <sendBufferSize>{buffer}</sendBufferSize>
        <receiveBufferSize>{buffer}</receiveBufferSize>
        <interfaceWhiteList><address>{address}</address></interfaceWhiteList>
        <maxInitialPeersRange>400</maxInitialPeersRange>
      </transport_descriptor>
    </transport_descriptors>
    <participant profile_name="swarmabs" is_default_profile="true">
      <rtps>
        {participant}
        <port>
          <portBase>{port_base}</portBase>
          <domainIDGain>{domain_gain}</domainIDGain>
          <participantIDGain>{participant_gain}</participantIDGain>
          <offsetd0>0</offsetd0>
          <offsetd1>{metatraffic_offset}</offsetd1>
          <offsetd2>1</offsetd2>
          <offsetd3>{data_offset}</offsetd3>
        </port>
        {multicast}
        <userTransports><transport_id>{transport}</transport_id></userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>
        <builtin>
          <discovery_config>
            {protocol}
            <leaseDuration><sec>{lease}</sec></leaseDuration>
            <leaseAnnouncement><sec>{announcement}</sec></leaseAnnouncement>
            <initialAnnouncements>
              <count>10</count>
              <period><sec>0</sec><nanosec>200000000</nanosec></period>
            </initialAnnouncements>
          </discovery_config>
          <use_WriterLivelinessProtocol>{liveliness}</use_WriterLivelinessProtocol>
{locators}          <mutation_tries>1000</mutation_tries>
        </builtin>
      </rtps>
    </participant>
    <data_reader profile_name="reader" is_default_profile="true">
      <topic>
        <resourceLimitsQos>
          <max_samples>{most_samples}</max_samples>
          <max_samples_per_instance>{most_samples}</max_samples_per_instance>
        </resourceLimitsQos>
      </topic>
    </data_reader>
  </profiles>
</dds>
"""

SIMPLE = "<discoveryProtocol>SIMPLE</discoveryProtocol>"
"""Participants find each other without help."""


@dataclass(frozen=True, slots=True)
class Discovery:
    """How participants find each other, and when one that is silent counts as gone.

    Parameters
    ----------
    protocol : str
        The protocol with what belongs to it, in XML.
    locators : str
        Lines of XML: where a participant hears of others, and to whom it announces itself.
    lease, announcement : int
        After which time without a word a participant is gone, and how often it announces itself, s.
    liveliness : bool
        Whether writers' liveliness is asserted.
    """

    protocol: str
    locators: str
    lease: int
    announcement: int
    liveliness: bool


def locator(address: str, port: int | None = None) -> str:
    """Return a UDP locator in XML."""
    end = "" if port is None else f"<port>{port}</port>"
    return f"<locator><udpv4><address>{address}</address>{end}</udpv4></locator>"


def unicast_locators(address: str, domain: int, peers: Iterable[tuple[str, int]]) -> str:
    """Return the lines of a participant that hears of others on its own address only.

    Parameters
    ----------
    address : str
        Its own address.
    domain : int
        The ROS domain.
    peers : iterable of (str, int)
        Address and participant id of those to whom it announces itself.
    """
    lines = [
        "          <metatrafficUnicastLocatorList>",
        f"            {locator(address)}",
        "          </metatrafficUnicastLocatorList>",
        "          <initialPeersList>",
        *(f"            {locator(peer, metatraffic_port(domain, number))}" for peer, number in peers),
        "          </initialPeersList>",
    ]
    return "".join(f"{line}\n" for line in lines)


def render(*, transport: str, address: str, participant: str, discovery: Discovery, multicast: str = "") -> str:
    """Return a profile.

    Parameters
    ----------
    transport : str
        Name of the only transport.
    address : str
        The only address that is listened on and sent from.
    participant : str
        The element with the participant id, or nothing.
    discovery : Discovery
        How participants find each other.
    multicast : str
        Groups for data, in XML.
    """
    return _PROFILE.format(
        buffer=_BUFFER,
        most_samples=_MOST_SAMPLES,
        transport=transport,
        address=address,
        participant=participant,
        multicast=multicast,
        port_base=PORT_BASE,
        domain_gain=DOMAIN_GAIN,
        participant_gain=PARTICIPANT_GAIN,
        metatraffic_offset=METATRAFFIC_OFFSET,
        data_offset=DATA_OFFSET,
        protocol=discovery.protocol,
        lease=discovery.lease,
        announcement=discovery.announcement,
        liveliness=str(discovery.liveliness).lower(),
        locators=discovery.locators,
    )

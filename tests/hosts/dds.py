"""A Fast DDS profile for test hosts: one transport, UDP, on one address or on all, with or without multicast."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from swarmabs_run.orchestration.network import dds_environment

_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>udp</transport_id>
        <type>UDPv4</type>
        {allowed}
      </transport_descriptor>
    </transport_descriptors>
    <participant profile_name="host" is_default_profile="true">
      <rtps>
        <userTransports><transport_id>udp</transport_id></userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>
        <builtin>{discovery}</builtin>
      </rtps>
    </participant>
  </profiles>
</dds>
"""
_LOCATOR = "<locator><udpv4><address>{}</address></udpv4></locator>"


def dds_on(folder: Path, allowed: str | None, peers: Iterable[str] | None, domain: int = 7) -> dict[str, str]:
    """Write the profile; return the environment of those who use it.

    Parameters
    ----------
    folder : Path
        Where the profile is written.
    allowed : str, optional
        Address or name of the only interface that DDS may use; all of them without.
    peers : iterable of str, optional
        Addresses to which participants announce themselves; by multicast without.
    domain : int
        ROS domain.
    """
    unicast = peers is not None and (
        # Naming where discovery listens takes the place of the default, which is a unicast address and a group.
        f"<metatrafficUnicastLocatorList>{_LOCATOR.format(allowed)}</metatrafficUnicastLocatorList>"
        f"<initialPeersList>{''.join(_LOCATOR.format(peer) for peer in peers)}</initialPeersList>"
    )
    allow = f"<interfaceWhiteList><address>{allowed}</address></interfaceWhiteList>" if allowed else ""
    path = folder / f"{allowed or 'all'}.xml"
    path.write_text(_PROFILE.format(allowed=allow, discovery=unicast or ""), encoding="utf-8")
    return {**dds_environment(domain, str(path)), "ROS_LOG_DIR": str(folder)}

"""UDP ports of the swarm: which of them a ROS domain and a DDS participant have, and how far apart runs are."""

from __future__ import annotations

PORT_BASE = 7000
"""First UDP port of domain 0; the usual 7400 with wider spacing leaves the range of ports above domain 101."""
DOMAIN_GAIN = 100
PARTICIPANT_GAIN = 2
METATRAFFIC_OFFSET = 10
DATA_OFFSET = 11
MULTICAST_OFFSET = 5
"""No participant uses this offset; the groups of a run have the UDP port there."""
GUARD_OFFSET = 9
"""No participant uses this offset; a run holds the TCP port there as its claim on the domain."""

SPACING = 5
"""Domains between runs: 203 participants use some 420 ports, those of more than four domains."""
LARGEST_DOMAIN = 230
"""ROS 2 knows domains up to 232; all ports stay below the range from which Linux picks ports by itself."""


def metatraffic_port(domain: int, participant: int) -> int:
    """Return the UDP port on which a participant hears of others."""
    return PORT_BASE + DOMAIN_GAIN * domain + METATRAFFIC_OFFSET + PARTICIPANT_GAIN * participant


def domains_spanned(participants: int) -> int:
    """Return over how many domains the ports of a run with this many participant ids reach, in whole claims."""
    ports = DATA_OFFSET + PARTICIPANT_GAIN * participants
    return -(-ports // (DOMAIN_GAIN * SPACING)) * SPACING


def multicast_port(domain: int) -> int:
    """Return the UDP port of a run's multicast groups."""
    return PORT_BASE + DOMAIN_GAIN * domain + MULTICAST_OFFSET

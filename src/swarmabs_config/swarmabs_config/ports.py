"""UDP ports of ROS domains and DDS participants, and the spacing of the domains of runs."""

from __future__ import annotations

PORT_BASE = 7000
"""First UDP port of domain 0. With the defaults of DDS, domains above 101 reach Linux's ephemeral ports."""
DOMAIN_GAIN = 100
PARTICIPANT_GAIN = 2
METATRAFFIC_OFFSET = 10
DATA_OFFSET = 11
MULTICAST_OFFSET = 5
"""Offset, unused by participants, of the UDP port of a run's multicast groups."""
GUARD_OFFSET = 9
"""Offset, unused by participants, of the TCP port that a run holds to claim its domain."""

SPACING = 5
"""Number of domains that each run claims: 203 participants use some 420 ports, those of more than four domains."""
LARGEST_DOMAIN = 230
"""ROS 2 allows domains up to 232; up to this one, all ports stay below Linux's ephemeral ports."""


def metatraffic_port(domain: int, participant: int) -> int:
    """Return the UDP port on which a participant receives discovery data."""
    return PORT_BASE + DOMAIN_GAIN * domain + METATRAFFIC_OFFSET + PARTICIPANT_GAIN * participant


def domains_spanned(participants: int) -> int:
    """Return how many domains the ports of this many participant ids span, rounded up to whole claims."""
    ports = DATA_OFFSET + PARTICIPANT_GAIN * participants
    return -(-ports // (DOMAIN_GAIN * SPACING)) * SPACING


def multicast_port(domain: int) -> int:
    """Return the UDP port of a run's multicast groups."""
    return PORT_BASE + DOMAIN_GAIN * domain + MULTICAST_OFFSET

"""ROS domains of runs on one machine: every run has one of its own, and nobody else gets it while the run lasts."""

from __future__ import annotations

import socket
from contextlib import contextmanager
from typing import TYPE_CHECKING

from swarmabs_core.errors import RunError

if TYPE_CHECKING:
    from collections.abc import Iterator

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


@contextmanager
def claimed_domain(spacing: int = SPACING) -> Iterator[int]:
    """Hold a free domain for the time of the block.

    The claim is a bound TCP port on loopback: the kernel gives it up however this process ends.

    Parameters
    ----------
    spacing : int
        How many domains the run's ports reach over.

    Yields
    ------
    int
        The domain's id.

    Raises
    ------
    RunError
        If there is none left.
    """
    held: list[socket.socket] = []
    try:
        for first in range(SPACING, LARGEST_DOMAIN - spacing, SPACING):
            held = _claim(range(first, first + spacing, SPACING))
            if held:
                yield first
                return
        raise RunError(
            f"no ROS domain is free on this machine: the guard ports of all {LARGEST_DOMAIN // SPACING} are held; "
            "end other runs"
        )
    finally:
        for guard in held:
            guard.close()


def _claim(domains: range) -> list[socket.socket]:
    """Bind the guard ports of all these domains, or of none."""
    held: list[socket.socket] = []
    for domain in domains:
        guard = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            guard.bind(("127.0.0.1", PORT_BASE + DOMAIN_GAIN * domain + GUARD_OFFSET))
        except OSError:
            guard.close()
            for other in held:
                other.close()
            return []
        held.append(guard)
    return held

"""ROS domains of runs on one machine: every run has one of its own, and nobody else gets it while the run lasts."""

from __future__ import annotations

import socket
from contextlib import contextmanager
from typing import TYPE_CHECKING

from swarmabs_config.ports import DOMAIN_GAIN, GUARD_OFFSET, LARGEST_DOMAIN, PORT_BASE, SPACING
from swarmabs_core.errors import RunError

if TYPE_CHECKING:
    from collections.abc import Iterator


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
